"""Strain of a dataset with a window of one's own: it needs what the processing knew about noise and windows."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr

from fringedic.evaluation import strain_of_step
from fringedic.surface import surface_strain

PIXEL, SPACING, WINDOW, STRAIN_WINDOW = 5e-5, 4, 32, 61
STRAINS = ("e_11", "e_22", "e_12", "sigma_e_11", "sigma_e_22", "sigma_e_12")


@pytest.fixture(scope="module")
def cloud() -> xr.Dataset:
    """A plate under tension whose crack opens by 1 px, as `couple` gives it."""
    column, row = np.meshgrid(SPACING * np.arange(90.0), SPACING * np.arange(50.0))
    noise = 2e-3 * np.random.default_rng(1).normal(size=column.shape)
    across = 0.004 * column + np.clip((column - 180) / 12, -0.5, 0.5) + noise
    fields = {"x": PIXEL * column, "y": -PIXEL * row, "u": PIXEL * across, "v": 1e-3 * PIXEL * row}
    fields |= dict.fromkeys(("z", "w"), 0 * row) | dict.fromkeys(("noise_z", "noise_z_deformed"), 1e-6 + 0 * row)
    fields |= dict.fromkeys(("sigma_u", "sigma_v", "sigma_w"), 2e-3 * PIXEL + 0 * row)
    fields |= dict.fromkeys(("displacement_sigma_x", "displacement_sigma_y"), 2e-3 + 0 * row)
    return xr.Dataset(
        {name: (("row", "column"), values.astype(np.float32)) for name, values in fields.items()},
        {"row": row[:, 0], "column": column[0]},
        {
            "camera_distance": 0.5,
            "z_filter_px": 2.0,
            "displacement_window_px": WINDOW,
            "displacement_method": "zoi",
        },
    )


def recorded(cloud: xr.Dataset, run: xr.Dataset) -> xr.Dataset:
    """The cloud and the strain of the run as a dataset contains them; another window was set after step 1."""
    first, last = (
        {
            "dic": {"window": window, "method": "zoi"},
            "coupling": {"z_filter_px": 2.0, "strain_window_px": STRAIN_WINDOW},
        }
        for window in (WINDOW, 48)
    )
    entries = [{"from_step": 0, "parameters": first}, {"from_step": 2, "parameters": last}]
    attributes = {"parameters": json.dumps(entries), "calibration": json.dumps({"camera_distance": 0.5})}
    maps = cloud.assign({name: run[name] for name in STRAINS})
    maps.attrs = attributes
    return xr.concat([maps, maps, maps], "step").assign_coords(step=[0, 1, 2])


@pytest.mark.parametrize("slope_noise", [1.0, 1.3])
def test_discontinuities_noise_and_gauge_are_those_of_the_run(cloud: xr.Dataset, slope_noise: float) -> None:
    run = surface_strain(cloud, window=STRAIN_WINDOW, slope_noise=slope_noise)
    assert np.isnan(run.e_11.sel(column=180)).mean() > 0.9, "the crack is masked"
    assert np.isfinite(run.e_11).mean() > 0.5
    dataset = recorded(cloud, run)
    again = strain_of_step(dataset, STRAIN_WINDOW, step=1)
    for name in STRAINS:
        np.testing.assert_allclose(again[name], run[name], rtol=2e-6, err_msg=name)
    assert again.attrs["virtual_strain_gauge_px"] == run.attrs["virtual_strain_gauge_px"]
    assert strain_of_step(dataset, STRAIN_WINDOW, step=2).attrs["virtual_strain_gauge_px"] == again.attrs[
        "virtual_strain_gauge_px"
    ] + (48 - WINDOW), "with the parameters of its step"
    wider = strain_of_step(dataset, 101, step=1)
    expected = surface_strain(cloud, window=101, slope_noise=slope_noise)
    for name in STRAINS:
        np.testing.assert_allclose(wider[name], expected[name], rtol=2e-6, err_msg=name)


def test_a_dataset_without_the_noise_of_the_heights_gives_the_strain_and_its_gauge(cloud: xr.Dataset) -> None:
    run = surface_strain(cloud, window=STRAIN_WINDOW)
    dataset = recorded(cloud, run).drop_vars(["noise_z", "noise_z_deformed"])
    found = strain_of_step(dataset, STRAIN_WINDOW, step=1)
    assert "sigma_e_11" not in found
    assert found.attrs["virtual_strain_gauge_px"] == run.attrs["virtual_strain_gauge_px"]
