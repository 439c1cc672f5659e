"""Delay, rise and refresh of a projector, from photographed changes between dark and bright."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from fringedic.errors import RigSetupError
from fringedic.rig_setup.refresh import Refresh, find_refresh
from fringedic.rig_setup.timing_fit import BrightnessModel, coarse_fit, fit_changes, fit_levels
from fringedic.rig_setup.timing_samples import FEWEST_CHANGES, LEFT_OVER, Array, TimingSamples

_LEAST_CONTRAST = 0.02  # (bright - dark) / bright; a camera that sees no projector has less than 0.01


@dataclass(frozen=True)
class ProjectorTiming:
    """Delay, jitter, rise and refresh of a projector; the sentences are in `fringedic.rig_setup.projector_sentences`.

    Attributes
    ----------
    delay, delay_sigma
        From the request of a pattern to its first light, and its standard uncertainty [s]; NaN when even the earliest
        exposure shows the pattern.
    earliest
        Begin of the earliest exposure [s]: an unknown delay is shorter.
    jitter
        Standard deviation of the delay from one pattern to the next [s]; NaN with the delay.
    rise, fall
        Time constants of the light when a pattern appears and disappears [s].
    dark, bright
        Mean grey levels at rest [grey level].
    noise
        Standard deviation of a sample's brightness over ``bright - dark``.
    refresh
        Pulses of the light; None when it does not pulse, or when the exposure averages whole periods.
    exposure_time
        Exposure time of the samples [s].
    samples
        Number of samples.
    """

    delay: float
    delay_sigma: float
    earliest: float
    jitter: float
    rise: float
    fall: float
    dark: float
    bright: float
    noise: float
    refresh: Refresh | None
    exposure_time: float
    samples: int

    def settled(self) -> float:
        """Return the time after which at most 0.2 % of the previous pattern is visible [s], plus 3 jitter and sigma."""
        if math.isnan(self.delay):
            return max(self.earliest, 0.0)
        decay = max(self.rise, self.fall) * math.log(1.0 / LEFT_OVER)
        return self.delay + decay + 3.0 * (self.jitter + self.delay_sigma)

    def settle_time(self) -> float:
        """Return the time to wait between pattern and exposure: `settled`, rounded up to refresh periods or ms [s].

        A projector takes the next pattern at the begin of a refresh only, so that whole periods cost no time.
        """
        unit = 1e-3 if self.refresh is None else self.refresh.period
        return unit * math.ceil(self.settled() / unit - 1e-6)

    def whole_exposure(self, exposure_time: float) -> float:
        """Return the multiple of the refresh period nearest to an exposure time [s]; that time if nothing pulses."""
        if self.refresh is None:
            return exposure_time
        return self.refresh.period * max(1, round(exposure_time * self.refresh.frequency))

    def beat(self, exposure_time: float) -> float:
        """Return the largest relative deviation of a bright frame from the mean one at an exposure time [s]."""
        return 0.0 if self.refresh is None else self.refresh.beat(exposure_time)

    def save(self, path: Path, exposure_time: float) -> None:
        """Write the measurement and the settings for a rig's exposure time [s] as YAML, in ms and Hz."""
        whole = self.whole_exposure(exposure_time)
        refresh = self.refresh
        path.write_text(
            yaml.safe_dump(
                {
                    "delay_ms": _round(1e3 * self.delay),
                    "delay_sigma_ms": _round(1e3 * self.delay_sigma),
                    "jitter_ms": _round(1e3 * self.jitter),
                    "rise_ms": _round(1e3 * self.rise),
                    "fall_ms": _round(1e3 * self.fall),
                    "refresh_hz": None if refresh is None else _round(refresh.frequency, 6),
                    "refresh_sigma_hz": None if refresh is None else _round(refresh.frequency_sigma),
                    "beat_percent": _round(100 * self.beat(exposure_time)),
                    "noise_percent": _round(100 * self.noise),
                    "samples": self.samples,
                    "advised": {
                        "exposure_ms": _round(1e3 * whole, 6),
                        "settle_ms": _round(1e3 * self.settle_time()),
                    },
                },
                sort_keys=False,
            ),
            "utf-8",
        )

    def curve(self, since: Array, bright: bool) -> Array:
        """Return the mean brightness of exposures after a change, without jitter and pulses.

        Parameters
        ----------
        since
            Times from the request to the middle of the exposure, shape (time,) [s].
        bright
            Whether the new pattern is the bright one.

        Returns
        -------
        ndarray
            Shape (time,) [grey level].
        """
        delay, decay = (0.0, 0.0) if math.isnan(self.delay) else (self.delay, self.rise if bright else self.fall)
        times = np.asarray(since, float)
        samples = TimingSamples(times, times, np.full(len(times), bright), np.zeros(len(times)), self.exposure_time)
        model = BrightnessModel.of(samples)
        return self.dark + (self.bright - self.dark) * model.parts(np.array([delay]), decay)[:, 0]


