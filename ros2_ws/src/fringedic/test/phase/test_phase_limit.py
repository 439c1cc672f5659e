"""The Cramer-Rao bound of the phase against the scatter of measured phases."""

from __future__ import annotations

import numpy as np
import pytest

from fringedic.errors import PhaseError
from fringedic.frames.noise import CameraNoise
from fringedic.patterns.sequences import fringe_sequence
from fringedic.phase import absolute_phase
from fringedic.phase.limit import phase_limit
from fringedic.virtual_rig import FringeScene, VirtualRig


@pytest.mark.parametrize(("shifts", "shot", "largest"), [(4, 0.0, 1.03), (8, 0.0, 1.03), (8, 0.2, 1.13)])
def test_phase_stepping_reaches_the_limit_without_shot_noise(shifts: int, shot: float, largest: float) -> None:
    """Equal weights cost 10 % where the brightest frames have ten times the variance of the darkest ones."""
    scene = FringeScene(
        rows=100, columns=200, seed=5, grey=70.0, texture=0.15, bits=0, read_noise=1.0, shot_noise=shot,
        first_column=20.0, last_column=120.0,
    )  # fmt: skip
    shown = fringe_sequence(140, 4, [140, 48, 12], [4, 4, shifts])
    frames, exact = (
        np.array([each.expose(image, k) for k, image in enumerate(shown)]) for each in (scene, scene.without_noise())
    )
    noise = CameraNoise(1.0, shot)
    measured, true = (absolute_phase(each, shown.patterns, noise=noise) for each in (frames, exact))
    maps = (true[name].values.astype(float) for name in ("texture", "modulation", "phase"))
    error = (measured.phase.values - true.phase.values) / phase_limit(*maps, shifts, noise)
    assert 0.97 < np.sqrt(np.nanmean(error**2)) < largest


def test_what_is_not_measured_has_no_limit() -> None:
    level = np.array([[100.0, np.nan, 100.0]])
    modulation = np.array([[40.0, 40.0, 0.0]])
    limit = phase_limit(level, modulation, np.zeros((1, 3)), 4, CameraNoise(1.0))
    assert np.isfinite(limit).tolist() == [[True, False, False]]
    with pytest.raises(PhaseError, match="at least 3 shifts"):
        phase_limit(level, modulation, np.zeros((1, 3)), 2, CameraNoise(1.0))


def test_dark_and_light_speckles_reach_the_bound() -> None:
    """Two stacks of the speckled plate at rest: nothing but other frames can lower the noise of dark speckles."""
    twin = VirtualRig.from_preset("plate", size="small", seed=138)
    rows, columns = twin.projector_shape
    shown = fringe_sequence(columns, rows, [columns, 40, 10], [4, 4, 8])
    stacks = [np.array([twin.expose(image, 0.0, 100 * each + k) for k, image in enumerate(shown)]) for each in (0, 1)]
    found = [absolute_phase(stack, shown.patterns) for stack in stacks]
    maps = (found[0][name].values.astype(float) for name in ("texture", "modulation", "phase"))
    limit = phase_limit(*maps, 8, CameraNoise(np.sqrt(1 + 1 / 12), 0.02))  # read noise and rounding
    score = (found[1].phase.values - found[0].phase.values) / np.sqrt(2) / limit
    light = found[0].modulation.values > np.nanmedian(found[0].modulation.values)
    for part in (light, ~light):
        assert 0.95 < np.sqrt(np.nanmean(score[part] ** 2)) < 1.1
