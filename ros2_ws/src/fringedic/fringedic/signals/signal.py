"""A signal: samples of one quantity with their stamps, unit, sign convention and standard uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fringedic.signals.samples import (
    FEWEST_FOR_A_LINE,
    NEAR_NS,
    SampleSummary,
    residuals,
    samples_over,
    slope,
    summarise,
)
from fringedic.wording.translation import translatable


class Channel(NamedTuple):
    """What a signal measures.

    Attributes
    ----------
    name
        Of the signal, unique in a rig; the name of its variables in a dataset.
    quantity, unit
        ``force``, ``length``, ``temperature`` and its SI unit.
    positive
        Sign convention: direction or state of positive values; empty without one.
    source
        What measures it.
    """

    name: str
    quantity: str
    unit: str
    positive: str = ""
    source: str = ""


FORCE = Channel(translatable("force"), "force", "N", "tension", "load_frame")
POSITION = Channel(translatable("position"), "length", "m", "in the direction of tension", "load_frame")


class SignalValue(NamedTuple):
    """Value of a signal during the exposures of a step.

    Attributes
    ----------
    mean
        Of the samples, or the value at the time of a stack in motion; NaN without any.
    sigma
        Its standard uncertainty: that of the sensor, and the scatter of the samples about a straight line. NaN where
        that of the sensor is not known.
    drift
        Its change from the begin to the end of the exposures, by the straight line through the samples; NaN with fewer
        than two.
    """

    mean: float = float("nan")
    sigma: float = float("nan")
    drift: float = float("nan")


@dataclass(frozen=True)
class Signal:
    """Samples of a channel, in the order of their arrival.

    Attributes
    ----------
    channel
        What they measure.
    stamps
        When they were acquired [ns], int64 (n,).
    values
        In the unit of the channel, float64 (n,); NaN is not measured.
    sigmas
        Standard uncertainty of each value, float64 (n,); NaN is not known.

    Examples
    --------
    >>> seconds = np.arange(4)
    >>> force = Signal(FORCE, 10**9 * seconds, 5.0 + seconds, np.full(4, 0.5))
    >>> force.value_over(1e9, 3e9)
    SignalValue(mean=7.0, sigma=0.5, drift=2.0)
    """

    channel: Channel
    stamps: np.ndarray
    values: np.ndarray
    sigmas: np.ndarray

    def around(self, begin: float, end: float) -> Signal:
        """Return the measured samples from the last one before a time [ns] to the first one after it."""
        known = np.flatnonzero(np.isfinite(self.values))
        first = max(int(np.searchsorted(self.stamps[known], begin, "right")) - 1, 0)
        chosen = known[first : int(np.searchsorted(self.stamps[known], end)) + 1]
        return replace(self, stamps=self.stamps[chosen], values=self.values[chosen], sigmas=self.sigmas[chosen])

    def summary_over(self, begin: float, end: float) -> SampleSummary:
        """Return mean, spread and drift of the samples during a time [ns]; see `samples_over`."""
        within = samples_over(self.stamps, begin, end)
        return summarise(self.stamps[within], self.values[within])

    def value_over(self, begin: float, end: float) -> SignalValue:
        """Return the value during a time [ns], NaN without a sample near it; see `samples_over`."""
        within = samples_over(self.stamps, begin, end)
        if not within.any():
            return SignalValue()
        stamps, values = self.stamps[within], self.values[within]
        measured = np.isfinite(values)
        variance = float(np.mean(self.sigmas[within][measured] ** 2)) if measured.any() else np.nan
        count = int(measured.sum())
        if count >= FEWEST_FOR_A_LINE:
            variance += float(np.sum(residuals(stamps, values) ** 2)) / (count - 2) / count
        drift = slope(stamps, values) * 1e-9 * (end - begin)
        return SignalValue(summarise(stamps, values).mean, float(np.sqrt(variance)), drift)

    def value_at(self, time: float, begin: float, end: float) -> SignalValue:
        """Return the value at one time of a test in motion, by the straight line through the samples around it.

        Parameters
        ----------
        time
            The time [ns].
        begin, end
            The line is fitted to the samples from the last one before `begin` to the first one after `end` [ns].

        Returns
        -------
        SignalValue
            NaN without a sample nearer than a second to `begin` or `end`; the drift is that from `begin` to `end`. Of
            fewer than three samples, whose scatter is not known, the uncertainty is that of the sensor.

        Examples
        --------
        >>> seconds = np.arange(4)
        >>> force = Signal(FORCE, 10**9 * seconds, 5.0 + 2.0 * seconds, np.full(4, 0.5))
        >>> force.value_at(1.25e9, 1e9, 2e9)
        SignalValue(mean=7.5, sigma=0.5, drift=2.0)
        """
        around = self.around(begin, end)
        near = (around.stamps > begin - NEAR_NS) & (around.stamps < end + NEAR_NS)
        stamps, values = around.stamps[near], around.values[near]
        if not stamps.size:
            return SignalValue()
        centred = 1e-9 * (stamps - stamps[0])
        middle = float(centred.mean())
        centred -= middle
        away = 1e-9 * (time - float(stamps[0])) - middle
        moment = float(centred @ centred)
        rate = slope(stamps, values)
        variance = float(np.mean(around.sigmas[near] ** 2))
        if len(values) >= FEWEST_FOR_A_LINE and moment > 0:
            scatter = float(np.sum(residuals(stamps, values) ** 2)) / (len(values) - 2)
            variance += scatter * (1 / len(values) + away**2 / moment)
        mean = float(values.mean()) + (rate * away if moment > 0 else 0.0)
        return SignalValue(mean, float(np.sqrt(variance)), rate * 1e-9 * (end - begin))

    def on_the_clock_of_the_rig(self, offset: float, drift: float, since: int) -> Signal:
        """Return the signal of a sensor that stamps with its own clock, with the stamps of the rig's clock.

        Parameters
        ----------
        offset, drift
            Clock of the sensor minus that of the rig [s] at the stamp `since` [ns] of the sensor's clock, and the
            growth of this offset [s/s].
        since
            See `offset`.
        """
        late = 1e9 * offset + drift * (self.stamps - since)
        return replace(self, stamps=self.stamps - np.rint(late).astype(np.int64))
