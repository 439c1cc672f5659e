"""A real tensile test of a plate with a hole: an orthotropic model is fitted by its constants and explains it."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import Delaunay

from fringedic.models import compare_model

ROOT = Path(__file__).resolve().parents[5]
DATA = Path(os.environ.get("FRINGEDIC_DATA", ROOT.parent / "shared" / "data")) / "open_hole_tension"


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch):
    """Return the module of the benchmark, which writes the validation page."""
    specification = importlib.util.spec_from_file_location("open_hole", ROOT / "benchmarks" / "open_hole.py")
    module = importlib.util.module_from_spec(specification)
    monkeypatch.setitem(sys.modules, "open_hole", module)  # its dataclass looks for its module
    specification.loader.exec_module(module)
    return module


@pytest.mark.skipif(not DATA.is_dir(), reason=f"needs the images in {DATA}")
def test_an_orthotropic_model_is_fitted_and_explains_the_displacement(tmp_path: Path, benchmark):
    images = [DATA / f"oht_cfrp_{number:02d}.tiff" for number in (0, 4, 8, 11)]
    data = benchmark.measure(tmp_path, images, spacing=12)
    plate = benchmark.Plate(*benchmark.make_mesh(20.0))
    ends = benchmark.measured_ends(data, plate)
    constants, covariance = benchmark.fit(data, plate, ends, 3)
    assert 0.3 < constants.across < 0.9
    assert 0.05 < constants.poisson < 0.4
    assert 0.06 < constants.shear < 0.2
    assert 0 < covariance[2, 2] ** 0.5 < 0.1 * constants.shear
    fitted, isotropic = (
        compare_model(data, benchmark.model_of(plate, each, ends), load_table={0: 0.0, 3: 3.0}).sel(step=3)
        for each in (constants, benchmark.isotropic())
    )
    assert float(fitted.relative_error.sel(quantity="v")) < 0.02
    assert float(fitted.relative_error.sel(quantity="e_yy")) < 0.2
    for name in ("u", "v", "e_yy", "e_xy"):
        better, worse = (float(each.normalized_rms.sel(quantity=name)) for each in (fitted, isotropic))
        assert better < 0.85 * worse, name


def test_a_plate_without_a_hole_keeps_a_uniform_strain(benchmark):
    """Patch test with irregular triangles."""
    column, row = (each.ravel() for each in np.meshgrid(np.linspace(0, 300, 9), np.linspace(*benchmark.ENDS, 20)))
    inside = (row > row.min()) & (row < row.max()) & (column > 0) & (column < 300)
    shift = inside[:, None] * np.random.default_rng(1).uniform(-8, 8, (len(row), 2))
    nodes = np.column_stack([column, row]) + shift
    plate = benchmark.Plate(nodes, Delaunay(nodes).simplices)
    true = 1e-3 * plate.nodes * [-0.2, 1.0]
    moved = plate.solve(benchmark.Constants(0.5, 0.2, 0.1), true[plate.ends][..., None])[..., 0]
    assert np.abs(moved - true).max() < 1e-10
