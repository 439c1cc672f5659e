"""What a testing machine did while a step was exposed: mean, spread and drift of its samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

FEWEST_FOR_A_LINE = 3
NEAR_NS = 1_000_000_000  # a sample further from the exposure tells nothing of it


class LoadSummary(NamedTuple):
    """Force [N] or position [m] over some time.

    Attributes
    ----------
    samples
        How many there are; those that are NaN are not counted.
    mean, spread
        Mean, and largest minus smallest value; NaN without samples.
    drift
        Change along the straight line through the samples, from the first to the last one; NaN without samples. A line
        averages noise, which would make the spread of many samples large.
    """

    samples: int
    mean: float
    spread: float
    drift: float


def samples_over(stamps: Sequence[int] | np.ndarray, begin: float, end: float) -> np.ndarray:
    """Return which samples belong to a time: those within it, or its neighbours when it is shorter than their distance.

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


def summarise_load(stamps: Sequence[int], values: Sequence[float]) -> LoadSummary:
    """Summarise the samples of one quantity.

    Parameters
    ----------
    stamps
        When they were acquired [ns], shape (n,), in any order.
    values
        Force [N] or position [m], shape (n,); NaN is left out.
    """
    value = np.asarray(values, dtype=np.float64)
    measured = np.isfinite(value)
    value = value[measured]
    if not value.size:
        return LoadSummary(0, np.nan, np.nan, np.nan)
    nanoseconds = np.asarray(stamps, dtype=np.int64)[measured]
    time = 1e-9 * (nanoseconds - nanoseconds.min())
    spread = float(np.ptp(value))
    drift = spread
    if value.size >= FEWEST_FOR_A_LINE and np.ptp(time) > 0:
        centred = time - time.mean()
        drift = float(centred @ value / (centred @ centred) * np.ptp(time))
    return LoadSummary(int(value.size), float(value.mean()), spread, drift)
