"""Homographies: the mapping between a plane and its image in an ideal camera."""

from __future__ import annotations

import numpy as np

_STEPS = 8  # of Gauss-Newton; tilts of a few degrees converge in four


def apply_homography(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Map points (points, 2) by a homography (3, 3)."""
    mapped = points @ homography[:, :2].T + homography[:, 2]
    result: np.ndarray = mapped[:, :2] / mapped[:, 2:]
    return result


def fit_homography(source: np.ndarray, target: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Return the homography that maps `source` to `target` by weighted least squares of the distances.

    Parameters
    ----------
    source, target : (points, 2)
        Pairs of points.
    weights : (points,)
        Inverse variances; equal weights without.

    Returns
    -------
    ndarray
        Homography (3, 3) whose last entry is 1.

    References
    ----------
    R. Hartley, A. Zisserman, "Multiple view geometry in computer vision", 2nd edition (2003), chapter 4.

    Examples
    --------
    >>> import numpy as np
    >>> from fringedic.camera.homography import apply_homography, fit_homography
    >>> source = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 3.0], [4.0, 3.0], [2.0, 1.0]])
    >>> truth = np.array([[2.0, 0.1, 5.0], [-0.1, 2.0, 1.0], [0.01, 0.0, 1.0]])
    >>> bool(np.allclose(fit_homography(source, apply_homography(truth, source)), truth))
    True
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
    result: np.ndarray = matrix / matrix[2, 2]
    return result


def _unit_scale(points: np.ndarray) -> np.ndarray:
    """Return the homography that normalises points to mean 0 and size 1."""
    centre, scale = points.mean(axis=0), 1 / points.std()
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])
