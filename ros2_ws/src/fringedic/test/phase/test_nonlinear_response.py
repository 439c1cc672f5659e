"""Noise, sigma and error of the phase with a projector whose light is not proportional to its grey level."""

from dataclasses import replace

import numpy as np
import pytest

from fringedic.patterns.pattern import Orientation
from fringedic.patterns.sequences import PatternSequence, fringe_sequence
from fringedic.phase import PhaseSettings, absolute_phase, measure_phase
from fringedic.phase.findings import FindingKind
from fringedic.phase.harmonic_correction import fit_harmonic_error
from fringedic.virtual_rig import FringeScene

TURN = 2 * np.pi
PITCH = 32.0
SCENE = FringeScene(rows=160, columns=300, seed=3, grey=70.0, texture=0.1, first_column=20.0, last_column=620.0)


def sequence(shifts: int) -> PatternSequence:
    return fringe_sequence(640, 4, [640, 128, PITCH], [4, 4, shifts])


def frames_of(scene: FringeScene, shown: PatternSequence) -> np.ndarray:
    return np.array([scene.expose(image, index) for index, image in enumerate(shown)])


def exact(scene: FringeScene) -> np.ndarray:
    return (scene.projector_column - 319.5) / PITCH * TURN


@pytest.mark.parametrize("shifts", [4, 5, 16])
@pytest.mark.parametrize("gamma", [1.0, 1.6, 2.4])
def test_sigma_is_the_noise_at_any_gamma(gamma: float, shifts: int) -> None:
    scene, shown = replace(SCENE, gamma=gamma), sequence(shifts)
    silent = absolute_phase(frames_of(scene.without_noise(), shown), shown.patterns, noise=0.1)
    measured = absolute_phase(frames_of(scene, shown), shown.patterns)
    score = float(((measured.phase - silent.phase) / measured.sigma).std())
    assert measured.valid.values.all()
    assert 0.9 < score < 1.1


@pytest.mark.parametrize(("gamma", "shifts"), [(2.2, 3), (1.4, 3), (1.4, 4), (2.4, 4)])
def test_the_error_by_harmonics_is_measured_and_corrected(gamma: float, shifts: int) -> None:
    scene, shown = replace(SCENE, gamma=gamma), sequence(shifts)
    silent = absolute_phase(frames_of(scene.without_noise(), shown), shown.patterns, noise=1.0)
    error = float(np.std(silent.phase.values - exact(scene))) / TURN
    measured = absolute_phase(frames_of(scene, shown), shown.patterns, noise=1.5)
    fitted = fit_harmonic_error(measured.phase, shifts, Orientation.VERTICAL)
    assert fitted.rms == pytest.approx(error, rel=0.1)
    left = float(np.std(fitted.correct(silent.phase.values) - exact(scene))) / TURN
    assert left < max(0.15 * error, 0.0005)


def test_a_large_error_is_a_remark_until_it_is_corrected() -> None:
    scene, shown = replace(SCENE, gamma=2.2), sequence(4)
    settings = PhaseSettings(largest_error=0.001)
    frames = frames_of(scene, shown)
    result, (remark,) = measure_phase(frames, shown.patterns, settings)
    assert (remark.kind, remark.fault) == (FindingKind.HARMONICS, False)
    assert result.phase.attrs["harmonic_error"] == remark.value > 0.001
    result, remarks = measure_phase(frames, shown.patterns, replace(settings, correct_harmonics=True))
    assert remarks == []
    assert result.phase.attrs["harmonic_error"] < 0.0002


def test_an_error_in_step_with_the_pixels_is_not_stated() -> None:
    """8 shifts of fringes of 8 px: the error has the period of a pixel, as the surface's height may have."""
    column = np.tile(np.arange(600.0), (40, 1))
    phase = absolute_phase(
        np.array([120 + 60 * np.cos(TURN * (column / 8 - k / 8)) for k in range(1, 9)], np.float32),
        fringe_sequence(600, 4, [8], 8).patterns,
        noise=1.0,
    ).phase
    assert np.isnan(fit_harmonic_error(phase, 8, Orientation.VERTICAL).rms)
    assert np.isnan(fit_harmonic_error(phase[:, :9], 4, Orientation.VERTICAL).rms)
