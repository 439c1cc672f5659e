"""Fringe orders without a pitch that covers the view: refused, or from the beats of pitches that are nearly alike."""

import numpy as np
import pytest

from fringedic.errors import ErrorCode, FringedicError, PhaseError, StepError
from fringedic.frames.noise import ROUNDING_NOISE, CameraNoise
from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic.patterns.sequences import fringe_sequence, gray_code_sequence
from fringedic.phase.demodulation import absolute_phase
from fringedic.phase.measure import measure_phase
from fringedic.phase.settings import PhaseSettings


def view(sequence, columns, *, step=0.0):
    """Frames of a camera with these projector columns side by side, with noise, and a step in the lower half."""
    images = np.array(list(sequence), np.float32)
    if sequence.patterns[0].orientation:
        images = images.transpose(0, 2, 1)
    seen = np.tile(np.asarray(columns, float), (12, 1))
    seen[6:, len(columns) // 2 :] += step
    grey = np.array([np.interp(seen, np.arange(image.shape[1]), image[0]) for image in images])
    noisy = grey + np.random.default_rng(1).normal(0, 1, grey.shape)
    frames = np.clip(np.rint(noisy), 0, 254).astype(np.uint8)
    return frames.transpose(0, 2, 1) if sequence.patterns[0].orientation else frames


@pytest.mark.parametrize("orientation", ["vertical", "horizontal"])
def test_fringes_that_repeat_in_view_are_refused_with_the_visible_width(orientation):
    sequence = fringe_sequence(200, 200, [100, 20, 5], 4, orientation)
    with pytest.raises(PhaseError, match=r"100 px repeat in the view.*at least 1[34]\d px") as refused:
        measure_phase(view(sequence, np.linspace(30, 170, 160)), sequence.patterns)
    assert refused.value.code is ErrorCode.INVALID_SEQUENCE
    with pytest.raises(PhaseError, match="100 px"):  # a relative phase would be wrong, too
        measure_phase(view(sequence, np.linspace(30, 170, 160)), sequence.patterns, PhaseSettings(accept_relative=True))


@pytest.mark.parametrize("step", [0.0, 12.0])
def test_fringes_that_cover_the_view_are_measured(step):
    columns = np.linspace(52, 136, 160)
    for sequence in (fringe_sequence(200, 4, [100, 20, 5], 4), gray_code_sequence(200, 4, 5, 4)):
        result, _ = measure_phase(view(sequence, columns, step=step), sequence.patterns)
        upper = result.phase.values[:6] * 5 / (2 * np.pi) + 99.5
        assert np.nanmax(np.abs(upper - columns)) < 0.5
        assert np.isfinite(upper).mean() > 0.95


def shown(pitches, shifts, columns, noise=1.5):
    """Frames of fringes of these pitches, written down from their formula, on projector columns (row, column)."""
    patterns = [
        ProjectedPattern(PatternKind.FRINGES, Orientation.VERTICAL, pitch, shift, shifts)
        for pitch in pitches
        for shift in range(1, shifts + 1)
    ]
    random = np.random.default_rng(2)
    grey = [
        120 + 80 * np.cos(2 * np.pi * (columns - 959.5) / each.pitch - 2 * np.pi * each.shift / each.shifts)
        for each in patterns
    ]
    noisy = np.array(grey) + random.normal(0, noise, (len(grey), *columns.shape))
    return np.clip(np.rint(noisy), 0, 254).astype(np.uint8), patterns


@pytest.mark.parametrize(
    ("pitches", "shifts"), [((48, 45, 42), 12), ((19.2, 18, 17), 4), ((36, 31, 25), 3), ((60, 49.5, 33), 4)]
)
def test_pitches_that_are_nearly_alike_are_measured_by_their_beats(pitches, shifts):
    """A step of 40 columns in the lower half changes no order; sigma is that of the weighted mean of all pitches."""
    columns = np.tile(80 + 2.2 * np.arange(640), (240, 1))
    columns[120:, 300:] += 40
    frames, patterns = shown(pitches, shifts, columns)
    result, remarks = measure_phase(frames, patterns, PhaseSettings(noise=CameraNoise(np.hypot(1.5, ROUNDING_NOISE))))
    assert remarks == []
    error = result.phase.values - 2 * np.pi * (columns - 959.5) / pitches[-1]
    assert np.isfinite(error).mean() > 0.9999
    assert np.nanmax(np.abs(error)) < np.pi, "no wrong order"
    assert np.nanstd(error / result.sigma.values) == pytest.approx(1, abs=0.02)
    alone = absolute_phase(frames[-shifts:], patterns[-shifts:], noise=1.5).sigma
    expected = sum((pitches[-1] / pitch) ** 2 for pitch in pitches) ** -0.5
    assert float(result.sigma.mean() / alone.mean()) == pytest.approx(expected, rel=0.05)


def test_beats_that_repeat_in_view_are_refused():
    frames, patterns = shown((21, 20), 4, np.tile(80 + 2.2 * np.arange(640), (60, 1)))
    with pytest.raises(PhaseError, match=r"the beats of 420 px repeat in the view.*at least 1[34]"):
        measure_phase(frames, patterns)


@pytest.mark.parametrize("pitches", [(300, 70, 17), (900, 400, 31)])
def test_a_sequence_without_a_pitch_that_covers_the_view_is_refused_for_that_reason(pitches):
    """The phases of its pitches contradict each other; no frame is wrong, and no delay explains it."""
    frames, patterns = shown(pitches, 8, np.tile(80 + 2.2 * np.arange(640), (60, 1)))
    with pytest.raises(StepError, match=r"^no pitch covers the view: .* of the coarsest fringes") as refused:
        measure_phase(frames, patterns)
    assert refused.value.code is ErrorCode.INVALID_SEQUENCE


def test_pitches_that_do_not_agree_are_refused():
    """The shifts of one pitch run backwards: each pitch fits alone, and no position explains all of them."""
    frames, patterns = shown((48, 45, 42), 12, np.tile(80 + 2.2 * np.arange(640), (60, 1)))
    frames[12:24] = frames[12:24][[*range(10, -1, -1), 11]]
    with pytest.raises(FringedicError, match=r"45|agree at \d+ % of what is lit only"):
        measure_phase(frames, patterns)


def test_beats_need_no_pitch_that_covers_the_view():
    """Three shifts that are late by one fit alone and grow as they should: the frames are wrong, not the sequence."""
    frames, patterns = shown((90, 60), 3, np.tile(80 + 2.2 * np.arange(640), (240, 1)))
    frames[3:] = frames[[5, 3, 4]]
    with pytest.raises(StepError) as refused:
        measure_phase(frames, patterns)
    assert refused.value.code in (ErrorCode.WRONG_PATTERN, ErrorCode.FRAMES_OUT_OF_ORDER)
