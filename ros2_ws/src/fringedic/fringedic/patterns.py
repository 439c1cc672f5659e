"""The patterns that the projector shows: phase-shifted fringes (eq. 8), white light and set-up patterns."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fringedic.errors import InvalidPatternError
from fringedic.sequence import Orientation, PatternKind, Projection

DARKEST, BRIGHTEST = 5, 250  # clear of both ends of the 8-bit scale, where projectors clip
SETUP_PATTERNS = ("dark", "grid", "crosshair")
_GRID_SPACING = 50  # projector pixels between the lines of the set-up grid


@dataclass(frozen=True)
class PatternSequence:
    """The frames that measure one step, iterable as 8-bit images of shape (height, width).

    Attributes
    ----------
    width, height
        Size of the projector [px].
    projections
        What each frame shows: pitches coarse to fine, within a pitch k = 1..n q.
    """

    width: int
    height: int
    projections: tuple[Projection, ...]

    def __len__(self) -> int:
        return len(self.projections)

    def __iter__(self) -> Iterator[np.ndarray]:
        return map(self.image, self.projections)

    def frame(self, index: int) -> np.ndarray:
        """Return frame `index` of the sequence, uint8 of shape (height, width)."""
        return self.image(self.projections[index])

    def image(self, projection: Projection) -> np.ndarray:
        """Return the image of any projection at this projector's size, uint8 of shape (height, width)."""
        return render_pattern(projection, self.width, self.height)


def fringe_sequence(
    width: int,
    height: int,
    pitches: Sequence[float],
    shifts: int | Sequence[int],
    orientation: str = "vertical",
    *,
    periods: int = 1,
) -> PatternSequence:
    """Return the n x q phase-shifted frames of every pitch.

    Parameters
    ----------
    width, height
        Size of the projector [px].
    pitches
        Fringe pitches [projector px], coarse to fine. The coarsest has to be at least as wide as the part of the
        projector's image that the camera sees, or the absolute phase is ambiguous.
    shifts
        q of eq. 11, at least 3: one number, or one for each pitch.
    orientation
        "vertical": fringes along y, the phase grows with the column; "horizontal": along x, it grows upwards.
    periods
        n of eq. 11: how often each cycle of q frames is shown.

    Raises
    ------
    InvalidPatternError
        When a pitch, a number of shifts or a size cannot be shown, or the pitches do not become finer.
    """
    if orientation.upper() not in Orientation.__members__:
        raise InvalidPatternError(f"orientation '{orientation}' is unknown: use 'vertical' or 'horizontal'")
    if not pitches:
        raise InvalidPatternError("a fringe sequence needs at least one pitch")
    if periods < 1:
        raise InvalidPatternError(f"{periods} periods of shifts: show at least one")
    of_each = [shifts] * len(pitches) if isinstance(shifts, int) else list(shifts)
    if len(of_each) != len(pitches):
        raise InvalidPatternError(f"{len(of_each)} numbers of shifts for {len(pitches)} pitches: give one for each")
    if any(fine >= coarse for coarse, fine in pairwise(pitches)):
        raise InvalidPatternError(f"pitches {list(pitches)} px have to become finer from each to the next")
    projections = tuple(
        Projection(PatternKind.FRINGES, Orientation[orientation.upper()], float(pitch), shift, count)
        for pitch, count in zip(pitches, of_each, strict=True)
        for shift in range(1, periods * count + 1)
    )
    for projection in projections:
        _check(projection, width, height)
    return PatternSequence(width, height, projections)


def render_pattern(projection: Projection, width: int, height: int, name: str = "") -> np.ndarray:
    """Return the 8-bit image of one projection.

    Fringes are ``I = A + B cos(phi - 2 pi k / q)`` between 5 and 250 with ``phi = 2 pi (c - (width - 1)/2) / pitch``
    at column c, or ``phi = 2 pi ((height - 1)/2 - row) / pitch`` for horizontal ones: zero at the centre of the
    image for every pitch, growing to the right or upwards. White is as bright as the brightest fringe.

    Parameters
    ----------
    projection
        What to show.
    width, height
        Size of the projector [px].
    name
        Which set-up pattern, for projections of kind OTHER: "dark", "grid" or "crosshair".

    Returns
    -------
    ndarray
        uint8, shape (height, width).

    Raises
    ------
    InvalidPatternError
        When there is no such pattern.
    """
    _check(projection, width, height)
    if projection.kind == PatternKind.FRINGES:
        return _fringes(projection, width, height)
    if projection.kind == PatternKind.WHITE:
        return np.full((height, width), BRIGHTEST, np.uint8)
    image = np.zeros((height, width), np.uint8)
    if name == "grid":
        image[_lines(height), :] = BRIGHTEST
        image[:, _lines(width)] = BRIGHTEST
    elif name == "crosshair":
        image[(height - 1) // 2 : height // 2 + 1, :] = BRIGHTEST
        image[:, (width - 1) // 2 : width // 2 + 1] = BRIGHTEST
    elif name != "dark":
        raise InvalidPatternError(f"set-up pattern '{name}' is unknown: use one of {', '.join(SETUP_PATTERNS)}")
    return image


def _fringes(projection: Projection, width: int, height: int) -> np.ndarray:
    vertical = projection.orientation == Orientation.VERTICAL
    length = width if vertical else height
    position = np.arange(length) - (length - 1) / 2
    phase = 2 * np.pi * (position if vertical else -position) / projection.pitch
    wave = np.cos(phase - 2 * np.pi * projection.shift / projection.shifts)
    levels = np.round((BRIGHTEST + DARKEST) / 2 + (BRIGHTEST - DARKEST) / 2 * wave).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(levels if vertical else levels[:, None], (height, width)))


def _lines(length: int) -> np.ndarray:
    """Return every pixel at a multiple of the grid's spacing from the middle."""
    return np.arange(length // 2 % _GRID_SPACING, length, _GRID_SPACING)


def _check(projection: Projection, width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise InvalidPatternError(f"projector of {width}x{height} px: both have to be at least 1")
    if projection.kind != PatternKind.FRINGES:
        return
    if not math.isfinite(projection.pitch) or projection.pitch <= 2:
        raise InvalidPatternError(f"{projection}: the pitch has to be above 2 projector pixels")
    if projection.shifts < 3:
        raise InvalidPatternError(f"{projection}: at least 3 shifts are needed to separate mean, modulation and phase")
    if projection.shift < 1:
        raise InvalidPatternError(f"{projection}: shifts are counted from 1")
