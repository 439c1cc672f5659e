"""The phases that a rig sees on turned and lifted planes, as a function of the parameters that a calibration seeks.

Camera and projector are a `RigModel`; what is added here are the planes. The reference plane z = 0 is where the plane
stands at angle 0 and height 0. It turns about an axis that is free in space (position and direction, four parameters),
nearly along the fringes, and moves along z. Names are those "across" the fringes, along the base of the rig, and
"along" them, so that both directions of fringes share one description.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fringedic.calibration.closed_form import PaperParameters
from fringedic.camera import DistortionMap
from fringedic.camera.plane_view import PinHole, PlaneView
from fringedic.rig import RigModel
from fringedic.sequence import Orientation

# Names of parameters, how far each may sensibly change at once, and what people call it.
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
    "projector_along": _LENGTH,
    "projector_principal": 1.0,
    "phase_offset": 1.0,
    "axis_position": 1e-3,
    "camera_tilt_x": _ANGLE,
    "camera_tilt_y": _ANGLE,
    "pixel_size": 1e-7,
}
PAPER = (
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
)
AXIS = ("axis_across", "axis_height", "axis_skew", "axis_slope")


@dataclass(frozen=True)
class Camera:
    """What is known of the camera and of the projector's image before the fit.

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
        How the camera sees the reference plane; None when no grid was seen there. Tilts are parameters then, and when a
        grid on the turned plane told more of them than a plane alone can.
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
    plane: PlaneView | None
    projector_width: int
    projector_height: int
    pitch: float
    orientation: Orientation

    @property
    def vertical(self) -> bool:
        """Fringes are vertical: across them is x."""
        return self.orientation == Orientation.VERTICAL

    @property
    def projector_centre(self) -> float:
        """Middle of the projector's image across the fringes [px]."""
        return ((self.projector_width if self.vertical else self.projector_height) - 1) / 2

    def ideal(self, column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ideal pixels of pixels of the image."""
        return (column, row) if self.distortion is None else self.distortion.ideal(column, row)

    def on_reference(self, column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where ideal pixels of an upright camera look on the reference plane [m] (across, along)."""
        x = self.pixel_size / self.pixel_aspect * (column - self.principal_column)
        y = -self.pixel_size * (row - self.principal_row)
        return (x, y) if self.vertical else (y, x)


def rig_model(camera: Camera, values: Mapping[str, float]) -> RigModel:
    """Return the rig with these parameters; those that are not given are 0 or known."""
    paper = "phase_offset" in values
    distance = values["camera_distance"]
    tilts = (values.get("camera_tilt_x", 0.0), values.get("camera_tilt_y", 0.0))
    pixel_size, pixel_aspect = values.get("pixel_size", camera.pixel_size), camera.pixel_aspect
    principal = [camera.principal_column, camera.principal_row]
    if paper:
        # the camera stands above the rotation axis: the principal point is where the axis is seen
        if camera.vertical:
            principal[0] += values["axis_position"] / (pixel_size / pixel_aspect)
        else:
            principal[1] -= values["axis_position"] / pixel_size
    elif camera.plane is not None:
        # the grid's pitch may be wrong by a factor, which leaves the angles of a smaller or larger rig as they are
        scale = pixel_size / camera.pixel_size
        seen = camera.plane.camera(distance / scale, None if camera.plane.pin_hole is None else tilts)
        pixel_size, pixel_aspect = scale * seen["pixel_size"], seen["pixel_aspect"]
        tilts = (seen["camera_tilt_x"], seen["camera_tilt_y"])
    across, along = values["projector_across"], values.get("projector_along", 0.0)
    turn, nod, roll = (values.get(f"projector_{name}", 0.0) for name in ("turn", "nod", "roll"))
    columns = [(camera.projector_width - 1) / 2, (camera.projector_height - 1) / 2]
    shift = values.get("projector_principal", 0.0)
    offset = values.get("phase_offset", 0.0) * camera.pitch / (2 * math.pi)
    if camera.vertical:
        columns[0] += shift + offset
    else:
        columns[1] += shift - offset
    height = values["projector_height"]
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
        projector_position=(across, along, height) if camera.vertical else (along, across, height),
        projector_rotation=(turn, nod, roll) if camera.vertical else (nod, turn, roll),
        projector_focal_length=values["projector_focal_length"],
        projector_principal_column=columns[0],
        projector_principal_row=columns[1],
        projector_k1=values.get("projector_k1", 0.0),
        model="paper" if paper else "general",
    )


def pin_hole_deviation(camera: Camera, pin_hole: PinHole, values: Mapping[str, float]) -> np.ndarray:
    """Return by how many standard deviations a rig's camera stands beside the pin-hole that grids told, (3,)."""
    # a grid of another pitch tells the same angles of a larger or smaller rig
    scale = values.get("pixel_size", camera.pixel_size) / camera.pixel_size
    return pin_hole.deviation(values["camera_distance"] / scale, values["camera_tilt_x"], values["camera_tilt_y"])


