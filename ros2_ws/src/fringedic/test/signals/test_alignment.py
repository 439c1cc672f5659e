"""Offset and drift of two clocks from a signal that both recorded, against the truth."""

from __future__ import annotations

import re

import numpy as np
import pytest

from fringedic.errors import RecordingError
from fringedic.signals import FORCE, Alignment, Channel, ClockFit, Signal, align_clocks


def staircase(steps: int = 10, ramp: float = 2.0, hold: float = 8.0, force: float = 200.0) -> np.ndarray:
    """Return times [s] and forces [N] of the corners of ramps with holds."""
    times, forces = [0.0, 5.0], [0.0, 0.0]
    for _ in range(steps):
        times += [times[-1] + ramp, times[-1] + ramp + hold]
        forces += [forces[-1] + force] * 2
    return np.array([times, forces])


def signal(time: np.ndarray, values: np.ndarray, channel: Channel = FORCE) -> Signal:
    return Signal(channel, np.rint(1e9 * time).astype(np.int64), values, np.full(time.size, np.nan))


def recorded(
    rng: np.random.Generator,
    corners: np.ndarray,
    *,
    offset: float = 0.0,
    drift: float = 0.0,
    noise: float = 0.01,
    gain: float = 1.0,
    level: float = 0.0,
) -> tuple[Signal, Signal]:
    """Return a force as the rig records it at 20 Hz, and as a file has it at 10 Hz; noise relative to the force."""
    end = corners[0, -1]
    of_rig = np.arange(rng.uniform(0, 0.05), end, 0.05)
    of_rig += 0.0005 * rng.standard_normal(of_rig.size)
    of_file = np.arange(rng.uniform(1.0, 1.1), end - 1, 0.1)
    values = [np.interp(time, *corners) for time in (of_rig, of_file)]
    values = [each * (1 + noise * rng.standard_normal(each.size)) for each in values]
    return signal(of_rig, values[0]), signal(of_file + offset + drift * (of_file - end / 2), gain * values[1] + level)


def error_of(alignment: Alignment, offset: float, end: float) -> tuple[float, float]:
    """Return error and stated uncertainty of the offset in the middle [s]."""
    clock, middle = alignment.clock, round(1e9 * (end / 2 + offset))
    found = clock.offset + clock.drift * 1e-9 * (middle - clock.since)
    return found - offset, float(clock.sigma_at(np.array([middle]))[0])


def test_offset_of_a_noisy_ramp_with_holds_is_within_its_uncertainty() -> None:
    """Of 200 trials 95 % are within 1.96 standard uncertainties (benchmarks/clocks.py); 24 of them here."""
    rng, corners, errors, sigmas = np.random.default_rng(11), staircase(), [], []
    for _ in range(24):
        offset, drift = rng.uniform(-900, 900), rng.normal(0, 5e-5)
        found = align_clocks(*recorded(rng, corners, offset=offset, drift=drift))
        error, sigma = error_of(found, offset, corners[0, -1])
        errors.append(error)
        sigmas.append(sigma)
    z_scores = np.array(errors) / np.array(sigmas)
    assert 0.65 < np.sqrt(np.mean(z_scores**2)) < 1.35
    assert np.sum(np.abs(z_scores) > 1.96) <= 4  # 24 trials: more happen in 1 of 150
    assert np.mean(sigmas) < 10e-3
    assert np.sqrt(np.mean(np.square(errors))) < 12e-3


def test_a_drift_that_crystal_clocks_have_not_is_found_and_told() -> None:
    rng, corners = np.random.default_rng(3), staircase(steps=16, hold=20)
    found = align_clocks(*recorded(rng, corners, offset=40.0, drift=4e-3))
    assert found.unusual_drift
    assert found.clock.drift == pytest.approx(4e-3, abs=4 * found.clock.sigma_drift)
    assert found.clock.sigma_drift < 3e-4


def test_gain_sign_and_level_may_differ() -> None:
    rng, corners = np.random.default_rng(3), staircase(steps=3, hold=11)
    found = align_clocks(*recorded(rng, corners, offset=-7.25, gain=-1.02, level=35.0))
    error, sigma = error_of(found, -7.25, corners[0, -1])
    assert abs(error) < 4 * sigma
    assert found.gain == pytest.approx(-1 / 1.02, rel=5e-3)


def test_applied_to_the_file_it_has_the_times_of_the_rig() -> None:
    rng, corners = np.random.default_rng(5), staircase()
    rig, file = recorded(rng, corners, offset=100.0, noise=0.0)
    clock = align_clocks(rig, file).clock
    moved = clock.applied_to(file)
    np.testing.assert_allclose(moved.values, np.interp(1e-9 * moved.stamps, *corners), atol=1.0)
    assert clock.applied_to(file).stamps[0] == pytest.approx(file.stamps[0] - 100 * 10**9, abs=10**7)


@pytest.mark.parametrize(
    ("corners", "reason"),
    [
        (np.array([[0.0, 100.0], [0.0, 2000.0]]), "too little structure to fix the offset of the clocks"),
        (np.array([[0.0, 100.0], [500.0, 500.0]]), "too little structure to fix the offset of the clocks"),
        (
            np.array([np.arange(0, 200, 2.5), 500.0 * (np.arange(80) % 2)]),
            "the signal repeats itself: the file fits as well 5 s",
        ),
    ],
    ids=["straight ramp", "constant", "cycles"],
)
def test_too_little_structure_is_told(corners: np.ndarray, reason: str) -> None:
    rng = np.random.default_rng(2)
    rig, file = recorded(rng, corners)
    noisy = (
        Signal(each.channel, each.stamps, each.values + rng.normal(0, 5, each.values.size), each.sigmas)
        for each in (rig, file)
    )
    with pytest.raises(RecordingError, match=re.escape(reason)):
        align_clocks(*noisy)


def test_few_samples_are_told() -> None:
    rig, file = recorded(np.random.default_rng(2), staircase())
    short = Signal(file.channel._replace(source="machine.csv"), file.stamps[:5], file.values[:5], file.sigmas[:5])
    with pytest.raises(RecordingError, match=r"the force of machine\.csv has 5 samples: the clocks need 12 or more"):
        align_clocks(rig, short)
    dense = Signal(short.channel, file.stamps[0] + np.arange(40), file.values[:40], file.sigmas[:40])
    with pytest.raises(RecordingError, match=r"has 1 sample: the clocks need 12 or more"):
        align_clocks(rig, dense)


def test_a_clock_that_jumps_in_a_pause_of_the_file_is_told() -> None:
    rng, corners = np.random.default_rng(4), staircase(steps=16)
    rig, file = recorded(rng, corners)
    kept = (file.stamps < 70e9) | (file.stamps > 76e9)
    late = file.stamps + np.where(file.stamps > 73e9, int(2.5e9), 0)
    paused = Signal(file.channel, file.stamps[kept], file.values[kept], file.sigmas[kept])
    jumped = Signal(file.channel, late[kept], file.values[kept], file.sigmas[kept])
    assert align_clocks(rig, paused).clock.offset == pytest.approx(0, abs=0.05)
    with pytest.raises(
        RecordingError, match=r"jumps by 2\.\d+ s while it has no samples, 68\.\d+ s after its first one"
    ):
        align_clocks(rig, jumped)


def test_uncertainty_grows_with_the_drift_that_is_not_known() -> None:
    clock = ClockFit(0.0, 0.0, 0, 3e-3, 4e-5)
    assert clock.sigma_at(np.array([-100 * 10**9, 0])) == pytest.approx([5e-3, 3e-3])
