"""Sums over the points of a window, and the least-squares planes from them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

MINIMUM_COVERAGE = 0.5  # measured share of a window; below, the centroid of its points may lie outside its inner half


class Samples(NamedTuple):
    """Points of a cloud, as the kernels take them.

    Attributes
    ----------
    fields : (2 + field, row, column)
        x, y and the fields whose planes are fitted.
    squared : (number, row, column)
        Fields that are averaged.
    middle : (2 + field,)
        Typical values of `fields`, subtracted from them: sums of squares keep their digits.
    known : (row, column) bool
        Points to be used.
    """

    fields: np.ndarray
    squared: np.ndarray
    middle: np.ndarray
    known: np.ndarray


class PlaneArrays(NamedTuple):
    """Results at every point, see `planes.Planes`."""

    slopes: np.ndarray
    white: np.ndarray
    means: np.ndarray
    centres: np.ndarray
    number: np.ndarray


@njit(cache=True, nogil=True)
def add_point(samples: Samples, row: int, column: int, sign: float, sums: np.ndarray, place: int) -> None:
    """Add a measured point to the sums (place, quantity), or subtract it.

    Quantities are the number of points, x, y, xx, xy, yy, then f, xf, yf of each field, then number and sum of each
    averaged field.
    """
    fields, squared, middle, _ = samples
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
def count_quantities(samples: Samples) -> int:
    """Return the number of quantities of `add_point`."""
    return 3 * len(samples.fields) + 2 * len(samples.squared)


@njit(cache=True, nogil=True)
def solve(sums: np.ndarray, enough: float, row: int, column: int, planes: PlaneArrays) -> None:
    """Compute the planes of a window from its sums (quantity); NaN where it contains fewer than `enough` points."""
    slopes, white, means, centres, count = planes
    number = sums[0]
    if number < enough:
        _leave_out(row, column, planes)
        return
    x, y = sums[1] / number, sums[2] / number
    xx = sums[3] / number - x * x
    xy = sums[4] / number - x * y
    yy = sums[5] / number - y * y
    determinant = xx * yy - xy * xy
    if determinant == 0.0:  # all points on one line
        _leave_out(row, column, planes)
        return
    centres[0, row, column], centres[1, row, column], count[row, column] = x, y, number
    for k in range(len(slopes)):
        f = sums[6 + 3 * k] / number
        xf = sums[7 + 3 * k] / number - x * f
        yf = sums[8 + 3 * k] / number - y * f
        slopes[k, 0, row, column] = (yy * xf - xy * yf) / determinant
        slopes[k, 1, row, column] = (xx * yf - xy * xf) / determinant
    white[0, row, column] = yy / (number * determinant)
    white[1, row, column] = xx / (number * determinant)
    white[2, row, column] = -xy / (number * determinant)
    for k in range(len(means)):
        at = 6 + 3 * len(slopes) + 2 * k
        # what remains of the sums where nothing is known is rounding
        if sums[at] > 0.5:
            means[k, row, column] = max(sums[at + 1] / sums[at], 0.0)
        else:
            means[k, row, column] = np.nan


@njit(cache=True, nogil=True)
def _leave_out(row: int, column: int, planes: PlaneArrays) -> None:
    slopes, white, means, centres, count = planes
    slopes[:, :, row, column] = np.nan
    white[:, row, column] = np.nan
    means[:, row, column] = np.nan
    centres[:, row, column] = np.nan
    count[row, column] = np.nan