def place_plane(camera: Camera, values: Mapping[str, float], angle: float, height: float) -> tuple[np.ndarray, float]:
    """Return (normal, offset) of the plane normal . X = offset at an angle [rad] and a height [m]."""
    across, up = values.get("axis_across", 0.0), values.get("axis_height", 0.0)
    skew, slope = values.get("axis_skew", 0.0), values.get("axis_slope", 0.0)
    if camera.vertical:
        direction, point, turn = np.array([skew, 1.0, slope]), np.array([across, 0.0, up]), -angle
    else:
        direction, point, turn = np.array([1.0, skew, slope]), np.array([0.0, across, up]), angle
    k = direction / np.linalg.norm(direction)
    c, s = math.cos(turn), math.sin(turn)
    # Rodrigues' rotation of the direction (0, 0, 1) about k
    turned = np.array([s * k[1], -s * k[0], c]) + (1 - c) * k[2] * k
    # the point of the axis keeps its distance from the plane, which was its height
    offset = turned @ point - up + height * turned[2]
    return turned, float(offset)


@dataclass(frozen=True)
class Placement:
    """Where the planes stand, as far as it is known.

    Attributes
    ----------
    angles, heights : (plane,)
        As given [rad], [m].
    """

    angles: np.ndarray
    heights: np.ndarray

    def of(self, plane: int, values: Mapping[str, float]) -> tuple[float, float]:
        """Return angle [rad] and height [m] of a plane with its errors among the parameters."""
        return (
            float(self.angles[plane]) + values.get(angle_error(plane), 0.0),
            float(self.heights[plane]) + values.get(height_error(plane), 0.0),
        )


def angle_error(plane: int) -> str:
    """Return the name of the parameter that is the error of a plane's angle [rad]."""
    return f"angle_error_{plane + 1}"


def height_error(plane: int) -> str:
    """Return the name of the parameter that is the error of a plane's height [m]."""
    return f"height_error_{plane + 1}"


def predict(
    camera: Camera,
    values: Mapping[str, float],
    placement: Placement,
    planes: Sequence[int],
    pixels: Sequence[np.ndarray],
) -> np.ndarray:
    """Return the phases [rad] that pixels see on planes.

    Parameters
    ----------
    planes
        Indices of planes.
    pixels
        For each of them its ideal pixels, (n, 3): column, row, 1.

    Returns
    -------
    (n1 + n2 + ...,)
        One plane after the other.
    """
    rig = rig_model(camera, values)
    matrix, points = rig.ray_matrix, []
    for plane, pixel in zip(planes, pixels, strict=True):
        normal, offset = place_plane(camera, values, *placement.of(plane, values))
        rays = pixel @ matrix.T
        along = (offset - normal[2] * rig.camera_distance) / (rays @ normal)
        point = along[:, None] * rays
        point[:, 2] += rig.camera_distance
        points.append(point)
    x, y, z = np.concatenate(points).T
    return rig.phase(x, y, z, camera.pitch, camera.orientation)


def paper_start(found: PaperParameters, camera: Camera) -> dict[str, float]:
    """Return the closed form as parameters of the paper's model."""
    return {
        "camera_distance": found.camera_distance,
        "projector_height": found.projector_distance,
        "projector_across": found.base,
        "projector_focal_length": found.sensitivity * camera.pitch / (2 * math.pi),
        "phase_offset": found.phase_offset,
        "axis_position": found.axis_position,
    }


def general_start(paper: Mapping[str, float], camera: Camera, turned: bool) -> dict[str, float]:
    """Return parameters of the general model near those of the paper's: turned so that the phase on the axis agrees.

    The paper's frame begins at the rotation axis, the general one below the camera's pin-hole.
    """
    start = dict.fromkeys(GENERAL + (AXIS if turned else ()), 0.0)
    for name in ("camera_distance", "projector_height", "projector_focal_length"):
        start[name] = paper[name]
    start["projector_across"] = paper["projector_across"] + paper["axis_position"]
    if turned:
        start["axis_across"] = paper["axis_position"]
    axis = (paper["axis_position"], 0.0) if camera.vertical else (0.0, paper["axis_position"])
    rig = rig_model(camera, start)
    missing = paper["phase_offset"] - float(rig.phase(*axis, 0.0, camera.pitch, camera.orientation))
    # a turn to its left moves everything to the right in the projector's image, one upwards everything down
    sensitivity = 2 * math.pi * paper["projector_focal_length"] / camera.pitch
    start["projector_turn"] = math.atan(missing / sensitivity) * (1 if camera.vertical else -1)
    return start
