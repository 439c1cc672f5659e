"""Measured fraction and RMS length of a vector field, for the status of a step."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange


def measured_part_and_rms(*components: np.ndarray) -> tuple[float, float]:
    """Return the measured fraction of the vectors, 0 to 1, and the root mean square of their length.

    The squares are summed row by row, so that the result does not depend on the number of threads.

    Parameters
    ----------
    components
        Components of the vectors, each (row, column), in one unit; a vector is measured where all are finite.

    Returns
    -------
    fraction, rms
        The rms has the unit of the components and is NaN when no vector is measured.
    """
    rows, columns = components[0].shape
    count, squares = np.zeros(rows, np.int64), np.zeros(rows)
    _sum_rows(components, count, squares)
    measured = int(count.sum())
    return measured / max(rows * columns, 1), math.sqrt(squares.sum() / measured) if measured else math.nan


@njit(cache=True, nogil=True, parallel=True)
def _sum_rows(components: tuple[np.ndarray, ...], count: np.ndarray, squares: np.ndarray) -> None:
    rows, columns = components[0].shape
    for i in prange(rows):
        found, total = 0, 0.0
        for j in range(columns):
            square = 0.0
            for component in components:
                square += np.float64(component[i, j]) ** 2
            if np.isfinite(square):
                found += 1
                total += square
        count[i] = found
        squares[i] = total
