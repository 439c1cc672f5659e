"""Frames whose light changes, written from their formula: the gains are fitted, and other causes are named as such."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic.phase.checks.stack import find_gains, inspect_stack
from fringedic.phase.demodulation import absolute_phase
from fringedic.phase.demodulation_kernel import add_gain_variance
from fringedic.phase.findings import FindingKind
from fringedic.phase.layout import shift_angles
from fringedic.phase.sentences import describe

ROWS, COLUMNS, PITCH, NOISE = 240, 320, 42.0, 1.5
MEAN, MODULATION = 110.0, 70.0
ROW, COLUMN = np.mgrid[:ROWS, :COLUMNS]
PLACE = 4.4 * COLUMN + 3 * np.sin(ROW / 40)  # projector px
TEXTURE = 1 + 0.1 * np.cos(COLUMN / 7) * np.cos(ROW / 9)


def patterns_of(shifts: int) -> list[ProjectedPattern]:
    return [ProjectedPattern(PatternKind.FRINGES, Orientation.VERTICAL, PITCH, k, shifts) for k in range(1, shifts + 1)]


def frames_of(shifts: int, seed: int, *, place: np.ndarray = PLACE, **changes: Any) -> np.ndarray:
    """Return ``T (g_k (A + B cos(phi - 2 pi k/q + e_k)) + r_k A)`` with noise, rounded to 8 bits.

    ``gain`` g, ``room`` r and ``displaced`` e [rad] have a value for each frame, ``gain`` one for each row too.
    """
    random = np.random.default_rng(seed)
    gain = changes.get("gain", np.ones(shifts))
    room, displaced = (changes.get(name, np.zeros(shifts)) for name in ("room", "displaced"))
    frames = []
    for k in range(shifts):
        angle = 2 * np.pi * (place / PITCH - (k + 1) / shifts) + displaced[k]
        level = TEXTURE * (gain[k] * (MEAN + MODULATION * np.cos(angle)) + room[k] * MEAN)
        frames.append(np.clip(np.round(level + random.normal(0, NOISE, PLACE.shape)), 0, 255))
    return np.array(frames, np.uint8)


def flicker(shifts: int, strength: float, seed: int) -> np.ndarray:
    gains = 1 + strength * np.random.default_rng((seed, 1)).uniform(-1, 1, shifts)
    return np.asarray(gains / gains.mean())


def one(shifts: int, value: float) -> np.ndarray:
    """Return a value for the second frame and 0 for the others."""
    return np.asarray(value * (np.arange(shifts) == 1))


def fault_of(frames: np.ndarray) -> FindingKind | None:
    """Return the fault that the fitted gains leave."""
    patterns = patterns_of(len(frames))
    gains = find_gains(frames, patterns)
    found = inspect_stack(frames, patterns, gains=gains.values)
    found += [] if gains.finding is None else [gains.finding]
    return next((each.kind for each in found if each.fault), None)


@pytest.mark.parametrize("strength", [0.02, 0.05])
@pytest.mark.parametrize("shifts", [4, 5, 8, 12])
def test_gains_are_fitted_and_the_phase_errs_by_its_sigma(shifts: int, strength: float) -> None:
    gain = flicker(shifts, strength, shifts)
    frames, patterns = frames_of(shifts, shifts, gain=gain), patterns_of(shifts)
    gains = find_gains(frames, patterns)
    (covariance,) = gains.covariance
    assert gains.finding is not None
    assert not gains.finding.fault
    assert gains.finding.value < 0.0015
    away = gains.values - gain
    assert np.abs(away).max() < 0.002
    square = away @ np.linalg.pinv(covariance, rcond=1e-8, hermitian=True) @ away
    assert square < 4 * (shifts - 1)
    assert not [each for each in inspect_stack(frames, patterns, gains=gains.values) if each.fault]

    def score(values: np.ndarray | None) -> tuple[float, float]:
        """Return error over sigma, RMS, and the error that all pixels of a phase share [fringe RMS]."""
        measured = absolute_phase(frames, patterns, noise=NOISE, gains=values)
        sigma = measured.sigma.values
        if values is not None:
            phase, modulation, texture = (measured[name].values for name in ("phase", "modulation", "texture"))
            add_gain_variance(phase, modulation, texture, shift_angles(patterns), covariance, sigma)
        error = np.angle(np.exp(1j * (measured.phase.values - 2 * np.pi * PLACE / PITCH)))
        turns = np.floor(16 * (PLACE / PITCH % 1)).astype(int).ravel()
        shared = np.bincount(turns, error.ravel()) / np.bincount(turns)
        return float(np.sqrt(np.mean((error / sigma) ** 2))), float(np.std(shared)) / (2 * np.pi)

    before, after = score(None), score(gains.values)
    assert 0.9 < after[0] < 1.06
    assert after[1] < 0.0004
    if strength > 0.04:
        assert before[1] > 4 * after[1]


def test_the_covariance_of_the_gains_is_that_of_their_errors() -> None:
    """Squared errors over the covariance are 1 per parameter, 1.2 with the covariance estimated from 64 tiles."""
    squares = []
    for seed in range(16):
        gain = flicker(8, 0.05, seed)
        gains = find_gains(frames_of(8, seed, gain=gain), patterns_of(8))
        away = gains.values - gain
        squares.append(away @ np.linalg.pinv(gains.covariance[0], rcond=1e-8, hermitian=True) @ away / 7)
    assert 0.7 < np.mean(squares) < 1.6


@pytest.mark.parametrize("shifts", [4, 5, 8, 12])
def test_steady_light_is_left_alone(shifts: int) -> None:
    for seed in range(5):
        frames = frames_of(shifts, 100 + seed)
        gains = find_gains(frames, patterns_of(shifts))
        assert gains.finding is None
        assert not gains.covers_flicker
        assert inspect_stack(frames, patterns_of(shifts)) == []


@pytest.mark.parametrize("degrees", [8.0, 20.0])
@pytest.mark.parametrize("shifts", [5, 8, 12])
def test_a_frame_with_another_shift_is_named(shifts: int, degrees: float) -> None:
    """From half a shift on the frame shows another pattern."""
    frames = frames_of(shifts, 1, displaced=one(shifts, np.radians(degrees)))
    assert find_gains(frames, patterns_of(shifts)).finding is None
    (fault,) = [each for each in inspect_stack(frames, patterns_of(shifts)) if each.fault]
    assert fault.kind in (FindingKind.DISPLACED_FRAME, FindingKind.OTHER_PATTERN)
    assert fault.frames == (1,)
    assert "frame 1" in describe(fault)


def test_of_four_shifts_another_shift_is_not_taken_for_flicker() -> None:
    """Two opposite frames leave the same residual: the frame is not known."""
    frames = frames_of(4, 1, displaced=one(4, np.radians(8.0)))
    assert find_gains(frames, patterns_of(4)).finding is None
    assert fault_of(frames) is FindingKind.MOTION_ALONG


@pytest.mark.parametrize("shifts", [5, 8, 12])
def test_light_of_the_room_is_named(shifts: int) -> None:
    room = 0.2 * np.sin(2 * np.pi * np.arange(shifts) / shifts + 0.4) + 0.05 * (np.arange(shifts) % 3)
    frames = frames_of(shifts, 2, room=0.3 * room)
    assert find_gains(frames, patterns_of(shifts)).finding is None
    assert fault_of(frames) is FindingKind.ROOM_LIGHT


@pytest.mark.parametrize("shifts", [5, 8, 12])
def test_light_that_changes_from_row_to_row_is_named(shifts: int) -> None:
    start = np.random.default_rng(1).uniform(0, 2 * np.pi, shifts)
    gain = 1 + 0.06 * np.sin(2 * np.pi * ROW / 200 + start[:, None, None])
    assert fault_of(frames_of(shifts, 3, gain=gain)) is FindingKind.UNEVEN_LIGHT


@pytest.mark.parametrize("shifts", [4, 5, 8, 12])
def test_a_motion_along_the_light_is_named_with_and_without_flicker(shifts: int) -> None:
    travel = np.linspace(-0.5, 0.5, shifts) * 2 * np.pi * 0.015
    for gain in (np.ones(shifts), flicker(shifts, 0.03, 5)):
        assert fault_of(frames_of(shifts, 4, displaced=travel, gain=gain)) is FindingKind.MOTION_ALONG


@pytest.mark.parametrize("shifts", [4, 12])
def test_gains_of_pixels_with_one_phase_are_refused(shifts: int) -> None:
    frames = frames_of(shifts, 5, place=PLACE / 1000 + 8, gain=flicker(shifts, 0.05, 2))
    gains = find_gains(frames, patterns_of(shifts))
    assert not gains.covers_flicker
    assert gains.finding is not None
    assert gains.finding.fault
    assert "do not have all phases" in describe(gains.finding)


def test_three_shifts_leave_no_residual_for_gains() -> None:
    gains = find_gains(frames_of(3, 6, gain=flicker(3, 0.05, 2)), patterns_of(3))
    assert gains.finding is None
    assert not gains.covers_flicker
