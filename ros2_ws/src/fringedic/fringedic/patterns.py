"""The patterns that the projector shows: phase-shifted fringes (eq. 8), Gray codes, plain light, set-up patterns."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from fringedic.errors import InvalidPatternError
from fringedic.response import ResponseCurve
from fringedic.sequence import Orientation, PatternKind, Projection

FringeOrder = Literal["pitches", "gray_code", "one_image"]
DARKEST, BRIGHTEST = 5, 250  # clear of both ends of the 8-bit scale, where projectors clip
SETUP_PATTERNS = ("dark", "grid", "crosshair", "focus")
_GRID_SPACING = 50  # projector pixels between the lines of the set-up grid
_FOCUS_TILE = 24  # projector pixels; lines of 1 to 4 px fit in whole pairs


@dataclass(frozen=True)
class PatternSequence:
    """The frames that measure one step, iterable as 8-bit images of shape (height, width).

    Attributes
    ----------
    width, height
        Size of the projector [px].
    projections
        What each frame shows: pitches coarse to fine, within a pitch k = 1..n q.
    response
        Response curve that the images make up for, None for a projector and a camera without one.
    """

    width: int
    height: int
    projections: tuple[Projection, ...]
    response: ResponseCurve | None = None

    def __len__(self) -> int:
        return len(self.projections)

    def __iter__(self) -> Iterator[np.ndarray]:
        return map(self.image, self.projections)

    def frame(self, index: int) -> np.ndarray:
        """Return frame `index` of the sequence, uint8 of shape (height, width)."""
        return self.image(self.projections[index])

    def image(self, projection: Projection) -> np.ndarray:
        """Return the image of any projection at this projector's size, uint8 of shape (height, width)."""
        return render_pattern(projection, self.width, self.height, response=self.response)


