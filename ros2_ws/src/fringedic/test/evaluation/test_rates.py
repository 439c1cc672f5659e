"""Rates between steps, and their uncertainty beside a reference of another noise."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from fringedic.evaluation import rates

REFERENCE, STEP, SECONDS = 7e-6, 5e-6, 2.0  # noise of the heights [m], time between steps [s]


def test_the_noise_of_the_reference_cancels_in_the_rate_of_w() -> None:
    """Half of the variance was taken for it, so that the rates of steps in motion had a z-score of 0.85."""
    random = np.random.default_rng(1)
    reference, *steps = random.normal(size=(4, 100, 100))
    maps, shape = ("step", "row", "column"), (3, 100, 100)
    w = np.stack([STEP * step - REFERENCE * reference for step in steps])
    times = np.array([0, SECONDS, 2 * SECONDS]) * 1e9
    experiment = xr.Dataset(
        {
            "w": xr.DataArray(w, dims=maps, attrs={"units": "m"}),
            "sigma_w": (maps, np.full(shape, np.hypot(REFERENCE, STEP))),
            "noise_z": (maps, np.full(shape, REFERENCE)),
            "reference_step": ("step", [0, 0, 0]),
        },
        coords={"step": [1, 2, 3], "time": ("step", times.astype("datetime64[ns]"))},
    )
    found = rates(experiment)
    assert float((found.w_rate / found.sigma_w_rate).std()) == pytest.approx(1.0, abs=0.03)
    without = rates(experiment.drop_vars("noise_z"))
    assert float((without.w_rate / without.sigma_w_rate).std()) == pytest.approx(0.82, abs=0.03)
