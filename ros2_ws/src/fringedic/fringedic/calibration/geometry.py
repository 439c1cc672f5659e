"""The phases that a rig sees on tilted and translated planes, as a function of the parameters of a calibration.

Camera and projector are a `RigModel`; this module adds the planes. The reference plane z = 0 is the plane at angle 0
and height 0. It turns about an axis that is free in space (position and direction, four parameters), nearly along the
fringes, and moves along z. Directions are called "across" the fringes (along the base of the rig) and "along" them, so
that both directions of fringes share one description.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fringedic.calibration.closed_form import SixParameters
from fringedic.calibration.placement import Placement
from fringedic.camera.distortion import DistortionMap
from fringedic.camera.plane_homography import PinHole, PlaneHomography
from fringedic.errors import CalibrationError
from fringedic.patterns.pattern import Orientation
from fringedic.rig.geometry import GENERAL as GENERAL_MODEL
from fringedic.rig.geometry import SIX_PARAMETER, projector_axes
from fringedic.rig.model import RigModel
from fringedic.wording.numbers import number_text

_WIDEST_FIELD = 2.0  # width over camera distance (an angle of view of 90 degree); wider means wrong angles
_NEAREST, _FARTHEST = 0.01, 50.0  # [m] of the camera from the plane; the scale is wrong beyond these
# Parameters with the change that scales each in the fit: about the size of its usual deviations.
_LENGTH, _ANGLE = 1e-2, 1e-2
SCALES: dict[str, float] = {
    "camera_distance": _LENGTH,
    "projector_across": _LENGTH,
    "projector_height": _LENGTH,
    "projector_focal_length": 30.0,
    "projector_turn": _ANGLE,
    "projector_nod": _ANGLE,
    "projector_roll": _ANGLE,
    "axis_across": 1e-3,
    "axis_height": 1e-3,
    "axis_skew": _ANGLE,
    "axis_slope": _ANGLE,
    "projector_k1": 0.1,
    "projector_k2": 1.0,
    "projector_p1": 1e-3,
    "projector_p2": 1e-3,
    "projector_k3": 10.0,
    "projector_along": _LENGTH,
    "projector_principal": 1.0,
    "phase_offset": 1.0,
    "axis_position": 1e-3,
    "camera_tilt_x": _ANGLE,
    "camera_tilt_y": _ANGLE,
    "pixel_size": 1e-7,
}
SIX_PARAMETERS = (
    "camera_distance",
    "projector_height",
    "projector_across",
    "projector_focal_length",
    "phase_offset",
    "axis_position",
)
GENERAL = (
    "camera_distance",
    "projector_across",
    "projector_height",
    "projector_focal_length",
    "projector_turn",
    "projector_nod",
    "projector_roll",
    "projector_k1",
    "projector_k2",
    "projector_k3",
    "projector_p1",
    "projector_p2",
    "projector_along",  # shifts the centre of the distortion, and without distortion nothing
)
AXIS = ("axis_across", "axis_height", "axis_skew", "axis_slope")


@dataclass(frozen=True)
class Camera:
    """What is known of the camera and of the projector before the fit.

    Attributes
    ----------
    width, height
        Size of the image [px].
    pixel_size, pixel_aspect
        gamma [m] and tau.
    principal_column, principal_row
        Ideal pixel of the optical axis [px].
    distortion
        From pixels of the image to ideal ones.
    plane
        Homography of the reference plane; None when no grid was seen there. The tilts of the camera are free parameters
        without it, and also when grids on the tilted plane have located the pin-hole.
    projector_width, projector_height
        Size of the projector's image [px].
    pitch
        Of the fringes [projector px].
    orientation
        Direction of the fringes.
    """

    width: int
    height: int
    pixel_size: float
    pixel_aspect: float
    principal_column: float
    principal_row: float
    distortion: DistortionMap | None
    plane: PlaneHomography | None
    projector_width: int
    projector_height: int
    pitch: float
    orientation: Orientation

    @property
    def vertical(self) -> bool:
        """Whether the fringes are vertical, so that x is across them."""
        return self.orientation == Orientation.VERTICAL

    def ideal(self, column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ideal pixels of pixels of the image."""
        return (column, row) if self.distortion is None else self.distortion.ideal(column, row)

    def on_reference(self, column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where the lines of sight of an untilted camera meet the reference plane [m] (across, along)."""
        x = self.pixel_size / self.pixel_aspect * (column - self.principal_column)
        y = -self.pixel_size * (row - self.principal_row)
        return (x, y) if self.vertical else (y, x)


def rig_model(camera: Camera, values: Mapping[str, float]) -> RigModel:
    """Return the rig with these parameters; parameters that are missing are 0 or known."""
    six_parameter = "phase_offset" in values
    distance = values["camera_distance"]
    tilts = (values.get("camera_tilt_x", 0.0), values.get("camera_tilt_y", 0.0))
    pixel_size, pixel_aspect = values.get("pixel_size", camera.pixel_size), camera.pixel_aspect
    principal = [camera.principal_column, camera.principal_row]
    if six_parameter:
        # the camera is above the rotation axis: the principal point is where the axis is seen
        if camera.vertical:
            principal[0] += values["axis_position"] / (pixel_size / pixel_aspect)
        else:
            principal[1] -= values["axis_position"] / pixel_size
    elif camera.plane is not None:
        # an error of the grid's pitch scales all lengths of the rig and leaves its angles unchanged
        scale = pixel_size / camera.pixel_size
        seen = camera.plane.camera(distance / scale, None if camera.plane.pin_hole is None else tilts)
        pixel_size, pixel_aspect = scale * seen["pixel_size"], seen["pixel_aspect"]
        tilts = (seen["camera_tilt_x"], seen["camera_tilt_y"])
    across = values["projector_across"]
    turn, nod, roll = (values.get(f"projector_{name}", 0.0) for name in ("turn", "nod", "roll"))
    columns = [(camera.projector_width - 1) / 2, (camera.projector_height - 1) / 2]
    shift = values.get("projector_principal", 0.0)
    offset = values.get("phase_offset", 0.0) * camera.pitch / (2 * math.pi)
    if camera.vertical:
        columns[0] += shift + offset
    else:
        columns[1] += shift - offset
    height = values["projector_height"]
    position = (across, 0.0, height) if camera.vertical else (0.0, across, height)
    rotation = (turn, nod, roll) if camera.vertical else (nod, turn, roll)
    along = values.get("projector_along", 0.0)
    if along:
        position, rotation = _moved_along_fringes(position, rotation, along, vertical=camera.vertical)
    return RigModel(
        camera_width=camera.width,
        camera_height=camera.height,
        camera_distance=distance,
        pixel_size=pixel_size,
        pixel_aspect=pixel_aspect,
        principal_column=principal[0],
        principal_row=principal[1],
        camera_tilt_x=tilts[0],
        camera_tilt_y=tilts[1],
        camera_distortion=camera.distortion,
        projector_width=camera.projector_width,
        projector_height=camera.projector_height,
        projector_position=position,
        projector_rotation=rotation,
        projector_focal_length=values["projector_focal_length"],
        projector_principal_column=columns[0],
        projector_principal_row=columns[1],
        projector_k1=values.get("projector_k1", 0.0),
        projector_k2=values.get("projector_k2", 0.0),
        projector_p1=values.get("projector_p1", 0.0),
        projector_p2=values.get("projector_p2", 0.0),
        projector_k3=values.get("projector_k3", 0.0),
        model=SIX_PARAMETER if six_parameter else GENERAL_MODEL,
    )


_Triple = tuple[float, float, float]


def _moved_along_fringes(
    position: _Triple, rotation: _Triple, distance: float, *, vertical: bool
) -> tuple[_Triple, _Triple]:
    """Return position and rotation of a projector that is moved along its own fringes [m], its axes parallel.

    Without distortion this changes no phase, so that a fit is not bent by it.
    """
    axes = projector_axes(position, rotation)
    x, y, z = (np.array(position) + distance * axes[:, 1 if vertical else 0]).tolist()
    turned = projector_axes((x, y, z), (0.0, 0.0, 0.0)).T @ axes
    yaw = math.atan2(turned[0, 2], turned[2, 2])
    nod = -math.asin(max(-1.0, min(1.0, turned[1, 2])))
    return (x, y, z), (yaw, nod, math.atan2(turned[1, 0], turned[1, 1]))


def check_size(camera: Camera, distance: float) -> None:
    """Refuse a rig of an impossible size: phases do not determine the size, and fit as well with a wrong unit.

    Raises
    ------
    CalibrationError
        The camera, at this distance [m], would look at a field wider than any lens sees, or be nearer or farther than
        that of any rig: angles or lengths of the wrong unit.
    """
    width = camera.pixel_size * max(camera.width / camera.pixel_aspect, camera.height)
    if width > _WIDEST_FIELD * distance or not _NEAREST < distance < _FARTHEST:
        raise CalibrationError(
            f"the camera would stand {number_text(distance, 3)} m from a field of {number_text(width, 3)} m: are the "
            "grid's pitch, the pixel size and heights given in metre and angles in radian (in files: millimetre, "
            "degree)?"
        )


def pin_hole_deviation(camera: Camera, pin_hole: PinHole, values: Mapping[str, float]) -> np.ndarray:
    """Return the deviation of a rig's camera from the pin-hole that grids located, in standard deviations, (3,)."""
    # a grid of another pitch gives the same angles of a larger or smaller rig
    scale = values.get("pixel_size", camera.pixel_size) / camera.pixel_size
    return pin_hole.deviation(values["camera_distance"] / scale, values["camera_tilt_x"], values["camera_tilt_y"])


def place_planes(
    camera: Camera, values: Mapping[str, float], angles: np.ndarray, heights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (normals, offsets) of the planes normal . X = offset at angles [rad] and heights [m], (n, 3) and (n,)."""
    across, up = values.get("axis_across", 0.0), values.get("axis_height", 0.0)
    skew, slope = values.get("axis_skew", 0.0), values.get("axis_slope", 0.0)
    if camera.vertical:
        direction, point, turn = (skew, 1.0, slope), (across, 0.0, up), -angles
    else:
        direction, point, turn = (1.0, skew, slope), (0.0, across, up), angles
    length = math.hypot(*direction)
    kx, ky, kz = (each / length for each in direction)
    c, s = np.cos(turn), np.sin(turn)
    # Rodrigues' rotation of the direction (0, 0, 1) about k
    share = (1 - c) * kz
    normals = np.stack([s * ky + share * kx, share * ky - s * kx, c + share * kz], axis=1)
    # the point of the axis keeps its distance from the plane, which is its height at angle 0
    offsets: np.ndarray = normals @ point - up + heights * normals[:, 2]
    return normals, offsets


def predict(
    camera: Camera,
    values: Mapping[str, float],
    placement: Placement,
    planes: Sequence[int],
    pixels: Sequence[np.ndarray],
) -> np.ndarray:
    """Return the phases that pixels see on planes.

    Parameters
    ----------
    camera, values, placement
        The known part of the rig, all parameters by name (SI, px), and the stated positions of the planes.
    planes
        Indices of planes.
    pixels
        For each of them its ideal pixels, (3, n): column, row, 1.

    Returns
    -------
    ndarray
        Phases [rad], float64, shape (n1 + n2 + ...,): one plane after the other.
    """
    rig = rig_model(camera, values)
    axes, rays = rig.projector_axes.T, rig.ray_matrix
    towards = axes @ rays
    camera_pin_hole = axes @ (np.array([0.0, 0.0, rig.camera_distance]) - rig.projector_position)
    normals, offsets = place_planes(camera, values, *placement.of(planes, values))
    distances = offsets - normals[:, 2] * rig.camera_distance
    # a plane maps pixels of the camera to directions of the projector by a homography
    homographies = distances[:, None, None] * towards + camera_pin_hole[:, None] * (normals @ rays)[:, None, :]
    directions = [each @ pixel for each, pixel in zip(homographies, pixels, strict=True)]
    return rig.phase_towards(np.concatenate(directions, axis=1), camera.pitch, camera.orientation)


def six_parameter_start(found: SixParameters, camera: Camera) -> dict[str, float]:
    """Return the closed form as start of the six-parameter model."""
    return {
        "camera_distance": found.camera_distance,
        "projector_height": found.projector_distance,
        "projector_across": found.base,
        "projector_focal_length": found.sensitivity * camera.pitch / (2 * math.pi),
        "phase_offset": found.phase_offset,
        "axis_position": found.axis_position,
    }


def general_start(six: Mapping[str, float], camera: Camera, turned: bool) -> dict[str, float]:
    """Return parameters of the general model near those of the six-parameter model.

    The origin of the six-parameter model is on the rotation axis, that of the general model below the camera's
    pin-hole. The projector is turned so that the phase on the axis agrees.
    """
    start = dict.fromkeys(GENERAL + (AXIS if turned else ()), 0.0)
    for name in ("camera_distance", "projector_height", "projector_focal_length"):
        start[name] = six[name]
    start["projector_across"] = six["projector_across"] + six["axis_position"]
    if turned:
        start["axis_across"] = six["axis_position"]
    axis = (six["axis_position"], 0.0) if camera.vertical else (0.0, six["axis_position"])
    rig = rig_model(camera, start)
    missing = six["phase_offset"] - float(rig.phase(*axis, 0.0, camera.pitch, camera.orientation))
    # a turn of the projector to its left moves the scene to the right in its image, a turn upwards moves it down
    sensitivity = 2 * math.pi * six["projector_focal_length"] / camera.pitch
    start["projector_turn"] = math.atan(missing / sensitivity) * (1 if camera.vertical else -1)
    return start