def fringe_sequence(
    width: int,
    height: int,
    pitches: Sequence[float],
    shifts: int | Sequence[int],
    orientation: str = "vertical",
    *,
    periods: int = 1,
    response: ResponseCurve | None = None,
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
    response
        Response curve that the images make up for.

    Raises
    ------
    InvalidPatternError
        When a pitch, a number of shifts or a size cannot be shown, or the pitches do not become finer.
    """
    direction = _direction(orientation)
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
        Projection(PatternKind.FRINGES, direction, float(pitch), shift, count)
        for pitch, count in zip(pitches, of_each, strict=True)
        for shift in range(1, periods * count + 1)
    )
    return _checked(PatternSequence(width, height, projections, response))


def gray_code_sequence(
    width: int,
    height: int,
    pitch: float,
    shifts: int,
    orientation: str = "vertical",
    *,
    periods: int = 1,
    response: ResponseCurve | None = None,
) -> PatternSequence:
    """Return a Gray code that numbers the fringes of one pitch, followed by their n x q phase-shifted frames.

    The code numbers half periods, one bit more than the orders need: its edges lie a quarter of a period away from
    where the order is read, so that a bit that is blurred at its edge never makes a wrong order.

    Parameters
    ----------
    width, height, pitch, shifts, orientation, periods, response
        See `fringe_sequence`; there is one pitch.

    Raises
    ------
    InvalidPatternError
        When pitch, number of shifts or size cannot be shown.
    """
    direction = _direction(orientation)
    if periods < 1:
        raise InvalidPatternError(f"{periods} periods of shifts: show at least one")
    fringes = Projection(PatternKind.FRINGES, direction, float(pitch), 1, shifts)
    _check(fringes, width, height)
    length = width if direction == Orientation.VERTICAL else height
    bits = max(2, math.ceil(math.log2(length / pitch + 2)) + 1)
    code = [Projection(PatternKind.GRAY_CODE, direction, float(pitch), bit, bits) for bit in range(1, bits + 1)]
    steps = [replace(fringes, shift=shift) for shift in range(1, periods * shifts + 1)]
    return PatternSequence(width, height, (*code, *steps), response)


def one_image_sequence(
    width: int,
    height: int,
    pitch: float,
    orientation: str = "vertical",
    *,
    grey: bool = False,
    response: ResponseCurve | None = None,
) -> PatternSequence:
    """Return one fringe image for events that are too fast for phase stepping.

    Parameters
    ----------
    width, height, pitch, orientation, response
        See `fringe_sequence`; there is one pitch.
    grey
        Show uniform grey as bright as the mean of the fringes first, for the texture of the surface.

    Raises
    ------
    InvalidPatternError
        When pitch or size cannot be shown.
    """
    fringes = Projection(PatternKind.FRINGES, _direction(orientation), float(pitch), 1, 1)
    plain = (Projection(PatternKind.GREY, shift=1, shifts=2),) if grey else ()
    return _checked(PatternSequence(width, height, (*plain, fringes), response))


def step_sequence(
    width: int,
    height: int,
    pitches: Sequence[float],
    shifts: Sequence[int],
    orientation: str = "vertical",
    fringe_order: FringeOrder = "pitches",
    *,
    grey_frame: bool = False,
) -> PatternSequence:
    """Return what a rig shows for one step.

    Parameters
    ----------
    width, height, pitches, orientation
        See `fringe_sequence`.
    shifts
        q of each pitch.
    fringe_order
        What tells the fringe orders. ``pitches``: each coarser one the next; ``gray_code``: a code, of the finest
        pitch alone; ``one_image``: nothing, one image of the finest pitch is all there is.
    grey_frame
        With one image, show uniform grey first, for the texture of the surface.

    Raises
    ------
    InvalidPatternError
        See `fringe_sequence`.
    """
    if fringe_order == "gray_code":
        return gray_code_sequence(width, height, pitches[-1], shifts[-1], orientation)
    if fringe_order == "one_image":
        return one_image_sequence(width, height, pitches[-1], orientation, grey=grey_frame)
    return fringe_sequence(width, height, pitches, shifts, orientation)


def render_pattern(
    projection: Projection, width: int, height: int, name: str = "", *, response: ResponseCurve | None = None
) -> np.ndarray:
    """Return the 8-bit image of one projection.

    Fringes are ``I = A + B cos(phi - 2 pi k / q)`` between 5 and 250 with ``phi = 2 pi (c - (width - 1)/2) / pitch``
    at column c, or ``phi = 2 pi ((height - 1)/2 - row) / pitch`` for horizontal ones: zero at the centre of the
    image for every pitch, growing to the right or upwards. White is as bright as the brightest fringe. The Gray code of
    a pitch numbers half periods, as many on both sides of the centre.

    Parameters
    ----------
    projection
        What to show.
    width, height
        Size of the projector [px].
    name
        Which set-up pattern, for projections of kind OTHER: "dark", "grid", "crosshair" or "focus" (tiles of lines of
        1 to 4 px).
    response
        Response curve that fringes and Gray codes make up for, so that the camera's grey levels are what is said
        above.

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
    if projection.kind in (PatternKind.FRINGES, PatternKind.GRAY_CODE):
        levels = _levels(projection, width, height)
        if response is not None:
            levels = response.level_for(levels / 255)
        shown = np.round(levels).astype(np.uint8)
        vertical = projection.orientation == Orientation.VERTICAL
        return np.ascontiguousarray(np.broadcast_to(shown if vertical else shown[:, None], (height, width)))
    if projection.kind == PatternKind.WHITE:
        return np.full((height, width), BRIGHTEST, np.uint8)
    if projection.kind == PatternKind.GREY:
        return np.full((height, width), round(255 * projection.shift / projection.shifts), np.uint8)
    image = np.zeros((height, width), np.uint8)
    if name == "grid":
        image[_lines(height), :] = BRIGHTEST
        image[:, _lines(width)] = BRIGHTEST
    elif name == "crosshair":
        image[(height - 1) // 2 : height // 2 + 1, :] = BRIGHTEST
        image[:, (width - 1) // 2 : width // 2 + 1] = BRIGHTEST
    elif name == "focus":
        row, column = np.indices((height, width))
        lines = 1 + (row // _FOCUS_TILE + column // _FOCUS_TILE) % 4
        across = np.where(row // _FOCUS_TILE % 2 == 0, column, row)
        image[across // lines % 2 == 1] = BRIGHTEST
    elif name != "dark":
        raise InvalidPatternError(f"set-up pattern '{name}' is unknown: use one of {', '.join(SETUP_PATTERNS)}")
    return image


def _levels(projection: Projection, width: int, height: int) -> np.ndarray:
    """Return the grey levels of fringes or of one bit of a Gray code along the direction in which they change."""
    vertical = projection.orientation == Orientation.VERTICAL
    length = width if vertical else height
    position = np.arange(length) - (length - 1) / 2
    fringe = (position if vertical else -position) / projection.pitch
    if projection.kind == PatternKind.GRAY_CODE:
        half_period = np.floor(2 * fringe + 1).astype(int) + (1 << (projection.shifts - 1))
        gray = half_period ^ (half_period >> 1)
        wave = 2.0 * (gray >> (projection.shifts - projection.shift) & 1) - 1
    else:
        wave = np.cos(2 * np.pi * (fringe - projection.shift / projection.shifts))
    return (BRIGHTEST + DARKEST) / 2 + (BRIGHTEST - DARKEST) / 2 * wave


def _lines(length: int) -> np.ndarray:
    """Return every pixel at a multiple of the grid's spacing from the middle."""
    return np.arange(length // 2 % _GRID_SPACING, length, _GRID_SPACING)


def _direction(orientation: str) -> Orientation:
    if orientation.upper() not in Orientation.__members__:
        raise InvalidPatternError(f"orientation '{orientation}' is unknown: use 'vertical' or 'horizontal'")
    return Orientation[orientation.upper()]


def _checked(sequence: PatternSequence) -> PatternSequence:
    for projection in sequence.projections:
        _check(projection, sequence.width, sequence.height)
    return sequence


def _check(projection: Projection, width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise InvalidPatternError(f"projector of {width}x{height} px: both have to be at least 1")
    if projection.kind == PatternKind.GREY:
        if not 0 <= projection.shift <= projection.shifts or projection.shifts < 1:
            raise InvalidPatternError(f"{projection}: the brightness has to be from 0 to 1")
        return
    if projection.kind not in (PatternKind.FRINGES, PatternKind.GRAY_CODE):
        return
    if not math.isfinite(projection.pitch) or projection.pitch <= 2:
        raise InvalidPatternError(f"{projection}: the pitch has to be above 2 projector pixels")
    if projection.kind == PatternKind.GRAY_CODE:
        length = width if projection.orientation == Orientation.VERTICAL else height
        if not 1 <= projection.shift <= projection.shifts or projection.shifts > 24:
            raise InvalidPatternError(f"{projection}: bits are counted from 1 to their number, 24 at most")
        if length / projection.pitch + 1 > 1 << (projection.shifts - 1):
            raise InvalidPatternError(f"{projection}: so few bits do not number all fringes on {length} px")
        return
    if projection.shifts < 3 and (projection.shift, projection.shifts) != (1, 1):
        raise InvalidPatternError(
            f"{projection}: at least 3 shifts are needed to separate mean, modulation and phase, "
            "or shift 1 of 1 for one image"
        )
    if projection.shift < 1:
        raise InvalidPatternError(f"{projection}: shifts are counted from 1")
