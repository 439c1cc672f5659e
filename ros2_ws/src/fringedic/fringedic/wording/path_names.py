"""Names that become files and folders: one rule for experiments, recordings, sensors, signals, rigs and tests."""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

_LONGEST = 100  # [byte] of 255 that a file system allows: endings and numbers follow
_DIGITS = 8  # of a checksum: two of a million names differ


def path_name(text: str, otherwise: str = "unnamed") -> str:
    """Return a text as the name of a file or folder: never empty, hidden, ``.`` or ``..``, and without a separator.

    Parameters
    ----------
    text
        Any text. Letters of all languages stay.
    otherwise
        Name of a text of which nothing stays.

    Examples
    --------
    >>> [path_name(text) for text in ("plate 7", "../../plate", "..", "Probe 3/4 (20 °C)", "試験")]
    ['plate-7', 'plate', 'unnamed', 'Probe-3-4-20-C', '試験']
    """
    name = re.sub(r"[^\w.-]+", "-", text).strip(".-") or otherwise
    encoded = name.encode()
    if len(encoded) <= _LONGEST:
        return name
    return f"{encoded[:_LONGEST].decode(errors='ignore')}-{_checksum(text)}"


def recording_names(places: Iterable[str | os.PathLike[str]]) -> dict[str, str]:
    """Return the shortest name of each recording that distinguishes it: the end of its path.

    The folder ``bag`` of a run is named as its run.

    Parameters
    ----------
    places
        Paths, or addresses of an object store.

    Returns
    -------
    dict
        The names by the places, each another one, as of `path_name`.

    Examples
    --------
    >>> recording_names(["/a/plate-7/bag", "/a/plate-8/bag", "/b/plate-8.mcap"])
    {'/a/plate-7/bag': 'plate-7', '/a/plate-8/bag': 'a_plate-8', '/b/plate-8.mcap': 'b_plate-8'}
    """
    parts = {str(place): _parts(str(place)) for place in places}
    names: dict[str, str] = {}
    for depth in range(1, 1 + max(map(len, parts.values()), default=0)):
        candidates = {place: path_name("_".join(parts[place][-depth:])) for place in parts if place not in names}
        counted = Counter([*candidates.values(), *names.values()])
        names |= {place: name for place, name in candidates.items() if counted[name] == 1}
    # "plate 7" and "plate-7" in one folder have the same name, and stay apart by their paths
    same = {place: f"{path_name(parts[place][-1])}-{_checksum(place)}" for place in parts if place not in names}
    return {place: names.get(place) or same[place] for place in parts}


def _parts(place: str) -> list[str]:
    """Return the parts of the path that name a recording."""
    path = Path("/", place.split("://")[1]) if "://" in place else Path(os.path.abspath(place))
    named = path.parent if path.name == "bag" else path.with_suffix("") if path.suffix == ".mcap" else path
    return [path_name(part) for part in named.parts[1:]] or ["recording"]


def _checksum(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]
