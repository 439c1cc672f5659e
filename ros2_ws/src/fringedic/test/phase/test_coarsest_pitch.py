"""A coarsest pitch that repeats in the view is refused, because its fringe orders would be wrong without notice."""

import numpy as np
import pytest

from fringedic.errors import ErrorCode, PhaseError
from fringedic.patterns.sequences import fringe_sequence, gray_code_sequence
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
