"""Renders a pattern as the image that the projector shows."""

from __future__ import annotations

import math

import numpy as np

from fringedic.errors import PatternError
from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic.patterns.response import FULL_SCALE, ResponseCurve

DARKEST, BRIGHTEST = 5, 250  # projectors clip at both ends of the 8-bit scale
SETUP_PATTERNS = ("dark", "grid", "crosshair", "focus")
_GRID_SPACING = 50  # [px] lies between the lines of the set-up grid
_FOCUS_TILE = 24  # [px] holds whole pairs of lines of 1 to 4 px
_SMALLEST_PITCH = 2  # [px]: a shorter period cannot be sampled (Nyquist)
_MOST_BITS = 24  # number more columns than any projector has


def render_pattern(
    pattern: ProjectedPattern, width: int, height: int, name: str = "", *, response: ResponseCurve | None = None
) -> np.ndarray:
    """Return the 8-bit image of one pattern.

    Fringes are ``I = A + B cos(phi - 2 pi k / q)`` between 5 and 250 with ``phi = 2 pi (c - (width - 1)/2) / pitch``
    at column c, or ``phi = 2 pi ((height - 1)/2 - row) / pitch`` for horizontal fringes: zero at the centre of the
    image for every pitch, growing to the right or upwards. White is as bright as the brightest fringe. The Gray code of
    a pitch numbers half periods, equally many on both sides of the centre.

    Parameters
    ----------
    pattern
        The pattern to show.
    width, height
        Size of the projector [px].
    name
        Name of the set-up pattern, for patterns of kind OTHER: "dark", "grid", "crosshair" or "focus" (tiles of lines
        of 1 to 4 px).
    response
        Response curve. Fringes and Gray codes are pre-compensated for it, so that the grey levels in the camera's image
        are those of the formula above.

    Returns
    -------
    ndarray
        uint8, shape (height, width).

    Raises
    ------
    PatternError
        The projector cannot show this pattern, or `name` is unknown.

    Examples
    --------
    >>> from fringedic.patterns import PatternKind, ProjectedPattern
    >>> image = render_pattern(ProjectedPattern(PatternKind.FRINGES, pitch=16.0, shift=4, shifts=4), 9, 2)
    >>> image.shape, int(image[0, 4])  # phase 0 at the centre, where shift q of q is brightest
    ((2, 9), 250)
    """
    check_pattern(pattern, width, height)
    if pattern.kind in (PatternKind.FRINGES, PatternKind.GRAY_CODE):
        vertical = pattern.orientation == Orientation.VERTICAL
        length = width if vertical else height
        position = np.arange(length) - (length - 1) / 2
        fringe = (position if vertical else -position) / pattern.pitch
        if pattern.kind == PatternKind.GRAY_CODE:
            half_period = np.floor(2 * fringe + 1).astype(int) + (1 << (pattern.shifts - 1))
            gray = half_period ^ (half_period >> 1)
            wave = 2.0 * (gray >> (pattern.shifts - pattern.shift) & 1) - 1
        else:
            wave = np.cos(2 * np.pi * (fringe - pattern.shift / pattern.shifts))
        levels = np.asarray((BRIGHTEST + DARKEST) / 2 + (BRIGHTEST - DARKEST) / 2 * wave)
        if response is not None:
            levels = response.level_for(levels / FULL_SCALE)
        line = np.round(levels).astype(np.uint8)
        return np.ascontiguousarray(np.broadcast_to(line if vertical else line[:, None], (height, width)))
    if pattern.kind == PatternKind.WHITE:
        return np.full((height, width), BRIGHTEST, np.uint8)
    if pattern.kind == PatternKind.GREY:
        return np.full((height, width), round(FULL_SCALE * pattern.shift / pattern.shifts), np.uint8)
    image = np.zeros((height, width), np.uint8)
    if name == "grid":
        image[_grid_lines(height), :] = BRIGHTEST
        image[:, _grid_lines(width)] = BRIGHTEST
    elif name == "crosshair":
        image[(height - 1) // 2 : height // 2 + 1, :] = BRIGHTEST
        image[:, (width - 1) // 2 : width // 2 + 1] = BRIGHTEST
    elif name == "focus":
        row, column = np.indices((height, width))
        line_width = 1 + (row // _FOCUS_TILE + column // _FOCUS_TILE) % 4
        across = np.where(row // _FOCUS_TILE % 2 == 0, column, row)
        image[across // line_width % 2 == 1] = BRIGHTEST
    elif name != "dark":
        raise PatternError(f"set-up pattern '{name}' is unknown: use one of {', '.join(SETUP_PATTERNS)}")
    return image


def check_pattern(pattern: ProjectedPattern, width: int, height: int) -> None:
    """Refuse a pattern that a projector of this size [px] cannot show.

    Raises
    ------
    PatternError
        Size, brightness, pitch, shift or number of bits is out of range.
    """
    if width < 1 or height < 1:
        raise PatternError(f"projector of {width}x{height} px: both have to be at least 1")
    if pattern.kind == PatternKind.GREY:
        if not 0 <= pattern.shift <= pattern.shifts or pattern.shifts < 1:
            raise PatternError(f"{pattern}: the brightness has to be from 0 to 1")
    elif pattern.kind in (PatternKind.FRINGES, PatternKind.GRAY_CODE):
        if not math.isfinite(pattern.pitch) or pattern.pitch <= _SMALLEST_PITCH:
            raise PatternError(f"{pattern}: the pitch has to be above {_SMALLEST_PITCH} projector pixels")
        if pattern.kind == PatternKind.GRAY_CODE:
            length = width if pattern.orientation == Orientation.VERTICAL else height
            if not 1 <= pattern.shift <= pattern.shifts or pattern.shifts > _MOST_BITS:
                raise PatternError(f"{pattern}: bits are counted from 1 to their number, {_MOST_BITS} at most")
            if length / pattern.pitch + 1 > 1 << (pattern.shifts - 1):
                raise PatternError(f"{pattern}: {pattern.shifts} bits do not number all fringes on {length} px")
        else:
            if pattern.shifts < 3 and (pattern.shift, pattern.shifts) != (1, 1):
                raise PatternError(
                    f"{pattern}: at least 3 shifts are needed to separate mean, modulation and phase, "
                    "or shift 1 of 1 for one image"
                )
            if pattern.shift < 1:
                raise PatternError(f"{pattern}: shifts are counted from 1")


def _grid_lines(length: int) -> np.ndarray:
    """Return every pixel at a multiple of the grid's spacing from the middle."""
    return np.arange(length // 2 % _GRID_SPACING, length, _GRID_SPACING)
