"""A step with the calibration of another rig fails with both values instead of a wrong displacement."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from aligned_rig import aligned_rig

from fringedic.errors import CalibrationError, ErrorCode, StepError
from fringedic.steps.parameters import CouplingParameters
from fringedic.steps.pipeline import OfflinePipeline
from fringedic.steps.shape_tracker import ShapeTracker
from fringedic.steps.step_results import DicResult, PhaseResult, displacement_field

SHAPE = (60, 72)
PITCH = 20.0
RIG = aligned_rig((72, 60), 2e-4, (80, 60), 900.0, projector_position=(0.15, 0.0, 0.38))


def plane_step(offset=0.0):
    """Phase of the reference plane and no displacement."""
    column, row = np.meshgrid(np.arange(72), np.arange(60))
    x, y = RIG.pixel_size * (column - RIG.principal_column), RIG.pixel_size * (RIG.principal_row - row)
    phase = (RIG.phase(x, y, 0.0, PITCH) + offset).astype(np.float32)
    small = np.full(SHAPE, 1e-3, np.float32)
    maps = xr.Dataset({"phase": (("row", "column"), phase), "sigma": (("row", "column"), small)})
    still = np.zeros((*SHAPE, 2), np.float32)
    field = displacement_field(still, still, origin=(0, 0), spacing=1, window=0, method="")
    return PhaseResult("e", 0, 0, maps, pitch=PITCH), DicResult("e", 0, 0, 0, 0, field)


def test_calibration_of_another_camera():
    tracker = ShapeTracker(CouplingParameters())
    tracker.set_calibration(replace(RIG, camera_width=1280, camera_height=960))
    phase, displacement = plane_step()
    assert tracker.surface(phase) is None
    with pytest.raises(StepError, match=r"1280 x 960 px.*72 x 60 px") as refused:
        tracker.step(phase, displacement)
    assert refused.value.code is ErrorCode.OTHER_RIG
    tracker.set_calibration(RIG)
    assert np.nanmax(np.abs(tracker.step(phase, displacement).shape.z)) < 1e-6


def test_surface_outside_the_measured_volume():
    """Fringes of another projector place the surface near or above the camera."""
    tracker = ShapeTracker(CouplingParameters())
    tracker.set_calibration(RIG)
    with pytest.raises(StepError, match=r"z = -?\d.* mm, its camera is at 400 mm") as refused:
        tracker.step(*plane_step(offset=-200.0))
    assert refused.value.code is ErrorCode.OTHER_RIG


def test_pipeline_refuses_lengths_that_contradict_each_other():
    with pytest.raises(CalibrationError, match="pixel_size of 200 mm"):
        OfflinePipeline({}, "e", (), replace(RIG, pixel_size=0.2))
