"""Summarises the samples of a signal during a step: mean, spread and drift."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

FEWEST_FOR_A_LINE = 3  # with two samples the line is their difference, as the spread
NEAR_NS = 1_000_000_000  # a sample further from the exposure does not describe it; machines send 10 Hz or more


class SampleSummary(NamedTuple):
    """Summary of the samples of one signal during a step.

    Attributes
    ----------
    samples
        Number of samples that are not NaN.
    mean, spread
        Mean, and largest minus smallest value; NaN without samples.
    drift
        Change of the fitted straight line from the first to the last sample; NaN without samples. The line averages
        noise, which increases the spread of many samples.
    """

    samples: int
    mean: float
    spread: float
    drift: float


def samples_over(stamps: Sequence[int] | np.ndarray, begin: float, end: float) -> np.ndarray:
    """Return the samples within a time, or its neighbours where it contains none.

    Parameters
    ----------
    stamps
        When samples were acquired [ns], shape (n,).
    begin, end
        Of the first and last exposure [ns].

    Returns
    -------
    ndarray
        bool, shape (n,); all false when none is nearer than a second.

    Examples
    --------
    >>> samples_over([0, 100, 200, 300], begin=120, end=180).tolist()
    [False, True, True, False]
    """
    stamp = np.asarray(stamps, dtype=np.int64)
    chosen = (stamp >= begin) & (stamp <= end)
    if chosen.any():
        return chosen
    before, after = (stamp < begin) & (stamp > begin - NEAR_NS), (stamp > end) & (stamp < end + NEAR_NS)
    if before.any():
        chosen |= stamp == stamp[before].max()
    if after.any():
        chosen |= stamp == stamp[after].min()
    return chosen


def summarise(stamps: Sequence[int] | np.ndarray, values: Sequence[float] | np.ndarray) -> SampleSummary:
    """Summarise the samples of one signal.

    Parameters
    ----------
    stamps
        When they were acquired [ns], shape (n,), in any order.
    values
        Shape (n,); NaN is left out.

    Examples
    --------
    >>> summarise([0, 10**9, 2 * 10**9], [5.0, 6.0, 7.0])
    SampleSummary(samples=3, mean=6.0, spread=2.0, drift=2.0)
    """
    value = np.asarray(values, dtype=np.float64)
    measured = np.isfinite(value)
    value = value[measured]
    if not value.size:
        return SampleSummary(0, np.nan, np.nan, np.nan)
    nanoseconds = np.asarray(stamps, dtype=np.int64)[measured]
    time = 1e-9 * (nanoseconds - nanoseconds.min())
    spread = float(np.ptp(value))
    drift = spread
    if value.size >= FEWEST_FOR_A_LINE and np.ptp(time) > 0:
        centred = time - time.mean()
        drift = float(centred @ value / (centred @ centred) * np.ptp(time))
    return SampleSummary(int(value.size), float(value.mean()), spread, drift)


def slope(stamps: np.ndarray, values: np.ndarray) -> float:
    """Return the slope of the straight line through samples [1/s], NaN with fewer than two; NaN is left out.

    Examples
    --------
    >>> round(slope(np.array([0, 10**9, 2 * 10**9]), np.array([5.0, np.nan, 9.0])), 9)
    2.0
    """
    measured = np.isfinite(values)
    value, time = values[measured], 1e-9 * (stamps[measured] - stamps.min())
    centred = time - time.mean() if time.size else time
    moment = float(centred @ centred)
    return float(centred @ value / moment) if moment > 0 else float("nan")


def residuals(stamps: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the deviations of samples from their fitted straight line; NaN is left out.

    Examples
    --------
    >>> residuals(np.array([0, 10**9, 2 * 10**9]), np.array([0.0, 3.0, 0.0])).round(6).tolist()
    [-1.0, 2.0, -1.0]
    """
    measured = np.isfinite(values)
    value, time = values[measured], 1e-9 * (stamps[measured] - stamps.min())
    centred = time - time.mean()
    level = value - value.mean()
    moment = float(centred @ centred)
    return np.asarray(level - (centred @ level / moment) * centred if moment > 0 else level)
