"""Refresh of a projector's light, found as a line in a least-squares spectrum (Lomb 1976)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar, nnls

from fringedic.rig_setup.timing_samples import FEWEST_CHANGES, Array, TimingSamples

_FREQUENCIES = (15.0, 600.0)  # [Hz], search range: slower is no projector, faster is averaged by any exposure
_FALSE_ALARM = 1e-6  # probability that noise is taken for a refresh
_HARMONICS = 6  # of the refresh that are fitted at most; test_timing.py fixes the accuracy of the frequency
_BINS = 60  # a refresh period is divided into so many
_EVENNESS = 0.02  # weight of the differences between neighbouring bins against that of the samples


@dataclass(frozen=True)
class Refresh:
    """Pulses of the projector's light, relative to its mean.

    Attributes
    ----------
    frequency, frequency_sigma
        f and its standard uncertainty [Hz].
    light : (bin,)
        m(t) in equal parts of a period, the first of which begins where the stamps of the samples are 0.
    """

    frequency: float
    frequency_sigma: float
    light: Array

    @property
    def period(self) -> float:
        """Period 1 / f [s]."""
        return 1.0 / self.frequency

    def mean(self, begin: Array, length: Array | float) -> Array:
        """Return the mean of m(t) over a length of time [s] from `begin` [s] on, which counts like the stamps."""
        return (self._sum(begin + length) - self._sum(begin)) / length

    def beat(self, exposure_time: float) -> float:
        """Return the largest relative deviation of a bright frame from the mean, over all exposure begins."""
        begin = np.linspace(0.0, self.period, 4 * len(self.light), endpoint=False)
        return float(np.abs(self.mean(begin, exposure_time) - 1.0).max())

    def _sum(self, time: Array) -> Array:
        """Return the integral of m from time 0 on [s]."""
        bins = len(self.light)
        sums = np.concatenate([[0.0], np.cumsum(self.light) / bins])
        periods, phase = np.divmod(time * self.frequency, 1.0)
        integral = periods * sums[-1] + np.interp(phase * bins, np.arange(bins + 1), sums)
        return np.asarray(integral / self.frequency)


def find_refresh(samples: TimingSamples, settled: NDArray[np.bool_], dark: float) -> Refresh | None:
    """Return the pulses of settled bright light; None when no line is significant or samples are too few."""
    time, light = samples.stamp[settled], samples.brightness[settled] - dark
    if len(time) < 3 * FEWEST_CHANGES:
        return None
    span = float(time.max() - time.min())
    light = light / light.mean() - 1.0
    tried = np.arange(*_FREQUENCIES, 0.2 / span)
    power = _line_strength(time, light, tried)
    strongest = float(tried[int(power.argmax())])
    if not _is_line(float(power.max()), len(time), len(tried)):
        return None
    strongest = _refine(time, light, strongest, span, 1)
    left = light - _harmonics(time, light, strongest, 2)[1]
    fundamental = strongest
    for part in (6, 5, 4, 3, 2):
        lower = strongest / part
        if lower >= _FREQUENCIES[0] and _is_line(
            float(_line_strength(time, left, np.array([lower]))[0]), len(time), 20
        ):
            fundamental = lower
            break
    fewest = max(1, min(_HARMONICS, math.floor(0.8 / (fundamental * samples.exposure_time)), len(time) // 12))
    frequency = _refine(time, light, fundamental, span, fewest)
    step = 0.02 / span
    least, *beside = (_left_over(time, light, frequency + shift, fewest) for shift in (0.0, step, -step))
    curvature = (sum(beside) - 2.0 * least) / step**2
    variance = least / max(len(time) - 2 * fewest - 2, 1)
    sigma = math.sqrt(2.0 * variance / curvature) if curvature > 0.0 else math.nan
    begin = (time - samples.exposure_time / 2) * frequency
    length = samples.exposure_time * frequency
    edges = np.arange(_BINS + 1) / _BINS
    # share of the exposure in each bin: whole periods, and the last part, which may end in the next period
    whole, last = divmod(length, 1.0)
    phase = (begin % 1.0)[:, np.newaxis]
    met = np.zeros((len(begin), _BINS))
    for shift in (0.0, 1.0):
        met += np.diff(np.clip(edges + shift, phase, phase + last), axis=1)
    met += whole / _BINS
    even = _EVENNESS * (np.eye(_BINS) - np.roll(np.eye(_BINS), 1, axis=1))
    pulses, _ = nnls(np.vstack([met / length, even]), np.concatenate([light + 1.0, np.zeros(_BINS)]))
    return Refresh(frequency, sigma, np.asarray(pulses / pulses.mean()))


def _line_strength(time: Array, light: Array, frequencies: Array) -> Array:
    """Return the share of the variance that a sine of each frequency explains (Lomb 1976)."""
    strength = np.empty(len(frequencies))
    total = light @ light
    for first in range(0, len(frequencies), 4096):
        chosen = slice(first, first + 4096)
        angle = 2.0 * np.pi * np.outer(frequencies[chosen], time)
        cosine, sine = np.cos(angle), np.sin(angle)
        cc, ss, cs = (cosine**2).sum(1), (sine**2).sum(1), (cosine * sine).sum(1)
        c, s = cosine @ light, sine @ light
        strength[chosen] = (ss * c**2 + cc * s**2 - 2.0 * cs * c * s) / (cc * ss - cs**2) / total
    return strength


def _is_line(strength: float, samples: int, frequencies: int) -> bool:
    """Return whether noise reaches that strength at one of so many frequencies too rarely to be a false alarm."""
    chance = frequencies * (1.0 - min(strength, 1.0 - 1e-12)) ** ((samples - 3) / 2)
    return bool(chance < _FALSE_ALARM)


def _harmonics(time: Array, light: Array, frequency: float, count: int) -> tuple[Array, Array]:
    """Return the amplitudes (2, harmonic) of cosines and sines, and the fitted value of each sample."""
    angle = 2.0 * np.pi * np.outer(time, frequency * np.arange(1, count + 1))
    matrix = np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(time))])
    solution, *_ = np.linalg.lstsq(matrix, light, rcond=None)
    return solution[:-1].reshape(2, count), matrix @ solution


def _left_over(time: Array, light: Array, frequency: float, count: int) -> float:
    return float(((light - _harmonics(time, light, frequency, count)[1]) ** 2).sum())


def _refine(time: Array, light: Array, frequency: float, span: float, count: int) -> float:
    """Return the frequency nearby with the least squares."""
    width = 0.3 / span
    found = minimize_scalar(
        lambda each: _left_over(time, light, each, count),
        bounds=(frequency - width, frequency + width),
        method="bounded",
        options={"xatol": 1e-5 * width},
    )
    return float(found.x)
