"""Objects that several sensors measure, each with the errors by noise and by the calibration of its sensor."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations, permutations

import numpy as np
import xarray as xr

from fringedic.calibration.acceptance import find_balls, fit_sphere
from fringedic.camera.grid import TO_SIGMA
from fringedic.errors import CalibrationError
from fringedic.patterns.pattern import Orientation
from fringedic.rig.geometry import RigGeometry
from fringedic.rig.uncertainty import position_errors, principal_directions

_PROPAGATED = 1500  # points of a feature are enough for smooth errors of the calibration
_OUTLIER = 4.0  # [robust standard deviations] from the fitted object
_FEWEST = 100


class FeatureKind(StrEnum):
    """What a feature is."""

    BALL = "ball"
    PLANE = "plane"


@dataclass(frozen=True, eq=False)
class Feature:
    """A ball or a plane in the rig frame of the sensor that measured it.

    Attributes
    ----------
    kind
        Ball or plane.
    sensor, name
        Of the sensor, and of the object: the same for all sensors that measured it.
    position : (3,)
        Centre of the ball, or of the measured part of the plane [m].
    axes : (3, 3)
        Rows: directions of the three errors. For a ball x, y and z; for a plane the normal and two directions along it.
    covariance : (3, 3)
        Of the errors by noise: of a ball of its centre [m^2]; of a plane of its position along the normal [m^2] and its
        slopes along the two directions.
    errors : (direction, 3)
        Errors of the same three for one standard deviation along each direction of the covariance of the calibration.
    points
        Number of measured points.
    residual
        RMS distance of the points from the fitted object [m].
    """

    kind: FeatureKind
    sensor: str
    name: str
    position: np.ndarray
    axes: np.ndarray
    covariance: np.ndarray
    errors: np.ndarray
    points: int
    residual: float

    def named(self, name: str) -> Feature:
        """Return the feature with another name of its object."""
        return dataclasses.replace(self, name=name)


def measure_balls(
    shape: xr.Dataset,
    model: RigGeometry,
    diameter: float,
    number: int,
    name: str = "",
    orientation: Orientation = Orientation.VERTICAL,
) -> list[Feature]:
    """Return the balls of a known diameter that a sensor sees, in any order.

    Parameters
    ----------
    shape
        ``x``, ``y``, ``z`` [m] over (row, column), NaN where not measured.
    model
        Calibration of the sensor.
    diameter
        Of the balls [m]; their centres are fitted with a free radius.
    number
        How many there are in view.
    name
        Beginning of the names of the balls.
    orientation
        Direction of the fringes.

    Raises
    ------
    CalibrationError
        The surface shows fewer balls of this diameter.
    """
    seen = shape.assign_attrs(camera_distance=model.camera_distance)
    found = []
    for index, cap in enumerate(find_balls(seen, diameter, number)):
        points = _without_outliers(cap, fit_sphere(cap).distances)
        sphere = fit_sphere(points)
        away = points - sphere.centre[:, None]
        radial = away / np.linalg.norm(away, axis=0)
        design = np.vstack([radial, np.ones(points.shape[1])]).T
        covariance, errors = _propagate(points, radial, design, sphere.distances, model, orientation)
        found.append(
            Feature(
                FeatureKind.BALL,
                model.sensor,
                f"{name}ball {index + 1}",
                sphere.centre,
                np.eye(3),
                covariance[:3, :3],
                errors[:, :3],
                points.shape[1],
                math.sqrt(float(np.mean(sphere.distances**2))),
            )
        )
    return found


def measure_plane(
    shape: xr.Dataset, model: RigGeometry, name: str = "plane", orientation: Orientation = Orientation.VERTICAL
) -> Feature:
    """Return the plane that a sensor sees, such as the plate on its stage.

    Parameters
    ----------
    shape
        ``x``, ``y``, ``z`` [m] over (row, column), NaN where not measured; everything that is measured is the plane.
    model, name, orientation
        As of `measure_balls`.

    Raises
    ------
    CalibrationError
        Too little is measured.
    """
    points = _points(shape)
    for _ in range(2):
        if points.shape[1] < _FEWEST:
            raise CalibrationError(
                f"{points.shape[1]} points of the plane were measured by the sensor '{model.sensor}', at least "
                f"{_FEWEST} are needed: light it better"
            )
        middle = points.mean(axis=1)
        axes = np.linalg.svd(np.cov(points))[0].T[::-1]  # the normal first
        axes *= np.where(axes[0, 2] < 0, -1.0, 1.0)
        distances = axes[0] @ (points - middle[:, None])
        points = _without_outliers(points, distances)
    distances = axes[0] @ (points - middle[:, None])
    along = axes[1:] @ (points - middle[:, None])
    design = np.vstack([np.ones(points.shape[1]), along]).T
    normal = np.broadcast_to(axes[0][:, None], points.shape)
    covariance, errors = _propagate(points, normal, design, distances, model, orientation)
    residual = math.sqrt(float(np.mean(distances**2)))
    return Feature(FeatureKind.PLANE, model.sensor, name, middle, axes, covariance, errors, points.shape[1], residual)


def pixels_of(model: RigGeometry, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ideal column and row [px] of the pixels that see points (3, n) [m] of the sensor's rig frame."""
    towards = points - np.array([0.0, 0.0, model.camera_distance])[:, None]
    column, row, scale = np.linalg.solve(model.ray_matrix, towards)
    return column / scale, row / scale


