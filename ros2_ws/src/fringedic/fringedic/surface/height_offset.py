"""Offset of a smoothed height by the curvature of the surface.

A weighted mean of neighbours whose weights have the second moment m lies off a curved surface by m z_xx / 2. The
curvature of a surface changes less from place to place than its noise does, so that it is measured in a window several
times as wide as that of the mean, and the offset is taken away at nearly no cost in noise.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numba import njit, prange

_HALF = 5  # samples from the centre of a window to its border, one per standard deviation of the Gaussian
_APART = 4  # standard deviations from window to window
_ENOUGH = 0.6  # of the samples of a window are measured
_OUTLIER = 3.0  # times the usual residual or the offset, beyond which a window contains an edge


class FilterOffset(NamedTuple):
    """Second derivatives of a height at nodes, and where they are known.

    Attributes
    ----------
    step
        Distance of the nodes [px]; the first one is half of it away from the first row and column.
    along_rows, along_columns : (row, column)
        Second derivatives [m/px^2], 0 where not known.
    known : (row, column)
        1 or 0.
    """

    step: int
    along_rows: np.ndarray
    along_columns: np.ndarray
    known: np.ndarray

    @classmethod
    def of(cls, z: np.ndarray, width: float) -> Self:
        """Fit a polynomial of the second degree in windows of 10 standard deviations of the Gaussian.

        A window that contains an edge of the surface, or too few measured pixels, is not known. Its residuals are
        larger than usual by much more than the offset.

        Parameters
        ----------
        z
            (row, column) float32, heights [m] that are smoothed along their rows; NaN where not measured.
        width
            Standard deviation of the Gaussian [px].
        """
        step = max(_APART, round(_APART * width))
        nodes = tuple(max(1, size // step) for size in z.shape)
        values, residuals = np.zeros((2, *nodes)), np.full(nodes, np.nan)
        _fit(z, step, max(1, round(width)), values, residuals)
        fitted = residuals[np.isfinite(residuals)]
        offsets = 0.5 * width**2 * np.abs(values).sum(axis=0)
        usual = np.maximum(np.median(fitted) if len(fitted) else 0.0, offsets)
        known = (residuals <= _OUTLIER * usual).astype(float)  # NaN is not
        return cls(step, values[0] * known, values[1] * known, known)

    def remove(self, z: np.ndarray, moment: np.ndarray, *, along_rows: bool) -> None:
        """Move heights that are means along one direction back to the surface, in place.

        Parameters
        ----------
        z
            (row, column) float32 [m].
        moment
            (row, column) float32, second moment of the weights of each mean [px^2].
        along_rows
            The means are those along rows.
        """
        _subtract(z, moment, self.step, self.along_rows if along_rows else self.along_columns, self.known)


@njit(cache=True, nogil=True, parallel=True)
def _fit(z: np.ndarray, step: int, stride: int, curvatures: np.ndarray, residuals: np.ndarray) -> None:
    """Fit a polynomial of the second degree around each node; set z_xx, z_yy [m/px^2] and the RMS of residuals [m]."""
    reach = _HALF * stride
    for a in prange(residuals.shape[0]):
        for b in range(residuals.shape[1]):
            powers, heights, squares = _sums(z, a * step + step // 2, b * step + step // 2, stride)
            known = powers[0, 0]
            if known < _ENOUGH * (2 * _HALF + 1) ** 2:
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
def _subtract(z: np.ndarray, moment: np.ndarray, step: int, curvatures: np.ndarray, known: np.ndarray) -> None:
    """Subtract the offset, with curvatures that are linear between those nodes where they are known."""
    rows, columns = known.shape
    for i in prange(z.shape[0]):
        upper, lower, below = _between(i, step, rows)
        for j in range(z.shape[1]):
            left, right, beyond = _between(j, step, columns)
            weight, curvature = 0.0, 0.0
            for a, share_a in ((upper, 1.0 - below), (lower, below)):
                for b, share_b in ((left, 1.0 - beyond), (right, beyond)):
                    weight += share_a * share_b * known[a, b]
                    curvature += share_a * share_b * curvatures[a, b]
            if weight > 0.0:
                z[i, j] -= np.float32(moment[i, j] * curvature / (2.0 * weight))


@njit(cache=True, nogil=True)
def _between(place: int, step: int, count: int) -> tuple[int, int, float]:
    """Return the nodes before and after a pixel, and where the pixel is between them, from 0 to 1."""
    position = min(max((place - step // 2) / step, 0.0), count - 1.0)
    first = int(position)
    return first, min(first + 1, count - 1), position - first
