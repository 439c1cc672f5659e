"""Timing of the projector: delay and rise of its light after a pattern, and its share in an exposure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fringedic.virtual_rig.configuration import ProjectorConfiguration


def pattern_weights(
    projector: ProjectorConfiguration, seed: int, shown: Sequence[int], start: int, exposure_time: float
) -> NDArray[np.float64]:
    """Return the part of an exposure's light that comes from each of the patterns handed to the projector.

    The light follows pattern i from ``t_i = shown_i + delay_i`` on: the light of the patterns before decays as
    ``exp(-(t - t_i) / rise)``, and the new pattern has the rest. With ``refresh_hz`` the light comes in pulses, the
    first of which began at time 0 of the clock; they are ``1 / refresh_duty`` times as bright as steady light. The
    weights are mean values over the exposure: 1 for steady light of one pattern.

    Parameters
    ----------
    projector
        Its delay, jitter, rise and refresh.
    seed
        Determines the delay of each pattern, together with the time at which it was handed over.
    shown
        When the patterns were handed over, rising [ns]; the first is also shown at all earlier times.
    start, exposure_time
        Begin [ns] and length [s] of the exposure.

    Returns
    -------
    ndarray
        float64, shape (pattern,): one weight for each pattern of `shown`.

    Examples
    --------
    >>> projector = ProjectorConfiguration(delay_ms=5.0)
    >>> pattern_weights(projector, 0, [-10**9, 0], start=0, exposure_time=0.02).round(3).tolist()
    [0.25, 0.75]
    """
    # seconds from the start of the exposure
    seen = np.maximum.accumulate([1e-9 * (each - start) + _delay(projector, seed, each) for each in shown])
    rise = 1e-3 * projector.rise_ms
    if projector.refresh_hz == 0.0:
        pulses = np.array([[0.0], [exposure_time]])
    else:
        period = 1.0 / projector.refresh_hz
        passed = math.fmod(start * 1e-9, period)  # of the pulse that has begun last
        begins = np.arange(-passed, exposure_time, period)
        pulses = np.asarray(np.clip([begins, begins + projector.refresh_duty * period], 0.0, exposure_time))
    share = np.zeros(len(shown))  # of the light, at the moment at which the next pattern begins
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
    return np.asarray(weights * brightness / exposure_time)


def _delay(projector: ProjectorConfiguration, seed: int, shown: int) -> float:
    """Return the delay of one pattern [s]."""
    delay = 1e-3 * projector.delay_ms
    if projector.jitter_ms > 0.0:
        delay += 1e-3 * projector.jitter_ms * np.random.default_rng((seed, shown)).uniform(-1.0, 1.0)
    return float(delay)
