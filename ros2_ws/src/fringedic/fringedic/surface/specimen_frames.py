"""Frames chosen by the user: the frame of a specimen, or cylinder coordinates around an axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from fringedic.errors import SurfaceError

_POINTS = 20000  # of a cloud are enough for a fit
_COLLINEAR = 1e-6  # three points with a smaller sine are collinear
_LEAST_CURVATURE = 1e-4  # half the size of the cloud over the radius: a sagitta of 1e-4 of its width; rounding is 1e-7
_COVARIANCES = ("sigma_u", "sigma_v", "sigma_w", "cov_uv", "cov_uw", "cov_vw")


@dataclass(frozen=True)
class SpecimenFrame:
    """Right-handed frame of a specimen.

    Attributes
    ----------
    origin
        In the rig frame [m], shape (3,).
    axes
        Rows are the unit vectors x, y, z of the specimen in the rig frame, shape (3, 3).

    Examples
    --------
    >>> frame = SpecimenFrame.from_points((0.01, 0.0, 0.0), on_x=(0.01, 0.02, 0.0), in_plane=(0.0, 0.0, 0.0))
    >>> (frame.axes @ (0.0, 1.0, 0.0)).tolist()  # the rig's y is the specimen's x
    [1.0, 0.0, 0.0]
    """

    origin: np.ndarray
    axes: np.ndarray

    @classmethod
    def from_points(cls, origin: ArrayLike, on_x: ArrayLike, in_plane: ArrayLike) -> Self:
        """Return the frame through three points of the rig frame [m]: x towards `on_x`, y on the side of `in_plane`.

        Parameters
        ----------
        origin, on_x, in_plane
            Positions in the rig frame [m], shape (3,) each.

        Raises
        ------
        SurfaceError
            The points lie on a line.
        """
        start, second, third = (np.asarray(each, float) for each in (origin, on_x, in_plane))
        x, other = second - start, third - start
        z = np.cross(x, other)
        if not np.linalg.norm(z) > _COLLINEAR * np.linalg.norm(x) * np.linalg.norm(other):
            raise SurfaceError(f"the points {start}, {second}, {third} m do not span a plane: choose three corners")
        return cls(start, _make_axes(x, z))

    @classmethod
    def best_plane(cls, cloud: xr.Dataset) -> Self:
        """Return the frame of the plane with the least squared distances from the points of a cloud.

        z is the normal towards the camera, the origin the centroid, and x the projection of the rig's x on the plane.

        Parameters
        ----------
        cloud
            With ``x``, ``y``, ``z`` [m].

        Raises
        ------
        SurfaceError
            Fewer than three points are measured or they lie on a line.
        """
        points = _measured_points(cloud)
        centre = points.mean(axis=0)
        _, extent, directions = np.linalg.svd(points - centre, full_matrices=False)
        if not extent[1] > _COLLINEAR * extent[0]:
            raise SurfaceError("the measured points lie on a line: no plane goes through them alone")
        normal = directions[2] if directions[2, 2] > 0 else -directions[2]
        return cls(centre, _make_axes(np.array([1.0, 0.0, 0.0]), normal))

    def transform(self, cloud: xr.Dataset) -> xr.Dataset:
        """Return positions, displacement and its uncertainty of a cloud in this frame.

        Parameters
        ----------
        cloud
            From `couple`, with ``x``, ``y``, ``z`` [m]; ``u``, ``v``, ``w``, their sigmas and covariances are
            transformed if they are present.

        Returns
        -------
        Dataset
            The same names; the attributes ``frame_origin`` [m] and ``frame_axes`` (row-major) contain the frame.
        """
        kind = cloud["x"].dtype
        positions = np.stack([np.asarray(cloud[name], float) for name in "xyz"]) - self.origin[:, None, None]
        fields = dict(zip("xyz", np.tensordot(self.axes, positions, 1), strict=True))
        if all(name in cloud for name in "uvw"):
            moved = np.stack([np.asarray(cloud[name], float) for name in "uvw"])
            fields |= zip("uvw", np.tensordot(self.axes, moved, 1), strict=True)
        if all(name in cloud for name in _COVARIANCES):
            c = np.einsum("ab,bcij,dc->adij", self.axes, _covariance(cloud), self.axes)
            fields |= zip(
                _COVARIANCES,
                [np.sqrt(c[0, 0]), np.sqrt(c[1, 1]), np.sqrt(c[2, 2]), c[0, 1], c[0, 2], c[1, 2]],
                strict=True,
            )
        return xr.Dataset(
            {name: (("row", "column"), values.astype(kind), cloud[name].attrs) for name, values in fields.items()},
            coords={name: cloud.coords[name] for name in ("row", "column")},
            attrs={"frame_origin": self.origin.tolist(), "frame_axes": self.axes.ravel().tolist()},
        )


@dataclass(frozen=True)
class CylinderFrame:
    """Frame around the axis of a cylinder.

    Attributes
    ----------
    origin
        Point of the axis nearest to the centroid of the cloud [m], shape (3,).
    axis
        Unit vector along the axis, towards +y of the rig (or +x where it is across), shape (3,).
    radius
        [m]
    residual
        Root mean square distance of the points from the cylinder [m].

    Examples
    --------
    >>> import numpy as np, xarray as xr
    >>> angle, y = np.meshgrid(np.linspace(-0.6, 0.6, 50), np.linspace(0, 0.03, 40))
    >>> fields = {"x": 0.02 * np.sin(angle), "y": y, "z": 0.02 * np.cos(angle)}
    >>> cloud = xr.Dataset({name: (("row", "column"), values) for name, values in fields.items()})
    >>> frame = CylinderFrame.fit(cloud)
    >>> round(1e3 * frame.radius, 6), [abs(round(each, 6)) for each in frame.axis.tolist()]
    (20.0, [0.0, 1.0, 0.0])
    """

    origin: np.ndarray
    axis: np.ndarray
    radius: float
    residual: float

    @classmethod
    def fit(cls, cloud: xr.Dataset) -> Self:
        """Fit the cylinder with the least squared distances from the points of a cloud.

        Parameters
        ----------
        cloud
            With ``x``, ``y``, ``z`` [m].

        Raises
        ------
        SurfaceError
            Fewer than three points are measured, or the surface is too flat for an axis.
        """
        points = _measured_points(cloud)
        plane = SpecimenFrame.best_plane(cloud)
        local = (points - plane.origin) @ plane.axes.T
        size = np.abs(local[:, :2]).max()
        x, y, z = (local / size).T
        quadric = np.linalg.lstsq(np.stack([x**2, x * y, y**2, x, y, np.ones_like(x)], axis=-1), z, rcond=None)[0]
        curvature, directions = np.linalg.eigh(np.array([[2 * quadric[0], quadric[1]], [quadric[1], 2 * quadric[2]]]))
        bent = int(np.argmax(np.abs(curvature)))
        if not abs(curvature[bent]) > _LEAST_CURVATURE:
            raise SurfaceError("the surface is too flat to fit the axis of a cylinder: use the best plane")
        along = np.append(directions[:, 1 - bent], 0.0)
        # unknowns: height of the axis over its foot at the distance of the radius, foot across, two tilts, radius
        across = np.cross([0.0, 0.0, 1.0], along)
        sign = np.sign(curvature[bent])

        def distances(unknowns: np.ndarray) -> np.ndarray:
            shift, height, tilt, turn, bend = unknowns
            axis = along + turn * across + np.array([0.0, 0.0, tilt])
            axis /= np.linalg.norm(axis)
            radius = 1 / bend
            foot = shift * across + np.array([0.0, 0.0, height + sign * radius])
            away = local / size - foot
            away = away - (away @ axis)[:, None] * axis
            return np.asarray(np.linalg.norm(away, axis=-1) - radius)

        found = least_squares(distances, [0.0, 0.0, 0.0, 0.0, abs(curvature[bent])], x_scale="jac")
        shift, height, tilt, turn, bend = found.x
        axis = along + turn * across + np.array([0.0, 0.0, tilt])
        axis = plane.axes.T @ (axis / np.linalg.norm(axis))
        axis *= -1.0 if axis[np.argmax(np.abs(axis) > 0.7 * np.abs(axis).max())] < 0 else 1.0
        foot = plane.origin + size * plane.axes.T @ (shift * across + np.array([0.0, 0.0, height + sign / bend]))
        origin = foot + axis * float((plane.origin - foot) @ axis)
        return cls(origin, axis, float(size / bend), float(size * np.sqrt(np.mean(found.fun**2))))

    def transform(self, cloud: xr.Dataset) -> xr.Dataset:
        """Return cylinder coordinates and the displacement along them at each reference point.

        Parameters
        ----------
        cloud
            From `couple`, with ``x``, ``y``, ``z`` [m]; ``u``, ``v``, ``w``, their sigmas and covariances are
            transformed if they are present.

        Returns
        -------
        Dataset
            Over (row, column):
            ``axial``, ``hoop`` (length of the arc at the cylinder's radius, 0 towards the camera, right-handed about
            the axis) and ``radial`` (distance from the axis) [m]; ``u_axial``, ``u_hoop``, ``u_radial`` [m] in the
            basis of the reference point, with their standard deviations where those of u, v, w are known.
        """
        relative = np.stack([np.asarray(cloud[name], float) for name in "xyz"]) - self.origin[:, None, None]
        axial = np.tensordot(self.axis, relative, 1)
        away = relative - self.axis[:, None, None] * axial
        radial = np.sqrt(np.sum(away**2, axis=0))
        outwards = away / radial
        around = np.moveaxis(np.cross(self.axis, np.moveaxis(outwards, 0, -1)), -1, 0)
        towards_camera = np.array([0.0, 0.0, 1.0]) - self.axis[2] * self.axis
        towards_camera /= np.linalg.norm(towards_camera)
        side = np.cross(self.axis, towards_camera)
        angle = np.arctan2(np.tensordot(side, outwards, 1), np.tensordot(towards_camera, outwards, 1))
        fields = {
            "axial": (axial, "position along the axis"),
            "hoop": (self.radius * angle, "position along the circumference"),
            "radial": (radial, "distance from the axis"),
        }
        basis = {"axial": np.broadcast_to(self.axis[:, None, None], around.shape), "hoop": around, "radial": outwards}
        if all(name in cloud for name in "uvw"):
            moved = np.stack([np.asarray(cloud[name], float) for name in "uvw"])
            for name, direction in basis.items():
                fields[f"u_{name}"] = (np.sum(direction * moved, axis=0), f"{name} displacement")
        if all(name in cloud for name in _COVARIANCES):
            covariance = _covariance(cloud)
            for name, direction in basis.items():
                spread = np.einsum("aij,abij,bij->ij", direction, covariance, direction)
                fields[f"sigma_u_{name}"] = (np.sqrt(spread), f"standard deviation of u_{name}")
        kind = cloud["x"].dtype
        return xr.Dataset(
            {
                name: (("row", "column"), values.astype(kind), {"units": "m", "long_name": long_name})
                for name, (values, long_name) in fields.items()
            },
            coords={name: cloud.coords[name] for name in ("row", "column")},
            attrs={
                "frame_origin": self.origin.tolist(),
                "frame_axis": self.axis.tolist(),
                "radius": self.radius,
            },
        )


def _make_axes(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return orthonormal rows x, y, z from a direction in the plane and its normal."""
    z = z / np.linalg.norm(z)
    x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _measured_points(cloud: xr.Dataset) -> np.ndarray:
    """Return some measured points (point, 3) of a cloud [m]."""
    points = np.stack([np.asarray(cloud[name], float).ravel() for name in "xyz"], axis=-1)
    points = points[np.isfinite(points).all(axis=-1)]
    if len(points) < 3:
        raise SurfaceError(f"{len(points)} points are measured: a frame needs at least three")
    return np.asarray(points[:: -(-len(points) // _POINTS)])


def _covariance(cloud: xr.Dataset) -> np.ndarray:
    """Covariance matrices of (u, v, w), shape (3, 3, row, column) [m^2]."""
    uu, vv, ww, uv, uw, vw = (np.asarray(cloud[name], float) for name in _COVARIANCES)
    return np.array([[uu**2, uv, uw], [uv, vv**2, vw], [uw, vw, ww**2]])
