"""Maximum-likelihood fit of delay, jitter and rise of a projector."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.special import ndtr

from fringedic.errors import RigSetupError
from fringedic.rig_setup.refresh import Refresh
from fringedic.rig_setup.timing_samples import LEFT_OVER, Array, TimingSamples

# Checked by test_timing.py against exactly known light
_SLICES = 16  # an exposure is integrated over so many
# Time constants that raise the log-likelihood by less are taken as 0. Chance gives less than 8, errors
# of the waveform of pulsing light gave more, and a delay that was 0.6 ms too early (25 times its sigma).
_WORTH = 40.0
_OUTLIERS = 0.02  # share of the samples that may have any value, such as those of a delayed frame
_RESOLUTION = 0.02  # delays are resolved to this part of the exposure time
_MOST_CELLS = 300
_UNLIKELY = 1e-6  # likelihood of a delay over that of the best one
_DIM = 0.2  # exposures between two pulses are too dark to locate the change
_MARGIN = 0.03  # parts nearer to 0 or 1 count as dark or bright


@dataclass(frozen=True)
class CoarseFit:
    """Grey levels dark and bright, delay and time constant of the light [s]."""

    dark: float
    bright: float
    delay: float
    decay: float


@dataclass(frozen=True)
class ChangesFit:
    """Delay with its standard uncertainty, jitter, and time constants of rise and fall [s]."""

    delay: float
    sigma: float
    jitter: float
    rise: float
    fall: float

    def settled(self) -> float:
        """Return the time after which at most `LEFT_OVER` of the previous pattern is visible [s], with 3 jitter."""
        return self.delay + max(self.rise, self.fall) * math.log(1.0 / LEFT_OVER) + 3.0 * self.jitter


@dataclass(frozen=True)
class BrightnessModel:
    """Part of the bright light in each sample; an exposure is divided into equal slices.

    Attributes
    ----------
    begin, end : (sample,)
        Of the exposures, from the request of the pattern [s].
    bright : (sample,) bool
        The pattern is the bright one.
    exposure_time
        Of all samples [s].
    starts : (sample, slice)
        Begin of the slices, from the request of the pattern [s].
    light : (sample, slice)
        Light of a bright pattern during each slice over its mean.
    """

    begin: Array
    end: Array
    bright: NDArray[np.bool_]
    exposure_time: float
    starts: Array
    light: Array

    @classmethod
    def of(cls, samples: TimingSamples, refresh: Refresh | None = None) -> BrightnessModel:
        """Return the model of samples, in pulsing light where its refresh is known."""
        exposure_time = samples.exposure_time
        begin, end = samples.since - exposure_time / 2, samples.since + exposure_time / 2
        length = exposure_time / _SLICES
        offsets = np.arange(_SLICES) * length
        starts = begin[:, np.newaxis] + offsets
        light = np.ones(starts.shape)
        if refresh is not None:
            light = refresh.mean((samples.stamp - exposure_time / 2)[:, np.newaxis] + offsets, length)
        return cls(begin, end, samples.bright, exposure_time, starts, light)

    def only(self, chosen: NDArray[np.bool_]) -> BrightnessModel:
        """Return the model of some of the samples."""
        parts = (self.begin[chosen], self.end[chosen], self.bright[chosen])
        return BrightnessModel(*parts, self.exposure_time, self.starts[chosen], self.light[chosen])

    def whole(self) -> Array:
        """Return the parts of bright light at rest."""
        return np.asarray(self.light.mean(axis=1))

    def parts(self, delays: Array, decay: float) -> Array:
        """Return the part of every sample for each of the delays, shape (sample, delay)."""
        after = np.zeros((len(self.begin), len(delays)))
        for each in range(_SLICES):
            passed = self.starts[:, each, np.newaxis] - delays
            come = _integral(passed + self.exposure_time / _SLICES, decay) - _integral(passed, decay)
            after += self.light[:, each, np.newaxis] * come
        after /= self.exposure_time
        return np.where(self.bright[:, np.newaxis], after, self.whole()[:, np.newaxis] - after)


def _integral(passed: Array, decay: float) -> Array:
    """Return the integral of 1 - exp(-t / decay) from the change on [s]."""
    time = np.maximum(passed, 0.0)
    return time + decay * np.expm1(-time / decay) if decay > 0.0 else time


def coarse_fit(model: BrightnessModel, brightness: Array) -> CoarseFit:
    """Return dark, bright, delay and time constant by grid search; the levels are a straight line over the parts."""
    least, best = math.inf, CoarseFit(0.0, 0.0, 0.0, 0.0)
    longest = float(model.end.max())
    delays = np.arange(0.0, longest, max(model.exposure_time / 2, longest / 400))
    for decay in (0.0, 2e-3, 8e-3, 32e-3):
        part = model.parts(delays, decay)
        from_mean = part - part.mean(axis=0)
        spread = (from_mean**2).sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = brightness @ from_mean / spread
        explained = np.where((spread > 0.0) & (slope > 0.0), slope**2 * spread, 0.0)
        at = int(explained.argmax())
        squares = float(((brightness - brightness.mean()) ** 2).sum() - explained[at])
        if squares < least:
            dark = float(brightness.mean() - slope[at] * part[:, at].mean())
            least, best = squares, CoarseFit(dark, dark + float(slope[at]), float(delays[at]), decay)
    return best


def fit_levels(model: BrightnessModel, brightness: Array, settled: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return dark, bright and the relative noise of settled samples."""
    part = np.where(model.bright, model.whole(), 0.0)[settled]
    at_rest = brightness[settled]
    if min(np.count_nonzero(part > 0.0), np.count_nonzero(part == 0.0)) < 3:
        raise RigSetupError("too few exposures show settled light: wait longer after each change")
    used = np.ones(len(part), bool)
    for _ in range(3):
        matrix = np.column_stack([np.ones(used.sum()), part[used]])
        dark, contrast = map(float, np.linalg.lstsq(matrix, at_rest[used], rcond=None)[0])
        left = np.abs(at_rest - dark - contrast * part)
        # pulsing light has a larger scatter than dark
        scale = max(1.4826 * float(np.median(left[group])) for group in (part > 0.0, part == 0.0))
        used = left <= 4.0 * max(scale, 1e-6 * abs(contrast))
    return dark, dark + contrast, max(scale / abs(contrast), 1e-4)


