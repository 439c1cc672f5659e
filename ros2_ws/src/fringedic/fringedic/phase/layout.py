"""What the frames of a stack are for: the bits of a Gray code first, then whole cycles of shifts, pitch after pitch."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np

from fringedic.errors import InvalidSequenceError, ShapeMismatchError
from fringedic.sequence import PatternKind, Projection


@dataclass(frozen=True)
class Layout:
    """Frames of a stack by their purpose.

    Attributes
    ----------
    code
        Number of frames at the beginning that show a Gray code, coarsest bit first.
    periods
        What the frames of each pitch show, coarse to fine, following each other after the code.
    """

    code: int
    periods: tuple[tuple[Projection, ...], ...]

    @property
    def pitches(self) -> list[float]:
        """Fringe pitches [projector pixel], coarse to fine."""
        return [period[0].pitch for period in self.periods]

    @property
    def counts(self) -> list[int]:
        """Number of frames of each pitch."""
        return [len(period) for period in self.periods]

    def slices(self) -> list[slice]:
        """Return where the frames of each pitch are in the stack."""
        ends = np.cumsum([self.code, *self.counts]).tolist()
        return [slice(first, last) for first, last in pairwise(ends)]


def layout_of(projections: Sequence[Projection]) -> Layout:
    """Sort the frames of a stack by their purpose.

    Raises
    ------
    InvalidSequenceError
        When no phase follows from such frames.
    """
    if not projections:
        raise InvalidSequenceError("no frames: a phase needs at least 3")
    for projection in projections:
        if projection.kind not in (PatternKind.FRINGES, PatternKind.GRAY_CODE):
            raise InvalidSequenceError(f"a frame shows '{projection}': a phase needs fringes in every frame")
    if len({projection.orientation for projection in projections}) > 1:
        raise InvalidSequenceError("vertical and horizontal fringes are mixed: measure each by itself")
    code = [each for each in projections if each.kind == PatternKind.GRAY_CODE]
    fringes = list(projections[len(code) :])
    if any(each.kind == PatternKind.GRAY_CODE for each in fringes):
        raise InvalidSequenceError("the frames of the Gray code have to come before all fringes")
    periods = tuple(tuple(group) for _, group in groupby(fringes, key=lambda each: (each.pitch, each.shifts)))
    check_finer([period[0].pitch for period in periods])
    for period in periods:
        pitch, shifts = period[0].pitch, period[0].shifts
        if shifts < 3:
            raise InvalidSequenceError(f"pitch {pitch:g} px: {shifts} shifts, at least 3 are needed")
        shown = Counter(each.shift % shifts for each in period)
        if len(shown) < shifts or len(set(shown.values())) > 1:
            raise InvalidSequenceError(
                f"pitch {pitch:g} px: {len(period)} frames are not whole cycles of {shifts} shifts"
            )
    if code:
        _check_code(code, periods)
    return Layout(len(code), periods)


def _check_code(code: list[Projection], periods: tuple[tuple[Projection, ...], ...]) -> None:
    if len(periods) != 1:
        raise InvalidSequenceError(f"a Gray code numbers the fringes of one pitch, there are {len(periods)}")
    if {each.pitch for each in code} != {periods[0][0].pitch}:
        raise InvalidSequenceError("the Gray code is made for another pitch than that of the fringes")
    if [each.shift for each in code] != list(range(1, code[0].shifts + 1)) or len(code) < 2:
        shown = ", ".join(str(each.shift) for each in code)
        raise InvalidSequenceError(f"Gray code: bits {shown}, expected every bit from 1 to {code[0].shifts} in order")


def check_finer(pitches: Sequence[float]) -> None:
    """Refuse pitches that do not become finer from each to the next."""
    if any(fine >= coarse for coarse, fine in pairwise(pitches)):
        raise InvalidSequenceError(f"pitches {list(pitches)} px have to become finer from each to the next")


def check_frames(frames: np.ndarray, projections: Sequence[Projection]) -> None:
    """Refuse frames that are not one for each projection."""
    if frames.ndim != 3 or len(frames) != len(projections):
        raise ShapeMismatchError(
            f"frames of shape {frames.shape} for {len(projections)} projections: "
            f"expected ({len(projections)}, rows, columns)"
        )


def shift_angles(projections: Sequence[Projection]) -> np.ndarray:
    """Return 2 pi k / q of each frame (eq. 11)."""
    return np.array([2 * np.pi * each.shift / each.shifts for each in projections])


def pixels(shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Return the coordinates of a full image."""
    return {"row": np.arange(shape[0]), "column": np.arange(shape[1])}
