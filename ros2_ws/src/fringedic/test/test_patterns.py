"""Patterns: zero of phase, direction of growth, brightness and refusals."""

import numpy as np
import pytest

from fringedic.errors import FringedicError, InvalidPatternError
from fringedic.patterns import fringe_sequence, render_pattern
from fringedic.sequence import Orientation, PatternKind, Projection


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
    assert [(each.pitch, each.shift, each.shifts) for each in sequence.projections] == [
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
    white = render_pattern(Projection(PatternKind.WHITE), 30, 20)
    fringes = fringe_sequence(1001, 20, [100], 4).frame(3)
    assert white.shape == (20, 30)
    assert np.all(white == fringes.max())


def test_setup_patterns() -> None:
    other = Projection(PatternKind.OTHER)
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
        ([float("nan")], 4, "vertical", "above 2"),
        ([40, 10], [4], "vertical", "one for each"),
        ([10], 4, "diagonal", "diagonal"),
    ],
)
def test_bad_sequences_are_refused(pitches: list[float], shifts: int, orientation: str, says: str) -> None:
    with pytest.raises(InvalidPatternError, match=says) as caught:
        fringe_sequence(64, 48, pitches, shifts, orientation)
    assert isinstance(caught.value, FringedicError)
    assert isinstance(caught.value, ValueError)


def test_bad_projections_are_refused() -> None:
    with pytest.raises(InvalidPatternError, match="nonsense"):
        render_pattern(Projection(PatternKind.OTHER), 64, 48, "nonsense")
    with pytest.raises(InvalidPatternError, match="0x48"):
        render_pattern(Projection(PatternKind.WHITE), 0, 48)
    with pytest.raises(InvalidPatternError, match="from 1"):
        render_pattern(Projection(PatternKind.FRINGES, Orientation.VERTICAL, 10.0, 0, 4), 64, 48)
    with pytest.raises(InvalidPatternError, match="one"):
        fringe_sequence(64, 48, [10], 4, periods=0)
