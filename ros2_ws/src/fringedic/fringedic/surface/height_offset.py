"""Offset of a smoothed height by the curvature of the surface.

A weighted mean of neighbours whose weights have the second moments m_x and m_y lies off a curved surface by
(m_x z_xx + m_y z_yy) / 2. The curvature of a surface changes less from place to place than its noise does: it is
measured in a window several times as wide as that of the mean, so that the correction adds little noise.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numba import njit, prange

from fringedic.surface.coarse_grid import by_point, interpolate_column, interpolate_row

_HALF = 5  # samples from the centre of a window to its border, one per standard deviation of the Gaussian
_APART = 4  # standard deviations from window to window
_FEWEST, _ENOUGH = 0.5, 0.75  # of the samples of a window are measured; its weight rises from 0 to 1 between them
_OUTLIER = 3.0  # times the usual residual or the offset, beyond which a window contains an edge
_STEEP = 8  # power of the residual by which its curvature then falls to 0
_WEAKEST = 0.25  # sum of weights, below which the offset falls to 0


class Curvature(NamedTuple):
    """Second derivatives of a height at nodes.

    Attributes
    ----------
    step
        Distance of the nodes [px]; the first one is half of it away from the first row and column.
    nodes : (row, column, 3)
        Second derivatives along rows and along columns [m/px^2] times the weight of the node, and this weight, 0 to 1.
    """

    step: int
    nodes: np.ndarray

    @classmethod
    def of(cls, z: np.ndarray, width: float) -> Self:
        """Fit a polynomial of the second degree in windows of 10 standard deviations of the Gaussian.

        The curvature of a window that contains an edge of the surface is taken as 0: its residuals are larger than
        usual by much more than the offset.

        Parameters
        ----------
        z
            (row, column) float32, smoothed heights [m]; NaN where not measured.
        width
            Standard deviation of the Gaussian [px].
        """
        step = max(_APART, round(_APART * width))
        count = tuple(max(1, size // step) for size in z.shape)
        values, residuals, measured = np.zeros((2, *count)), np.zeros(count), np.zeros(count)
        _fit(z, step, max(1, round(width)), values, residuals, measured)
        offsets = 0.5 * width**2 * np.abs(values).sum(axis=0)
        usual = np.median(residuals[measured > _FEWEST]) if (measured > _FEWEST).any() else 0.0
        highest = np.maximum(_OUTLIER * np.maximum(usual, offsets), np.finfo(float).tiny)
        values /= 1.0 + (residuals / highest) ** _STEEP
        weight = np.clip((measured - _FEWEST) / (_ENOUGH - _FEWEST), 0.0, 1.0)
        return cls(step, by_point(np.stack([*(values * weight), weight])))


@njit(cache=True, nogil=True, parallel=True)
def _fit(
    z: np.ndarray, step: int, stride: int, curvatures: np.ndarray, residuals: np.ndarray, measured: np.ndarray
) -> None:
    """Fit a polynomial of the second degree around each node.

    Sets z_xx and z_yy [m/px^2], the RMS of the residuals [m] and the measured part of the samples; with too few of them
    the others stay 0.
    """
    reach = _HALF * stride
    for a in prange(residuals.shape[0]):
        for b in range(residuals.shape[1]):
            powers, heights, squares = _sums(z, a * step + step // 2, b * step + step // 2, stride)
            known = powers[0, 0]
            measured[a, b] = known / (2 * _HALF + 1) ** 2
            if measured[a, b] <= _FEWEST:
                continue
            solution, explained = _solve(powers, heights)
            curvatures[0, a, b] = 2.0 * solution[3] / reach**2
            curvatures[1, a, b] = 2.0 * solution[5] / reach**2
            residuals[a, b] = np.sqrt(max(squares - explained, 0.0) / (known - 6.0))


@njit(cache=True, nogil=True)
def _sums(z: np.ndarray, row: int, column: int, stride: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return sums of u^p v^q, of z u^p v^q and of z^2 over a window, with u along rows and v along columns, -1 to 1."""
    reach = _HALF * stride
    powers, heights, squares = np.zeros((5, 5)), np.zeros((3, 3)), 0.0
    for i in range(max(row - reach, row % stride), min(row + reach + 1, z.shape[0]), stride):
        of_row, height = np.zeros(5), np.zeros(3)
        for j in range(max(column - reach, column % stride), min(column + reach + 1, z.shape[1]), stride):
            value = np.float64(z[i, j])
            if not np.isfinite(value):
                continue
            squares += value * value
            u = (j - column) / reach
            power = 1.0
            for p in range(5):
                of_row[p] += power
                if p < 3:
                    height[p] += power * value
                power *= u
        v = (i - row) / reach
        power = 1.0
        for q in range(5):
            for p in range(5 - q):
                powers[p, q] += power * of_row[p]
                if q < 3 and p < 3 - q:
                    heights[p, q] += power * height[p]
            power *= v
    return powers, heights, squares


@njit(cache=True, nogil=True)
def _solve(powers: np.ndarray, heights: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the coefficients of 1, u, v, u^2, u v, v^2, and the part of the sum of squares that they explain."""
    p, q = np.array([0, 1, 0, 2, 1, 0]), np.array([0, 0, 1, 0, 1, 2])
    factor, solution = np.zeros((6, 6)), np.empty(6)
    explained = 0.0
    for i in range(6):  # Cholesky's factor, and the solution with it
        right = heights[p[i], q[i]]
        for j in range(i + 1):
            value = powers[p[i] + p[j], q[i] + q[j]]
            for k in range(j):
                value -= factor[i, k] * factor[j, k]
            factor[i, j] = np.sqrt(max(value, 1e-12)) if i == j else value / factor[j, j]
        for j in range(i):
            right -= factor[i, j] * solution[j]
        solution[i] = right / factor[i, i]
        explained += solution[i] * solution[i]
    for i in range(5, -1, -1):
        for j in range(i + 1, 6):
            solution[i] -= factor[j, i] * solution[j]
        solution[i] /= factor[i, i]
    return solution, explained


@njit(cache=True, nogil=True, parallel=True)
def set_offsets(
    curvature: Curvature,
    moment_of_rows: np.ndarray,
    moment_of_columns: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    offsets: np.ndarray,
) -> None:
    """Compute how far the smoothed height lies from the surface at points.

    Parameters
    ----------
    curvature
        Of the surface.
    moment_of_rows, moment_of_columns : (row, column) float32
        Second moments of the weights along rows and along columns [px^2].
    rows, columns : (row,), (column,)
        Places of the points [px].
    offsets : (row, column) float32
        Becomes the smoothed height minus that of the surface [m].
    """
    step, nodes = curvature
    last_row, last_column = moment_of_rows.shape[0] - 1, moment_of_rows.shape[1] - 1
    for a in prange(len(rows)):
        i = min(max(int(rows[a] + 0.5), 0), last_row)
        line, values = np.empty(nodes.shape[1:]), np.empty(3)
        interpolate_row(nodes, step, max(i - step // 2, 0), line)
        for b in range(len(columns)):
            j = min(max(int(columns[b] + 0.5), 0), last_column)
            interpolate_column(line, step, max(j - step // 2, 0), values)
            moved = moment_of_rows[i, j] * values[0] + moment_of_columns[i, j] * values[1]
            offsets[a, b] = np.float32(0.5 * moved / max(values[2], _WEAKEST))