class _Likelihood:
    """Likelihood of the samples around the change.

    The part y of a bright sample bounds the delay of its own pattern: later than the exposure for y = 0, earlier for
    y = 1, during the exposure in between. The normal distribution of the delays is a sum over cells of `_RESOLUTION`
    exposure times.
    """

    def __init__(self, model: BrightnessModel, part: Array, noise: float) -> None:
        whole = model.whole()
        part_of_whole = np.where(whole > _DIM, part / np.where(whole > _DIM, whole, 1.0), math.nan)
        changed = np.where(model.bright, part_of_whole, 1.0 - part_of_whole)
        unit = model.exposure_time
        low = float(model.begin[changed > _MARGIN].min()) - unit
        high = float(model.end[changed < 1.0 - _MARGIN].max(initial=low + unit)) + unit
        count = min(max(math.ceil((high - low) / (_RESOLUTION * unit)), 16), _MOST_CELLS)
        self.edges = np.linspace(low, high, count + 1)
        self.centres = (self.edges[1:] + self.edges[:-1]) / 2
        around = (model.end > low) & (model.begin < high)
        self.noise = max(noise, _RESOLUTION)
        self.directions = [
            (model.only(chosen), part[chosen]) for chosen in (around & model.bright, around & ~model.bright)
        ]

    def of_cells(self, direction: int, decay: float) -> Array:
        """Return the likelihood of each sample of a direction (0: rise, 1: fall) for a delay in each cell."""
        model, part = self.directions[direction]
        distance = (part[:, np.newaxis] - model.parts(self.centres, decay)) / self.noise
        return np.exp(-0.5 * distance**2) / (math.sqrt(2.0 * math.pi) * self.noise)

    def cost(self, cells: Array, delay: Array | float, jitter: Array | float) -> Array:
        """Return the negative log-likelihood; delays beyond the cells count in the outermost ones."""
        below = ndtr((self.edges[:, np.newaxis] - delay) / jitter)
        below[0], below[-1] = 0.0, 1.0
        likelihood = (1.0 - _OUTLIERS) * (cells @ np.diff(below, axis=0)) + _OUTLIERS
        return np.asarray(-np.log(likelihood).sum(axis=0))


