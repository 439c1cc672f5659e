"""Several specimens: known spread beside known uncertainty, and the page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from fringedic.errors import DatasetError
from fringedic.evaluation import compare_specimens, specimen_maps, strain_curve
from fringedic.evaluation.sentences import specimen_sentences
from fringedic.report.specimens import specimen_curve, write_specimens

DIMENSIONS = ("step", "row", "column")


def specimen(seed: int, *, offset: float = 0.0, **attributes: str) -> xr.Dataset:
    """Two steps with strain and force: independent noise of known standard deviation, and an offset of the specimen."""
    generator = np.random.default_rng(seed)
    sigma = np.full((2, 30, 40), 2e-5)
    maps = {
        name: (DIMENSIONS, offset + mean + generator.normal(0, sigma), {"units": "1"})
        for name, mean in (("e_11", -3e-4), ("e_22", 1e-3))
    }
    sigmas = {f"sigma_{name}": (DIMENSIONS, sigma, {"units": "1"}) for name in maps}
    axes = {"step": [0, 1], "row": np.arange(30), "column": np.arange(40)}
    return xr.Dataset(maps | sigmas | {"force": ("step", [0.0, 100.0])}, axes, attrs=attributes)


def test_equal_specimens_differ_by_the_uncertainty_and_others_by_more() -> None:
    equal = compare_specimens([specimen(seed) for seed in range(4)]).sel(quantity="e_22")
    assert np.allclose(equal.spread_over_uncertainty, 1, atol=0.05)
    assert np.allclose(equal.uncertainty, 2e-5)
    offsets = [0.0, 1e-4, 2e-4]
    group = [specimen(seed, offset=offset) for seed, offset in enumerate(offsets)]
    found = compare_specimens(group).sel(quantity="e_22", step=1)
    assert float(found["mean"]) == pytest.approx(1.1e-3, abs=2e-6)
    assert float(found.spread_of_means) == pytest.approx(1e-4, rel=0.03)
    assert float(found.spread) == pytest.approx(np.hypot(1e-4, 2e-5), rel=0.05)
    assert "e_22: the spread of the specimens at a point is 5." in specimen_sentences(compare_specimens(group))[1]


def test_points_are_those_that_all_specimens_have() -> None:
    group = [specimen(seed) for seed in range(3)]
    group[1]["e_11"] = group[1].e_11.where(group[1].column > 4)
    group[2] = group[2].isel(row=slice(10, None))
    found = compare_specimens(group).sel(step=0)
    assert found.points.sel(quantity="e_11") == 20 * 35
    assert found.points.sel(quantity="e_22") == 20 * 40
    maps = specimen_maps(group, 0)
    assert np.isfinite(maps.ratio_e_11).sum() == 20 * 35
    values = np.array([each.e_22.sel(step=0, row=15, column=7) for each in group])
    assert float(maps.spread_e_22.sel(row=15, column=7)) == pytest.approx(values.std(ddof=1))


def test_experiments_have_to_have_something_in_common() -> None:
    one = specimen(1)
    with pytest.raises(DatasetError, match="no step in common"):
        compare_specimens([one, one.assign_coords(step=[5, 6])])
    with pytest.raises(DatasetError, match="no point in common"):
        compare_specimens([one, one, one.assign_coords(row=one.row + 1000)])
    with pytest.raises(DatasetError, match="not all of the experiments have a step 5"):
        specimen_maps([one, one], 5)


def test_specimens_with_other_reference_steps_are_named(tmp_path: Path) -> None:
    steps = {"a": [0, 0], "b": [0, 1], "c": [-1, 0]}
    group = {
        name: specimen(seed).assign(reference_step=("step", steps[name])) for seed, name in enumerate(sorted(steps))
    }
    assert compare_specimens(list(group.values())).references_differ.values.tolist() == [False, True]
    page = write_specimens(group, tmp_path / "group.html").read_text()
    assert "<td>reference_step</td><td>0; 1</td>" in page
    assert "at 1 of 2 steps the experiments have different reference steps" in page
    del group["b"]
    assert not compare_specimens(list(group.values())).references_differ.any()


def test_a_curve_is_interrupted_where_the_reference_changes() -> None:
    """The strain starts there at 0 again, and the force does not."""
    twice = xr.concat([specimen(1), specimen(1).assign_coords(step=[2, 3])], "step")
    curve = strain_curve(twice.assign(reference_step=("step", [0, 0, 2, 2])))
    values = {str(name): each.values for name, each in curve.data_vars.items()}
    drawn = specimen_curve(values, "e_22")
    for each in (drawn.strain, drawn.sigma, drawn.load):
        assert np.isnan(each).tolist() == [False, False, True, False, False]
    del values["reference_step"]
    assert len(specimen_curve(values, "e_22").strain) == 4, "of a receipt of an earlier version"


def test_the_page_contains_curves_maps_and_what_differs(tmp_path: Path) -> None:
    group = {f"plate-{seed}": specimen(seed, experiment=f"plate {seed}", commit=str(seed % 2)) for seed in range(3)}
    page = write_specimens(group, tmp_path / "group.html").read_text()
    assert "<h1>3 specimens</h1>" in page
    assert page.count('<img alt="mean, spread, uncertainty') == 2
    assert "<td>commit</td><td>0; 1</td>" in page
    assert "mean axial strain" in page
    assert "<td>experiment</td>" not in page
    unmeasured = {
        name: each.assign({key: each[key] * np.nan for key in ("e_11", "e_22")}) for name, each in group.items()
    }
    with pytest.raises(DatasetError, match="no point is measured of all specimens"):
        write_specimens(unmeasured, tmp_path / "other.html")
