"""Slopes of fields over the coordinates of a map, by least-squares planes over windows of points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

_COVERED = 0.5  # measured share of a window, as of the strain of one sensor


class Slopes(NamedTuple):
    """Slopes of fields.

    Attributes
    ----------
    values : (field, 2, row, column)
        Of each field by a and by b; NaN where too little of the window is measured.
    white : (3, row, column)
        Variances of both slopes, and their covariance, for independent errors of variance 1.
    """

    values: np.ndarray
    white: np.ndarray


def window_sums(fields: np.ndarray, known: np.ndarray, half: int, closed: bool = False) -> np.ndarray:
    """Return the sums (field, row, column) of the known values of fields over windows of 2 half + 1 points.

    On a `closed` map the last column is followed by the first one.
    """
    values = np.where(known, fields, 0.0)
    size = 2 * half + 1
    if closed:
        values = np.concatenate([values[..., -half:], values, values[..., :half]], axis=-1)
    sums = np.stack([uniform_filter(each, size, mode="constant") for each in values]) * size**2
    return sums[..., half:-half] if closed and half else sums


def window_slopes(
    a: np.ndarray, b: np.ndarray, fields: np.ndarray, known: np.ndarray, half: int, closed: bool = False
) -> Slopes:
    """Return the slopes of fields (field, row, column) over the coordinates a and b of points.

    Parameters
    ----------
    a, b
        Coordinates (row, column) of the points; on a closed map they are a regular grid.
    fields
        NaN where not known.
    known
        Points to be used, bool (row, column).
    half
        Half width of the window [points].
    closed
        Whether the last column is followed by the first one.
    """
    rows, columns = known.shape
    if closed:  # coordinates relative to the point of the window would jump: the grid is regular, its index does not
        step = a[0, 1] - a[0, 0]
        local = np.arange(-half, columns + half) * step
        pad = np.concatenate([np.arange(columns - half, columns), np.arange(columns), np.arange(half)])
        found = window_slopes(np.tile(local, (rows, 1)), b[:, pad], fields[..., pad], known[:, pad], half)
        inner = slice(half, half + columns)
        return Slopes(found.values[..., inner], found.white[..., inner])
    known = known & np.isfinite(fields).all(axis=0) & np.isfinite(a + b)
    a, b = a - np.mean(a[known]) if known.any() else a, b - np.mean(b[known]) if known.any() else b
    middle = np.array([np.mean(each[known]) if known.any() else 0.0 for each in fields])
    fields = fields - middle[:, None, None]
    stack = np.concatenate([[np.ones(a.shape), a, b, a * a, a * b, b * b], fields, a * fields, b * fields])
    sums = window_sums(stack, known, half)
    number = np.where(sums[0] > 0.5, sums[0], np.nan)
    means = sums[1:] / number
    x, y, xx, xy, yy = means[:5]
    xx, xy, yy = xx - x * x, xy - x * y, yy - y * y
    determinant = xx * yy - xy * xy
    usable = known & (sums[0] >= _COVERED * (2 * half + 1) ** 2) & (determinant > 1e-6 * (xx + yy) ** 2)
    determinant = np.where(usable, determinant, np.nan)
    f, xf, yf = means[5:].reshape(3, len(fields), rows, columns)
    xf, yf = xf - x * f, yf - y * f
    values = np.stack([(yy * xf - xy * yf) / determinant, (xx * yf - xy * xf) / determinant], axis=1)
    return Slopes(values, np.stack([yy, xx, -xy]) / (number * determinant))
