"""Change of a model's maps by a small motion of the model, to first order.

Maps are functions of the measured points, so that a model that moves by m shows at (x, y) what was at (x, y) - m
before: its displacement f turns with the model and changes by -m . grad f.
"""

from __future__ import annotations

import numpy as np


def surface_gradient(positions: np.ndarray, maps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of maps (..., row, column) along x and along y of the rig, one-sided at edges.

    Parameters
    ----------
    positions : (3, row, column)
        Of the surface [m], NaN where not measured.
    maps : (..., row, column)
        NaN where not known.

    Examples
    --------
    >>> y, x = np.mgrid[3.0:-3.0:7j, 0.0:8.0:9j]
    >>> along_x, along_y = surface_gradient(np.stack([x, y, 0 * x]), np.where(x > 2, np.nan, 3 * x - 5 * y))
    >>> along_x[0, :3].tolist(), along_y[0, :3].tolist(), bool(np.isnan(along_x[:, 3:]).all())
    ([3.0, 3.0, 3.0], [-5.0, -5.0, -5.0], True)
    """
    (x_row, y_row), (x_column, y_column) = (_slope(positions[:2], axis) for axis in (-2, -1))
    area = x_column * y_row - x_row * y_column
    by_row, by_column = (_slope(maps, axis) for axis in (-2, -1))
    return (by_column * y_row - by_row * y_column) / area, (by_row * x_column - by_column * x_row) / area


def image_jacobian(positions: np.ndarray) -> np.ndarray:
    """Return the derivatives (2, 2, row, column) of x and y of the surface by column and by row, per point."""
    (x_row, y_row), (x_column, y_column) = (_slope(positions[:2], axis) for axis in (-2, -1))
    return np.array([[x_column, x_row], [y_column, y_row]])


def _slope(maps: np.ndarray, axis: int) -> np.ndarray:
    """Return differences per point along an axis: central where both neighbours are known, else one-sided."""
    steps = np.moveaxis(np.diff(maps, axis=axis), axis, -1)
    beside = np.full((*steps.shape[:-1], 1), np.nan, steps.dtype)
    before, after = np.concatenate([beside, steps], -1), np.concatenate([steps, beside], -1)
    mean = np.where(np.isnan(before), after, np.where(np.isnan(after), before, (before + after) / 2))
    return np.moveaxis(mean, -1, axis)


class Sensitivity:
    """Changes of a model's displacement and strain by motions of the model.

    Parameters
    ----------
    positions : (3, row, column)
        x and y of the measured points, z of the model there [m].
    displacement : (3, row, column)
        Of the model at the measured points [m].
    centre : (3,)
        Point that rotations turn about [m].
    """

    def __init__(self, positions: np.ndarray, displacement: np.ndarray, centre: np.ndarray) -> None:
        self._positions = (positions - centre[:, np.newaxis, np.newaxis]).astype(np.float32)
        self._displacement = displacement.astype(np.float32)
        self._gradient = surface_gradient(self._positions, self._displacement)
        self._slopes = surface_gradient(self._positions, self._positions[2])
        unit = np.eye(3, dtype=np.float32)[:, :, np.newaxis, np.newaxis]
        along = [
            axis + np.stack([0 * slope, 0 * slope, slope]) for axis, slope in zip(unit[:2], self._slopes, strict=True)
        ]
        self._tangents = [one + change for one, change in zip(along, self._gradient, strict=True)]

    def displacement(self, motion: np.ndarray) -> np.ndarray:
        """Return the change (3, row, column) [m] by a translation [m] and rotation [rad] about the centre (6,)."""
        motion = motion.astype(np.float32)
        shift = _cross(motion[3:], self._positions) + motion[:3, np.newaxis, np.newaxis]
        along_x, along_y = self._gradient
        return np.asarray(_cross(motion[3:], self._displacement) - shift[0] * along_x - shift[1] * along_y)

    def strain(self, change: np.ndarray) -> np.ndarray:
        """Return the change of e_11, e_22, e_12 (3, row, column) by a change of the displacement (3, row, column).

        The strain is half the change of a_i . a_j, with the tangent vectors a_i = A_i + (u, v, w)_i, in the basis of
        `fringedic.surface.surface_strain`; the change of a_i is that of the displacement's derivative.
        """
        z_x, z_y = self._slopes
        (a_x, a_y), (c_x, c_y) = self._tangents, surface_gradient(self._positions, change)
        e_xx, e_yy, e_xy = _dot(a_x, c_x), _dot(a_y, c_y), (_dot(a_x, c_y) + _dot(a_y, c_x)) / 2
        return tangent_components(np.stack([e_xx, e_yy, e_xy]), z_x, z_y)


def tangent_components(metric: np.ndarray, z_x: np.ndarray, z_y: np.ndarray) -> np.ndarray:
    """Return e_11, e_22, e_12 (3, row, column) of a strain E in the basis of `fringedic.surface.surface_strain`.

    The metric contains A_x . E A_x, A_y . E A_y and A_x . E A_y, with A_x = (1, 0, z_x) and A_y = (0, 1, z_y).
    """
    e_xx, e_yy, e_xy = metric
    squared = 1 + z_x**2
    r = np.sqrt(squared / (squared + z_y**2))
    p, q = 1 / np.sqrt(squared), -r * z_x * z_y / squared
    return np.stack([p**2 * e_xx, q**2 * e_xx + 2 * q * r * e_xy + r**2 * e_yy, p * (q * e_xx + r * e_xy)])


def _cross(vector: np.ndarray, maps: np.ndarray) -> np.ndarray:
    (a, b, c), (x, y, z) = vector, maps
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x])


def _dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.asarray(one[0] * other[0] + one[1] * other[1] + one[2] * other[2])
