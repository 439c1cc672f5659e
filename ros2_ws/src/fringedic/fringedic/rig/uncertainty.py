"""Propagation of the calibration's covariance to measured positions, J Sigma_p J^T, with numerical derivatives.

The covariance of the parameters is split into its principal directions, Sigma_p = sum l l^T. The parameters are moved
by a small part e of the standard deviation along each direction l, and the line of sight is intersected with the fringe
again at the same pixel and phase: J l = (P(p + e l) - P(p - e l)) / 2 e. Sums of squares over the directions are
variances (JCGM 102:2011, propagation of uncertainty); differences between two points give the error of a displacement.

Steps are small because camera, projector and the centre of its lens may turn together with hardly any effect on the
phases. Such parameters follow a curve, and a step of a whole standard deviation along its tangent leaves it.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from fringedic.patterns.pattern import Orientation
from fringedic.rig.geometry import RigGeometry, parameter_values, with_parameters
from fringedic.rig.projector_lens import distorted

# test_sigma_of_float32_images_and_crops: interpolation on this grid reproduces the sigma of every pixel within 2 %
GRID = 48  # intervals of the variance map along each side of the image
HEIGHT_RANGE = 0.1  # of the camera's distance, on both sides of the reference plane; the map is clamped beyond it
# Intervals of the height with a cubic polynomial each. Variances differ by powers of ten within the range, and a
# polynomial or a spline of all of it becomes negative where they are small: test_sigma_of_a_rig_with_precise_grids.
HEIGHT_INTERVALS = 32
_SMALLEST = 1e-30  # [m^2] has a logarithm; (1e-15 m)^2 is far below every measured variance
_PART = 1e-2  # of a standard deviation: rounding and third order are below 1e-4 of an error
_NEGLIGIBLE = 1e-13  # of the largest variance among the directions: rounding errors of the eigenvalues
_NEWTON_STEPS = 4  # converges quadratically from the undistorted intersection
_PITCH = 1.0  # [projector px] cancels: phases are predicted and used with the same pitch


def position_errors(
    geometry: RigGeometry,
    column: ArrayLike,
    row: ArrayLike,
    z: ArrayLike,
    orientation: Orientation = Orientation.VERTICAL,
    directions: np.ndarray | None = None,
) -> np.ndarray:
    """Return the errors of measured positions for one standard deviation along each direction of the covariance.

    Parameters
    ----------
    geometry
        The calibrated rig with its covariance.
    column, row, z
        Pixels [px] and the heights [m] of the points that they see, arrays of one shape (or that broadcast).
    orientation
        Direction of the fringes.
    directions
        Other directions (direction, parameter) than `principal_directions`, such as those of a file.

    Returns
    -------
    ndarray
        Errors of x, y and z [m], float64, shape (direction, 3, ...). The sum of squares over the directions is the
        variance of the position; the sum of squares of a difference of two points is the variance of their distance.
    """
    column, row, z = np.broadcast_arrays(*(np.asarray(each, float) for each in (column, row, z)))
    distortion = geometry.camera_distortion
    if distortion is not None:
        column, row = distortion.ideal(column, row)
    rays = np.stack([column, row, np.ones(column.shape)], axis=-1) @ geometry.ray_matrix.T
    along = (z - geometry.camera_distance) / rays[..., 2]
    phase = geometry.phase(along * rays[..., 0], along * rays[..., 1], z, _PITCH, orientation)
    plain = dataclasses.replace(geometry, parameter_names=(), covariance=())
    centre = parameter_values(geometry, geometry.parameter_names)

    def position(values: np.ndarray) -> np.ndarray:
        moved = with_parameters(plain, geometry.parameter_names, values)
        rays = np.stack([column, row, np.ones(column.shape)], axis=-1) @ moved.ray_matrix.T
        order = [0, 1, 2] if orientation == Orientation.VERTICAL else [1, 0, 2]
        axes = moved.projector_axes[:, order]
        camera = np.array([0.0, 0.0, moved.camera_distance])
        along_m, along_n, along_back = np.moveaxis(rays @ axes, -1, 0)
        camera_m, camera_n, camera_back = (camera - moved.projector_position) @ axes
        scale, axis = moved.fringe_scale(_PITCH, orientation)
        target = scale * phase + axis
        t = -(camera_m + target * camera_back) / (along_m + target * along_back)
        lens = moved.projector_lens(orientation)
        for _ in range(_NEWTON_STEPS if any(lens) else 0):
            back = -1 / (camera_back + t * along_back)
            m, n = (camera_m + t * along_m) * back, (camera_n + t * along_n) * back
            m_t, n_t = (along_m + m * along_back) * back, (along_n + n * along_back) * back
            seen, by_m, by_n = distorted(m, n, *lens)
            t = t - (seen - target) / (by_m * m_t + by_n * n_t)
        return np.moveaxis(camera + t[..., None] * rays, -1, 0)

    steps = _PART * (principal_directions(geometry) if directions is None else directions)
    errors = [(position(centre + step) - position(centre - step)) / (2 * _PART) for step in steps]
    return np.array(errors).reshape(-1, 3, *column.shape)


def displacement_variance(
    geometry: RigGeometry,
    before: tuple[ArrayLike, ArrayLike, ArrayLike],
    after: tuple[ArrayLike, ArrayLike, ArrayLike],
    orientation: Orientation = Orientation.VERTICAL,
) -> np.ndarray:
    """Return the variances of a displacement due to the calibration, (J' - J) Sigma_p (J' - J)^T.

    Both positions are measured with the same calibration, so that most of its error cancels. The remainder grows with
    the displacement and is far smaller than J Sigma_p J^T. It is smooth over the image; compute it on a coarse grid of
    points and interpolate.

    Parameters
    ----------
    geometry
        The calibrated rig with its covariance.
    before, after
        (column [px], row [px], z [m]) of the same material points in the reference and in the deformed image, arrays of
        any one shape.
    orientation
        Direction of the fringes.

    Returns
    -------
    ndarray
        Variances of u, v and w [m^2], float64, shape (3, ...); zero when the covariance of the calibration is unknown.
    """
    difference = position_errors(geometry, *after, orientation) - position_errors(geometry, *before, orientation)
    result: np.ndarray = np.sum(difference**2, axis=0)
    return result


@lru_cache(maxsize=8)
def variance_map(geometry: RigGeometry, orientation: Orientation) -> tuple[np.ndarray, float]:
    """Return the variances due to the calibration as splines of the height, on a grid over the image.

    Returns
    -------
    coefficients : ndarray
        float64, shape (49, 49, 3, 32, 4): for 32 equal intervals from -scale to scale, coefficients of the variances of
        x, y and z [m^2] for the powers 0 to 3 of the part of the interval below the height. On a regular grid of 49 x
        49 points from the first to the last pixel of the image. NaN where a line of sight meets no fringe at one of the
        heights.
    scale : float
        Largest height of the map [m], on both sides of the reference plane.
    """
    scale = HEIGHT_RANGE * geometry.camera_distance
    borders = np.arange(HEIGHT_INTERVALS + 1)
    row, column, z = np.meshgrid(
        np.linspace(0, geometry.camera_height - 1, GRID + 1),
        np.linspace(0, geometry.camera_width - 1, GRID + 1),
        scale * (2 * borders / HEIGHT_INTERVALS - 1),
        indexing="ij",
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        variances = np.sum(position_errors(geometry, column, row, z, orientation) ** 2, axis=0)
    met = np.isfinite(variances).all(axis=-1)  # elsewhere no fringe meets the line of sight
    coefficients = np.full((*met.shape, HEIGHT_INTERVALS, 4), np.nan)
    coefficients[met] = _positive_cubics(np.maximum(variances[met], _SMALLEST))
    return np.ascontiguousarray(np.moveaxis(coefficients, 0, 2)), scale


def _positive_cubics(values: np.ndarray) -> np.ndarray:
    """Return coefficients (..., interval, 4) of positive cubics through values (..., border), with continuous slopes.

    Slopes are those of a spline of the logarithm; three times the value is the steepest with which a cubic is positive
    for certain (J. W. Schmidt, W. Hess, "Positivity of cubic polynomials on intervals and positive spline
    interpolation", BIT 28, 340-352, 1988).
    """
    borders = np.arange(values.shape[-1])
    slopes = values * CubicSpline(borders, np.log(values), axis=-1)(borders, 1)
    slopes = np.clip(slopes, -3 * values, 3 * values)
    first, last, at_first, at_last = values[..., :-1], values[..., 1:], slopes[..., :-1], slopes[..., 1:]
    rise = last - first
    return np.stack([first, at_first, 3 * rise - 2 * at_first - at_last, at_first + at_last - 2 * rise], axis=-1)


def principal_directions(geometry: RigGeometry) -> np.ndarray:
    """Return one standard deviation along each direction of the covariance, (direction, parameter), SI and px.

    The covariance of the parameters is the sum of the outer products of the directions.
    """
    count = len(geometry.parameter_names)
    covariance = np.array(geometry.covariance).reshape(count, count)
    sigma = np.sqrt(np.diag(covariance))
    # scaled to unit variances first, because metres and pixels differ by powers of ten
    safe = np.where(sigma > 0, sigma, 1.0)
    share, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    kept = share > _NEGLIGIBLE * max(share[-1], 0.0) if count else np.zeros(0, bool)
    result: np.ndarray = (vectors[:, kept] * np.sqrt(share[kept])).T * sigma
    return result
