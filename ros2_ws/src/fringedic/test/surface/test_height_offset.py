"""A smoothed height is corrected for the curvature, and edges of a surface do not move it. Surfaces are formulas."""

import numpy as np
import pytest
import xarray as xr

from fringedic.surface import PreparedShape, couple

PIXEL = 2e-4  # [m]
NOISE = 10e-6
RADIUS = 20e-3
ROW, COLUMN = np.meshgrid(np.arange(300.0), np.arange(200.0), indexing="ij")
X, Y = PIXEL * (COLUMN - 100), PIXEL * (150 - ROW)


def prepared(z, holes=0.0, seed=1):
    """Prepare a surface with noise and single pixels that are not measured."""
    random = np.random.default_rng(seed)
    seen = z + NOISE * random.normal(size=z.shape)
    seen[random.random(z.shape) < holes] = np.nan
    fields = {"x": X * (1 - seen / 0.5), "y": Y * (1 - seen / 0.5), "z": seen, "noise_z": NOISE + 0 * z}
    shape = xr.Dataset({name: (("row", "column"), values) for name, values in fields.items()})
    return PreparedShape(shape.assign_attrs(camera_distance=0.5), z_filter=2.0)


def height(z, holes=0.0):
    """Return the height that is stated as the reference position of each pixel."""
    shape = prepared(z, holes)
    return shape.z - shape.offsets(np.arange(len(z)), np.arange(len(z[0])))


@pytest.mark.parametrize("holes", [0.0, 0.02])
@pytest.mark.parametrize(
    "squared", [X**2, Y**2, X**2 + Y**2, (0.6 * X + 0.8 * Y) ** 2], ids=["upright", "lying", "sphere", "inclined"]
)
def test_curved_surfaces_stay_in_place(squared, holes):
    """The mean over the Gaussian alone would lie 4 µm below a cylinder, 8 µm below a sphere; the noise is 1.5 µm."""
    z = np.sqrt(np.maximum(RADIUS**2 - squared, 0.0))
    inside = squared < (0.5 * RADIUS) ** 2
    error, sigma = height(z, holes) - z, np.sqrt(prepared(z, holes).variance)
    inside &= np.isfinite(error)
    error, score = error[inside], (error / sigma)[inside]
    assert abs(error.mean()) < 0.3e-6
    assert 0.95 < np.sqrt(np.mean(score**2)) < 1.1


def test_positions_of_a_coupling_are_on_the_surface_and_the_displacement_of_a_point_at_rest_is_none():
    z = np.sqrt(RADIUS**2 - X**2 / 4)
    shape = prepared(z)
    places = {"row": np.arange(20, 280, 4), "column": np.arange(30, 170, 4)}
    names = ("displacement_x", "displacement_y", "sigma_x", "sigma_y")
    none = np.zeros((65, 35))
    still = xr.Dataset(dict.fromkeys(names, (("row", "column"), none)), coords=places)
    cloud = couple(shape, shape, still, z_filter=2.0)
    true = z[np.ix_(places["row"], places["column"])]
    assert abs(float((cloud.z - true).mean())) < 0.3e-6
    assert float(np.abs(cloud[["u", "v", "w"]].to_array()).max()) == 0.0
    ray = X[20:280:4, 30:170:4]
    assert np.abs(cloud.x.values - ray * (1 - cloud.z.values / 0.5)).max() < 5e-9


def columns_of(error):
    """Return the mean error of each column; next to a step their noise is 2.5 times that of others."""
    means = np.nanmean(error[20:-20], axis=0)[20:-20]
    assert np.isfinite(means).all()
    return np.abs(means)


def test_relief_and_edges_stay_as_they_are():
    relief = 30e-6 * np.sin(COLUMN / 2) * np.sin(ROW / 2.5)
    step = np.where(COLUMN > 90, 1e-3, 0.0)
    for z, bound in ((0 * X, 1e-6), (relief, 1e-6), (step, 3e-6)):
        assert columns_of(height(z) - z).max() < bound


def test_next_to_an_edge_a_curved_surface_keeps_the_offset_of_the_filter():
    """Windows that contain the edge are not used: 3 µm remain, where a parabola over it would be 30 µm off."""
    z = np.where(COLUMN > 90, 1e-3, 0.0) + 20 * X**2
    error = columns_of(height(z) - z)
    assert error.max() < 5e-6
    assert np.delete(error, slice(70 - 20, 112 - 20)).max() < 1e-6


def test_large_holes_and_small_surfaces():
    """No window is complete in an image of few pixels, and next to a hole the curvature beside it holds."""
    z = np.sqrt(RADIUS**2 - X**2 / 4)
    holed = z.copy()
    holed[130:150, 80:110] = np.nan
    error = (height(holed) - z)[20:-20, 40:-40]
    assert abs(np.nanmean(error)) < 0.3e-6
    few = np.s_[:9, :12]
    fields = {"x": X[few], "y": Y[few], "z": z[few], "noise_z": NOISE + 0 * z[few]}
    part = xr.Dataset({name: (("row", "column"), values) for name, values in fields.items()})
    small = PreparedShape(part.assign_attrs(camera_distance=0.5), z_filter=2.0)
    assert np.abs(small.offsets(np.arange(9), np.arange(12))).max() < 5e-6