def errors_at(
    model: RigGeometry, points: np.ndarray, orientation: Orientation, directions: np.ndarray | None = None
) -> np.ndarray:
    """Return the errors (direction, 3, n) [m] of points (3, n) by the calibration, as of `position_errors`."""
    ideal = dataclasses.replace(model, camera_distortion=None)
    if directions is None:
        directions = principal_directions(model)
    return position_errors(ideal, *pixels_of(model, points), points[2], orientation, directions)


def _propagate(
    points: np.ndarray,
    normals: np.ndarray,
    design: np.ndarray,
    distances: np.ndarray,
    model: RigGeometry,
    orientation: Orientation,
) -> tuple[np.ndarray, np.ndarray]:
    """Return covariance by noise, and errors by the calibration, of parameters fitted to distances along normals."""
    freedom = max(1, len(distances) - design.shape[1])
    variance = float(distances @ distances) / freedom
    covariance = variance * np.linalg.inv(design.T @ design)
    few = slice(None, None, max(1, points.shape[1] // _PROPAGATED))
    moved = errors_at(model, points[:, few], orientation)
    along = np.einsum("kin,in->kn", moved, normals[:, few])
    errors = np.linalg.lstsq(design[few], along.T, rcond=None)[0].T
    return covariance, errors


def _points(shape: xr.Dataset) -> np.ndarray:
    points = np.stack([np.asarray(shape[name], float) for name in "xyz"]).reshape(3, -1)
    return points[:, np.isfinite(points).all(axis=0)]


def _without_outliers(points: np.ndarray, distances: np.ndarray) -> np.ndarray:
    spread = TO_SIGMA * np.median(np.abs(distances - np.median(distances)))
    return points[:, np.abs(distances - np.median(distances)) <= _OUTLIER * spread]


def match_balls(first: Sequence[Feature], other: Sequence[Feature]) -> list[Feature]:
    """Return the balls of another sensor with the names of those of the first one, by their mutual distances.

    Parameters
    ----------
    first, other
        The balls of one object that two sensors measured at the same time; at least three of them are common.

    Raises
    ------
    CalibrationError
        Fewer than three balls are common, or their distances do not tell them apart.
    """
    known = np.stack([each.position for each in first], axis=1)
    seen = np.stack([each.position for each in other], axis=1)
    common = min(known.shape[1], seen.shape[1])
    if common < 3:
        raise CalibrationError(
            f"the sensors '{first[0].sensor}' and '{other[0].sensor}' have {common} balls in common, three are needed: "
            "move the object so that both see them"
        )
    options = [
        (rigid_fit(seen[:, list(chosen)], known[:, list(order)])[2], chosen, order)
        for chosen in combinations(range(seen.shape[1]), common)
        for order in permutations(range(known.shape[1]), common)
    ]
    options.sort(key=lambda each: each[0])
    if len(options) > 1 and options[1][0] < 3 * options[0][0]:
        raise CalibrationError(
            "the distances of the balls are too alike to tell them apart: place them so that all distances differ by "
            "more than a millimetre"
        )
    _, chosen, order = options[0]
    return [other[i].named(first[j].name) for i, j in zip(chosen, order, strict=True)]


def rigid_fit(points: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return rotation (3, 3), translation (3,) and RMS distance that move points (3, n) onto targets (Kabsch 1976)."""
    middle, aim = points.mean(axis=1), targets.mean(axis=1)
    rotation = rotation_between(points - middle[:, None], targets - aim[:, None])
    translation = aim - rotation @ middle
    left = rotation @ points + translation[:, None] - targets
    return rotation, translation, math.sqrt(float(np.mean(np.sum(left**2, axis=0))))


def rotation_between(vectors: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) that turns vectors (3, n) onto targets by least squares."""
    u, _, v = np.linalg.svd(targets @ vectors.T)
    turned: np.ndarray = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
    return turned
