"""Patterns: zero of phase, direction of growth, brightness and refusals."""

import numpy as np
import pytest

from fringedic.errors import FringedicError, PatternError
from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic.patterns.render import render_pattern
from fringedic.patterns.sequences import fringe_sequence, gray_code_sequence, one_image_sequence


def phase_of(images: list[np.ndarray], shifts: int) -> np.ndarray:
    angles = 2 * np.pi * np.arange(1, len(images) + 1) / shifts
    stack = np.array(images, float)
    return np.arctan2(np.tensordot(np.sin(angles), stack, 1), np.tensordot(np.cos(angles), stack, 1))


@pytest.mark.parametrize("width", [800, 801])
@pytest.mark.parametrize("pitch", [800, 37.5, 10])
def test_zero_of_phase_is_the_centre_for_every_pitch_and_grows_to_the_right(width: int, pitch: float) -> None:
    sequence = fringe_sequence(width, 6, [pitch], 8)
    measured = phase_of(list(sequence), 8)[3]
    expected = 2 * np.pi * (np.arange(width) - (width - 1) / 2) / pitch
    error = np.angle(np.exp(1j * (measured - expected)))
    assert np.abs(error).max() < 8 * 0.5 / (4 * 122.5)  # eight roundings by half a grey level at most
    assert np.abs(error).mean() < 1.5e-3
    near_axis = measured[width // 2 - 2 : width // 2 + 3]
    assert np.all(np.diff(near_axis) > 0)


def test_horizontal_fringes_grow_upwards() -> None:
    sequence = fringe_sequence(5, 600, [600], 4, "horizontal")
    measured = phase_of(list(sequence), 4)
    assert np.all(measured == measured[:, :1])
    expected = 2 * np.pi * ((600 - 1) / 2 - np.arange(600)) / 600
    assert np.abs(measured[:, 2] - expected).max() < 0.01


def test_order_is_coarse_to_fine_and_k_from_one_on() -> None:
    sequence = fringe_sequence(64, 48, [64, 16], [4, 3], periods=2)
    assert [(each.pitch, each.shift, each.shifts) for each in sequence.patterns] == [
        *((64.0, k, 4) for k in range(1, 9)),
        *((16.0, k, 3) for k in range(1, 7)),
    ]
    assert len(sequence) == 14
    assert np.array_equal(sequence.frame(9), list(sequence)[9])
    assert np.array_equal(sequence.frame(0), sequence.frame(4)), "a second period repeats the first"


def test_frames_are_8_bit_and_never_saturate() -> None:
    for image in fringe_sequence(200, 20, [200, 10], 4):
        assert image.dtype == np.uint8
        assert image.shape == (20, 200)
        assert image.min() >= 5
        assert image.max() <= 250


def test_white_is_as_bright_as_the_brightest_fringe() -> None:
    white = render_pattern(ProjectedPattern(PatternKind.WHITE), 30, 20)
    fringes = fringe_sequence(1001, 20, [100], 4).frame(3)
    assert white.shape == (20, 30)
    assert np.all(white == fringes.max())


def test_setup_patterns() -> None:
    other = ProjectedPattern(PatternKind.OTHER)
    assert not render_pattern(other, 30, 20, "dark").any()
    cross = render_pattern(other, 31, 20, "crosshair")
    assert np.flatnonzero(cross[0]).tolist() == [15]
    assert np.flatnonzero(cross[:, 0]).tolist() == [9, 10]
    grid = render_pattern(other, 200, 120, "grid")
    assert np.flatnonzero(grid[1]).tolist() == [0, 50, 100, 150]
    assert np.flatnonzero(grid[:, 1]).tolist() == [10, 60, 110]


@pytest.mark.parametrize(
    ("pitches", "shifts", "orientation", "says"),
    [
        ([], 4, "vertical", "at least one pitch"),
        ([10], 2, "vertical", "at least 3 shifts"),
        ([10, 40], 4, "vertical", "finer"),
        ([40, 40], 4, "vertical", "finer"),
        ([2], 4, "vertical", "above 2"),
        ([float("nan")], 4, "vertical", "a number"),
        ([40, 10], [4], "vertical", "one for each"),
        ([10], 4, "diagonal", "diagonal"),
    ],
)
def test_bad_sequences_are_refused(pitches: list[float], shifts: int, orientation: str, says: str) -> None:
    with pytest.raises(PatternError, match=says) as caught:
        fringe_sequence(64, 48, pitches, shifts, orientation)
    assert isinstance(caught.value, FringedicError)
    assert isinstance(caught.value, ValueError)


def test_bad_patterns_are_refused() -> None:
    with pytest.raises(PatternError, match="nonsense"):
        render_pattern(ProjectedPattern(PatternKind.OTHER), 64, 48, "nonsense")
    with pytest.raises(PatternError, match="0x48"):
        render_pattern(ProjectedPattern(PatternKind.WHITE), 0, 48)
    with pytest.raises(PatternError, match="from 1"):
        render_pattern(ProjectedPattern(PatternKind.FRINGES, Orientation.VERTICAL, 10.0, 0, 4), 64, 48)
    with pytest.raises(PatternError, match="one"):
        fringe_sequence(64, 48, [10], 4, periods=0)


@pytest.mark.parametrize("orientation", ["vertical", "horizontal"])
def test_gray_code_numbers_half_periods_upwards_from_the_centre(orientation: str) -> None:
    width, height, pitch = (401, 6, 12.5) if orientation == "vertical" else (6, 401, 12.5)
    sequence = gray_code_sequence(width, height, pitch, 4, orientation)
    code = [each for each in sequence.patterns if each.kind == PatternKind.GRAY_CODE]
    images = np.array([sequence.image(each) for each in code])
    assert set(np.unique(images)) == {5, 250}
    lines = images[:, 0, :] if orientation == "vertical" else images[:, ::-1, 0]
    number = np.zeros(401, int)
    bit = np.zeros(401, int)
    for line in lines > 127:
        bit ^= line
        number = 2 * number + bit
    half_period = np.floor((np.arange(401) - 200) / (pitch / 2) + 1).astype(int)
    assert np.array_equal(number - (1 << (len(code) - 1)), half_period)
    changed = np.sum(np.diff((lines > 127).astype(int), axis=1) != 0, axis=0)
    assert changed.max() == 1, "only one bit changes at an edge"
    assert [each.kind for each in sequence.patterns[len(code) :]] == [PatternKind.FRINGES] * 4


def test_one_image_and_grey() -> None:
    sequence = one_image_sequence(60, 10, 12, grey=True)
    grey, fringes = list(sequence)
    assert set(np.unique(grey)) == {128}
    assert abs(fringes.mean() - 127.5) < 1
    assert np.argmax(fringes[0]) % 12 in (6, 5), "phase - 2 pi has its maximum on the axis, at 29.5"
    assert set(np.unique(render_pattern(ProjectedPattern(PatternKind.GREY, shift=51, shifts=255), 4, 3))) == {51}


@pytest.mark.parametrize(
    ("pattern", "words"),
    [
        (ProjectedPattern(PatternKind.GREY, shift=3, shifts=2), "from 0 to 1"),
        (ProjectedPattern(PatternKind.GREY), "from 0 to 1"),
        (ProjectedPattern(PatternKind.GRAY_CODE, pitch=10.0, shift=9, shifts=8), "counted from 1"),
        (ProjectedPattern(PatternKind.GRAY_CODE, pitch=10.0, shift=1, shifts=3), "3 bits do not number"),
        (ProjectedPattern(PatternKind.GRAY_CODE, pitch=1.0, shift=1, shifts=8), "above 2"),
        (ProjectedPattern(PatternKind.FRINGES, pitch=10.0, shift=2, shifts=2), "1 of 1 for one image"),
    ],
)
def test_impossible_codes_and_greys_are_refused(pattern: ProjectedPattern, words: str) -> None:
    with pytest.raises(PatternError, match=words):
        render_pattern(pattern, 800, 10)
