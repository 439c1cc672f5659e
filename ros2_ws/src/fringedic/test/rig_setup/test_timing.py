"""Delay, jitter, rise and refresh of a projector from frames whose light is known exactly."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import yaml

from fringedic.errors import RigSetupError
from fringedic.figures.timing import timing_figure
from fringedic.rig_setup.refresh import Refresh
from fringedic.rig_setup.timing import ProjectorTiming, measure_timing, rough_delay
from fringedic.rig_setup.timing_samples import TimingSamples
from fringedic.virtual_rig import pattern_weights
from fringedic.virtual_rig.configuration import ProjectorConfiguration

EXPOSURE = 3e-3
START = 1_700_000_000_000_000_000


def frames(
    projector: ProjectorConfiguration,
    *,
    changes: int = 80,
    reach: float = 9e-3,
    seed: int = 1,
    noise: float = 0.1,
    exposure: float = EXPOSURE,
) -> TimingSamples:
    """Mean brightness of 4 dark and 110 bright grey levels, with noise, around each change and at rest."""
    random = np.random.default_rng(seed)
    shown = [START - 10**9, START]
    rows = []
    for number in range(changes):
        bright = number % 2 == 0
        shown = [*shown[-8:], shown[-1] + round(1e9 * random.uniform(0.15, 0.19))]
        near = 1e-3 * projector.delay_ms + random.uniform(-reach, reach + 4e-3 * projector.rise_ms)
        for since in (near, *random.uniform(0.1, 0.14, 3 if bright else 1)):
            since = max(since, 0.002)
            middle = shown[-1] + round(1e9 * since)
            weights = pattern_weights(projector, seed, shown, middle - round(0.5e9 * exposure), exposure)
            # the latest pattern is bright or not, and those before it in turn
            lit = weights[::-1][0 if bright else 1 :: 2].sum()
            rows.append((since, 1e-9 * (middle - START), bright, 4.0 + 106.0 * lit + random.normal(0.0, noise)))
    since, stamp, lit, level = np.array(rows).T
    return TimingSamples(since, stamp, lit > 0, level, exposure)


def assert_delay(timing: ProjectorTiming, delay_ms: float, largest_sigma_ms: float) -> None:
    error, sigma = 1e3 * timing.delay - delay_ms, 1e3 * timing.delay_sigma
    assert abs(error) < 3 * sigma, f"delay is off by {error:.3f} ms at a standard uncertainty of {sigma:.3f} ms"
    assert sigma < largest_sigma_ms


def test_delay_of_steady_light() -> None:
    samples = frames(ProjectorConfiguration(delay_ms=37.0))
    timing = measure_timing(samples)
    assert_delay(timing, 37.0, 0.05)
    assert (timing.jitter, timing.rise, timing.fall, timing.refresh) == (0.0, 0.0, 0.0, None)
    assert timing.dark == pytest.approx(4.0, abs=0.1)
    assert timing.bright == pytest.approx(110.0, abs=0.1)
    assert timing.settle_time() == pytest.approx(0.038)
    assert timing.whole_exposure(0.010) == 0.010
    rough, decay = rough_delay(samples)
    assert abs(rough - 0.037) <= EXPOSURE
    assert decay == 0.0


@pytest.fixture(scope="module")
def pulsing_samples() -> TimingSamples:
    return frames(ProjectorConfiguration(delay_ms=37.0, refresh_hz=60.0, refresh_duty=0.4))


@pytest.fixture(scope="module")
def pulsing(pulsing_samples: TimingSamples) -> ProjectorTiming:
    return measure_timing(pulsing_samples)


def test_pulses_do_not_bias_the_delay(pulsing: ProjectorTiming) -> None:
    """At 60 Hz and a duty of 0.4 an exposure of 10 ms sees 6.67 / 10 of 2.5: it is up to 67 % too bright, or dark."""
    timing = pulsing
    assert_delay(timing, 37.0, 0.1)
    assert timing.refresh is not None
    error = abs(timing.refresh.frequency - 60.0)
    assert error < 4 * timing.refresh.frequency_sigma, f"refresh is off by {1e3 * error:.3f} mHz"
    assert timing.beat(0.010) == pytest.approx(1.0, abs=0.05)
    assert timing.beat(2 / 60) < 1e-3
    assert timing.whole_exposure(0.010) == pytest.approx(1 / 60, rel=1e-4)
    assert timing.whole_exposure(0.030) == pytest.approx(2 / 60, rel=1e-4)
    assert timing.settle_time() == pytest.approx(3 / 60, rel=1e-4)


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_errors_of_the_waveform_are_not_taken_for_a_slow_rise(seed: int) -> None:
    timing = measure_timing(
        frames(
            ProjectorConfiguration(delay_ms=37.0, refresh_hz=60.0, refresh_duty=0.5), changes=60, seed=seed, noise=1.0
        )
    )
    assert abs(1e3 * timing.delay - 37.0) < 4e3 * timing.delay_sigma, timing
    assert (timing.rise, timing.fall) == (0.0, 0.0)


def test_the_uncertainty_of_the_delay_covers_the_dark_between_pulses() -> None:
    """Few exposures of 1 ms contain the change and a pulse; without one, a delay is as likely as its neighbours."""
    projector = ProjectorConfiguration(delay_ms=37.0, refresh_hz=60.0, refresh_duty=0.5)
    found = [
        measure_timing(frames(projector, changes=60, seed=seed, noise=1.0, exposure=1e-3)) for seed in range(100, 116)
    ]
    scores = np.array([(timing.delay - 0.037) / timing.delay_sigma for timing in found])
    assert 0.6 < np.sqrt(np.mean(scores**2)) < 1.5, scores.round(1)
    assert np.median([timing.delay_sigma for timing in found]) < 0.4e-3


def test_jitter_is_not_taken_for_a_slow_rise() -> None:
    """Delays spread evenly by up to 4 ms to either side have the standard deviation 4 / sqrt(3) ms."""
    timing = measure_timing(frames(ProjectorConfiguration(delay_ms=45.0, jitter_ms=4.0), changes=120))
    assert_delay(timing, 45.0, 0.6)
    assert timing.jitter == pytest.approx(4e-3 / np.sqrt(3), rel=0.3), f"jitter {1e3 * timing.jitter:.2f} ms"
    assert max(timing.rise, timing.fall) == 0.0
    assert timing.settled() > 0.049


def test_slow_rise_is_waited_for() -> None:
    timing = measure_timing(frames(ProjectorConfiguration(delay_ms=25.0, rise_ms=5.0)))
    assert_delay(timing, 25.0, 0.2)
    for value in (timing.rise, timing.fall):
        assert value == pytest.approx(5e-3, rel=0.1), f"{1e3 * value:.2f} ms"
    left_over = np.exp(-(timing.settled() - 0.025) / 0.005)
    assert left_over < 0.0025


def test_a_delay_shorter_than_the_earliest_exposure_is_not_a_number() -> None:
    timing = measure_timing(frames(ProjectorConfiguration()))
    assert np.isnan(timing.delay)
    assert timing.settled() < 0.001


def test_the_file_contains_the_settings(pulsing: ProjectorTiming, tmp_path) -> None:
    pulsing.save(tmp_path / "timing.yaml", 0.010)
    entries = yaml.safe_load((tmp_path / "timing.yaml").read_text())
    assert entries["delay_ms"] == pytest.approx(1e3 * pulsing.delay, abs=0.01)
    assert entries["advised"]["exposure_ms"] == pytest.approx(16.6667, abs=1e-3)
    assert entries["advised"]["settle_ms"] == pytest.approx(50.0, abs=1e-2)


def test_the_figure_shows_the_change_and_the_pulses(pulsing_samples: TimingSamples, pulsing: ProjectorTiming) -> None:
    assert len(timing_figure(pulsing_samples, pulsing, 0.010).axes) == 2


def test_a_camera_that_sees_no_projector_is_refused() -> None:
    samples = frames(ProjectorConfiguration(delay_ms=37.0))
    with pytest.raises(RigSetupError, match="does not see the projector"):
        measure_timing(dataclasses.replace(samples, brightness=np.full(len(samples.since), 40.0)))
    few = {name: getattr(samples, name)[:20] for name in ("since", "stamp", "bright", "brightness")}
    with pytest.raises(RigSetupError, match="too few"):
        measure_timing(TimingSamples(**few, exposure_time=EXPOSURE))


def test_means_of_pulses_are_integrals() -> None:
    refresh = Refresh(100.0, 0.0, np.repeat([2.0, 0.0], 30))
    assert refresh.mean(np.array([0.0]), 0.005)[0] == pytest.approx(2.0)
    assert refresh.mean(np.array([0.0025]), 0.005)[0] == pytest.approx(1.0)
    assert refresh.mean(np.array([-0.0975]), 0.030)[0] == pytest.approx(1.0)
