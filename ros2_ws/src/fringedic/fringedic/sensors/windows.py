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
    variances : (error, 3, row, column)
        Variances of both slopes, and their covariance, for independent errors with the given variances.
    """

    values: np.ndarray
    variances: np.ndarray


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
    a: np.ndarray,
    b: np.ndarray,
    fields: np.ndarray,
    known: np.ndarray,
    half: int,
    closed: bool = False,
    errors: np.ndarray | None = None,
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
    errors
        Variances (error, row, column) of independent errors of the points, which may differ from point to point; they
        count as 0 where they are not known.
    """
    rows, columns = known.shape
    errors = np.zeros((0, rows, columns)) if errors is None else errors
    if closed:  # coordinates relative to the point of the window would jump: the grid is regular, its index does not
        step = a[0, 1] - a[0, 0]
        local = np.arange(-half, columns + half) * step
        pad = np.concatenate([np.arange(columns - half, columns), np.arange(columns), np.arange(half)])
        a = np.tile(local, (rows, 1))
        found = window_slopes(a, b[:, pad], fields[..., pad], known[:, pad], half, errors=errors[..., pad])
        inner = slice(half, half + columns)
        return Slopes(found.values[..., inner], found.variances[..., inner])
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
    return Slopes(
        values, _variances(np.nan_to_num(errors), known, half, (a, b), (x, y), (xx, xy, yy), number * determinant)
    )


def _variances(
    errors: np.ndarray,
    known: np.ndarray,
    half: int,
    at: tuple[np.ndarray, np.ndarray],
    middle: tuple[np.ndarray, np.ndarray],
    moments: tuple[np.ndarray, np.ndarray, np.ndarray],
    scale: np.ndarray,
) -> np.ndarray:
    """Return the covariance (error, 3, row, column) of both slopes: each point counts with its own variance."""
    if not len(errors):
        return np.zeros((0, 3, *known.shape))
    (a, b), (x, y), (xx, xy, yy) = at, middle, moments
    weights = np.stack([np.ones(a.shape), a, b, a * a, a * b, b * b])
    sums = window_sums((errors[:, None] * weights).reshape(-1, *known.shape), known, half)
    m, m_a, m_b, m_aa, m_ab, m_bb = np.moveaxis(sums.reshape(-1, 6, *known.shape), 1, 0)
    m_aa, m_bb = m_aa - 2 * x * m_a + x * x * m, m_bb - 2 * y * m_b + y * y * m
    m_ab = m_ab - x * m_b - y * m_a + x * y * m
    # the weights of a point in the slopes are yy (a - x) - xy (b - y) and xx (b - y) - xy (a - x), over the scale
    of_a = yy * yy * m_aa - 2 * yy * xy * m_ab + xy * xy * m_bb
    of_b = xx * xx * m_bb - 2 * xx * xy * m_ab + xy * xy * m_aa
    of_both = (xx * yy + xy * xy) * m_ab - xy * (yy * m_aa + xx * m_bb)
    covariance: np.ndarray = np.stack([of_a, of_b, of_both], axis=1) / scale**2
    return covariance
