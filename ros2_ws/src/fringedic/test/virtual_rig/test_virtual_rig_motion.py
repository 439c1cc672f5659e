"""Frames of the virtual rig while its crosshead moves."""

import numpy as np
import pytest

from fringedic.errors import CrossheadRangeError
from fringedic.virtual_rig import ConstantRate, Ramp, Sine, StickSlip, VirtualRig


@pytest.fixture(scope="module")
def rig() -> VirtualRig:
    """Plate without noise."""
    return VirtualRig.from_preset("plate", size="tiny", ideal=True)


def test_motion_blur_is_the_mean_over_the_exposure(rig: VirtualRig) -> None:
    fringes = np.tile((np.arange(rig.projector_shape[1]) % 10 < 5).astype(np.uint8) * 250, (rig.projector_shape[0], 1))
    motion = ConstantRate(start=5e-4, rate=1e-3)
    blurred = rig.expose_moving(fringes, motion, time=0.0, exposure_time=0.6, frame=0, instants=3)
    sharp = [rig.expose(fringes, position, 0).astype(float) for position in (3e-4, 5e-4, 7e-4)]
    assert np.abs(blurred - np.mean(sharp, axis=0)).max() < 1.0  # each frame is rounded
    assert np.abs(blurred - sharp[1]).max() > 3.0
    later = rig.expose_moving(fringes, motion, time=0.1, exposure_time=0.0, frame=0)
    assert np.array_equal(later, rig.expose(fringes, 6e-4, 0))


def test_a_course_beyond_the_range_is_refused(rig: VirtualRig) -> None:
    white = np.full(rig.projector_shape, 250, np.uint8)
    with pytest.raises(CrossheadRangeError, match="outside 0 to"):
        rig.expose_moving(white, Sine(mean=0.0, amplitude=1e-4, frequency=1.0), time=0.75, exposure_time=0.1, frame=0)


@pytest.mark.parametrize("course", [Ramp(0.0, 2e-3, 1e-2), StickSlip(0.0, 1e-4, 0.5, 0.05)])
def test_courses_are_continuous(course: Ramp | StickSlip) -> None:
    times = np.linspace(-1, 3, 4001)
    positions = np.array([course.position(time) for time in times])
    assert np.abs(np.diff(positions)).max() < 2.1e-3 * 1e-3
    assert np.diff(positions).min() > -1e-12
