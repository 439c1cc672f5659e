"""Homographies: the views that one ideal camera has of a plane."""

from __future__ import annotations

import numpy as np

_STEPS = 8  # of Gauss-Newton; views of a few degrees settle in four


def apply_homography(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Map points (points, 2) by a homography (3, 3)."""
    mapped = points @ homography[:, :2].T + homography[:, 2]
    return mapped[:, :2] / mapped[:, 2:]


def fit_homography(source: np.ndarray, target: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Return the homography that maps `source` to `target` with the least weighted squares of the distances.

    Parameters
    ----------
    source, target : (points, 2)
        Pairs of points.
    weights : (points,)
        Inverse variances, all equal without.

    Returns
    -------
    (3, 3), its last entry 1.
    """
    from_units, to_units = _unit_scale(source), _unit_scale(target)
    a, b = apply_homography(from_units, source), apply_homography(to_units, target)
    root = np.ones(len(a)) if weights is None else np.sqrt(weights)
    h = np.array([1.0, 0, 0, 0, 1, 0, 0, 0])
    homogeneous, none = np.column_stack([a, np.ones(len(a))]), np.zeros((len(a), 3))
    for _ in range(_STEPS):
        matrix = np.append(h, 1.0).reshape(3, 3)
        mapped = apply_homography(matrix, a)
        scale = (root / (homogeneous @ matrix[2]))[:, None]
        jacobian = np.concatenate(
            [
                np.hstack([homogeneous, none, -mapped[:, :1] * a]) * scale,
                np.hstack([none, homogeneous, -mapped[:, 1:] * a]) * scale,
            ]
        )
        left = ((b - mapped) * root[:, None]).T.ravel()
        h = h + np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ left)
    matrix = np.linalg.inv(to_units) @ np.append(h, 1.0).reshape(3, 3) @ from_units
    return matrix / matrix[2, 2]


def _unit_scale(points: np.ndarray) -> np.ndarray:
    """Homography that brings points to the mean 0 and the size 1."""
    centre, scale = points.mean(axis=0), 1 / points.std()
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])
