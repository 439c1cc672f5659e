"""Exposures that begin before the projector has changed: every frame shows part of the pattern before."""

from __future__ import annotations

import numpy as np
import pytest

from fringedic.errors import StepError
from fringedic.patterns.sequences import PatternSequence, fringe_sequence
from fringedic.phase.checks.sample_noise import estimate_sample_noise
from fringedic.phase.checks.sampling import Sample
from fringedic.phase.checks.stack import check_stack
from fringedic.phase.layout import layout_of
from fringedic.virtual_rig import VirtualRig

SHIFTS = 4
RIG = VirtualRig.from_preset("plate", size="tiny")
ROWS, COLUMNS = RIG.projector_shape
SEQUENCE = fringe_sequence(COLUMNS, ROWS, (COLUMNS, COLUMNS / 3, COLUMNS / 10), SHIFTS)


def frames(shares: np.ndarray) -> np.ndarray:
    """Return one frame for each pattern, with this share of the pattern before."""
    images = list(SEQUENCE)
    return np.array(
        [
            RIG.expose_parts([(images[max(i - 1, 0)], share), (image, 1 - share)], 0.0, i)
            for i, (image, share) in enumerate(zip(images, shares, strict=True))
        ]
    )


@pytest.mark.parametrize("share", [0.03, 0.2, 0.5, 0.8])
def test_the_share_of_the_pattern_before_is_reported(share: float) -> None:
    with pytest.raises(StepError, match="fringedic timing") as error:
        check_stack(frames(np.full(len(SEQUENCE), share)), SEQUENCE.patterns)
    reported = int(str(error.value).split("%")[0].split()[-1])
    assert abs(reported - 100 * share) <= 2, f"{error.value}: it is {100 * share:g} %"
    assert error.value.index == SHIFTS


def test_a_share_that_varies_from_frame_to_frame() -> None:
    shares = np.random.default_rng(2).uniform(0.15, 0.35, len(SEQUENCE))
    with pytest.raises(StepError, match="of the pattern before"):
        check_stack(frames(shares), SEQUENCE.patterns)


@pytest.mark.parametrize("flicker", [0.0, 0.02])
def test_frames_without_lag_give_no_remark(flicker: float) -> None:
    factor = 1 + flicker * np.random.default_rng(1).normal(size=(len(SEQUENCE), 1, 1))
    seen = np.round(frames(np.zeros(len(SEQUENCE))) * factor).clip(0, 255).astype(np.uint8)
    assert check_stack(seen, SEQUENCE.patterns) == []


def frames_late_by(delay: float, sequence: PatternSequence) -> np.ndarray:
    """Return one frame for each pattern, taken so many frames before the projector shows it; at first it is dark."""
    whole, share = int(delay), delay % 1
    images = [np.zeros((ROWS, COLUMNS), np.uint8)] * (whole + 2) + list(sequence)
    return np.array(
        [RIG.expose_parts([(images[i + 1], share), (images[i + 2], 1 - share)], 0.0, i) for i in range(len(sequence))]
    )


@pytest.mark.parametrize("shifts", [3, 4])
@pytest.mark.parametrize("delay", [1.25, 1.5, 1.75, 2.25, 2.5, 2.75, 2.85, 3.0, 3.5, 4.5, 6.5, 7.5])
def test_a_projector_that_is_late_by_several_frames_is_named(delay: float, shifts: int) -> None:
    sequence = fringe_sequence(COLUMNS, ROWS, (COLUMNS, COLUMNS / 5), shifts)
    with pytest.raises(StepError, match="fringedic timing"):
        check_stack(frames_late_by(delay, sequence), sequence.patterns)


def test_fine_fringes_that_show_the_coarse_ones_are_named() -> None:
    """Irregular frames of a late projector, of which few pixels tell that the pitches do not belong together."""
    sequence = fringe_sequence(COLUMNS, ROWS, (COLUMNS, COLUMNS / 5), 4)
    dark, first, second, third, *_ = np.zeros((ROWS, COLUMNS), np.uint8), *sequence
    parts = [[(dark, 1.0)]] * 2 + [[(dark, 0.56), (first, 0.44)]] + [[(second, 1.0)]] * 3 + [[(third, 1.0)]] * 2
    seen = np.array([RIG.expose_parts(each, 0.0, number) for number, each in enumerate(parts)])
    with pytest.raises(StepError, match="of pitch 20 px do not continue those of pitch 100 px"):
        check_stack(seen, sequence.patterns)


def test_late_frames_of_a_textured_surface_are_no_noise() -> None:
    """With three shifts the noise is that between the means of the pitches, which the late frames change."""
    sequence = fringe_sequence(COLUMNS, ROWS, (COLUMNS, COLUMNS / 5), 3)
    good, late = (
        estimate_sample_noise(Sample.from_stack(frames_late_by(delay, sequence), layout_of(sequence.patterns)))
        for delay in (0.0, 1.5)
    )
    level = np.array([20.0, 60.0])
    assert np.sqrt(late.variance(level) / good.variance(level)) == pytest.approx(1.0, rel=0.25)
