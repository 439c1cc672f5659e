"""What an uncertain calibration does to measured positions: J Sigma_p J^T, without a formula for any J.

The covariance of the parameters is split into independent directions, Sigma_p = sum l l^T. Moving the parameters by one
standard deviation along each, l, and meeting line of sight and fringe again at the same pixel and phase tells by how
much the position moves: J l = (P(p + l) - P(p - l)) / 2, up to third order. Sums of squares of these are variances;
their differences between two points are the error of a displacement.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fringedic.errors import InvalidCalibrationError
from fringedic.sequence import Orientation

if TYPE_CHECKING:
    from fringedic.rig import RigModel

# Names of parameters in a covariance, and where they are in a RigModel.
PARAMETERS: dict[str, tuple[str, int | None]] = {
    "camera_distance": ("camera_distance", None),
    "pixel_size": ("pixel_size", None),
    "pixel_aspect": ("pixel_aspect", None),
    "principal_column": ("principal_column", None),
    "principal_row": ("principal_row", None),
    "camera_tilt_x": ("camera_tilt_x", None),
    "camera_tilt_y": ("camera_tilt_y", None),
    "projector_x": ("projector_position", 0),
    "projector_y": ("projector_position", 1),
    "projector_z": ("projector_position", 2),
    "projector_yaw": ("projector_rotation", 0),
    "projector_pitch": ("projector_rotation", 1),
    "projector_roll": ("projector_rotation", 2),
    "projector_focal_length": ("projector_focal_length", None),
    "projector_principal_column": ("projector_principal_column", None),
    "projector_principal_row": ("projector_principal_row", None),
    "projector_k1": ("projector_k1", None),
}
GRID = 48  # intervals of the map of variances along each side of the image
HEIGHT_RANGE = 0.1  # of the camera's distance, to both sides of the reference plane; beyond, that at the end is taken
HEIGHT_POWERS = 5  # a variance grows with about the fourth power of the height
_HEIGHTS = 9
_SMALLEST = 1e-30  # [m^2]
_NEGLIGIBLE = 1e-13  # part of the largest variance among the directions
_NEWTON_STEPS = 4
_PITCH = 1.0  # any: phases are made and used with the same one


def check_names(names: Sequence[str]) -> None:
    """Raise an error when a covariance names a parameter that a rig has not.

    Raises
    ------
    InvalidCalibrationError
        Names the unknown one and those that are known.
    """
    for name in names:
        _place(name)


def parameter_values(model: RigModel, names: Sequence[str]) -> np.ndarray:
    """Return the parameters of a model by their names in a covariance (SI).

    Raises
    ------
    InvalidCalibrationError
        When a name is unknown.
    """
    values = []
    for name in names:
        field, index = _place(name)
        value = getattr(model, field)
        values.append(value if index is None else value[index])
    return np.array(values, float)


def with_parameters(model: RigModel, names: Sequence[str], values: ArrayLike) -> RigModel:
    """Return a model with other values of some parameters (SI)."""
    changes: dict[str, float | tuple[float, ...]] = {}
    for name, value in zip(names, np.asarray(values, float).tolist(), strict=True):
        field, index = _place(name)
        if index is None:
            changes[field] = value
        else:
            whole = list(changes.get(field, getattr(model, field)))
            whole[index] = value
            changes[field] = tuple(whole)
    return dataclasses.replace(model, **changes)  # type: ignore[arg-type]


def position_errors(
    model: RigModel,
    column: ArrayLike,
    row: ArrayLike,
    z: ArrayLike,
    orientation: Orientation = Orientation.VERTICAL,
) -> np.ndarray:
    """Return what one standard deviation along each direction of the covariance does to measured positions.

    Parameters
    ----------
    column, row, z
        Pixels [px] and the heights [m] of the points that they see.
    orientation
        Direction of the fringes.

    Returns
    -------
    (direction, 3, ...)
        Errors of x, y and z [m]. The sum of squares over the directions is the variance; that of the difference of two
        points is the variance of the distance between them.
    """
    column, row, z = np.broadcast_arrays(*(np.asarray(each, float) for each in (column, row, z)))
    distortion = model.camera_distortion
    if distortion is not None:
        column, row = distortion.ideal(column, row)
    rays = np.stack([column, row, np.ones(column.shape)], axis=-1) @ model.ray_matrix.T
    along = (z - model.camera_distance) / rays[..., 2]
    phase = model.phase(along * rays[..., 0], along * rays[..., 1], z, _PITCH, orientation)
    plain = dataclasses.replace(model, parameter_names=(), covariance=())
    centre = parameter_values(model, model.parameter_names)
    errors = [
        (
            _positions(with_parameters(plain, model.parameter_names, centre + step), column, row, phase, orientation)
            - _positions(with_parameters(plain, model.parameter_names, centre - step), column, row, phase, orientation)
        )
        / 2
        for step in _directions(model)
    ]
    return np.array(errors).reshape(-1, 3, *column.shape)


def displacement_variance(
    model: RigModel,
    before: tuple[ArrayLike, ArrayLike, ArrayLike],
    after: tuple[ArrayLike, ArrayLike, ArrayLike],
    orientation: Orientation = Orientation.VERTICAL,
) -> np.ndarray:
    """Return the calibration's part of the variances of a displacement, (J' - J) Sigma_p (J' - J)^T.

    Both positions are measured with the same calibration, so that most of its error cancels: it grows with the
    displacement and is far smaller than J Sigma_p J^T. It is smooth over the image; compute it on a coarse grid of
    points and interpolate.

    Parameters
    ----------
    before, after
        (column [px], row [px], z [m]) of the same material points in the reference and in the deformed image, arrays of
        any one shape.
    orientation
        Direction of the fringes.

    Returns
    -------
    (3, ...)
        Variances of u, v and w [m^2]; zero when the covariance of the calibration is not known.
    """
    difference = position_errors(model, *after, orientation) - position_errors(model, *before, orientation)
    result: np.ndarray = np.sum(difference**2, axis=0)
    return result


@lru_cache(maxsize=8)
def variance_map(model: RigModel, orientation: Orientation) -> tuple[np.ndarray, float]:
    """Return the calibration's variances as polynomials of the height on a grid over the image.

    Returns
    -------
    coefficients : (49, 49, 3, 5)
        Of the variances of x, y and z [m^2] on a regular grid of 49 x 49 points from the first to the last pixel of the
        image: factors of the powers of z / scale.
    scale
        Height [m] that the powers refer to, and to both sides of which they hold.
    """
    scale = HEIGHT_RANGE * model.camera_distance
    heights = scale * np.cos(np.pi * (np.arange(_HEIGHTS) + 0.5) / _HEIGHTS)
    row, column, z = np.meshgrid(
        np.linspace(0, model.camera_height - 1, GRID + 1),
        np.linspace(0, model.camera_width - 1, GRID + 1),
        heights,
        indexing="ij",
    )
    variances = np.sum(position_errors(model, column, row, z, orientation) ** 2, axis=0)
    # every height counts by its relative error: variances differ by powers of ten
    powers = np.vander(heights / scale, HEIGHT_POWERS, increasing=True)
    weights = 1 / np.maximum(variances, _SMALLEST) ** 2
    normal = np.einsum("hp,crsh,hq->crspq", powers, weights, powers)
    right = np.einsum("hp,crsh->crsp", powers, weights * variances)
    coefficients = np.linalg.solve(normal, right[..., None])[..., 0]
    return np.ascontiguousarray(np.moveaxis(coefficients, 0, 2)), scale


def _place(name: str) -> tuple[str, int | None]:
    if name not in PARAMETERS:
        raise InvalidCalibrationError(f"covariance of '{name}': known parameters are {', '.join(PARAMETERS)}")
    return PARAMETERS[name]


def _directions(model: RigModel) -> np.ndarray:
    """Return steps (direction, parameter) with Sigma_p = sum of step step^T."""
    count = len(model.parameter_names)
    covariance = np.array(model.covariance).reshape(count, count)
    sigma = np.sqrt(np.diag(covariance))
    # unit variances first, or millimetres hide behind focal lengths in pixels
    safe = np.where(sigma > 0, sigma, 1.0)
    share, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    kept = share > _NEGLIGIBLE * max(share[-1], 0.0) if count else np.zeros(0, bool)
    result: np.ndarray = (vectors[:, kept] * np.sqrt(share[kept])).T * sigma
    return result


def _positions(
    model: RigModel, column: np.ndarray, row: np.ndarray, phase: np.ndarray, orientation: Orientation
) -> np.ndarray:
    """Meet lines of sight of scattered ideal pixels with their fringes, as `RigModel.reconstruct` does for images."""
    rays = np.stack([column, row, np.ones(column.shape)], axis=-1) @ model.ray_matrix.T
    order = [0, 1, 2] if orientation == Orientation.VERTICAL else [1, 0, 2]
    axes = model.projector_axes[:, order]
    camera = np.array([0.0, 0.0, model.camera_distance])
    along_m, along_n, along_back = np.moveaxis(rays @ axes, -1, 0)
    camera_m, camera_n, camera_back = (camera - model.projector_position) @ axes
    scale, axis = model._fringes(_PITCH, orientation)
    target = scale * phase + axis
    t = -(camera_m + target * camera_back) / (along_m + target * along_back)
    for _ in range(_NEWTON_STEPS if model.projector_k1 else 0):
        back = -1 / (camera_back + t * along_back)
        m, n = (camera_m + t * along_m) * back, (camera_n + t * along_n) * back
        m_t, n_t = (along_m + m * along_back) * back, (along_n + n * along_back) * back
        stretch = 1 + model.projector_k1 * (m * m + n * n)
        slope = m_t * (stretch + 2 * model.projector_k1 * m * m) + 2 * model.projector_k1 * m * n * n_t
        t = t - (m * stretch - target) / slope
    return np.moveaxis(camera + t[..., None] * rays, -1, 0)
