"""Fields that vary little within a window, computed at every few points and interpolated between them.

Everything that is derived from windows of a window is as smooth as the window: three values per half-width describe it,
at a small part of the time that a value at every point takes.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.ndimage import distance_transform_edt, uniform_filter

_PER_HALF_WIDTH = 3


def step_of(half: tuple[int, int]) -> int:
    """Return the distance of the coarse points in points, for windows of a half-width in points (rows, columns)."""
    return max(1, min(half) // _PER_HALF_WIDTH)


def coarse_half(half: tuple[int, int], step: int) -> tuple[int, int]:
    """Return the half-width of a window in coarse points."""
    return max(1, round(half[0] / step)), max(1, round(half[1] / step))


def window_means(fields: np.ndarray, known: np.ndarray, half: tuple[int, int]) -> np.ndarray:
    """Return the means of fields (field, row, column) over the known points of windows, NaN at all other points."""
    size = (2 * half[0] + 1, 2 * half[1] + 1)
    share = np.where(known, uniform_filter(known.astype(float), size, mode="constant"), np.nan)
    inside = np.where(known, fields, 0.0)
    return np.stack([uniform_filter(each, size, mode="constant") for each in inside]) / share


def fill_from_nearest(fields: np.ndarray) -> np.ndarray:
    """Return fields (field, row, column) with the nearest known values where they are NaN; zero without any."""
    known = np.isfinite(fields).all(axis=0)
    if not known.any():
        return np.zeros_like(fields)
    rows, columns = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(fields[:, rows, columns])


def by_point(fields: np.ndarray) -> np.ndarray:
    """Return fields (field, row, column) as (row, column, field), as the functions below take them."""
    return np.ascontiguousarray(np.moveaxis(fields, 0, -1))


@njit(cache=True, nogil=True, error_model="numpy")
def interpolate_row(coarse: np.ndarray, step: int, row: int, line: np.ndarray) -> None:
    """Interpolate coarse fields (row, column, field) at a row of points; `line` is (coarse column, field)."""
    last = coarse.shape[0] - 1
    upper = min(row // step, last)
    part = row / step - upper
    line[:] = (1.0 - part) * coarse[upper] + part * coarse[min(upper + 1, last)]


@njit(cache=True, nogil=True, error_model="numpy")
def interpolate_column(line: np.ndarray, step: int, column: int, values: np.ndarray) -> None:
    """Interpolate the fields of a row, from `interpolate_row`, at a point."""
    last = line.shape[0] - 1
    left = min(column // step, last)
    part = column / step - left
    right = min(left + 1, last)
    for k in range(len(values)):
        values[k] = (1.0 - part) * line[left, k] + part * line[right, k]
