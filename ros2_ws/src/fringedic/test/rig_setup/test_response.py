"""Response of projector and camera: measured on the twin, undone in the patterns, kept as a file."""

import numpy as np
import pytest

from fringedic.errors import ImageError, PatternError
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.patterns.render import render_pattern
from fringedic.patterns.response import ResponseCurve
from fringedic.patterns.sequences import fringe_sequence, gray_code_sequence
from fringedic.phase import absolute_phase
from fringedic.rig_setup.response import measure_response, response_patterns
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration


def bent_rig(gamma: float = 2.2, response: float = 0.8, **sensor: float) -> VirtualRig:
    return VirtualRig(
        VirtualRigConfiguration.from_dict(
            {
                "preset": "plane",
                "size": "small",
                "seed": 5,
                "projector": {"gamma": gamma},
                "sensor": {"response": response, "bits": 12, **sensor},
            }
        )
    )


def ramp(twin: VirtualRig) -> np.ndarray:
    rows, columns = twin.projector_shape
    images = [render_pattern(each, columns, rows) for each in response_patterns()]
    return np.array([twin.expose(image, 0.0, index) for index, image in enumerate(images)])


@pytest.fixture(scope="module")
def measured() -> ResponseCurve:
    return measure_response(ramp(bent_rig(ambient_light=1e-3)), response_patterns())


def test_curve_is_that_of_projector_and_camera(measured: ResponseCurve) -> None:
    level = np.arange(256) / 255
    expected = level ** (2.2 * 0.8)
    error = np.abs(np.array(measured.brightness) - expected)
    assert measured.gamma == pytest.approx(1.76, rel=0.02)  # the room's light, bent too, adds 1 %
    assert error.max() < 0.003
    wanted = np.linspace(0, 1, 50)
    assert np.allclose(np.interp(measured.level_for(wanted), np.arange(256), measured.brightness), wanted, atol=1e-6)


@pytest.mark.parametrize("shifts", [3, 4, 8])
def test_waves_vanish_when_the_patterns_make_up_for_it(shifts: int, measured: ResponseCurve) -> None:
    twin = bent_rig(read_noise_grey_level=0.0, shot_noise_grey_level=0.0, bits=16)
    rows, columns = twin.projector_shape
    truth = (twin.view(0.0).projector_column - (columns - 1) / 2) / 20
    waves = []
    for curve in (None, measured):
        sequence = fringe_sequence(columns, rows, [columns, 20], [8, shifts], response=curve)
        frames = np.array([twin.expose(image, 0.0, index) for index, image in enumerate(sequence)])
        error = absolute_phase(frames, sequence.patterns, noise=1.0).phase.values / (2 * np.pi) - truth
        waves.append(float(np.sqrt(np.nanmean((error - np.nanmean(error)) ** 2))))
    if shifts == 3:  # more shifts do not see the second harmonic
        assert waves[0] > 0.015
    assert waves[1] < 0.001


def test_code_and_fringes_have_the_same_brightness(measured: ResponseCurve) -> None:
    sequence = gray_code_sequence(200, 10, 10, 4, response=measured)
    images = np.array(list(sequence))
    brightness = np.array(measured.brightness)[images]
    assert brightness[:-4].max(axis=(1, 2)) == pytest.approx(250 / 255, abs=0.01)
    assert brightness[-4:].mean() == pytest.approx(0.5, abs=0.01)
    untouched = render_pattern(ProjectedPattern(PatternKind.GREY, shift=100, shifts=255), 4, 3, response=measured)
    assert set(np.unique(untouched)) == {100}, "the procedure sees the projector as it is"


def test_curve_is_kept_in_a_file(measured: ResponseCurve, tmp_path) -> None:
    path = tmp_path / "response.yaml"
    measured.save(path)
    loaded = ResponseCurve.load(path)
    assert np.abs(np.array(loaded.brightness) - measured.brightness).max() < 1e-6
    for content, words in (("a: 1", "not a response curve"), ("response_curve: {brightness: [0, 1]}", "256")):
        path.write_text(content)
        with pytest.raises(PatternError, match=words):
            ResponseCurve.load(path)
    with pytest.raises(PatternError, match="not a response curve"):
        ResponseCurve.load(tmp_path / "absent.yaml")


def test_images_that_tell_no_curve_are_refused() -> None:
    twin = bent_rig()
    frames, patterns = ramp(twin), response_patterns()
    with pytest.raises(PatternError, match="hardly differs"):
        measure_response(frames // 2000, patterns)
    with pytest.raises(PatternError, match="saturates"):
        measure_response(frames, patterns, saturation=1)
    with pytest.raises(PatternError, match="out of order"):
        measure_response(frames[[0, *range(16, 0, -1), 17]], patterns)
    with pytest.raises(PatternError, match="black, full white"):
        measure_response(frames[1:], patterns[1:])
    with pytest.raises(PatternError, match="other patterns"):
        measure_response(frames[:2], [patterns[0], ProjectedPattern(PatternKind.WHITE)])
    with pytest.raises(ImageError):
        measure_response(frames[:5], patterns)
    with pytest.raises(PatternError, match="never fall"):
        ResponseCurve((0.0, 0.5, 0.4, *np.linspace(0.5, 1, 253)))
    with pytest.raises(PatternError, match="at least 3"):
        response_patterns(2)
