"""Response of projector and camera: measured on the twin, undone in the patterns, kept as a file."""

import numpy as np
import pytest

from fringedic.errors import InvalidResponseError, ShapeMismatchError
from fringedic.patterns import fringe_sequence, gray_code_sequence, render_pattern
from fringedic.phase import absolute_phase
from fringedic.response import ResponseCurve, measure_response, response_projections
from fringedic.sequence import PatternKind, Projection
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
    images = [render_pattern(each, columns, rows) for each in response_projections()]
    return np.array([twin.expose(image, 0.0, index) for index, image in enumerate(images)])


@pytest.fixture(scope="module")
def measured() -> ResponseCurve:
    return measure_response(ramp(bent_rig(ambient_light=1e-3)), response_projections())


def test_curve_is_that_of_projector_and_camera(measured: ResponseCurve) -> None:
    level = np.arange(256) / 255
    expected = level ** (2.2 * 0.8)
    error = np.abs(np.array(measured.brightness) - expected)
    print(
        f"gamma {measured.gamma:.4f} (2.2 x 0.8 = 1.76), curve off by {error.max():.5f}, scatter {measured.sigma:.5f}"
    )
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
        error = absolute_phase(frames, sequence.projections, noise=1.0).phase.values / (2 * np.pi) - truth
        waves.append(float(np.sqrt(np.nanmean((error - np.nanmean(error)) ** 2))))
    print(f"q = {shifts}: waves of {waves[0]:.5f} fringe RMS before, {waves[1]:.5f} after")
    if shifts == 3:  # more shifts do not see the second harmonic
        assert waves[0] > 0.015
    assert waves[1] < 0.001


def test_code_and_fringes_have_the_same_brightness(measured: ResponseCurve) -> None:
    sequence = gray_code_sequence(200, 10, 10, 4, response=measured)
    images = np.array(list(sequence))
    brightness = np.array(measured.brightness)[images]
    assert brightness[:-4].max(axis=(1, 2)) == pytest.approx(250 / 255, abs=0.01)
    assert brightness[-4:].mean() == pytest.approx(0.5, abs=0.01)
    untouched = render_pattern(Projection(PatternKind.GREY, shift=100, shifts=255), 4, 3, response=measured)
    assert set(np.unique(untouched)) == {100}, "the procedure sees the projector as it is"


def test_curve_is_kept_in_a_file(measured: ResponseCurve, tmp_path) -> None:
    path = tmp_path / "response.yaml"
    measured.save(path)
    loaded = ResponseCurve.load(path)
    assert np.abs(np.array(loaded.brightness) - measured.brightness).max() < 1e-6
    for content, words in (("a: 1", "not a response curve"), ("response_curve: {brightness: [0, 1]}", "256")):
        path.write_text(content)
        with pytest.raises(InvalidResponseError, match=words):
            ResponseCurve.load(path)
    with pytest.raises(InvalidResponseError, match="not a response curve"):
        ResponseCurve.load(tmp_path / "absent.yaml")


def test_images_that_tell_no_curve_are_refused() -> None:
    twin = bent_rig()
    frames, projections = ramp(twin), response_projections()
    with pytest.raises(InvalidResponseError, match="hardly differs"):
        measure_response(frames // 2000, projections)
    with pytest.raises(InvalidResponseError, match="saturates"):
        measure_response(frames, projections, saturation=1)
    with pytest.raises(InvalidResponseError, match="out of order"):
        measure_response(frames[[0, *range(16, 0, -1), 17]], projections)
    with pytest.raises(InvalidResponseError, match="black, full white"):
        measure_response(frames[1:], projections[1:])
    with pytest.raises(InvalidResponseError, match="other patterns"):
        measure_response(frames[:2], [projections[0], Projection(PatternKind.WHITE)])
    with pytest.raises(ShapeMismatchError):
        measure_response(frames[:5], projections)
    with pytest.raises(InvalidResponseError, match="never fall"):
        ResponseCurve((0.0, 0.5, 0.4, *np.linspace(0.5, 1, 253)))
    with pytest.raises(InvalidResponseError, match="at least 3"):
        response_projections(2)
