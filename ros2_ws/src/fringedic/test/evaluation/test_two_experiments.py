"""Two experiments: statistics of known differences, what differs in the settings, and the page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import fringedic
from fringedic.errors import DatasetError
from fringedic.evaluation import compare_experiments, difference_maps, differing_attributes
from fringedic.evaluation.sentences import comparison_sentences
from fringedic.report.two_experiments import write_comparison

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"


@pytest.fixture(scope="module")
def experiments(tmp_path_factory: pytest.TempPathFactory) -> tuple[xr.Dataset, xr.Dataset]:
    """One recording with two windows."""
    folder = tmp_path_factory.mktemp("two")
    files = [
        fringedic.process_bag(RECORDED, output=folder / f"{window}.nc", overrides={"dic.window": window})
        for window in (24, 32)
    ]
    first, second = (fringedic.open_experiment(file) for file in files)
    return first, second


def noise(seed: int, *, steps: int = 2, offset: int = 0) -> xr.Dataset:
    """Independent noise of a known standard deviation, with its correct sigma."""
    generator = np.random.default_rng(seed)
    dimensions = ("step", "row", "column")
    sigma = generator.uniform(1e-6, 3e-6, (steps, 80, 100))
    values = generator.normal(0, sigma)
    coordinates = {"step": range(steps), "row": range(80), "column": offset + np.arange(100)}
    return xr.Dataset({"w": (dimensions, values), "sigma_w": (dimensions, sigma)}, coordinates)


def test_independent_noise_is_explained_by_its_uncertainty() -> None:
    found = compare_experiments(noise(1), noise(2)).sel(quantity="w")
    assert np.allclose(found.normalized_rms, 1, atol=0.03)
    assert np.allclose(found.within_2_sigma, 0.954, atol=0.01)


def test_a_real_difference_is_found_at_the_common_points() -> None:
    one, other = noise(1), noise(2, steps=3, offset=60)
    other["w"] = other.w + 20e-6
    found = compare_experiments(one, other).sel(quantity="w")
    assert found.step.values.tolist() == [0, 1]
    assert found.points.values.tolist() == [80 * 40] * 2
    assert np.allclose(found.mean_other - found.mean_one, 20e-6, rtol=0.02)
    assert (found.within_2_sigma < 0.01).all()
    maps = difference_maps(one, other, 1)
    assert np.allclose(maps.difference_w, 20e-6 + (noise(2, steps=3).w[1, :, :40].values - one.w[1, :, 60:].values))


def test_two_settings_of_one_recording_share_its_noise(experiments: tuple[xr.Dataset, xr.Dataset]) -> None:
    found = compare_experiments(*experiments)
    at_last = found.sel(step=2, quantity="displacement_x")
    assert 0 < float(at_last.normalized_rms) < 1
    changed = {each.name: (each.one, each.other) for each in differing_attributes(*experiments)}
    assert changed == {"parameters.dic.window": (24, 32)}
    assert np.allclose(found.force_one, found.force_other)


def test_an_experiment_equals_itself(experiments: tuple[xr.Dataset, xr.Dataset]) -> None:
    found = compare_experiments(experiments[0], experiments[0])
    assert np.nanmax(found.rms_difference) == 0
    assert int(found.points.sel(step=2, quantity="w")) > 5000
    assert differing_attributes(experiments[0], experiments[0]) == []


def test_displacements_relative_to_other_reference_steps_are_named(tmp_path: Path) -> None:
    one = noise(1, steps=3).assign(reference_step=("step", [0, 0, 0]))
    other = noise(2, steps=4).assign(reference_step=("step", [-1, 0, 2, 2]))
    assert differing_attributes(one, other) == [("reference_step", 0, 2)]
    assert differing_attributes(one, other.isel(step=[0, 1])) == []
    assert differing_attributes(one, other.drop_vars("reference_step")) == []
    found = compare_experiments(one, other)
    assert found.references_differ.values.tolist() == [False, False, True]
    assert "different reference steps" in comparison_sentences(found)[0]
    page = write_comparison(one, other, tmp_path / "page.html").read_text()
    assert "<tr><td>reference_step</td><td>0</td><td>2</td></tr>" in page
    assert "at 1 of 3 steps the experiments have different reference steps" in page
    assert "different reference steps" not in comparison_sentences(compare_experiments(one, one))[0]


def test_scale_and_size_of_images_are_named(tmp_path: Path) -> None:
    one = noise(1).assign_attrs(pixel_size=5e-5, image_width=100, image_height=80)
    one.to_netcdf(tmp_path / "one.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "one.nc", engine="h5netcdf") as read:
        assert differing_attributes(one, read) == []
        found = differing_attributes(read, noise(2).assign_attrs(pixel_size=1e-4, image_width=120, image_height=90))
        assert found == [("pixel_size", 5e-5, 1e-4), ("image_width", 100, 120), ("image_height", 80, 90)]
        assert [str(each.one) for each in found] == ["5e-05", "100", "80"]
        assert not any(isinstance(each.one, np.generic) for each in found)


def test_the_page_shows_settings_curves_and_maps(experiments: tuple[xr.Dataset, xr.Dataset], tmp_path: Path) -> None:
    page = write_comparison(*experiments, tmp_path / "page.html").read_text()
    assert "parameters.dic.window" in page
    assert page.count("<img alt=") == 4
    assert "Force over mean strain" in page
    assert comparison_sentences(compare_experiments(*experiments))[0].startswith("displacement_x: ")
    with pytest.raises(DatasetError, match="exists already"):
        write_comparison(*experiments, tmp_path / "page.html")


def test_experiments_without_anything_in_common_are_refused() -> None:
    one = noise(1)
    with pytest.raises(DatasetError, match="no step in common"):
        compare_experiments(one, one.assign_coords(step=[5, 6]))
    with pytest.raises(DatasetError, match="no point in common"):
        compare_experiments(one, one.assign_coords(row=one.row + 1000))
    with pytest.raises(DatasetError, match="none of the maps"):
        compare_experiments(one, one.rename(w="height"))
    with pytest.raises(DatasetError, match="one is 3: it has to be"):
        compare_experiments(3, one)
    unmeasured = compare_experiments(one, one.assign(w=one.w * np.nan))
    assert int(unmeasured.points.sum()) == 0
    with pytest.raises(DatasetError, match="no point is measured in both"):
        comparison_sentences(unmeasured)
