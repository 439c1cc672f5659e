"""A region that should stand still: drift of the rig is measured there and said."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from pydantic import ValidationError

from fringedic.chain import CouplingParameters, ShapeTracker
from fringedic.rig import RigModel
from fringedic.watch import watched_motion, watched_steps

REGION = [100, 20, 40, 60]
RIG = RigModel(
    camera_width=160,
    camera_height=120,
    camera_distance=0.4,
    pixel_size=4e-4,
    pixel_aspect=1.0,
    principal_column=79.5,
    principal_row=59.5,
    projector_width=800,
    projector_height=600,
    projector_position=(0.18, 0.0, 0.38),
    projector_focal_length=3400.0,
    projector_principal_column=399.5,
    projector_principal_row=299.5,
)
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
    tracker = ShapeTracker(CouplingParameters(watch_region_px=REGION, strain_window_px=0, local_frame_window_px=0))
    tracker.set_calibration(RIG)
    column = np.broadcast_to(np.arange(160), (120, 160))
    still, drifted = (np.where(column < 90, 0.5e-3, drift) for drift in (0.0, 30e-6))
    found = []
    for step, height in enumerate((np.zeros((120, 160)), still, drifted)):
        rows, columns = np.arange(0, 120, 4), np.arange(0, 160, 4)
        displacement = np.zeros((len(rows), len(columns), 2), np.float32)
        result = tracker.step(
            "test",
            step,
            step,
            phase_at(height, step),
            np.full((120, 160), SIGMA_PHASE, np.float32),
            displacement,
            np.full_like(displacement, 0.005),
            pitch=10.0,
            spacing=4,
        )
        assert result.watched is not None
        found.append(result.watched)
    print([f"w {1e6 * each.w:.2f} µm, sigma of a point {1e6 * each.sigma_w:.2f} µm" for each in found])
    assert [bool(each.words) for each in found] == [False, False, True]
    assert found[2].w == pytest.approx(30e-6, abs=2e-6) and abs(found[1].w) < 2e-6
    assert "since step 0" in found[2].words and "drifts" in found[2].words
    assert all(each.measured == 1.0 for each in found)


def maps(drift: float) -> dict[str, np.ndarray]:
    """Maps of a specimen that moves and a region that moves by `drift` [m] along y."""
    shape = (60, 80)
    fields = {name: np.full(shape, 1e-3, np.float32) for name in "uvw"}
    fields |= {f"sigma_{name}": np.full(shape, 1e-6, np.float32) for name in "uvw"}
    for name in "uvw":
        fields[name][10:40, 50:70] = drift if name == "v" else 0.0
    return fields


def test_places_count_in_pixels_of_the_image() -> None:
    """Points of 2 px, the first at row 4, column 2: the region of rows 24 to 83 and columns 102 to 141."""
    fields = maps(5e-6)
    region = [102, 24, 40, 60]
    motion = watched_motion(fields, region, spacing=2, origin=(4, 2))
    assert (motion.u, motion.v, motion.w) == (0.0, pytest.approx(5e-6), 0.0) and motion.moved
    names = [f"sigma_{name}" for name in "uvw"]
    coordinates = {"step": [0, 7], "row": 4 + 2 * np.arange(60), "column": 2 + 2 * np.arange(80)}
    steps = [maps(0.0), fields]
    dataset = xr.Dataset(
        {name: (("step", "row", "column"), np.array([each[name] for each in steps])) for name in (*"uvw", *names)},
        coords=coordinates,
    )
    found = watched_steps(dataset, region)
    assert found[7] == motion and not found[0].moved and not found[0].words


def test_a_region_that_is_not_measured_says_so() -> None:
    fields = maps(0.0)
    fields["u"][10:39, 50:70] = np.nan
    motion = watched_motion(fields, [100, 20, 40, 60], spacing=2)
    assert motion.lost and "3 % of the watched region" in motion.words
    assert watched_motion(fields, [900, 20, 40, 60], spacing=2).lost


def test_regions_that_mean_nothing_are_refused() -> None:
    for region in ([1, 2, 3], [0, 0, -5, 5], [0, 0, 10, 0]):
        with pytest.raises(ValidationError, match="width and height"):
            CouplingParameters(watch_region_px=region)
