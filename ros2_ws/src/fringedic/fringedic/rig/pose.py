"""Poses of camera, projector and load frame in the rig frame, as ROS states them."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from fringedic.rig.model import RigModel

Quaternion = tuple[float, float, float, float]

LOAD_FRAME_QUATERNION: Quaternion = (-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
"""Orientation of the load frame (z: direction of loading, y of the rig; x as the rig) as a quaternion (x, y, z, w)."""


def camera_quaternion(rig: RigModel) -> Quaternion:
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
    return _quaternion(rotation)


def projector_quaternion(rig: RigModel) -> Quaternion:
    """Return the orientation of the projector's optical frame (z forward, x right, y down) in the rig frame.

    Returns
    -------
    tuple of float
        Unit quaternion (x, y, z, w) that rotates vectors of the optical frame into the rig frame.
    """
    right, up, backward = rig.projector_axes.T
    return _quaternion(Rotation.from_matrix(np.stack([right, -up, -backward], axis=1)))


def _quaternion(rotation: Rotation) -> Quaternion:
    x, y, z, w = rotation.as_quat().tolist()
    return x, y, z, w
