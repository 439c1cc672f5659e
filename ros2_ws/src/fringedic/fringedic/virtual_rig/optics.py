"""Camera and projector of the virtual rig as pin-holes: matrices derived from the definition of the rig frame.

x is right in the image, y up in the image, z towards the camera; z = 0 is the reference plane. Rotations are
right-handed. SI units; image lengths in pixel.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fringedic.virtual_rig.configuration import CameraConfiguration, PlacementConfiguration, ProjectorConfiguration

Matrix = NDArray[np.float64]


def rotation_x(angle: float) -> Matrix:
    """Return the right-handed rotation by `angle` [rad] about x."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_y(angle: float) -> Matrix:
    """Return the right-handed rotation by `angle` [rad] about y."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rotation_z(angle: float) -> Matrix:
    """Return the right-handed rotation by `angle` [rad] about z."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def placement_matrices(placement: PlacementConfiguration) -> tuple[Matrix, Matrix]:
    """Return rotation (3, 3) and translation (3,) [m] from the sensor's rig frame to the frame of the specimen."""
    x, y, z = (math.radians(each) for each in placement.rotation_degree)
    angle = math.sqrt(x * x + y * y + z * z)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation = np.eye(3)
    if angle > 0.0:  # Rodrigues' formula
        rotation += math.sin(angle) / angle * cross + (1.0 - math.cos(angle)) / angle**2 * cross @ cross
    return rotation, 1e-3 * np.array(placement.translation_mm)


def looking_at_origin(position: Matrix) -> Matrix:
    """Return the attitude (columns: right, up, backwards) of a pin-hole that looks at the origin from `position`."""
    forward = -position / np.linalg.norm(position)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, forward), -forward], axis=1)


def _pin_hole(
    position: Matrix, rotation: Matrix, scale: tuple[float, float], principal: tuple[float, float], lens: list[float]
) -> Matrix:
    return np.concatenate([position, rotation.ravel(), scale, principal, lens])


def _centre(value: float | None, size: int) -> float:
    return 0.5 * (size - 1) if value is None else value


def camera_pin_hole(camera: CameraConfiguration) -> Matrix:
    """Return the camera as the vector of the ray tracing.

    Without its lens the direction of pixel (r, s) is Rx(tilt_x) Ry(tilt_y) ((gamma/tau)(r - r0)/h0, -gamma (s - s0)/h0,
    -1).
    """
    optics = camera_optics(camera)
    scale = optics["camera_distance"] / optics["pixel_size"]
    lens, width = camera.lens, camera.columns / 100
    shift = [width * value for value in lens.bump_percent]
    centre = [
        0.5 * (size - 1) + width * value
        for size, value in zip((camera.columns, camera.rows), lens.bump_centre_percent, strict=True)
    ]
    return _pin_hole(
        np.array([0.0, 0.0, optics["camera_distance"]]),
        rotation_x(optics["camera_tilt_x"]) @ rotation_y(optics["camera_tilt_y"]),
        (scale * optics["pixel_aspect"], scale),
        (optics["principal_column"], optics["principal_row"]),
        [lens.k1, lens.k2, lens.p1, lens.p2, lens.k3, *shift, *centre, width * lens.bump_radius_percent],
    )


def projector_pin_hole(projector: ProjectorConfiguration) -> Matrix:
    """Return the projector as the vector of the ray tracing: attitude R0 Ry(yaw) Rx(pitch) Rz(roll)."""
    position = 1e-3 * np.array([projector.x_mm, projector.y_mm, projector.z_mm])
    rotation = (
        looking_at_origin(position)
        @ rotation_y(math.radians(projector.yaw_degree))
        @ rotation_x(math.radians(projector.pitch_degree))
        @ rotation_z(math.radians(projector.roll_degree))
    )
    principal = (
        _centre(projector.principal_column, projector.columns),
        _centre(projector.principal_row, projector.rows),
    )
    focal = projector.focal_length_px
    lens = [projector.k1, projector.k2, projector.p1, projector.p2, projector.k3, *[0.0] * 4, 1.0]
    return _pin_hole(position, rotation, (focal, focal), principal, lens)


def camera_optics(camera: CameraConfiguration) -> dict[str, float]:
    """Return camera parameters [m, rad, px] with the names of fringedic_msgs/RigCalibration, without the lens."""
    return {
        "camera_width": camera.columns,
        "camera_height": camera.rows,
        "camera_distance": 1e-3 * camera.distance_mm,
        "pixel_size": 1e-6 * camera.pixel_size_um,
        "pixel_aspect": camera.pixel_aspect,
        "principal_column": _centre(camera.principal_column, camera.columns),
        "principal_row": _centre(camera.principal_row, camera.rows),
        "camera_tilt_x": math.radians(camera.tilt_x_degree),
        "camera_tilt_y": math.radians(camera.tilt_y_degree),
    }


def projector_optics(projector: ProjectorConfiguration) -> dict[str, float | list[float]]:
    """Return projector parameters [m, rad, px] with the names of fringedic_msgs/RigCalibration."""
    return {
        "projector_width": projector.columns,
        "projector_height": projector.rows,
        "projector_position": [1e-3 * projector.x_mm, 1e-3 * projector.y_mm, 1e-3 * projector.z_mm],
        "projector_rotation": [
            math.radians(angle) for angle in (projector.yaw_degree, projector.pitch_degree, projector.roll_degree)
        ],
        "projector_focal_length": projector.focal_length_px,
        "projector_principal_column": _centre(projector.principal_column, projector.columns),
        "projector_principal_row": _centre(projector.principal_row, projector.rows),
        "projector_k1": projector.k1,
        "projector_k2": projector.k2,
        "projector_p1": projector.p1,
        "projector_p2": projector.p2,
        "projector_k3": projector.k3,
    }
