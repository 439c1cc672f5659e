"""Two-dimensional Chebyshev polynomials over an image, fitted to scattered points; their order by cross-validation."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.linalg.lapack import dpotrf

HIGHEST_ORDER = 18  # of the comparison
_POINTS_PER_TERM = 10
_OWN = 1e-4  # share of a term's square that is independent of the terms before it
_FOLDS = 5
_SAMPLES = (30, 40)  # rows and columns at which the noise of a field is evaluated


class Basis:
    """Products T_i(b) T_j(a), i + j <= order, over the normalised rows b and columns a of an image.

    They are sorted by total degree: the basis of a lower order is the beginning of that of a higher one. On points that
    cover the image they are nearly orthogonal, so that normal equations are accurate.

    Parameters
    ----------
    points : (points, 2)
        Column and row of each point [px].
    shape
        Rows and columns of the image.
    highest
        Highest order; lower when the points are too few for it, or leave such a hole that its terms are not
        independent.
    """

    def __init__(self, points: np.ndarray, shape: tuple[int, int], highest: int = HIGHEST_ORDER) -> None:
        while highest > 1 and terms(highest) * _POINTS_PER_TERM > len(points):
            highest -= 1
        self.points = points
        self.shape = shape
        self.matrix = _matrix(points, shape, highest)
        gram = self.matrix.T @ self.matrix
        factor, failed = dpotrf(gram, lower=1)
        count = failed - 1 if failed > 0 else len(gram)
        own = np.diag(factor)[:count] ** 2 / np.diag(gram)[:count]
        if (own < _OWN).any():
            count = int(np.argmax(own < _OWN))
        while highest > 1 and terms(highest) > count:
            highest -= 1
        self.highest = highest
        self.matrix = self.matrix[:, : terms(self.highest)]

    def fit(self, values: np.ndarray, order: int, weights: np.ndarray) -> np.ndarray:
        """Return coefficients (terms, components) that fit `values` (points, components) by weighted least squares."""
        return least_squares(self.matrix[:, : terms(order)], values, weights)

    def evaluate(self, coefficients: np.ndarray) -> np.ndarray:
        """Return the polynomials at the points, (points, components)."""
        values: np.ndarray = self.matrix[:, : len(coefficients)] @ coefficients
        return values

    def uncertainty(self, order: int, weights: np.ndarray) -> float:
        """Return the noise of the fitted field, root mean square over the image, where weight 1 means noise 1."""
        used = self.matrix[:, : terms(order)]
        row, column = np.meshgrid(
            *(np.linspace(0, n - 1, m) for n, m in zip(self.shape, _SAMPLES, strict=True)), indexing="ij"
        )
        everywhere = _matrix(np.stack([column.ravel(), row.ravel()], axis=1), self.shape, order)
        mean_square = everywhere.T @ everywhere / len(everywhere)
        return float(np.sqrt(np.trace(cho_solve(cho_factor(used.T @ (weights[:, None] * used)), mean_square))))


def terms(order: int) -> int:
    """Return the number of products of total degree up to `order`."""
    return (order + 1) * (order + 2) // 2


def square(coefficients: np.ndarray, order: int) -> np.ndarray:
    """Return the coefficients (terms,) as the array (order + 1, order + 1) of a `DistortionMap`."""
    array = np.zeros((order + 1, order + 1), coefficients.dtype)
    by_row, by_column = _degrees(order)
    array[by_row[: len(coefficients)], by_column[: len(coefficients)]] = coefficients
    return array


def least_squares(matrix: np.ndarray, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the coefficients that fit `values` by weighted least squares, from the normal equations."""
    weighted = matrix.T * weights
    coefficients: np.ndarray = cho_solve(cho_factor(weighted @ matrix), weighted @ values)
    return coefficients


def choose_order(
    basis: Basis, values: np.ndarray, weights: np.ndarray, block: float
) -> tuple[int, tuple[int, ...], tuple[float, ...]]:
    """Return the lowest order that predicts left-out points as well as the best one.

    The best of many orders is often too high by chance, and its additional terms are noise. Another order is as good
    when its sum of squares exceeds that of the best by at most one standard deviation of this difference, which follows
    from the differences in the blocks (the one-standard-error rule).

    Parameters
    ----------
    basis
        Polynomials at the points.
    values : (points, components)
        Values to be fitted.
    weights : (points,)
        Of the points, inverse variances.
    block
        Points are left out in squares of this width [px], every fifth at a time: neighbours share noise.

    Returns
    -------
    order : int
        The chosen order.
    orders : tuple of int
        All orders that were compared.
    errors : tuple of float
        Weighted root mean square error of each at the left-out points.

    References
    ----------
    T. Hastie, R. Tibshirani, J. Friedman, "The elements of statistical learning", 2nd edition (2009), section 7.10:
    cross-validation and the one-standard-error rule.
    """
    place = np.floor(basis.points / block).astype(int)
    fold = (place[:, 0] + 2 * place[:, 1]) % _FOLDS
    cell = place[:, 0] + (place[:, 0].max() + 1) * place[:, 1]
    cells = int(cell.max()) + 1
    parts = []
    for k in range(_FOLDS):
        matrix, target, weight = basis.matrix[fold == k], values[fold == k], weights[fold == k]
        weighted = matrix.T * weight
        parts.append((weighted @ matrix, weighted @ target))
    gram, side = sum(part[0] for part in parts), sum(part[1] for part in parts)
    orders = tuple(range(1, basis.highest + 1))
    squares = np.zeros((len(orders), cells))
    for k, (left_gram, left_side) in enumerate(parts):
        matrix, target, weight = basis.matrix[fold == k], values[fold == k], weights[fold == k]
        # the factor of the beginning of a matrix is the beginning of its factor: one for all orders
        factor = np.linalg.cholesky(gram - left_gram)
        forward = solve_triangular(factor, side - left_side, lower=True)
        for index, order in enumerate(orders):
            n = terms(order)
            found = solve_triangular(factor[:n, :n].T, forward[:n], lower=False)
            error = weight * np.sum((target - matrix[:, :n] @ found) ** 2, axis=1)
            squares[index] += np.bincount(cell[fold == k], error, cells)
    total = squares.sum(axis=1)
    worse = squares - squares[np.argmin(total)]
    as_good = worse.sum(axis=1) <= np.sqrt(np.sum(worse**2, axis=1))
    return orders[int(np.argmax(as_good))], orders, tuple(np.sqrt(total / weights.sum()).tolist())


def _degrees(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the degrees along the rows and along the columns of each product."""
    pairs = [(i, total - i) for total in range(order + 1) for i in range(total + 1)]
    by_row, by_column = np.array(pairs).T
    return by_row, by_column


def _matrix(points: np.ndarray, shape: tuple[int, int], order: int) -> np.ndarray:
    by_row, by_column = _degrees(order)
    rows, columns = shape
    along_columns = chebyshev.chebvander(2 * points[:, 0] / (columns - 1) - 1, order)
    along_rows = chebyshev.chebvander(2 * points[:, 1] / (rows - 1) - 1, order)
    return along_rows[:, by_row] * along_columns[:, by_column]
