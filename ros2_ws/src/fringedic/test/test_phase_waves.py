"""Waves of a bent response, measured without knowing the surface, beside the twin's exact phase."""

import numpy as np
import pytest

from fringedic.errors import InvalidSequenceError
from fringedic.patterns import fringe_sequence
from fringedic.phase import demodulate
from fringedic.phase.waves import WAVE_SHIFTS, phase_waves
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

PITCH = 20.0


def rig_of(gamma: float, **sensor: float) -> VirtualRig:
    entries = {"preset": "leather", "size": "small", "projector": {"gamma": gamma}, "sensor": sensor}
    return VirtualRig(VirtualRigConfiguration.from_dict(entries))


def frames_of(twin: VirtualRig, shifts: int) -> np.ndarray:
    rows, columns = twin.projector_shape
    return np.array(
        [twin.expose(image, 0.0, k) for k, image in enumerate(fringe_sequence(columns, rows, [PITCH], shifts))]
    )


@pytest.mark.parametrize("gamma", [1.0, 1.6, 2.2])
def test_waves_are_those_of_the_exact_phase(gamma: float) -> None:
    noisy = phase_waves(frames_of(rig_of(gamma), WAVE_SHIFTS))
    silent = rig_of(gamma, read_noise_grey_level=0.0, shot_noise_grey_level=0.0, bits=16)
    middle = (silent.projector_shape[1] - 1) / 2
    truth = (silent.view(0.0).projector_column - middle) / PITCH
    for shifts in (3, 4):
        turns = demodulate(frames_of(silent, shifts), shifts, noise=20.0).phase.values / (2 * np.pi) - truth
        turns -= np.round(turns)
        exact = float(np.nanstd(turns))
        assert noisy.rms(shifts) == pytest.approx(exact, rel=0.05, abs=3e-4), f"{shifts} shifts: {exact:.5f} fringe"


def test_series_that_cannot_tell_are_refused() -> None:
    frames = frames_of(rig_of(1.0), 8)
    with pytest.raises(InvalidSequenceError, match="not whole multiples"):
        phase_waves(frames)
    with pytest.raises(InvalidSequenceError, match="show fringes"):
        phase_waves(np.full((24, 50, 50), 60, np.uint8))