def rough_delay(samples: TimingSamples) -> tuple[float, float]:
    """Return delay and time constant of the light [s], to about the exposure time, from frames taken continuously."""
    coarse = coarse_fit(BrightnessModel.of(samples), samples.brightness)
    return coarse.delay, coarse.decay


def measure_timing(samples: TimingSamples) -> ProjectorTiming:
    """Estimate delay, jitter, rise and refresh of a projector.

    The refresh is the strongest line of the least-squares spectrum of settled bright samples, or the lowest frequency
    with a line of its own of which the strongest is a multiple; the waveform is a non-negative linear fit. Delay,
    jitter, rise and fall maximise the likelihood of all samples, with a share of 2 % for outliers.

    Parameters
    ----------
    samples
        Exposures of a scene on which dark and bright patterns alternate.

    Raises
    ------
    RigSetupError
        There are too few samples, dark and bright do not differ, or the light still changes in the last exposures.

    References
    ----------
    Lomb, "Least-squares frequency analysis of unequally spaced data" (1976).

    Examples
    --------
    A projector that shows a pattern 20 ms after the request, in exposures of 1 ms:

    >>> import numpy as np
    >>> since = np.tile(np.linspace(0.005, 0.1, 96), 2)
    >>> bright = np.arange(192) < 96
    >>> seen = np.where(bright, since > 0.02, since <= 0.02)
    >>> brightness = 10 + 90 * seen + np.random.default_rng(1).normal(0, 0.1, 192)
    >>> samples = TimingSamples(since, np.arange(192.0), bright, brightness, exposure_time=1e-3)
    >>> timing = measure_timing(samples)
    >>> round(1e3 * timing.delay), timing.refresh
    (20, None)
    """
    lit, count = samples.bright, len(samples.since)
    if min(np.count_nonzero(lit), np.count_nonzero(~lit)) < FEWEST_CHANGES:
        raise RigSetupError(f"{count} samples are too few: {FEWEST_CHANGES} of dark and of bright are needed")
    model = BrightnessModel.of(samples)
    coarse = coarse_fit(model, samples.brightness)
    _refuse_low_contrast(coarse.dark, coarse.bright)
    dark = coarse.dark
    at_rest = min(coarse.delay + 3.0 * coarse.decay, float(np.quantile(model.begin, 0.7)))
    for _ in range(2):  # the first pass finds the pulses and the samples at rest, the second uses them
        settled = model.begin > at_rest
        refresh = find_refresh(samples, settled & lit, dark)
        model = BrightnessModel.of(samples, refresh)
        dark, bright, noise = fit_levels(model, samples.brightness, settled)
        _refuse_low_contrast(dark, bright)
        fitted = fit_changes(model, (samples.brightness - dark) / (bright - dark), noise)
        at_rest = fitted.settled()
    if at_rest > model.begin.max():
        raise RigSetupError(
            f"the light still changes {1e3 * samples.since.max():.0f} ms after a change of the pattern: "
            "wait longer after each change"
        )
    earliest = float(model.begin.min())
    seen = fitted.delay > earliest
    return ProjectorTiming(
        delay=fitted.delay if seen else math.nan,
        delay_sigma=fitted.sigma if seen else math.nan,
        earliest=earliest,
        jitter=fitted.jitter if seen else math.nan,
        rise=fitted.rise if seen else 0.0,
        fall=fitted.fall if seen else 0.0,
        dark=dark,
        bright=bright,
        noise=noise,
        refresh=refresh,
        exposure_time=samples.exposure_time,
        samples=count,
    )


def _refuse_low_contrast(dark: float, bright: float) -> None:
    if not bright - dark > _LEAST_CONTRAST * abs(bright):
        raise RigSetupError(
            f"bright frames have the grey level {bright:.1f} and dark ones {dark:.1f}: the camera does not see the "
            "projector, or its delay exceeds the longest wait; check the image, the lamp and the lens cap"
        )


def _round(value: float, digits: int = 4) -> float | None:
    """Return a value rounded to significant digits, None for NaN."""
    return None if math.isnan(value) else float(f"{value:.{digits}g}")
