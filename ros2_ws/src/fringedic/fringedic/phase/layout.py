"""Layout of a stack: the bits of a Gray code first, then whole cycles of shifts, pitch after pitch."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import groupby, pairwise

import numpy as np

from fringedic.errors import ErrorCode, ImageError, PhaseError
from fringedic.patterns.pattern import PatternKind, ProjectedPattern

_DENOMINATOR = 1000  # pitches are multiples of a thousandth of a pixel
_LONGEST = 8192.0  # [projector px], wider than the image of any projector
_ALIKE = 2.0


@dataclass(frozen=True)
class Layout:
    """The frames of a stack, sorted into Gray code and pitches.

    Attributes
    ----------
    code
        Number of frames at the beginning that show a Gray code, coarsest bit first.
    periods
        Patterns of the frames of each pitch, coarse to fine, in the order of the frames after the code.
    """

    code: int
    periods: tuple[tuple[ProjectedPattern, ...], ...]

    @property
    def pitches(self) -> list[float]:
        """Fringe pitches [projector pixel], coarse to fine."""
        return [period[0].pitch for period in self.periods]

    @property
    def counts(self) -> list[int]:
        """Number of frames of each pitch."""
        return [len(period) for period in self.periods]

    @property
    def by_beats(self) -> bool:
        """Whether the orders come from beats; see `unambiguous_range`."""
        return not self.code and nearly_alike(self.pitches)

    @property
    def unambiguous(self) -> float:
        """Range of the positions whose fringe orders the pitches determine [projector pixel]."""
        return unambiguous_range(self.pitches)

    def slices(self) -> list[slice]:
        """Return the slice of the stack that holds the frames of each pitch."""
        ends = np.cumsum([self.code, *self.counts]).tolist()
        return [slice(first, last) for first, last in pairwise(ends)]


def layout_of(patterns: Sequence[ProjectedPattern]) -> Layout:
    """Return the layout of a stack.

    Parameters
    ----------
    patterns
        Pattern of each frame.

    Raises
    ------
    PhaseError
        No phase can be measured from such a sequence.

    Examples
    --------
    >>> from fringedic.patterns import gray_code_sequence
    >>> layout = layout_of(gray_code_sequence(80, 4, 10, shifts=4).patterns)
    >>> layout.code, layout.pitches, layout.slices()
    (5, [10.0], [slice(5, 9, None)])
    """
    if not patterns:
        raise PhaseError("no frames: a phase needs at least 3", code=ErrorCode.INVALID_SEQUENCE)
    for pattern in patterns:
        if pattern.kind not in (PatternKind.FRINGES, PatternKind.GRAY_CODE):
            raise PhaseError(
                f"a frame shows '{pattern}': a phase needs fringes in every frame", code=ErrorCode.INVALID_SEQUENCE
            )
    if len({pattern.orientation for pattern in patterns}) > 1:
        raise PhaseError(
            "vertical and horizontal fringes are mixed: measure each by itself", code=ErrorCode.INVALID_SEQUENCE
        )
    code = [each for each in patterns if each.kind == PatternKind.GRAY_CODE]
    fringes = list(patterns[len(code) :])
    if any(each.kind == PatternKind.GRAY_CODE for each in fringes):
        raise PhaseError("the frames of the Gray code have to come before all fringes", code=ErrorCode.INVALID_SEQUENCE)
    periods = tuple(tuple(group) for _, group in groupby(fringes, key=lambda each: (each.pitch, each.shifts)))
    check_finer([period[0].pitch for period in periods])
    for period in periods:
        pitch, shifts = period[0].pitch, period[0].shifts
        if shifts < 3:
            raise PhaseError(
                f"pitch {pitch:g} px: {shifts} shifts, at least 3 are needed", code=ErrorCode.INVALID_SEQUENCE
            )
        shown = Counter(each.shift % shifts for each in period)
        if len(shown) < shifts or len(set(shown.values())) > 1:
            raise PhaseError(
                f"pitch {pitch:g} px: {len(period)} frames are not whole cycles of {shifts} shifts",
                code=ErrorCode.INVALID_SEQUENCE,
            )
    if code:
        if len(periods) != 1:
            raise PhaseError(
                f"a Gray code numbers the fringes of one pitch, there are {len(periods)}",
                code=ErrorCode.INVALID_SEQUENCE,
            )
        if {each.pitch for each in code} != {periods[0][0].pitch}:
            raise PhaseError(
                "the Gray code is made for another pitch than that of the fringes", code=ErrorCode.INVALID_SEQUENCE
            )
        if [each.shift for each in code] != list(range(1, code[0].shifts + 1)) or len(code) < 2:
            bits = ", ".join(str(each.shift) for each in code)
            raise PhaseError(
                f"Gray code: bits {bits}, expected every bit from 1 to {code[0].shifts} in order",
                code=ErrorCode.INVALID_SEQUENCE,
            )
    return Layout(len(code), periods)


def nearly_alike(pitches: Sequence[float]) -> bool:
    """Return whether several pitches differ by less than a factor of two, so that their beats give the orders."""
    return len(pitches) > 1 and max(pitches) < _ALIKE * min(pitches)


def unambiguous_range(pitches: Sequence[float]) -> float:
    """Return the range of the positions whose fringe orders the pitches determine [projector px].

    It is the coarsest pitch, or, for pitches that are nearly alike, the length after which the phases of all of them
    repeat: their least common multiple.

    Examples
    --------
    >>> unambiguous_range([800.0, 40.0, 8.0]), unambiguous_range([48.0, 45.0, 42.0]), unambiguous_range([21.0, 20.0])
    (800.0, 5040.0, 420.0)
    """
    if not nearly_alike(pitches):
        return max(pitches)
    parts = [Fraction(pitch).limit_denominator(_DENOMINATOR) for pitch in pitches]
    return min(
        math.lcm(*(part.numerator for part in parts)) / math.gcd(*(part.denominator for part in parts)), _LONGEST
    )


def check_finer(pitches: Sequence[float]) -> None:
    """Raise `PhaseError` for pitches that do not become finer from each to the next."""
    if any(fine >= coarse for coarse, fine in pairwise(pitches)):
        raise PhaseError(
            f"pitches {list(pitches)} px have to become finer from each to the next", code=ErrorCode.INVALID_SEQUENCE
        )


def check_frames(frames: np.ndarray, patterns: Sequence[ProjectedPattern]) -> None:
    """Raise `ImageError` unless there is one frame for each pattern."""
    if frames.ndim != 3 or len(frames) != len(patterns):
        raise ImageError(
            f"frames of shape {frames.shape} for {len(patterns)} patterns: expected ({len(patterns)}, rows, columns)"
        )


def shift_angles(patterns: Sequence[ProjectedPattern]) -> np.ndarray:
    """Return 2 pi k / q of each frame [rad] (eq. 11)."""
    return np.array([2 * np.pi * each.shift / each.shifts for each in patterns])


def pixels(shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Return the coordinates row and column of a full image."""
    return {"row": np.arange(shape[0]), "column": np.arange(shape[1])}
