"""Charts of a surface that several sensors see: the plane or the cylinder on which its points are a map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

_FACING = math.cos(math.radians(65.0))  # normals farther from their mean need a cylinder
_FACING_SHARE = 0.99
_SECTORS, _FILLED = 72, 70  # a circumference is closed if so many of its sectors contain points


@dataclass(frozen=True, eq=False)
class Chart:
    """A plane, or a cylinder, with the coordinates a (right, or around), b (up, or along the axis) and a height.

    Attributes
    ----------
    origin : (3,)
        Of the plane, or on the axis of the cylinder [m].
    axes : (3, 3)
        Rows: directions of a and b in the origin of the map, and the normal there.
    radius
        Of the cylinder [m]; infinite for a plane.
    """

    origin: np.ndarray
    axes: np.ndarray
    radius: float = math.inf

    @property
    def is_plane(self) -> bool:
        """Whether the chart is a plane."""
        return math.isinf(self.radius)

    @property
    def circumference(self) -> float:
        """Length around the cylinder [m]; infinite for a plane."""
        return 2 * math.pi * self.radius

    def coordinates(self, points: np.ndarray, middle: float = 0.0) -> np.ndarray:
        """Return a, b and the height [m] of points (3, ...); on a cylinder a is within half a turn of `middle`."""
        across, along, up = np.tensordot(self.axes, points - _column(self.origin, points), axes=1)
        if self.is_plane:
            return np.stack([across, along, up])
        a = self.radius * np.arctan2(across, up)
        a = np.remainder(a - middle + 0.5 * self.circumference, self.circumference) + middle - 0.5 * self.circumference
        return np.stack([a, along, np.hypot(across, up) - self.radius])

    def directions(self, a: np.ndarray) -> np.ndarray:
        """Return the directions of a, b and the height at points, (3, 3, ...): direction, then x, y, z."""
        right, along, up = (_column(each, np.empty((3, *np.shape(a)))) for each in self.axes)
        if self.is_plane:
            whole = np.zeros((3, *np.shape(a)))
            return np.stack([right + whole, along + whole, up + whole])
        angle = a / self.radius
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([c * right - s * up, along + 0.0 * angle, s * right + c * up])

    def points(self, a: np.ndarray, b: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Return the points (3, ...) [m] at coordinates."""
        right, along, up = (_column(each, np.empty((3, *np.shape(a)))) for each in self.axes)
        origin = _column(self.origin, np.empty((3, *np.shape(a))))
        if self.is_plane:
            found = origin + a * right + b * along + height * up
        else:
            angle = a / self.radius
            away = self.radius + height
            found = origin + away * np.sin(angle) * right + b * along + away * np.cos(angle) * up
        return np.asarray(found)


def _column(vector: np.ndarray, like: np.ndarray) -> np.ndarray:
    return np.reshape(vector, (3, *[1] * (like.ndim - 1)))


def choose_chart(points: np.ndarray, normals: np.ndarray) -> Chart:
    """Return the plane of points (3, n) with their normals, or the cylinder if they face too many directions.

    The direction a of a plane, and the begin of the map on a cylinder, are those of the common frame: x to the right, z
    towards the camera.
    """
    mean = normals.mean(axis=1)
    facing = mean / max(float(np.linalg.norm(mean)), 1e-12)
    middle = points.mean(axis=1)
    if np.mean(facing @ normals > _FACING) >= _FACING_SHARE:
        return Chart(middle, _frame(facing, np.array([0.0, 1.0, 0.0])))
    axis = np.linalg.eigh(normals @ normals.T)[1][:, 0]
    axis *= math.copysign(1.0, axis[int(np.argmax(np.abs(axis)))])
    front = np.array([0.0, 0.0, 1.0]) - axis[2] * axis
    if np.linalg.norm(front) < 0.1:  # an axis along z
        front = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
    front /= np.linalg.norm(front)
    right = np.cross(axis, front)
    across, up = right @ (points - middle[:, None]), front @ (points - middle[:, None])
    # x^2 + y^2 = 2 c x + r^2 - |c|^2 is linear in the centre of the circle
    design = np.stack([2 * across, 2 * up, np.ones(across.size)], axis=1)
    c, s, rest = np.linalg.lstsq(design, across**2 + up**2, rcond=None)[0]
    return Chart(middle + c * right + s * front, np.stack([right, axis, front]), math.sqrt(rest + c * c + s * s))


def _frame(normal: np.ndarray, upwards: np.ndarray) -> np.ndarray:
    """Return rows right, up and normal of a plane, with up nearest to a direction."""
    up = upwards - (upwards @ normal) * normal
    if np.linalg.norm(up) < 0.1:
        up = np.array([0.0, 0.0, -1.0]) + normal[2] * normal
    up /= np.linalg.norm(up)
    return np.stack([np.cross(up, normal), up, normal])


def is_closed(chart: Chart, a: np.ndarray) -> bool:
    """Return whether points with the coordinate a cover the whole circumference of a cylinder."""
    if chart.is_plane:
        return False
    sectors = np.floor(np.remainder(a, chart.circumference) / chart.circumference * _SECTORS)
    return len(np.unique(sectors)) >= _FILLED
