"""Pose of the camera in the rig frame, as ROS states it."""

from __future__ import annotations

from scipy.spatial.transform import Rotation

from fringedic.rig.model import RigModel


def camera_quaternion(rig: RigModel) -> tuple[float, float, float, float]:
    """Return the orientation of the camera's optical frame (z forward, x right, y down) in the rig frame.

    The camera's axes are those of the rig (z towards the camera, y up), rotated by the tilts about x and y, then by 180
    degrees about x, which turns z towards the reference plane.

    Returns
    -------
    tuple of float
        Unit quaternion (x, y, z, w) that rotates vectors of the optical frame into the rig frame.
    """
    rotation = (
        Rotation.from_euler("x", rig.camera_tilt_x)
        * Rotation.from_euler("y", rig.camera_tilt_y)
        * Rotation.from_euler("x", 180, degrees=True)
    )
    x, y, z, w = rotation.as_quat().tolist()
    return x, y, z, w
