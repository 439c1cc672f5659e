"""Pose of a sensor: from its own rig frame to the common frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class SensorPose:
    """Rotation and translation from the rig frame of a sensor to the common frame.

    Attributes
    ----------
    rotation
        Rotation vector [rad].
    translation
        Origin of the sensor's rig frame in the common frame [m].

    Examples
    --------
    >>> pose = SensorPose((0.0, 0.0, np.pi / 2), (0.1, 0.0, 0.0))
    >>> pose.apply(np.array([[1.0], [0.0], [0.0]])).ravel().round(6).tolist()
    [0.1, 1.0, 0.0]
    """

    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, matrix: np.ndarray, translation: np.ndarray) -> SensorPose:
        """Return the pose of a rotation matrix (3, 3) and a translation (3,) [m]."""
        x, y, z = Rotation.from_matrix(matrix).as_rotvec().tolist()
        a, b, c = np.asarray(translation, float).tolist()
        return cls((x, y, z), (a, b, c))

    @property
    def matrix(self) -> np.ndarray:
        """Rotation matrix (3, 3)."""
        found: np.ndarray = Rotation.from_rotvec(self.rotation).as_matrix()
        return found

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Rotation as a quaternion (x, y, z, w)."""
        x, y, z, w = Rotation.from_rotvec(self.rotation).as_quat().tolist()
        return x, y, z, w

    def turn(self, vectors: np.ndarray) -> np.ndarray:
        """Return vectors (3, ...) of the sensor's rig frame in the common frame."""
        turned: np.ndarray = np.tensordot(self.matrix, vectors, axes=1)
        return turned

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Return points (3, ...) [m] of the sensor's rig frame in the common frame."""
        moved: np.ndarray = self.turn(points) + np.reshape(self.translation, (3, *[1] * (np.ndim(points) - 1)))
        return moved

    def moved(self, change: np.ndarray) -> SensorPose:
        """Return this pose after a small rotation (3,) [rad] about the sensor's origin and a translation (3,) [m]."""
        turn = Rotation.from_rotvec(change[:3]) * Rotation.from_rotvec(self.rotation)
        return SensorPose.of(turn.as_matrix(), np.add(self.translation, change[3:]))

    def error_matrix(self, points: np.ndarray) -> np.ndarray:
        """Return the derivative (3, 6, ...) of `apply` at points (3, ...) by the six numbers of `moved`."""
        found = np.zeros((3, 6, *np.shape(points)[1:]))
        found[:, :3] = rotation_errors(self.turn(points))
        for axis in range(3):
            found[axis, 3 + axis] = 1.0
        return found


def rotation_errors(vectors: np.ndarray) -> np.ndarray:
    """Return the derivative (3, 3, ...) of vectors (3, ...) by a small rotation a, which moves a vector p by a x p."""
    x, y, z = vectors
    none = np.zeros_like(x)
    return np.stack([np.stack([none, z, -y]), np.stack([-z, none, x]), np.stack([y, -x, none])])
