"""Exposures that begin before the projector has changed: every frame shows part of the pattern before."""

from __future__ import annotations

import numpy as np
import pytest

from fringedic.errors import StepError
from fringedic.patterns.sequences import fringe_sequence
from fringedic.phase.checks.stack import check_stack
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
