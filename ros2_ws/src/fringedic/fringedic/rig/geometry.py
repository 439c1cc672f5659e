"""The rig's geometry: a pin-hole camera and a pin-hole projector, with the lens distortion of both.

Rig frame, right-handed: z = 0 is the reference plane, z towards the camera, x to the right of the image, y up in the
image. The camera's pin-hole is at (0, 0, h0), the projector's at (d, y, hp). A fringe of phase phi leaves the projector
as a surface (a plane without distortion).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from fringedic.camera.distortion import DistortionMap
from fringedic.errors import CalibrationError
from fringedic.frames.sensor import SENSOR, sensor_name
from fringedic.patterns.pattern import Orientation
from fringedic.rig.projector_lens import ProjectorLens, distorted
from fringedic.wording.arguments import Check, check_value, excerpt, several, text

SIX_PARAMETER, GENERAL = "six_parameter", "general"
UNKNOWN_FIRST = (-1, -1)
"""(column, row) of the sensor with which an image begins, when it is not known."""
ADDED = ("projector_k2", "projector_p1", "projector_p2", "projector_k3", "camera_first_column", "camera_first_row")
"""Fields that files and messages of older versions lack; they have their default there."""
_OLDER_MODEL_NAMES = {"paper": SIX_PARAMETER}  # in files and messages of older versions

# Names of the parameters that a covariance contains, and the field (with its index) of the geometry that each is.
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
    **{name: (name, None) for name in (f"projector_{each}" for each in ("k1", "k2", "p1", "p2", "k3"))},
}


@dataclass(frozen=True)
class RigGeometry:
    """Parameters of the pin-hole model of camera and projector (SI); see `fringedic.RigModel` for their meaning.

    Raises
    ------
    CalibrationError
        A parameter is not finite, is not positive although it has to be, or does not fit the others.
    """

    camera_width: int
    camera_height: int
    camera_distance: float
    pixel_size: float
    pixel_aspect: float
    principal_column: float
    principal_row: float
    projector_width: int
    projector_height: int
    projector_position: tuple[float, float, float]
    projector_focal_length: float
    projector_principal_column: float
    projector_principal_row: float
    camera_tilt_x: float = 0.0
    camera_tilt_y: float = 0.0
    camera_distortion: DistortionMap | None = None
    projector_rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    projector_k1: float = 0.0
    projector_k2: float = 0.0
    projector_p1: float = 0.0
    projector_p2: float = 0.0
    projector_k3: float = 0.0
    camera_first_column: int = UNKNOWN_FIRST[0]
    camera_first_row: int = UNKNOWN_FIRST[1]
    sensor: str = SENSOR
    identifier: str = ""
    model: str = GENERAL
    source: str = ""
    parameter_names: tuple[str, ...] = ()
    covariance: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name, check in _CHECKS.items():
            check_value(CalibrationError, name, getattr(self, name), check)
        for name in _TUPLES:
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(self, "model", current_model_name(self.model))
        for name in _NUMBERS:
            value = getattr(self, name)
            if not all(map(math.isfinite, value if name in _TUPLES else (value,))):
                raise CalibrationError(f"{name} is {excerpt(value)}: it has to be a finite number")
        for name in _POSITIVE:
            if getattr(self, name) <= 0:
                raise CalibrationError(f"{name} is {getattr(self, name)}: it has to be above 0")
        if self.projector_position[2] <= 0:
            raise CalibrationError(
                f"projector_position is {self.projector_position}: the projector has to be above the reference plane"
            )
        if self.model not in (SIX_PARAMETER, GENERAL):
            raise CalibrationError(f"model is '{self.model}': use '{SIX_PARAMETER}' or '{GENERAL}'")
        if len(self.covariance) != len(self.parameter_names) ** 2:
            raise CalibrationError(
                f"covariance has {len(self.covariance)} numbers for {len(self.parameter_names)} parameters"
            )
        for name in self.parameter_names:
            _field_of(name)
        distortion = self.camera_distortion
        if distortion is not None and (distortion.width, distortion.height) != (self.camera_width, self.camera_height):
            raise CalibrationError(
                f"camera_distortion belongs to an image of {distortion.width} x {distortion.height} px, the camera has "
                f"{self.camera_width} x {self.camera_height}"
            )

    @property
    def ray_matrix(self) -> np.ndarray:
        """Matrix (3, 3) from an ideal (column, row, 1) to the direction of its line of sight in the rig frame."""
        column = self.pixel_size / self.pixel_aspect / self.camera_distance
        row = self.pixel_size / self.camera_distance
        untilted = np.array(
            [
                [column, 0.0, -column * self.principal_column],
                [0.0, -row, row * self.principal_row],
                [0.0, 0.0, -1.0],
            ]
        )
        matrix: np.ndarray = _rotation_x(self.camera_tilt_x) @ _rotation_y(self.camera_tilt_y) @ untilted
        return matrix

    @property
    def projector_axes(self) -> np.ndarray:
        """Rotation matrix (3, 3): its columns are the projector's right, up and backward axes in the rig frame."""
        return projector_axes(self.projector_position, self.projector_rotation)

    def phase(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, pitch: float, orientation: Orientation = Orientation.VERTICAL
    ) -> np.ndarray:
        """Return the phase of the fringes on points of a surface.

        Parameters
        ----------
        x, y, z
            Points in the rig frame [m], arrays of one shape (or that broadcast).
        pitch
            Fringe pitch [projector px].
        orientation
            Direction of the fringes.

        Returns
        -------
        ndarray
            Absolute phase [rad], float64, in the shape of the points; 0 on the projector axis, growing towards +x
            (vertical fringes) or +y (horizontal).
        """
        points = np.stack(np.broadcast_arrays(x, y, z), axis=-1).astype(float)
        towards = np.moveaxis((points - self.projector_position) @ self.projector_axes, -1, 0)
        return self.phase_towards(towards, pitch, orientation)

    def phase_towards(
        self, directions: np.ndarray, pitch: float, orientation: Orientation = Orientation.VERTICAL
    ) -> np.ndarray:
        """Return the phase of the fringes along directions from the projector's pin-hole.

        Parameters
        ----------
        directions
            Components along the `projector_axes` (right, up, backward), float64 (3, ...); any length.
        pitch
            Fringe pitch [projector px].
        orientation
            Direction of the fringes.

        Returns
        -------
        ndarray
            Absolute phase [rad] as of `phase`, float64 (...).
        """
        right, up, backward = directions
        across, along = (right, up) if orientation == Orientation.VERTICAL else (up, right)
        coordinate = -across / backward
        lens = self.projector_lens(orientation)
        if any(lens):
            coordinate = distorted(coordinate, -along / backward, *lens)[0]
        scale, axis = self.fringe_scale(pitch, orientation)
        phase: np.ndarray = (coordinate - axis) / scale
        return phase

    def projector_lens(self, orientation: Orientation) -> ProjectorLens:
        """Return the distortion of the projector for fringes of a direction."""
        return ProjectorLens.of(
            self.projector_k1, self.projector_k2, self.projector_p1, self.projector_p2, self.projector_k3, orientation
        )

    def fringe_scale(self, pitch: float, orientation: Orientation) -> tuple[float, float]:
        """Return (scale, axis) of fringes of `pitch` [projector px].

        The distorted normalised coordinate of the projector across the fringes is ``scale * phi + axis``.
        """
        scale = pitch / (2 * math.pi * self.projector_focal_length)
        if orientation == Orientation.VERTICAL:
            offset = (self.projector_width - 1) / 2 - self.projector_principal_column
        else:
            offset = self.projector_principal_row - (self.projector_height - 1) / 2
        return scale, offset / self.projector_focal_length


