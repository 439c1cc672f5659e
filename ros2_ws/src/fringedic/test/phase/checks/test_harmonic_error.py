"""Harmonic error of a non-linear response, measured without knowledge of the surface, against the exact phase."""

import numpy as np
import pytest

from fringedic.errors import PhaseError
from fringedic.patterns.sequences import fringe_sequence
from fringedic.phase import demodulate
from fringedic.phase.checks.harmonic_error import SERIES_SHIFTS, measure_harmonic_error
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
def test_harmonic_error_is_that_of_the_exact_phase(gamma: float) -> None:
    noisy = measure_harmonic_error(frames_of(rig_of(gamma), SERIES_SHIFTS))
    silent = rig_of(gamma, read_noise_grey_level=0.0, shot_noise_grey_level=0.0, bits=16)
    middle = (silent.projector_shape[1] - 1) / 2
    truth = (silent.view(0.0).projector_column - middle) / PITCH
    for shifts in (3, 4):
        turns = demodulate(frames_of(silent, shifts), shifts, noise=20.0).phase.values / (2 * np.pi) - truth
        turns -= np.round(turns)
        exact = float(np.nanstd(turns))
        assert noisy.rms(shifts) == pytest.approx(exact, rel=0.05, abs=3e-4), f"{shifts} shifts: {exact:.5f} fringe"


def test_series_without_a_result_are_refused() -> None:
    frames = frames_of(rig_of(1.0), 8)
    with pytest.raises(PhaseError, match="not whole multiples"):
        measure_harmonic_error(frames)
    with pytest.raises(PhaseError, match="show fringes"):
        measure_harmonic_error(np.full((24, 50, 50), 60, np.uint8))
