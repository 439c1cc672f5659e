"""Masked fit: least-squares planes beside discontinuities, over the points that are connected with the centre.

In each row of a window these points are a few runs without a gap. Their sums are differences of sums along the row, and
connections are found from run to run instead of from point to point.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from fringedic.surface.plane_sums import MINIMUM_COVERAGE, PlaneArrays, Samples, add_point, count_quantities, solve

_TILE = 64  # points in both directions that share sums along rows; fixed, so that results do not depend on threads


@njit(cache=True, nogil=True, parallel=True)
def fit_masked(samples: Samples, divided: np.ndarray, half: tuple[int, int], planes: PlaneArrays) -> None:
    """Fit again the planes around measured points whose window may be divided, bool (row, column)."""
    rows, columns = divided.shape
    across = (columns + _TILE - 1) // _TILE
    for tile in prange(across * ((rows + _TILE - 1) // _TILE)):
        top, left = (tile // across) * _TILE, (tile % across) * _TILE
        bottom, right = min(top + _TILE, rows), min(left + _TILE, columns)
        if divided[top:bottom, left:right].any():
            _fit_tile(samples, divided, half, (top, bottom, left, right), planes)


@njit(cache=True, nogil=True)
def _fit_tile(
    samples: Samples, divided: np.ndarray, half: tuple[int, int], tile: tuple[int, int, int, int], planes: PlaneArrays
) -> None:
    """Fit the planes of a tile (first row, row after the last one, first column, column after the last one)."""
    rows, columns = divided.shape
    top, bottom, left, right = tile
    half_rows, half_columns = half
    height, width = 2 * half_rows + 1, 2 * half_columns + 1
    enough = MINIMUM_COVERAGE * height * width
    first_row, first_column = max(top - half_rows, 0), max(left - half_columns, 0)
    last_row, last_column = min(bottom + half_rows, rows), min(right + half_columns, columns)
    here = samples.known[first_row:last_row, first_column:last_column]
    along = np.zeros((here.shape[0], here.shape[1] + 1, count_quantities(samples)))
    ends = np.empty(here.shape, np.int64)
    for i in range(here.shape[0]):
        _sum_along(samples, here[i], first_row + i, first_column, along[i])
        _find_ends(here[i], ends[i])
    runs = np.empty((height * (half_columns + 1), 4), np.int64)
    first_run = np.empty(height + 1, np.int64)
    waiting = np.empty(len(runs), np.int64)
    total = np.empty(along.shape[2])
    for row in range(top, bottom):
        for column in range(left, right):
            if divided[row, column]:
                window = (
                    max(row - half_rows, 0) - first_row,
                    min(row + half_rows, rows - 1) - first_row,
                    max(column - half_columns, 0) - first_column,
                    min(column + half_columns, columns - 1) - first_column,
                )
                _list_runs(here, ends, window, runs, first_run)
                at = row - first_row - window[0]
                _mark_connected(runs, first_run, at, column - first_column, waiting)
                _sum_connected(along[window[0] :], runs, first_run[-1], total)
                solve(total, enough, row, column, planes)


@njit(cache=True, nogil=True)
def _sum_along(samples: Samples, known: np.ndarray, row: int, first_column: int, along: np.ndarray) -> None:
    """Sum the measured points of a row before each place, (place, quantity)."""
    for j in range(len(known)):
        along[j + 1] = along[j]
        if known[j]:
            add_point(samples, row, first_column + j, 1.0, along, j + 1)


@njit(cache=True, nogil=True)
def _find_ends(known: np.ndarray, ends: np.ndarray) -> None:
    """Find the last place of the run, of measured points or of others, that each place of a row belongs to."""
    last = len(known) - 1
    for j in range(last, -1, -1):
        if j < last and known[j] != known[j + 1]:
            last = j
        ends[j] = last


@njit(cache=True, nogil=True)
def _list_runs(
    known: np.ndarray, ends: np.ndarray, window: tuple[int, int, int, int], runs: np.ndarray, first_run: np.ndarray
) -> None:
    """List the runs of measured points in a window (first and last row, first and last column), row by row.

    `runs` becomes their first and last place, row of the window, and 0 (not connected); `first_run` becomes the index
    of the first run of each row.
    """
    top, bottom, left, right = window
    number = 0
    for row in range(top, bottom + 1):
        first_run[row - top] = number
        place = left
        while place <= right:
            end = min(ends[row, place], right)
            if known[row, place]:
                runs[number, 0], runs[number, 1], runs[number, 2], runs[number, 3] = place, end, row - top, 0
                number += 1
            place = end + 1
    first_run[bottom - top + 1 :] = number


@njit(cache=True, nogil=True)
def _mark_connected(runs: np.ndarray, first_run: np.ndarray, row: int, column: int, waiting: np.ndarray) -> None:
    """Mark the runs that are connected with a measured place of the window."""
    start = first_run[row]
    while runs[start, 1] < column:
        start += 1
    runs[start, 3] = 1
    waiting[0] = start
    number = 1
    while number > 0:
        number -= 1
        first, last, at, _ = runs[waiting[number]]
        for beside in (at - 1, at + 1):
            if beside < 0 or beside + 1 >= len(first_run):
                continue
            for other in range(first_run[beside], first_run[beside + 1]):
                if runs[other, 0] > last:
                    break
                if runs[other, 1] >= first and runs[other, 3] == 0:
                    runs[other, 3] = 1
                    waiting[number] = other
                    number += 1


@njit(cache=True, nogil=True)
def _sum_connected(along: np.ndarray, runs: np.ndarray, number: int, sums: np.ndarray) -> None:
    """Sum over the marked runs; `along` begins with the window's first row."""
    sums[:] = 0.0
    run = 0
    while run < number:
        if runs[run, 3] == 0:
            run += 1
            continue
        first, row = runs[run, 0], runs[run, 2]
        # there are no points between the runs of a row, so runs that follow each other are one difference
        while run + 1 < number and runs[run + 1, 2] == row and runs[run + 1, 3] == 1:
            run += 1
        last = runs[run, 1]
        for k in range(len(sums)):
            sums[k] += along[row, last + 1, k] - along[row, first, k]
        run += 1
