"""Frames chosen by the user, and the local frame's low-pass filter."""

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from fringedic.errors import SurfaceError
from fringedic.surface import CylinderFrame, SpecimenFrame, surface_strain

TURN = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
ORIGIN = np.array([4e-3, -7e-3, 2e-3])
COVARIANCE = np.diag([1.0, 4.0, 9.0]) * 1e-12


def grid(columns: int = 60, rows: int = 40) -> tuple[np.ndarray, np.ndarray]:
    return np.meshgrid(1e-4 * (np.arange(columns) - 25), -1e-4 * (np.arange(rows) - 15))


def cloud_of(local: np.ndarray, moved: np.ndarray, covariance: np.ndarray = COVARIANCE) -> xr.Dataset:
    """A cloud in the rig frame from positions, displacement and covariance in the specimen's."""
    points = np.tensordot(TURN, local, 1) + ORIGIN[:, None, None]
    moves = np.tensordot(TURN, moved, 1)
    turned = TURN @ covariance @ TURN.T
    fields = dict(zip("xyzuvw", [*points, *moves], strict=True))
    for k, name in enumerate("uvw"):
        fields[f"sigma_{name}"] = np.full(local.shape[1:], np.sqrt(turned[k, k]))
    for (a, b), name in (((0, 1), "uv"), ((0, 2), "uw"), ((1, 2), "vw")):
        fields[f"cov_{name}"] = np.full(local.shape[1:], turned[a, b])
    rows, columns = local.shape[1:]
    return xr.Dataset(
        {name: (("row", "column"), each, {"units": "m"}) for name, each in fields.items()},
        {"row": np.arange(rows), "column": np.arange(columns)},
    )


def plate() -> tuple[xr.Dataset, np.ndarray, np.ndarray]:
    x, y = grid()
    local = np.stack([x, y, 0 * x])
    moved = np.stack([0.02 * x, -0.01 * y, 1e-4 + 0.1 * x])
    return cloud_of(local, moved), local, moved


def test_three_points_give_the_frame_of_the_specimen() -> None:
    cloud, local, moved = plate()
    corners = [np.array([float(cloud[name][place]) for name in "xyz"]) for place in ((15, 25), (15, 55), (2, 30))]
    frame = SpecimenFrame.from_points(*corners)
    assert np.allclose(frame.axes, TURN.T, atol=1e-12)
    assert np.allclose(frame.origin, ORIGIN)
    seen = frame.transform(cloud)
    for name, each in zip("xyzuvw", [*local, *moved], strict=True):
        assert np.allclose(seen[name], each, atol=1e-15), name
    for name, variance in zip("uvw", np.diag(COVARIANCE), strict=True):
        assert np.allclose(seen[f"sigma_{name}"], np.sqrt(variance))
    assert np.allclose(seen.cov_uv, 0, atol=1e-24)
    strain = surface_strain(seen, window=5)
    assert np.nanmax(np.abs(strain.e_11 - (0.02 + (0.02**2 + 0.1**2) / 2))) < 1e-9
    with pytest.raises(SurfaceError, match="do not span a plane"):
        SpecimenFrame.from_points(corners[0], corners[1], 2 * corners[1] - corners[0])


def test_best_plane_is_found_under_noise() -> None:
    cloud, _, _ = plate()
    cloud["z"] = cloud.z + 1e-6 * np.random.default_rng(1).normal(size=cloud.z.shape)
    cloud["z"][5:9, 5:9] = np.nan
    frame = SpecimenFrame.best_plane(cloud)
    normal = TURN[:, 2]
    angle = np.arccos(min(1.0, abs(frame.axes[2] @ normal)))
    assert angle < 1e-4
    assert frame.axes[2, 2] > 0
    assert np.allclose(frame.axes @ frame.axes.T, np.eye(3))
    assert frame.axes[0, 0] > 0
    assert np.linalg.det(frame.axes) == pytest.approx(1)
    nothing = cloud.where(False)
    with pytest.raises(SurfaceError, match="at least three"):
        SpecimenFrame.best_plane(nothing)


def test_cylinder_and_its_displacement() -> None:
    """A pipe of 20 mm around a skew axis that swells by 1 % and turns about its axis."""
    arc, along = grid(90, 70)
    radius, swelling, twist = 0.02, 0.01, 1e-3
    angle = arc / radius
    axis_origin = np.array([0.0, 0.0, -radius])
    outwards = np.stack([np.sin(angle), 0 * angle, np.cos(angle)])
    around = np.stack([np.cos(angle), 0 * angle, -np.sin(angle)])
    local = axis_origin[:, None, None] + radius * outwards + np.stack([0 * along, along, 0 * along])
    moved = swelling * radius * outwards + twist * radius * around + np.stack([0 * along, 0.003 * along, 0 * along])
    cloud = cloud_of(local, moved)
    frame = CylinderFrame.fit(cloud)
    axis = TURN[:, 1]
    assert frame.radius == pytest.approx(radius, rel=1e-6)
    assert frame.residual < 1e-9
    assert np.linalg.norm(np.cross(frame.axis, axis)) < 1e-6
    assert frame.axis @ axis > 0
    seen = frame.transform(cloud)
    assert np.allclose(seen.radial, radius, atol=1e-9)
    assert np.allclose(seen.u_radial, swelling * radius, atol=1e-9)
    assert np.allclose(np.abs(seen.u_hoop), twist * radius, atol=1e-9)
    assert np.allclose(seen.u_axial - 0.003 * (seen.axial - seen.axial[15, 0]), 0, atol=1e-9)
    # arcs are right-handed about the axis, and u_hoop grows with them
    step = seen.hoop.diff("column").mean() * np.sign(float(seen.u_hoop.mean()))
    assert float(step) > 0
    assert float(abs(seen.hoop.diff("column")).mean()) == pytest.approx(1e-4, rel=1e-6)
    assert float(seen.sigma_u_axial.mean()) == pytest.approx(2e-6, rel=1e-4)
    with pytest.raises(SurfaceError, match="too flat"):
        CylinderFrame.fit(plate()[0])
