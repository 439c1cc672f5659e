"""How a camera sees the plane that a grid lies on: scale, aspect and tilt without any length but the grid's pitch."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

_ROUNDS = 20  # tilts of a few degrees settle to rounding errors in five


@dataclass(frozen=True, eq=False)
class PinHole:
    """Where the camera's pin-hole stands above a plane, as the grid on the turned plane told.

    Attributes
    ----------
    distance, foot_x, foot_y
        Height above the plane, and the point of the plane below it in the coordinates of a `PlaneView` [m].
    covariance : (3, 3)
        Of the three [m^2].
    """

    distance: float
    foot_x: float
    foot_y: float
    covariance: np.ndarray

    def deviation(self, distance: float, tilt_x: float, tilt_y: float) -> np.ndarray:
        """Return by how many standard deviations another camera disagrees, as three independent numbers.

        The optical axis of a camera with the tilts [rad] of a `RigModel` meets the plane in the origin of the
        `PlaneView`, h0 tan b / cos a beside the foot along x and -h0 tan a along y.
        """
        foot_x, foot_y = distance * math.tan(tilt_y) / math.cos(tilt_x), -distance * math.tan(tilt_x)
        apart = np.array([distance - self.distance, foot_x - self.foot_x, foot_y - self.foot_y])
        result: np.ndarray = np.linalg.solve(np.linalg.cholesky(self.covariance), apart)
        return result


@dataclass(frozen=True, eq=False)
class PlaneView:
    """Homography from ideal pixels to the plane of the grid, and what it says about the camera.

    Attributes
    ----------
    homography : (3, 3)
        From (column, row, 1) of ideal pixels to (x, y, 1) on the plane [m]: x to the right of the image, y upwards.
        The principal point sees the origin, and y does not change along its row; the last entry is the value of the
        denominator there, 1.
    principal_column, principal_row
        Principal point [px]: the image's centre, as no plane can tell it.
    pin_hole
        Where the lines of sight come from; None when the grid was seen on one plane only.

    Notes
    -----
    A single plane says where every pixel's line of sight meets it and no more. Together with the height of the pin-hole
    above it follows the camera's attitude, `camera`. Any error of the assumed principal point, and the part of a
    distortion that looks like a tilt, move the foot of the pin-hole on the plane and nothing on the plane itself. With
    `pin_hole` the homography's perspective is that of the pin-hole there, and what is left is the distortion's.
    """

    homography: np.ndarray
    principal_column: float
    principal_row: float
    pin_hole: PinHole | None = None

    @property
    def pixel_size(self) -> float:
        """Length on the plane per row at the principal point [m]."""
        return -float(self._slopes[1, 1])

    @property
    def pixel_aspect(self) -> float:
        """Length per row over length per column at the principal point (tau)."""
        return self.pixel_size / float(self._slopes[0, 0])

    @property
    def perspective(self) -> tuple[float, float]:
        """Relative growth of the denominator per column and per row [1/px], 0 for a camera square to the plane."""
        return float(self.homography[2, 0]), float(self.homography[2, 1])

    @property
    def skew(self) -> float:
        """Change of x along a column over that of y, at the principal point: 0 for square pixels and a flat grid."""
        return float(self._slopes[0, 1] / self._slopes[1, 1])

    @property
    def _slopes(self) -> np.ndarray:
        """Derivatives of (x, y) by (column, row) at the principal point, where x = y = 0 and the denominator is 1."""
        return self.homography[:2, :2]

    def on_plane(self, column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x and y [m] at which the lines of sight of ideal pixels meet the plane."""
        x, y, w = (each[0] * column + each[1] * row + each[2] for each in self.homography)
        return x / w, y / w

    def camera(self, camera_distance: float, tilts: tuple[float, float] | None = None) -> dict[str, float]:
        """Return the camera parameters of a `RigModel` whose plane z = 0 this is.

        With the direction Rx(a) Ry(b) (u, v, -1), u = gamma / tau / h0 per column and v = -gamma / h0 per row, the
        denominator grows by u tan b - v tan a / cos b, and the slopes at the principal point are
        dx/du = h0 / (cos a cos^2 b) and dy/dv = h0 / (cos^2 a cos b).

        Parameters
        ----------
        camera_distance
            Height h0 of the pin-hole above the plane [m].
        tilts
            Camera tilts about x and y [rad] where they are known otherwise; the perspective tells them without.

        Returns
        -------
        dict
            ``pixel_size`` [m], ``pixel_aspect``, ``camera_tilt_x`` and ``camera_tilt_y`` [rad], ``principal_column``
            and ``principal_row`` [px].
        """
        by_column, by_row = self.perspective
        a, b = (0.0, 0.0) if tilts is None else tilts
        for _ in range(_ROUNDS):
            u = float(self._slopes[0, 0]) * math.cos(a) * math.cos(b) ** 2 / camera_distance
            v = float(self._slopes[1, 1]) * math.cos(a) ** 2 * math.cos(b) / camera_distance
            if tilts is not None:
                break
            b = math.atan(by_column / u)
            a = math.atan(-by_row * math.cos(b) / v)
        return {
            "pixel_size": -v * camera_distance,
            "pixel_aspect": -v / u,
            "camera_tilt_x": a,
            "camera_tilt_y": b,
            "principal_column": self.principal_column,
            "principal_row": self.principal_row,
        }
