"""When the projector's light follows a pattern, and how much of it falls into an exposure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fringedic.virtual_rig.configuration import ProjectorConfiguration


def pattern_weights(
    projector: ProjectorConfiguration, seed: int, shown: Sequence[int], start: int, exposure_time: float
) -> NDArray[np.float64]:
    """Part of an exposure's light that comes from each of the patterns that were handed to the projector.

    The light follows pattern i from ``t_i = shown_i + delay_i`` on: what was there before decays as
    ``exp(-(t - t_i) / rise)``, and the new pattern has the rest. A light of ``refresh_hz`` comes in pulses, the first
    of which began at time 0 of the clock, ``1 / refresh_duty`` times as bright as steady light. The weights are mean
    values over the exposure: 1 for steady light of one pattern.

    Parameters
    ----------
    projector
        Its delay, jitter, rise and refresh.
    seed
        Together with the time at which a pattern was handed over it decides the pattern's delay.
    shown
        When the patterns were handed over, rising [ns]; the first was there for ever before.
    start, exposure_time
        Begin [ns] and length [s] of the exposure.

    Returns
    -------
    float64 (pattern)
        One weight for each pattern of `shown`.
    """
    # seconds from the begin of the exposure
    seen = np.maximum.accumulate([1e-9 * (each - start) + _delay(projector, seed, each) for each in shown])
    rise = 1e-3 * projector.rise_ms
    pulses = _pulses(projector, start, exposure_time)
    share = np.zeros(len(shown))  # of the light, at the moment at which a pattern follows
    weights = np.zeros(len(shown))
    for i, begin in enumerate(seen):
        end = seen[i + 1] if i + 1 < len(seen) else math.inf
        first, last = np.clip(pulses, begin, end)
        decayed, left = 0.0, 0.0
        if rise > 0.0:
            decayed = rise * float((np.exp(-(first - begin) / rise) - np.exp(-(last - begin) / rise)).sum())
            left = math.exp(-(end - begin) / rise)
        weights += share * decayed
        weights[i] += (last - first).sum() - share.sum() * decayed
        share *= left
        share[i] = 1.0 - share.sum()
    brightness = 1.0 if projector.refresh_hz == 0.0 else 1.0 / projector.refresh_duty
    return weights * brightness / exposure_time


def _pulses(projector: ProjectorConfiguration, start: int, exposure_time: float) -> NDArray[np.float64]:
    """Begins and ends of the light within the exposure, (2, pulse) [s] from its begin."""
    if projector.refresh_hz == 0.0:
        return np.array([[0.0], [exposure_time]])
    period = 1.0 / projector.refresh_hz
    passed = math.fmod(start * 1e-9, period)  # of the pulse that has begun last
    begins = np.arange(-passed, exposure_time, period)
    return np.clip([begins, begins + projector.refresh_duty * period], 0.0, exposure_time)


def _delay(projector: ProjectorConfiguration, seed: int, shown: int) -> float:
    """Delay of one pattern [s]."""
    delay = 1e-3 * projector.delay_ms
    if projector.jitter_ms > 0.0:
        delay += 1e-3 * projector.jitter_ms * np.random.default_rng((seed, shown)).uniform(-1.0, 1.0)
    return float(delay)