_AnyGeometry = TypeVar("_AnyGeometry", bound=RigGeometry)


def current_model_name(name: str) -> str:
    """Return the present name of a model that an older version may have written under another name."""
    return _OLDER_MODEL_NAMES.get(name, name)


def parameter_values(geometry: RigGeometry, names: Sequence[str]) -> np.ndarray:
    """Return parameters of a rig by their names in a covariance, float64 (parameter,), SI.

    Raises
    ------
    CalibrationError
        A name is unknown.
    """
    values = []
    for name in names:
        field, index = _field_of(name)
        value = getattr(geometry, field)
        values.append(value if index is None else value[index])
    return np.array(values, float)


def with_parameters(geometry: _AnyGeometry, names: Sequence[str], values: ArrayLike) -> _AnyGeometry:
    """Return a rig with other values of some parameters (SI).

    Raises
    ------
    CalibrationError
        A name is unknown, or a value is not allowed.
    """
    changes: dict[str, Any] = {}
    for name, value in zip(names, np.asarray(values, float).tolist(), strict=True):
        field, index = _field_of(name)
        if index is None:
            changes[field] = value
        else:
            whole = list(changes.get(field, getattr(geometry, field)))
            whole[index] = value
            changes[field] = tuple(whole)
    return dataclasses.replace(geometry, **changes)


def _field_of(name: str) -> tuple[str, int | None]:
    if name not in PARAMETERS:
        raise CalibrationError(f"covariance of '{name}': known parameters are {', '.join(PARAMETERS)}")
    return PARAMETERS[name]


def projector_axes(position: Sequence[float], rotation: Sequence[float]) -> np.ndarray:
    """Return the projector's right, up and backward axes in the rig frame as columns (3, 3).

    Parameters
    ----------
    position
        Of the projector [m]; without rotation it looks at the origin.
    rotation
        Yaw, pitch and roll [rad].
    """
    x, y, z = forward = -np.asarray(position) / np.linalg.norm(position)
    right = np.array([-z, 0.0, x])  # horizontal: forward x (0, 1, 0)
    right /= np.linalg.norm(right)
    # written out, because np.cross takes longer than the phases of a plane
    up = np.array([-right[2] * y, right[2] * x - right[0] * z, right[0] * y])
    attitude = np.stack([right, up, -forward], axis=1)
    yaw, pitch, roll = rotation
    axes: np.ndarray = attitude @ _rotation_y(yaw) @ _rotation_x(pitch) @ _rotation_z(roll)
    return axes


def _rotation_x(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _rotation_y(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _rotation_z(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _any_number(value: Any) -> Any:
    """Check for a number; `RigGeometry` checks whether it is finite together with its other conditions."""
    if not isinstance(value, Real):
        raise ValueError("a number")
    return value


_NOT_NUMBERS = ("sensor", "identifier", "model", "source", "parameter_names", "camera_distortion")
_NUMBERS = tuple(each.name for each in dataclasses.fields(RigGeometry) if each.name not in _NOT_NUMBERS)
_TUPLES = ("projector_position", "projector_rotation", "parameter_names", "covariance")
_POSITIVE = (
    "camera_width",
    "camera_height",
    "camera_distance",
    "pixel_size",
    "pixel_aspect",
    "projector_width",
    "projector_height",
    "projector_focal_length",
)
_TRIPLE = several(_any_number, length=3)
_CHECKS: dict[str, Check] = dict.fromkeys(_NUMBERS, _any_number) | {
    "projector_position": _TRIPLE,
    "projector_rotation": _TRIPLE,
    "sensor": sensor_name,
    **dict.fromkeys(("identifier", "model", "source"), text),
    "parameter_names": several(text),
    "covariance": several(_any_number),
}
