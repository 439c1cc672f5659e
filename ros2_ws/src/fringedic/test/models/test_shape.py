"""Deviation of a measured shape from a nominal one, with its uncertainty."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import fringedic
from fringedic.errors import ModelError
from fringedic.export import export_dataset
from fringedic.models import Model
from fringedic.report.model_comparison import write_shape_comparison

X, Y = np.meshgrid(0.2e-3 * np.arange(-50.0, 51.0), 0.2e-3 * np.arange(40.0, -41.0, -1))
SIGMA = 5e-6


def sheet(height) -> Model:
    x, y = (each.ravel() for each in np.meshgrid(*2 * [np.linspace(-15e-3, 15e-3, 151)], indexing="ij"))
    first = (np.arange(150)[:, None] * 151 + np.arange(150)).ravel()
    quads = np.stack([first, first + 151, first + 152, first + 1], axis=1)
    triangles = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    nodes = np.column_stack([x, y, height(x, y)])
    return Model("nominal.stl", nodes, triangles, False, np.empty(0), np.empty((0, len(nodes), 3)))


def measured(height, seed: int = 1) -> xr.Dataset:
    """A step without shape, and one with a shape whose errors lie along the lines of sight of a camera at 0.3 m."""
    error = np.random.default_rng(seed).normal(0, SIGMA, X.shape)
    z = height(X, Y)
    points = [X + error * X / (z - 0.3), Y + error * Y / (z - 0.3), z + error, np.full(X.shape, SIGMA)]
    names = ("shape_x", "shape_y", "shape_z", "shape_sigma_z")
    dimensions = ("step", "row", "column")
    fields = {
        name: (dimensions, np.stack([np.full(X.shape, np.nan), each]).astype(np.float32))
        for name, each in zip(names, points, strict=True)
    }
    coordinates = {"step": [0, 4], "row": np.arange(81), "column": np.arange(101)}
    return xr.Dataset(fields, coordinates, {"experiment": "cover", "calibration": json.dumps({"camera_distance": 0.3})})


def plane(x, y):
    return 0 * x * y


def hill(x, y):
    return 3e-3 * np.exp(-((x - 2e-3) ** 2 + y**2) / (5e-3) ** 2) + 20 * x * y


def test_a_right_shape_deviates_by_noise_and_a_dent_is_found():
    found = fringedic.compare_shape(measured(hill), sheet(hill)).sel(step=4)
    assert 0.95 < float(found.normalized_rms) < 1.05
    assert 0.93 < float(found.within_2_sigma) < 0.97
    assert float(found.systematic) < 0.3 * SIGMA
    assert 0.7 < float(found.peak_to_valley / found.noise_peak_to_valley) < 1.3

    def dented(x, y):
        return hill(x, y) - 60e-6 * np.exp(-((x + 5e-3) ** 2 + (y - 3e-3) ** 2) / (1e-3) ** 2)

    found = fringedic.compare_shape(measured(dented), sheet(hill), step=4).sel(step=4)
    row, column = np.unravel_index(np.nanargmin(found.deviation.values), X.shape)
    assert (X[row, column], Y[row, column]) == pytest.approx((-5e-3, 3e-3), abs=0.5e-3)
    assert float(found.deviation.min()) == pytest.approx(-60e-6, abs=3 * SIGMA)
    assert int(found.largest_region) > 30


def test_flatness_of_a_bent_plate_with_its_uncertainty():
    def bent(x, y):
        return 0.4 * x**2 + 0 * y

    found = fringedic.compare_shape(measured(bent), sheet(plane)).sel(step=4)
    assert float(found.peak_to_valley) == pytest.approx(0.4 * (10e-3) ** 2, abs=6 * SIGMA)
    assert float(found.sigma_peak_to_valley) == pytest.approx(np.sqrt(2) * SIGMA, rel=0.05)
    assert json.loads(found.attrs["placement"])["free"]["shape"] == "a plane"


def test_page_and_files(tmp_path: Path):
    found = fringedic.compare_shape(measured(hill), sheet(hill))
    page = write_shape_comparison(found, tmp_path / "shape.html").read_text(encoding="utf-8")
    assert "peak to valley" in page
    done = export_dataset(found, tmp_path, ["vtk", "ply"])
    assert not any(each.problems for each in done)
    assert b"deviation_um" in (tmp_path / "cover_ply" / "step_004.ply").read_bytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: (data.drop_vars("shape_sigma_z"), {}), "no shape_sigma_z"),
        (lambda data: (data, {"step": 0}), "no measured shape in step 0"),
        (lambda data: (data, {"step": 7}), "has no step 7; it has 0, 4"),
        (lambda data: (data.isel(step=[0]), {}), "no measured shape in any step"),
    ],
)
def test_shapes_that_cannot_be_compared_are_refused(change, message):
    data, options = change(measured(hill))
    with pytest.raises(ModelError, match=message):
        fringedic.compare_shape(data, sheet(hill), **options)
