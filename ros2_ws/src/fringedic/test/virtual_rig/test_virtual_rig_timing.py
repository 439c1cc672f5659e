"""Delay, jitter and pulses of the virtual projector against sums over fine steps of time."""

from __future__ import annotations

import numpy as np
import pytest

from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration, pattern_weights
from fringedic.virtual_rig.configuration import ProjectorConfiguration

START = 1_700_000_000_123_456_789
MS = 1_000_000


def summed(projector: ProjectorConfiguration, shown: list[int], start: int, exposure_time: float) -> np.ndarray:
    """Return the same weights by integration over small steps of time."""
    steps = 20_000
    dt = exposure_time / steps
    delay, rise = 1e-3 * projector.delay_ms, 1e-3 * projector.rise_ms
    seen = [1e-9 * (each - start) + delay for each in shown]
    begin = min(0.0, seen[1])  # the first pattern was always there
    share = np.zeros(len(shown))
    share[0] = 1.0
    weights = np.zeros(len(shown))
    for time in np.arange(begin + dt / 2, exposure_time, dt):
        target = np.zeros(len(shown))
        target[max(0, np.searchsorted(seen, time, side="right") - 1)] = 1.0
        share = target + (share - target) * (np.exp(-dt / rise) if rise else 0.0)
        if time > 0.0:
            phase = (start * 1e-9 + time) * projector.refresh_hz % 1.0
            on = phase < projector.refresh_duty
            weights += share * on / projector.refresh_duty / steps
    return weights


@pytest.mark.parametrize("rise_ms", [0.0, 4.0])
def test_weights_are_the_integral_of_the_light(rise_ms: float) -> None:
    projector = ProjectorConfiguration(delay_ms=37.0, rise_ms=rise_ms, refresh_hz=60.0, refresh_duty=0.7)
    shown = [START - 300 * MS, START - 31 * MS, START - 17 * MS]
    weights = pattern_weights(projector, 0, shown, START, 0.025)
    expected = summed(projector, shown, START, 0.025)
    error = np.abs(weights - expected).max()
    assert error < 2e-4, f"weights {weights}, summed {expected}: error {error:.1e}"
    assert weights.min() > 0.01, f"{weights}: not every pattern has a part in this case"


def test_steady_light_is_divided_at_the_moment_it_changes() -> None:
    projector = ProjectorConfiguration(delay_ms=37.0)
    weights = pattern_weights(projector, 0, [0, START - 33 * MS], START, 0.010)
    np.testing.assert_allclose(weights, [0.4, 0.6], atol=1e-6)


def test_light_of_the_pattern_before_decays_with_the_rise_time() -> None:
    """At a time constant of 5 ms: integral of exp(-t / 5 ms) over 0 to 10 ms after the change, over 10 ms."""
    projector = ProjectorConfiguration(delay_ms=20.0, rise_ms=5.0)
    weights = pattern_weights(projector, 0, [0, START - 20 * MS], START, 0.010)
    left = 0.5 * (1 - np.exp(-2.0))
    np.testing.assert_allclose(weights, [left, 1 - left], atol=1e-6)


def test_whole_refresh_periods_have_the_mean_light() -> None:
    projector = ProjectorConfiguration(refresh_hz=60.0, refresh_duty=0.3)
    starts = [START + n * 1_234_567 for n in range(40)]
    whole = [pattern_weights(projector, 0, [0], start, 2 / 60).sum() for start in starts]
    short = [pattern_weights(projector, 0, [0], start, 1 / 240).sum() for start in starts]
    np.testing.assert_allclose(whole, 1.0, atol=1e-4)
    assert min(short) == 0.0
    assert max(short) == pytest.approx(1 / 0.3, abs=1e-4)


def test_jitter_belongs_to_a_pattern_and_has_its_width() -> None:
    projector = ProjectorConfiguration(delay_ms=50.0, jitter_ms=6.0)
    stamps = [START + n * 100 * MS for n in range(400)]

    def delay(shown: int, seed: int) -> float:
        return 0.1 - 0.1 * pattern_weights(projector, seed, [0, shown], shown, 0.1)[1]

    delays = np.array([delay(shown, 3) for shown in stamps])
    assert delay(stamps[0], 3) == delays[0]
    assert delay(stamps[0], 4) != delays[0]
    assert 0.044 <= delays.min() < 0.045
    assert 0.055 < delays.max() <= 0.056
    assert abs(delays.mean() - 0.050) < 3 * 0.006 / np.sqrt(3 * 400)


def test_parts_add_up_to_the_whole_exposure() -> None:
    rig = VirtualRig(VirtualRigConfiguration.from_dict({"preset": "plate", "size": "tiny", "ideal": True}))
    bright, dark = (np.full(rig.projector_shape, level, np.uint8) for level in (250, 0))
    np.testing.assert_array_equal(rig.expose_parts([(dark, 0.0), (bright, 1.0)], 0.0, 0), rig.expose(bright, 0.0, 0))
    ends = [rig.expose(each, 0.0, 0).astype(float) for each in (dark, bright)]
    mixed = rig.expose_parts([(dark, 0.75), (bright, 0.25)], 0.0, 0)
    error = np.abs(mixed - (0.75 * ends[0] + 0.25 * ends[1])).max()
    assert error <= 1.0, f"a quarter of the light is off by {error} grey levels"
