"""Least-squares planes in a moving window: slopes of fields over (x, y), and what noise does to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numba import njit, prange
from scipy.ndimage import find_objects, label, maximum_filter

from fringedic.errors import InvalidWindowError
from fringedic.rig import pixel_positions
from fringedic.surface.joined_planes import fit_joined
from fringedic.surface.plane_sums import MINIMUM_COVERAGE, add_point, solve

_BLOCK = 64  # rows that share running sums; fixed, so that results do not depend on the number of threads


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
        divided = _divided(torn, half) & known
        fit_joined(fields, squared, middle, known, divided, half[0], half[1], slopes, white, means)
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
    enough = MINIMUM_COVERAGE * (2 * half_rows + 1) * (2 * half_columns + 1)
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
                solve(total, 0, needed, row, column, slopes, white, means)


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
            add_point(fields, squared, middle, row, column, sign, sums, column)
