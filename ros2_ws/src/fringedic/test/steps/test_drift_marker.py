"""A region that should stand still: drift of the rig is measured there and said."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from aligned_rig import aligned_rig
from pydantic import ValidationError

from fringedic.steps.drift_marker import drift_of_steps, measure_drift
from fringedic.steps.parameters import CouplingParameters
from fringedic.steps.sentences import drift_sentence
from fringedic.steps.shape_tracker import ShapeTracker
from fringedic.steps.step_results import DicResult, PhaseResult, displacement_field

REGION = [100, 20, 40, 60]
RIG = aligned_rig((160, 120), 4e-4, (800, 600), 3400.0)
SIGMA_PHASE = 0.02


def phase_at(height: np.ndarray, seed: int) -> np.ndarray:
    """Phase of a surface of this height [m] at every pixel, with noise."""
    row, column = np.mgrid[:120, :160]
    reach = (RIG.camera_distance - height) / RIG.camera_distance
    x, y = (column - 79.5) * RIG.pixel_size * reach, (59.5 - row) * RIG.pixel_size * reach
    noise = np.random.default_rng(seed).normal(0.0, SIGMA_PHASE, height.shape)
    return (RIG.phase(x, y, height, 10.0) + noise).astype(np.float32)


def test_a_rig_that_drifts_is_told_from_the_specimen() -> None:
    """The specimen moves by 0.5 mm towards the camera; the marker beside it by nothing, and then by 30 µm."""
    tracker = ShapeTracker(CouplingParameters(drift_marker_px=REGION, strain_window_px=0, local_frame_window_px=0))
    tracker.set_calibration(RIG)
    column = np.broadcast_to(np.arange(160), (120, 160))
    still, drifted = (np.where(column < 90, 0.5e-3, drift) for drift in (0.0, 30e-6))
    found = []
    for step, height in enumerate((np.zeros((120, 160)), still, drifted)):
        displacement = np.zeros((30, 40, 2), np.float32)
        sigma = np.full_like(displacement, 0.005)
        field = displacement_field(displacement, sigma, origin=(0, 0), spacing=4, window=32, method="dense")
        maps_of_step = xr.Dataset(
            {
                "phase": (("row", "column"), phase_at(height, step)),
                "sigma": (("row", "column"), np.full((120, 160), SIGMA_PHASE, np.float32)),
            }
        )
        phase = PhaseResult("test", step, step, maps_of_step, pitch=10.0)
        result = tracker.step(phase, DicResult("test", step, step, 0, 0, field))
        assert result.drift is not None
        found.append(result.drift)
    assert [bool(drift_sentence(each)) for each in found] == [False, False, True]
    assert found[2].w == pytest.approx(30e-6, abs=2e-6)
    assert abs(found[1].w) < 2e-6
    assert "since step 0" in drift_sentence(found[2])
    assert "drifts" in drift_sentence(found[2])
    assert all(each.measured == 1.0 for each in found)


def maps(drift: float) -> xr.Dataset:
    """Maps of a specimen that moves and a marker that moves by `drift` [m] along y; points of 2 px from (2, 4) on."""
    shape = (60, 80)
    fields = {name: np.full(shape, 1e-3, np.float32) for name in "uvw"}
    fields |= {f"sigma_{name}": np.full(shape, 1e-6, np.float32) for name in "uvw"}
    for name in "uvw":
        fields[name][10:40, 50:70] = drift if name == "v" else 0.0
    coordinates = {"row": 4 + 2 * np.arange(60), "column": 2 + 2 * np.arange(80)}
    return xr.Dataset({name: (("row", "column"), array) for name, array in fields.items()}, coords=coordinates)


def test_places_count_in_pixels_of_the_image() -> None:
    """Points of 2 px, the first at row 4, column 2: the region of rows 24 to 83 and columns 102 to 141."""
    fields = maps(5e-6)
    region = [102, 24, 40, 60]
    motion = measure_drift(fields, region)
    assert (motion.u, motion.v, motion.w) == (0.0, pytest.approx(5e-6), 0.0)
    assert motion.moved
    dataset = xr.concat([maps(0.0), fields], xr.DataArray([0, 7], dims="step", name="step"))
    found = drift_of_steps(dataset, region)
    assert found[7] == motion
    assert not found[0].moved
    assert not drift_sentence(found[0])


def test_a_region_that_is_not_measured_says_so() -> None:
    fields = maps(0.0)
    fields["u"][10:39, 50:70] = np.nan
    motion = measure_drift(fields, [102, 24, 40, 60])
    assert motion.lost
    assert "3 % of the drift marker" in drift_sentence(motion)
    assert measure_drift(fields, [900, 20, 40, 60]).lost


def test_regions_that_mean_nothing_are_refused() -> None:
    for region in ([1, 2, 3], [0, 0, -5, 5], [0, 0, 10, 0]):
        with pytest.raises(ValidationError, match="width and height"):
            CouplingParameters(drift_marker_px=region)
