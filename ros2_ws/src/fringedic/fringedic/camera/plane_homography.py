"""Homography of the plane of a grid: scale, aspect and tilt of the camera from the pitch of the grid alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

_ROUNDS = 20  # tilts of a few degrees converge to rounding errors in five


@dataclass(frozen=True, eq=False)
class PinHole:
    """Position of the camera's pin-hole above a plane, located by the grid on the tilted plane.

    Attributes
    ----------
    distance, foot_x, foot_y
        Height above the plane, and the point of the plane below it in the coordinates of a `PlaneHomography` [m].
    covariance : (3, 3)
        Of the three [m^2].
    """

    distance: float
    foot_x: float
    foot_y: float
    covariance: np.ndarray

    def deviation(self, distance: float, tilt_x: float, tilt_y: float) -> np.ndarray:
        """Return the deviation of another camera in standard deviations, as three independent numbers (3,).

        The optical axis of a camera with the tilts [rad] of a `RigModel` meets the plane in the origin of the
        `PlaneHomography`, at h0 tan b / cos a along x and -h0 tan a along y from the foot.
        """
        foot_x, foot_y = distance * math.tan(tilt_y) / math.cos(tilt_x), -distance * math.tan(tilt_x)
        apart = np.array([distance - self.distance, foot_x - self.foot_x, foot_y - self.foot_y])
        result: np.ndarray = np.linalg.solve(np.linalg.cholesky(self.covariance), apart)
        return result


@dataclass(frozen=True, eq=False)
class PlaneHomography:
    """Homography from ideal pixels to the plane of the grid, and the camera parameters that follow from it.

    Attributes
    ----------
    homography : (3, 3)
        From (column, row, 1) of ideal pixels to (x, y, 1) on the plane [m]: x to the right of the image, y upwards.
        The principal point sees the origin, and y is constant along its row; the denominator there is 1.
    principal_column, principal_row
        Principal point [px]: the image's centre, because a plane does not determine it.
    pin_hole
        In which the lines of sight meet; None when the grid was measured on one plane only.

    Notes
    -----
    A single plane gives the point in which the line of sight of every pixel meets it, and nothing else. Together with
    the height of the pin-hole it gives the attitude of the camera, `camera`. An error of the assumed principal point,
    and the part of a distortion that is equivalent to a tilt, move the foot of the pin-hole on the plane and change
    nothing on the plane itself. With `pin_hole` the perspective of the homography is that of the pin-hole, and the
    remainder is part of the distortion.

    References
    ----------
    Z. Zhang, "A flexible new technique for camera calibration", IEEE Transactions on Pattern Analysis and Machine
    Intelligence 22 (2000) 1330-1334.
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
        """Return the points x, y [m] in which the lines of sight of ideal pixels meet the plane, in their shape."""
        x, y, w = (each[0] * column + each[1] * row + each[2] for each in self.homography)
        return x / w, y / w

    def camera(self, camera_distance: float, tilts: tuple[float, float] | None = None) -> dict[str, float]:
        """Return the camera parameters of a `RigModel` whose reference plane z = 0 is this plane.

        With the direction Rx(a) Ry(b) (u, v, -1), u = gamma / tau / h0 per column and v = -gamma / h0 per row, the
        denominator grows by u tan b - v tan a / cos b, and the slopes at the principal point are
        dx/du = h0 / (cos a cos^2 b) and dy/dv = h0 / (cos^2 a cos b).

        Parameters
        ----------
        camera_distance
            Height h0 of the pin-hole above the plane [m].
        tilts
            Camera tilts about x and y [rad] where they are known; otherwise they follow from the perspective.

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
