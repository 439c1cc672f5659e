"""A smoothed height lies on curved surfaces, and edges of a surface do not move it. Surfaces are formulas."""

import numpy as np
import pytest
import xarray as xr

from fringedic.surface import PreparedShape

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


@pytest.mark.parametrize("holes", [0.0, 0.02])
@pytest.mark.parametrize(
    "squared", [X**2, Y**2, X**2 + Y**2, (0.6 * X + 0.8 * Y) ** 2], ids=["upright", "lying", "sphere", "inclined"]
)
def test_curved_surfaces_stay_in_place(squared, holes):
    """The mean over the Gaussian alone would lie 4 µm below a cylinder, 8 µm below a sphere; the noise is 1.5 µm."""
    z = np.sqrt(np.maximum(RADIUS**2 - squared, 0.0))
    inside = squared < (0.5 * RADIUS) ** 2
    shape = prepared(z, holes)
    error = (shape.z - z)[inside & np.isfinite(shape.z)]
    score = error / np.sqrt(shape.variance[inside & np.isfinite(shape.z)])
    assert abs(error.mean()) < 0.3e-6
    assert 0.95 < np.sqrt(np.mean(score**2)) < 1.1


def columns_of(error):
    """Return the mean error of each column; next to a step their noise is 2.5 times that of others."""
    means = np.nanmean(error[20:-20], axis=0)[20:-20]
    assert np.isfinite(means).all()
    return np.abs(means)


def test_relief_and_edges_stay_as_they_are():
    relief = 30e-6 * np.sin(COLUMN / 2) * np.sin(ROW / 2.5)
    step = np.where(COLUMN > 90, 1e-3, 0.0)
    for z, bound in ((0 * X, 1e-6), (relief, 1e-6), (step, 3e-6)):
        assert columns_of(prepared(z).z - z).max() < bound


def test_next_to_an_edge_a_curved_surface_keeps_the_offset_of_the_filter():
    """Windows that contain the edge are not used: 3 µm remain, where a parabola over it would be 30 µm off."""
    z = np.where(COLUMN > 90, 1e-3, 0.0) + 20 * X**2
    error = columns_of(prepared(z).z - z)
    assert error.max() < 5e-6
    assert np.delete(error, slice(70 - 20, 112 - 20)).max() < 1e-6


def test_large_holes_and_small_surfaces():
    """No window is complete in an image of few pixels, and next to a hole the curvature beside it holds."""
    z = np.sqrt(RADIUS**2 - X**2 / 4)
    holed = z.copy()
    holed[130:150, 80:110] = np.nan
    shape = prepared(holed)
    error = (shape.z - z)[20:-20, 40:-40]
    assert abs(np.nanmean(error)) < 0.3e-6
    few = np.s_[:9, :12]
    fields = {"x": X[few], "y": Y[few], "z": z[few], "noise_z": NOISE + 0 * z[few]}
    part = xr.Dataset({name: (("row", "column"), values) for name, values in fields.items()})
    assert np.isfinite(PreparedShape(part.assign_attrs(camera_distance=0.5), z_filter=2.0).z).any()
