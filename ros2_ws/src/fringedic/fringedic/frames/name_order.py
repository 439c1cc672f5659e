"""Order of image files by the numbers in their names, as people write them."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any

# a sign, which never follows a digit (2024-05-01), and digits, which may have points or decimal commas between them, or
# one before them (_.5)
_NUMBER = re.compile(r"((?<!\d)[-+])?(\d+(?:[.,]\d+)*|(?<![^\W_])\.\d+)")
_POINT = re.compile(r"[.,]")
_JOINED = re.compile(r"[^\W_]|\s")  # a hyphen behind a letter or a space may join a word and a counter
_Place = tuple[str, ...]  # the texts before a number


def order_by_name(files: Iterable[Path]) -> list[Path]:
    """Return files in the order of the numbers in their names: -1, 0, 0.25, 0.5, 2, 10.

    Names are compared part by part, texts as texts without their case, numbers by their values. Numbers are at the same
    place if the texts before them are equal.

    - A point or comma between digits is that of a decimal number. It separates counters, as in 1.9 and 1.10, if a
      number at this place has several points, or if the numbers behind the points count on without a gap, have
      different lengths, and none has a leading zero.
    - A hyphen before a number separates behind a digit, as in dates and times. Behind a letter or a space it separates,
      as in ``img-1`` and ``img-2``, unless another name has a number without a hyphen at this place: in ``x-1`` and
      ``x0`` it is a minus sign. At the start of a name and behind other characters it is a minus sign.

    Parameters
    ----------
    files
        Only their names are compared, not their folders.

    Returns
    -------
    list of Path
        Names with equal numbers, such as 1 and 01, are in alphabetical order.

    Examples
    --------
    >>> def order(*names):
    ...     return " ".join(file.name for file in order_by_name(map(Path, names)))
    >>> order("load_10.tif", "load_0.5.tif", "load_0.tif", "load_0.25.tif", "load_-10.tif")
    'load_-10.tif load_0.tif load_0.25.tif load_0.5.tif load_10.tif'
    >>> order("img-10.tif", "img-2.tif")
    'img-2.tif img-10.tif'
    """
    named = [(file, _Name.of(file)) for file in files]
    places: dict[_Place, _Numbers] = defaultdict(_Numbers)
    for _, name in named:
        for place, sign, digits in name.numbers():
            places[place].add(sign, digits)
    named.sort(key=lambda each: (each[1].key(places), each[0].suffix.lower(), each[0].name))
    return [file for file, _ in named]


@dataclass
class _Numbers:
    """The numbers of all names at one place."""

    unsigned: bool = False
    most_points: int = 0
    behind_point: set[str] = field(default_factory=set)

    def add(self, sign: str, digits: str) -> None:
        parts = _POINT.split(digits)
        self.unsigned |= sign != "-"
        self.most_points = max(self.most_points, len(parts) - 1)
        self.behind_point |= set(parts[1:2])

    def are_counters(self) -> bool:
        """Return whether points separate counters."""
        if self.most_points != 1:
            return self.most_points > 1
        counted = sorted(map(int, self.behind_point))
        return (
            len(set(map(len, self.behind_point))) > 1
            and not any(part.startswith("0") and part != "0" for part in self.behind_point)
            and counted == list(range(counted[0], counted[0] + len(counted)))
        )


@dataclass(frozen=True)
class _Name:
    """The name of a file without its suffix: texts, and between them signs and digits."""

    texts: list[str]
    signs: list[str]
    digits: list[str]

    @classmethod
    def of(cls, file: Path) -> _Name:
        parts = [part or "" for part in _NUMBER.split(file.stem.lower())]
        return cls(parts[::3], parts[1::3], parts[2::3])

    def numbers(self) -> Iterable[tuple[_Place, str, str]]:
        """Yield place, sign and digits of each number."""
        for index, (sign, digits) in enumerate(zip(self.signs, self.digits, strict=True)):
            yield tuple(self.texts[: index + 1]), sign, digits

    def key(self, places: dict[_Place, _Numbers]) -> list[Any]:
        """Return texts and the values of numbers in turns."""
        key: list[Any] = [self.texts[0]]
        for place, sign, digits in self.numbers():
            numbers, before = places[place], place[-1][-1:]
            parts = _POINT.split(digits) if numbers.are_counters() else [digits.replace(",", ".")]
            is_minus = sign == "-" and (numbers.unsigned or not _JOINED.match(before))
            values = [Decimal(part or 0) for part in parts]
            key += [[-value for value in values] if is_minus else values, self.texts[len(place)]]
        return key
