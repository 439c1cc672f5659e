"""A calibration of another rig, or with a length in another unit, is refused with both values."""

import math
from dataclasses import replace

import pytest
from aligned_rig import aligned_rig

from fringedic.configuration.virtual_calibration import calibration_of
from fringedic.errors import CalibrationError, ErrorCode, PatternError
from fringedic.patterns.sequences import fringe_sequence, gray_code_sequence, one_image_sequence
from fringedic.rig.compatibility import RigSetup, check_calibration, needed_pitch
from fringedic.virtual_rig import VirtualRigConfiguration
from fringedic.virtual_rig.configuration import SIZES

TINY = aligned_rig((160, 120), 4e-4, (200, 150), 850.0)


@pytest.mark.parametrize("name", ["plate", "skin", "leather"])
@pytest.mark.parametrize("size", list(SIZES))
def test_every_virtual_rig_fits_its_own_calibration(name, size):
    rig = VirtualRigConfiguration.from_dict({"preset": name, "size": size})
    model = calibration_of(rig)
    width, height = rig.projector.columns, rig.projector.rows
    patterns = fringe_sequence(width, height, [width, width / 5], 4).patterns
    check_calibration(model, RigSetup((rig.camera.columns, rig.camera.rows), (width, height), patterns))


@pytest.mark.parametrize(
    ("setup", "values"),
    [
        (RigSetup(camera_size=(1280, 960)), r"camera of 160 x 120 px.*1280 x 960 px"),
        (RigSetup(projector_size=(800, 600)), r"projector of 200 x 150 px.*800 x 600 px"),
    ],
)
def test_calibration_of_another_size_is_refused_with_both(setup, values):
    with pytest.raises(CalibrationError, match=values) as refused:
        check_calibration(TINY, setup)
    assert refused.value.code is ErrorCode.OTHER_RIG


def test_calibration_of_another_part_of_the_sensor_is_refused_with_both():
    """x and y would be wrong by the distance of the two parts."""
    region = replace(TINY, camera_first_column=64, camera_first_row=32)
    check_calibration(region, RigSetup(camera_first=(64, 32)))
    check_calibration(region, RigSetup())
    check_calibration(TINY, RigSetup(camera_first=(0, 32)))  # of an older file, where it is not known
    with pytest.raises(CalibrationError, match=r"\(64, 32\) of the sensor.*begin at \(0, 32\)") as refused:
        check_calibration(region, RigSetup(camera_first=(0, 32)))
    assert refused.value.code is ErrorCode.OTHER_RIG


@pytest.mark.parametrize("factor", [1e-3, 1e3])
@pytest.mark.parametrize("view_degree", [0.3, 1.0, 9.0, 50.0, 119.0])
def test_scale_in_another_unit_is_refused_for_every_lens(view_degree, factor):
    pixel_size = 2 * 0.4 * math.tan(math.radians(view_degree) / 2) / 160
    lens = replace(TINY, pixel_size=pixel_size, projector_focal_length=min(850.0, 40 / view_degree * 850))
    check_calibration(lens, RigSetup())
    with pytest.raises(CalibrationError, match=r"pixel_size.*mm.*camera_distance.*mm") as refused:
        check_calibration(replace(lens, pixel_size=factor * pixel_size), RigSetup())
    assert refused.value.code is ErrorCode.OTHER_RIG


def test_projector_that_does_not_light_the_view_is_refused():
    with pytest.raises(CalibrationError, match="does not light"):
        check_calibration(replace(TINY, projector_rotation=(0.5, 0.0, 0.0)), RigSetup())


@pytest.mark.parametrize("position", [(180.0, 0.0, 380.0), (1.8e-4, 0.0, 3.8e-4)])
def test_position_of_the_projector_in_another_unit_is_refused(position):
    with pytest.raises(CalibrationError, match=r"projector.* mm.*camera.*400 mm") as refused:
        check_calibration(replace(TINY, projector_position=position), RigSetup())
    assert refused.value.code is ErrorCode.OTHER_RIG


def test_needed_pitch_is_the_visible_part_of_the_projector():
    """Seen from the projector's axis, the farthest visible column lies half a needed pitch away."""
    closer = replace(TINY, pixel_size=1e-4)
    x = [s * 1e-4 * 79.5 for s in (-1, 1)]
    y = [s * 1e-4 * 59.5 for s in (-1, 1)]
    farthest = max(abs(float(closer.phase(a, b, 0.0, 2 * math.pi))) for a in x for b in y)
    assert 0 < farthest < 60
    assert needed_pitch(closer) == pytest.approx(2 * farthest, abs=0.5)
    assert needed_pitch(replace(TINY, pixel_size=1.5e-3)) == 200, "the whole projector is visible"


def test_sequence_that_repeats_in_view_is_refused_with_the_needed_pitch():
    needed = needed_pitch(TINY)
    assert 100 < needed <= 200
    repeating = RigSetup(patterns=fringe_sequence(200, 150, [100, 20, 5], 4).patterns)
    with pytest.raises(PatternError, match=f"100 px.*at least {math.ceil(needed)} px") as refused:
        check_calibration(TINY, repeating)
    assert refused.value.code is ErrorCode.INVALID_SEQUENCE
    enough = fringe_sequence(200, 150, [math.ceil(needed), 20, 5], 4).patterns
    for patterns in (enough, gray_code_sequence(200, 150, 10, 4).patterns, one_image_sequence(200, 150, 10).patterns):
        check_calibration(TINY, RigSetup(patterns=patterns))


def test_horizontal_fringes_need_the_visible_rows():
    lower = RigSetup(patterns=fringe_sequence(200, 150, [60, 20], 4, "horizontal").patterns)
    with pytest.raises(PatternError, match="60 px"):
        check_calibration(TINY, lower)
    check_calibration(TINY, RigSetup(patterns=fringe_sequence(200, 150, [150, 20], 4, "horizontal").patterns))
