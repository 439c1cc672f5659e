"""Least-squares planes in a moving window: slopes of fields over (x, y), and what noise does to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numba import njit, prange
from scipy.ndimage import find_objects, label, maximum_filter

from fringedic.errors import InvalidWindowError
from fringedic.rig import pixel_positions

_BLOCK = 64  # rows that share running sums; fixed, so that results do not depend on the number of threads
_MINIMUM_COVERAGE = 0.5  # of a window, measured


@dataclass(frozen=True)
class Planes:
    """Planes fitted around every point, NaN where the point or more than half of the window is not measured.

    Attributes
    ----------
    slopes : (field, 2, row, column)
        Derivatives of the fields by x and y.
    white : (3, row, column)
        Variances of the slopes by x and y and their covariance for errors of variance 1 that are independent from
        point to point [1/m^2].
    means : (number, row, column)
        Means over the window of the fields that were only to be averaged, where they are known.
    half : (rows, columns)
        Half-width of the window in points.
    spacing : (rows, columns)
        Distance of the points [px].
    """

    slopes: np.ndarray
    white: np.ndarray
    means: np.ndarray
    half: tuple[int, int]
    spacing: tuple[float, float]

    @property
    def width_px(self) -> tuple[float, float]:
        """Distance between the first and the last point of a window along rows and columns [px]."""
        return 2 * self.half[0] * self.spacing[0], 2 * self.half[1] * self.spacing[1]


def fit_planes(
    cloud: xr.Dataset,
    names: tuple[str, ...],
    window: int,
    averaged: tuple[str, ...] = (),
    torn: np.ndarray | None = None,
) -> Planes:
    """Fit planes over ``x`` and ``y`` of a cloud to its fields `names`; average the squares of the fields `averaged`.

    Parameters
    ----------
    window
        Width of the window [px of the reference image].
    torn
        Points beside a tear, bool (row, column): they count as not measured, and a window holds only the points that
        are joined to its centre by measured ones.

    Raises
    ------
    InvalidWindowError
        When the window holds fewer than 3 x 3 points.
    """
    rows, columns = pixel_positions(cloud, cloud["x"].shape)
    half, spacing = zip(*(_half_width(window, positions) for positions in (rows, columns)), strict=True)
    arrays = [np.asarray(cloud[name]) for name in ("x", "y", *names)]
    kind = np.result_type(np.float32, *arrays)
    fields = np.stack([np.asarray(each, kind) for each in arrays])
    known = np.isfinite(fields[0])
    for each in fields[1:]:
        known &= np.isfinite(each)
    if torn is not None:
        known &= ~torn
    squared = np.empty((len(averaged), *fields.shape[1:]), kind)
    for target, name in zip(squared, averaged, strict=True):
        np.square(np.asarray(cloud[name], kind), out=target)
    # sums of squares keep their digits around the middle; slopes do not depend on it
    middle = np.array([_middle(each[::8, ::8]) for each in fields])
    slopes = np.empty((len(names), 2, *fields.shape[1:]), kind)
    white = np.empty((3, *fields.shape[1:]), kind)
    means = np.empty((len(averaged), *fields.shape[1:]), kind)
    _fit(fields, squared, middle, known, half[0], half[1], slopes, white, means)
    if torn is not None and torn.any():
        places = np.flatnonzero(_divided(torn, half))
        _fit_joined(fields, squared, middle, known, places, half[0], half[1], slopes, white, means)
    return Planes(slopes, white, means, half, spacing)


def _divided(torn: np.ndarray, half: tuple[int, int]) -> np.ndarray:
    """Points whose window a tear may divide, bool (row, column): what is shorter than half of a window cannot."""
    patches, _ = label(torn, np.ones((3, 3)))
    long = np.zeros(torn.shape, np.bool_)
    for number, place in enumerate(find_objects(patches), start=1):
        if any(part.stop - part.start > each for part, each in zip(place, half, strict=True)):
            long[place] |= patches[place] == number
    return maximum_filter(long, size=[2 * each + 1 for each in half], mode="constant")


def _middle(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean(dtype=float)) if known.size else 0.0


def _half_width(window: int, positions: np.ndarray) -> tuple[int, float]:
    spacing = float(positions[1] - positions[0]) if len(positions) > 1 else 1.0
    half = round((window - 1) / 2 / spacing)
    if half < 1:
        raise InvalidWindowError(
            f"a window of {window} px holds fewer than 3 points at a spacing of {spacing:g} px: widen it"
        )
    return half, spacing


@njit(cache=True, nogil=True)
def _add_point(
    fields: np.ndarray,
    squared: np.ndarray,
    middle: np.ndarray,
    row: int,
    column: int,
    sign: float,
    sums: np.ndarray,
    place: int,
) -> None:
    """Add what a measured point gives to the sums (place, quantity).

    Quantities are the number of points, x, y, xx, xy, yy, then f, xf, yf of each field, then number and sum of each
    averaged field.
    """
    count = len(fields)
    x, y = fields[0, row, column] - middle[0], fields[1, row, column] - middle[1]
    sums[place, 0] += sign
    sums[place, 1] += sign * x
    sums[place, 2] += sign * y
    sums[place, 3] += sign * x * x
    sums[place, 4] += sign * x * y
    sums[place, 5] += sign * y * y
    for k in range(count - 2):
        f = sign * (fields[k + 2, row, column] - middle[k + 2])
        sums[place, 6 + 3 * k] += f
        sums[place, 7 + 3 * k] += x * f
        sums[place, 8 + 3 * k] += y * f
    at = 3 * count
    for k in range(len(squared)):
        if np.isfinite(squared[k, row, column]):
            sums[place, at + 2 * k] += sign
            sums[place, at + 2 * k + 1] += sign * squared[k, row, column]


@njit(cache=True, nogil=True)
def _solve(
    sums: np.ndarray,
    place: int,
    enough: float,
    row: int,
    column: int,
    slopes: np.ndarray,
    white: np.ndarray,
    means: np.ndarray,
) -> None:
    """Plane of the sums (place, quantity) of a window; NaN where it holds too few points."""
    number = sums[place, 0]
    if number < enough:
        slopes[:, :, row, column] = np.nan
        white[:, row, column] = np.nan
        means[:, row, column] = np.nan
        return
    x, y = sums[place, 1] / number, sums[place, 2] / number
    xx = sums[place, 3] / number - x * x
    xy = sums[place, 4] / number - x * y
    yy = sums[place, 5] / number - y * y
    determinant = xx * yy - xy * xy
    for k in range(len(slopes)):
        f = sums[place, 6 + 3 * k] / number
        xf = sums[place, 7 + 3 * k] / number - x * f
        yf = sums[place, 8 + 3 * k] / number - y * f
        slopes[k, 0, row, column] = (yy * xf - xy * yf) / determinant
        slopes[k, 1, row, column] = (xx * yf - xy * xf) / determinant
    white[0, row, column] = yy / (number * determinant)
    white[1, row, column] = xx / (number * determinant)
    white[2, row, column] = -xy / (number * determinant)
    for k in range(len(means)):
        at = 6 + 3 * len(slopes) + 2 * k
        # what remains of the sums where nothing is known is rounding
        if sums[place, at] > 0.5:
            means[k, row, column] = max(sums[place, at + 1] / sums[place, at], 0.0)
        else:
            means[k, row, column] = np.nan


@njit(cache=True, nogil=True, parallel=True)
def _fit(
    fields: np.ndarray,
    squared: np.ndarray,
    middle: np.ndarray,
    known: np.ndarray,
    half_rows: int,
    half_columns: int,
    slopes: np.ndarray,
    white: np.ndarray,
    means: np.ndarray,
) -> None:
    """Planes in whole windows, by running sums."""
    count, rows, columns = fields.shape
    quantities = 3 * count + 2 * len(squared)
    enough = _MINIMUM_COVERAGE * (2 * half_rows + 1) * (2 * half_columns + 1)
    for block in prange((rows + _BLOCK - 1) // _BLOCK):
        sums = np.zeros((columns, quantities))
        total = np.empty((1, quantities))
        first = block * _BLOCK
        last = min(first + _BLOCK, rows)
        for row in range(max(first - half_rows, 0), min(first + half_rows, rows)):
            _add_row(fields, squared, middle, known, row, 1.0, sums)
        for row in range(first, last):
            if row + half_rows < rows:
                _add_row(fields, squared, middle, known, row + half_rows, 1.0, sums)
            if row > first and row - half_rows - 1 >= 0:
                _add_row(fields, squared, middle, known, row - half_rows - 1, -1.0, sums)
            total[:] = 0.0
            for column in range(min(half_columns, columns)):
                for k in range(quantities):
                    total[0, k] += sums[column, k]
            for column in range(columns):
                if column + half_columns < columns:
                    for k in range(quantities):
                        total[0, k] += sums[column + half_columns, k]
                if column - half_columns - 1 >= 0:
                    for k in range(quantities):
                        total[0, k] -= sums[column - half_columns - 1, k]
                needed = enough if known[row, column] else np.inf
                _solve(total, 0, needed, row, column, slopes, white, means)


@njit(cache=True, nogil=True)
def _add_row(
    fields: np.ndarray,
    squared: np.ndarray,
    middle: np.ndarray,
    known: np.ndarray,
    row: int,
    sign: float,
    sums: np.ndarray,
) -> None:
    """Add what a row gives to the sums (column, quantity)."""
    for column in range(fields.shape[2]):
        if known[row, column]:
            _add_point(fields, squared, middle, row, column, sign, sums, column)


@njit(cache=True, nogil=True, parallel=True)
def _fit_joined(
    fields: np.ndarray,
    squared: np.ndarray,
    middle: np.ndarray,
    known: np.ndarray,
    places: np.ndarray,
    half_rows: int,
    half_columns: int,
    slopes: np.ndarray,
    white: np.ndarray,
    means: np.ndarray,
) -> None:
    """Planes around some places (flat indices) over the part of the window that is joined to its centre."""
    count, _, columns = fields.shape
    enough = _MINIMUM_COVERAGE * (2 * half_rows + 1) * (2 * half_columns + 1)
    for index in prange(len(places)):
        row, column = places[index] // columns, places[index] % columns
        if known[row, column]:
            sums = np.zeros((1, 3 * count + 2 * len(squared)))
            _add_joined(fields, squared, middle, known, row, column, half_rows, half_columns, sums)
            _solve(sums, 0, enough, row, column, slopes, white, means)


@njit(cache=True, nogil=True)
def _add_joined(
    fields: np.ndarray,
    squared: np.ndarray,
    middle: np.ndarray,
    known: np.ndarray,
    row: int,
    column: int,
    half_rows: int,
    half_columns: int,
    sums: np.ndarray,
) -> None:
    """Sums over the points of a window that measured neighbours join to its centre, which is measured."""
    rows, columns = fields.shape[1:]
    top, left = max(row - half_rows, 0), max(column - half_columns, 0)
    bottom, right = min(row + half_rows, rows - 1), min(column + half_columns, columns - 1)
    width = right - left + 1
    reached = np.zeros((bottom - top + 1) * width, np.bool_)
    waiting = np.empty(len(reached), np.int64)
    waiting[0] = (row - top) * width + column - left
    reached[waiting[0]] = True
    number = 1
    while number > 0:
        number -= 1
        i, j = divmod(waiting[number], width)
        _add_point(fields, squared, middle, top + i, left + j, 1.0, sums, 0)
        for down, aside in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            r, c = top + i + down, left + j + aside
            if r < top or r > bottom or c < left or c > right:
                continue
            place = (r - top) * width + c - left
            if not reached[place] and known[r, c]:
                reached[place] = True
                waiting[number] = place
                number += 1