def fit_changes(model: BrightnessModel, part: Array, noise: float) -> ChangesFit:
    """Return the maximum-likelihood fit; the delay and its sigma are mean and width of its likelihood."""
    likelihood = _Likelihood(model, part, noise)
    shortest = _RESOLUTION * model.exposure_time / 4

    def with_decays(rise: float, fall: float) -> tuple[float, Array]:
        cells = np.vstack([likelihood.of_cells(0, rise), likelihood.of_cells(1, fall)])
        shortest = _RESOLUTION * model.exposure_time / 4
        tried = np.meshgrid(
            np.linspace(likelihood.edges[0], likelihood.edges[-1], 60), model.exposure_time * 3.0 ** np.arange(-3, 3)
        )
        delays, jitters = (each.ravel() for each in tried)

        def cost(values: Array) -> float:
            return float(np.squeeze(likelihood.cost(cells, values[0], shortest + math.exp(min(values[1], 5.0)))))

        best = int(likelihood.cost(cells, delays, jitters).argmin())
        begin = np.array([delays[best], math.log(jitters[best])])
        simplex = np.vstack([begin, begin + np.diag([jitters[best], -1.0])])
        options: Any = {"initial_simplex": simplex, "xatol": 1e-6, "fatol": 1e-4, "maxiter": 150}
        found = minimize(cost, begin, method="Nelder-Mead", options=options)
        return float(found.fun), found.x

    rise, fall, of_decay = _decays(with_decays, model.exposure_time)
    _, found = with_decays(rise, fall)
    jitter = shortest + math.exp(float(found[1]))
    cells = np.vstack([likelihood.of_cells(0, rise), likelihood.of_cells(1, fall)])
    # The delay is distributed as its likelihood. Only exposures that contain the change and light locate it: the
    # likelihood has flat parts with steep ends, whose width the curvature at the maximum does not give.
    first, last = float(likelihood.edges[0]), float(likelihood.edges[-1])
    for _ in range(3):  # towards the delays that are likely
        tried = np.linspace(first, last, _MOST_CELLS)
        cost = likelihood.cost(cells, tried, jitter)
        weight = np.exp(cost.min() - cost)
        likely = np.flatnonzero(weight > _UNLIKELY)
        first, last = float(tried[max(likely[0] - 1, 0)]), float(tried[min(likely[-1] + 1, len(tried) - 1)])
    weight /= weight.sum()
    mean = float(weight @ tried)
    sigma = math.sqrt(float(weight @ (tried - mean) ** 2) + (tried[1] - tried[0]) ** 2 / 12)
    return ChangesFit(mean, math.hypot(sigma, of_decay), jitter if jitter > 8 * shortest else 0.0, rise, fall)


def _decays(
    with_decays: Callable[[float, float], tuple[float, Array]], exposure_time: float
) -> tuple[float, float, float]:
    """Return the time constants of rise and fall, and what their uncertainty adds to the sigma of the delay."""
    tried = [0.0, *(exposure_time * 4.0 ** np.arange(-1, 3))]
    # a time constant must explain more than chance does
    decay = min(tried, key=lambda each: with_decays(each, each)[0] + (_WORTH if each > 0.0 else 0.0))
    if decay <= 0.0:
        return 0.0, 0.0, 0.0
    rise = fall = decay

    def scaled(rises: float, falls: float) -> tuple[float, Array]:
        return with_decays(rise * math.exp(rises), fall * math.exp(falls))

    def best(cost: Callable[[float], float]) -> float:
        options: Any = {"xatol": 0.02, "maxiter": 12}
        found = minimize_scalar(cost, bounds=(-1.5, 1.5), method="bounded", options=options)
        return math.exp(found.x)

    factor = best(lambda each: scaled(each, each)[0])
    rise, fall = factor * rise, factor * fall
    factor = best(lambda each: scaled(each, 0.0)[0])
    rise *= factor
    factor = best(lambda each: scaled(0.0, each)[0])
    fall *= factor
    (less, early), (least, _), (more, late) = (scaled(each, each) for each in (-0.1, 0.0, 0.1))
    curvature = (less + more - 2.0 * least) / 0.1**2
    of_decay = abs(late[0] - early[0]) / 0.2 / math.sqrt(curvature) if curvature > 0.0 else math.nan
    return rise, fall, of_decay
