"""How much of a field of vectors is measured, and how long they are: what the status of a step says."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange


def measured_part_and_rms(*components: np.ndarray) -> tuple[float, float]:
    """Return which part of the vectors is measured, 0 to 1, and the root mean square of their length.

    The squares are added up row by row, so that the sum does not depend on the number of threads.

    Parameters
    ----------
    components
        Each of shape (row, column), in one unit; a vector counts where all of them are finite.

    Returns
    -------
    part, rms
        The rms has the components' unit and is NaN where there is no vector.
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
