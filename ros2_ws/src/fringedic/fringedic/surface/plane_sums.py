"""Sums over the points of a window, and the least-squares planes that they give."""

from __future__ import annotations

import numpy as np
from numba import njit

MINIMUM_COVERAGE = 0.5  # of a window, measured


@njit(cache=True, nogil=True)
def add_point(
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
def solve(
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
