"""When a projector's light follows a pattern, and how it pulses, measured by the camera itself.

Dark and bright are shown in turn and photographed at many times after each change. A pattern that is handed over at
time 0 is there from ``delay`` on,

    light(t) = dark + (bright - dark) (1 - exp(-(t - delay) / rise)) m(t)    for t > delay,

and what was bright before decays with the time constant ``fall``. The delay of each pattern is normally distributed
with the standard deviation ``jitter``. The light itself pulses with the projector's refresh: m(t) is periodic and its
mean is 1. An exposure sees the mean over its length, which is always the same for whole refresh periods. Brightness is
a mean over many pixels, so that what is left of the noise is small.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar, nnls
from scipy.special import ndtr

from fringedic.errors import TimingError

Array = NDArray[np.float64]

LEFT_OVER = 0.002  # of a pattern's light may still be there when the exposure of the next one begins
_FEWEST = 12  # samples of dark and of bright each
_LOWEST_CONTRAST = 0.02  # of dark and bright, over bright
_FREQUENCIES = (15.0, 600.0)  # among which the refresh is looked for [Hz]
_FALSE_ALARM = 1e-6  # probability with which noise may be taken for a refresh
_HARMONICS = 6
_BINS = 60  # of a refresh period
_EVENNESS = 0.02  # weight of the differences between neighbouring bins beside the samples
_SLICES = 16  # of an exposure
_WORTH = 8.0  # by which time constants have to raise the logarithm of the likelihood, or there are none
_OUTLIERS = 0.02  # part of the samples that may be anything, such as of a frame that came late
_RESOLUTION = 0.02  # of delays, over the exposure time
_MOST_CELLS = 300
_DIM = 0.2  # exposures that fall between two pulses do not tell how far the change is
_MARGIN = 0.03  # parts nearer to 0 or 1 count as dark or bright


@dataclass(frozen=True)
class TimingSamples:
    """Exposures of a scene on which dark and bright were shown in turn.

    Attributes
    ----------
    since : (sample,)
        From the pattern that was handed over last to the middle of the exposure [s].
    stamp : (sample,)
        Middle of the exposure [s], counted from any time.
    bright : (sample,) bool
        The pattern was the bright one.
    brightness : (sample,)
        Mean grey level of the lit pixels.
    exposure_time
        Of all of them [s].
    """

    since: Array
    stamp: Array
    bright: NDArray[np.bool_]
    brightness: Array
    exposure_time: float


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
        """1 / f [s]."""
        return 1.0 / self.frequency

    def mean(self, begin: Array, length: Array | float) -> Array:
        """Mean of m(t) over times of some length from `begin` on, counted as the stamps."""
        return (self._sum(begin + length) - self._sum(begin)) / length

    def beat(self, exposure_time: float) -> float:
        """Largest deviation of a bright frame from the mean one, relative to it, whenever the exposure begins."""
        begin = np.linspace(0.0, self.period, 4 * len(self.light), endpoint=False)
        return float(np.abs(self.mean(begin, exposure_time) - 1.0).max())

    def _sum(self, time: Array) -> Array:
        """Integral of m from time 0 on [s]."""
        bins = len(self.light)
        sums = np.concatenate([[0.0], np.cumsum(self.light) / bins])
        periods, phase = np.divmod(time * self.frequency, 1.0)
        return (periods * sums[-1] + np.interp(phase * bins, np.arange(bins + 1), sums)) / self.frequency


@dataclass(frozen=True)
class ProjectorTiming:
    """What the samples say.

    Attributes
    ----------
    delay, delay_sigma
        From a pattern that is handed over to its first light, and its standard uncertainty [s]; NaN when the very
        first exposures showed it already.
    earliest
        Begin of the earliest exposure [s]: the delay is shorter where it is not known.
    jitter
        Standard deviation of the delay from one pattern to the next [s]; NaN with the delay.
    rise, fall
        Time constants of the light when a pattern comes and goes [s].
    dark, bright
        Mean grey levels at rest.
    noise
        Standard deviation of a sample's brightness over ``bright - dark``.
    refresh
        None: the light does not pulse, or the exposure hides it.
    exposure_time
        Of the samples [s].
    samples
        Their number.
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
        """Time from which on no more than 0.2 % of the pattern before is seen [s], with 3 jitter and sigma."""
        if math.isnan(self.delay):
            return max(self.earliest, 0.0)
        decay = max(self.rise, self.fall) * math.log(1.0 / LEFT_OVER)
        return self.delay + decay + 3.0 * (self.jitter + self.delay_sigma)

    def settle_time(self) -> float:
        """Time to wait between pattern and exposure: `settled`, up to whole refresh periods or milliseconds [s].

        A projector takes the next pattern at the begin of a refresh only, so that whole periods cost no time.
        """
        unit = 1e-3 if self.refresh is None else self.refresh.period
        return unit * math.ceil(self.settled() / unit - 1e-6)

    def whole_exposure(self, exposure_time: float) -> float:
        """Return the whole number of refresh periods nearest to an exposure time [s], which is left alone without."""
        if self.refresh is None:
            return exposure_time
        return self.refresh.period * max(1, round(exposure_time * self.refresh.frequency))

    def beat(self, exposure_time: float) -> float:
        """Largest deviation of a bright frame from the mean one at an exposure time [s], relative to it."""
        return 0.0 if self.refresh is None else self.refresh.beat(exposure_time)

    def words(self, exposure_time: float, settle_time: float) -> list[str]:
        """Say in sentences what was measured, and what it means for a rig's exposure and settle time [s]."""
        said = [self._delay_in_words(), self._refresh_in_words(exposure_time)]
        settled = self.settled()
        if settle_time < settled:
            said.append(
                f"A settle time of {1e3 * settle_time:.4g} ms is too short: a pattern takes {1e3 * settled:.1f} ms to "
                "come fully, and earlier exposures show the pattern before."
            )
        else:
            said.append(f"A settle time of {1e3 * settle_time:.4g} ms is enough; it takes {1e3 * settled:.1f} ms.")
        return said

    def _delay_in_words(self) -> str:
        if math.isnan(self.delay):
            return (
                f"A pattern is seen less than {1e3 * max(self.earliest, 0.0):.1f} ms after it was handed over: "
                "before the camera can begin an exposure."
            )
        said = (
            f"A pattern is seen {1e3 * self.delay:.2f} ms after it was handed over (standard uncertainty "
            f"{1e3 * self.delay_sigma:.2f} ms); from one to the next that varies by {1e3 * self.jitter:.2f} ms "
            "(standard deviation)."
        )
        slow = max(self.rise, self.fall)
        if slow > 1e-4:
            said += f" Its light then comes within {1e3 * self.rise:.1f} ms and goes within {1e3 * self.fall:.1f} ms."
        return said

    def _refresh_in_words(self, exposure_time: float) -> str:
        if self.refresh is None:
            return "The light is steady."
        whole = self.whole_exposure(exposure_time)
        left = max(100 * self.beat(whole), 0.01)
        return (
            f"The light pulses at {self.refresh.frequency:.2f} Hz: an exposure of {1e3 * exposure_time:.4g} ms is up "
            f"to {100 * self.beat(exposure_time):.2g} % brighter or darker than the mean, one of {1e3 * whole:.4f} ms "
            f"({round(whole / self.refresh.period)} x {1e3 * self.refresh.period:.4f} ms) by less than "
            f"{left:.1g} %."
        )

    def save(self, path: Path, exposure_time: float) -> None:
        """Write what was measured and what is advised for an exposure time [s] as YAML, in ms and Hz."""
        path.write_text(yaml.safe_dump(self._entries(exposure_time), sort_keys=False), "utf-8")

    def _entries(self, exposure_time: float) -> Mapping[str, Any]:
        whole = self.whole_exposure(exposure_time)
        refresh = self.refresh
        return {
            "delay_ms": _rounded(1e3 * self.delay),
            "delay_sigma_ms": _rounded(1e3 * self.delay_sigma),
            "jitter_ms": _rounded(1e3 * self.jitter),
            "rise_ms": _rounded(1e3 * self.rise),
            "fall_ms": _rounded(1e3 * self.fall),
            "refresh_hz": None if refresh is None else _rounded(refresh.frequency, 6),
            "refresh_sigma_hz": None if refresh is None else _rounded(refresh.frequency_sigma),
            "beat_percent": _rounded(100 * self.beat(exposure_time)),
            "noise_percent": _rounded(100 * self.noise),
            "samples": self.samples,
            "advised": {"exposure_ms": _rounded(1e3 * whole, 6), "settle_ms": _rounded(1e3 * self.settle_time())},
        }

    def curve(self, since: Array, bright: bool) -> Array:
        """Mean brightness of exposures at these times after a change, without jitter and pulses."""
        delay, decay = (0.0, 0.0) if math.isnan(self.delay) else (self.delay, self.rise if bright else self.fall)
        times = np.asarray(since, float)
        model = _Model(times, times, np.full(len(times), bright), self.exposure_time, None)
        return self.dark + (self.bright - self.dark) * model.parts(np.array([delay]), decay)[:, 0]


def rough_delay(samples: TimingSamples) -> tuple[float, float]:
    """Delay and time constant of the light [s] to about the exposure time, from frames taken all the time."""
    model = _Model(samples.since, samples.stamp, samples.bright, samples.exposure_time, None)
    return _coarse(model, samples.brightness)[2:]


def measure_timing(samples: TimingSamples) -> ProjectorTiming:
    """Estimate delay, jitter, rise and refresh of a projector.

    The refresh is the strongest line of the settled bright samples' least-squares spectrum, or the lowest frequency of
    which that is a multiple and at which there is a line, too; its form is a non-negative linear fit. Delay, jitter,
    rise and fall maximise the likelihood of all samples, of which 2 % may be anything.

    Raises
    ------
    TimingError
        There are too few samples, dark and bright do not differ, or a change is not seen to its end.
    """
    lit, count = samples.bright, len(samples.since)
    if min(np.count_nonzero(lit), np.count_nonzero(~lit)) < _FEWEST:
        raise TimingError(f"{count} samples are too few: {_FEWEST} of dark and of bright are needed")
    model = _Model(samples.since, samples.stamp, lit, samples.exposure_time, None)
    dark, bright, delay, decay = _coarse(model, samples.brightness)
    _refuse_dark(dark, bright)
    at_rest = min(delay + 3.0 * decay, float(np.quantile(model.begin, 0.7)))
    for _ in range(2):  # the second time with the pulses, and what is at rest, known better
        settled = model.begin > at_rest
        refresh = _refresh(samples, settled & lit, dark)
        model = _Model(samples.since, samples.stamp, lit, samples.exposure_time, refresh)
        dark, bright, noise = _levels(model, samples.brightness, settled)
        _refuse_dark(dark, bright)
        fitted = _fit(model, (samples.brightness - dark) / (bright - dark), noise)
        at_rest = fitted.settled()
    earliest = float(model.begin.min())
    if at_rest > model.begin.max():
        raise TimingError(
            f"{1e3 * samples.since.max():.0f} ms after a change the light still follows it; "
            "wait longer after each change"
        )
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


def _refuse_dark(dark: float, bright: float) -> None:
    if not bright - dark > _LOWEST_CONTRAST * abs(bright):
        raise TimingError(
            f"bright frames have the grey level {bright:.1f} and dark ones {dark:.1f}: the camera does not see the "
            "projector, or it is later than the longest wait; look at the image, the lamp and the lens cap"
        )


@dataclass(frozen=True)
class _Fit:
    delay: float
    sigma: float
    jitter: float
    rise: float
    fall: float

    def settled(self) -> float:
        return self.delay + max(self.rise, self.fall) * math.log(1.0 / LEFT_OVER) + 3.0 * self.jitter


class _Model:
    """Part of the bright light that each sample sees; an exposure is divided into equal slices."""

    def __init__(
        self, since: Array, stamp: Array, bright: NDArray[np.bool_], exposure_time: float, refresh: Refresh | None
    ) -> None:
        self.begin, self.end = since - exposure_time / 2, since + exposure_time / 2
        self.bright = bright
        self.exposure_time = exposure_time
        self._slice = exposure_time / _SLICES
        starts = np.arange(_SLICES) * self._slice
        self._starts = self.begin[:, np.newaxis] + starts
        self._light = np.ones(self._starts.shape)
        if refresh is not None:
            self._light = refresh.mean((stamp - exposure_time / 2)[:, np.newaxis] + starts, self._slice)

    def only(self, chosen: NDArray[np.bool_]) -> _Model:
        """The same for some of the samples."""
        model = copy.copy(self)
        model.begin, model.end, model.bright = self.begin[chosen], self.end[chosen], self.bright[chosen]
        model._starts, model._light = self._starts[chosen], self._light[chosen]
        return model

    def whole(self) -> Array:
        """Parts of bright light at rest."""
        return self._light.mean(axis=1)

    def parts(self, delays: Array, decay: float) -> Array:
        """Parts of every sample for each of the delays, (sample, delay)."""
        after = np.zeros((len(self.begin), len(delays)))
        for each in range(_SLICES):
            passed = self._starts[:, each, np.newaxis] - delays
            come = _integral(passed + self._slice, decay) - _integral(passed, decay)
            after += self._light[:, each, np.newaxis] * come
        after /= self.exposure_time
        return np.where(self.bright[:, np.newaxis], after, self.whole()[:, np.newaxis] - after)


def _integral(passed: Array, decay: float) -> Array:
    """Integral of 1 - exp(-t / decay) from the change on [s]."""
    time = np.maximum(passed, 0.0)
    return time + decay * np.expm1(-time / decay) if decay > 0.0 else time


def _coarse(model: _Model, brightness: Array) -> tuple[float, float, float, float]:
    """Dark, bright, delay and time constant by trying: the levels are a straight line over the parts."""
    best = (math.inf, 0.0, 0.0, 0.0, 0.0)
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
        if squares < best[0]:
            dark = float(brightness.mean() - slope[at] * part[:, at].mean())
            best = (squares, dark, dark + float(slope[at]), float(delays[at]), decay)
    return best[1:]


def _levels(model: _Model, brightness: Array, settled: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Dark, bright and the relative noise of what is at rest."""
    part = np.where(model.bright, model.whole(), 0.0)[settled]
    at_rest = brightness[settled]
    if min(np.count_nonzero(part > 0.0), np.count_nonzero(part == 0.0)) < 3:
        raise TimingError("hardly an exposure shows settled light; wait longer after each change")
    used = np.ones(len(part), bool)
    for _ in range(3):
        matrix = np.column_stack([np.ones(used.sum()), part[used]])
        dark, contrast = map(float, np.linalg.lstsq(matrix, at_rest[used], rcond=None)[0])
        left = np.abs(at_rest - dark - contrast * part)
        # light that pulses is known less well than dark
        scale = max(1.4826 * float(np.median(left[group])) for group in (part > 0.0, part == 0.0))
        used = left <= 4.0 * max(scale, 1e-6 * abs(contrast))
    return dark, dark + contrast, max(scale / abs(contrast), 1e-4)


class _Likelihood:
    """Likelihood of what the samples around the change see.

    A sample with the part y says of the delay of its own pattern: later than its exposure for y = 0 (of a bright one),
    earlier for y = 1, and when during the exposure for what is between. The normal distribution of the delays is a sum
    over cells of `_RESOLUTION` exposure times.
    """

    def __init__(self, model: _Model, part: Array, noise: float) -> None:
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
        """Likelihood of each sample of a direction (0: rise, 1: fall) for a delay in each cell, (sample, cell)."""
        model, part = self.directions[direction]
        distance = (part[:, np.newaxis] - model.parts(self.centres, decay)) / self.noise
        return np.exp(-0.5 * distance**2) / (math.sqrt(2.0 * math.pi) * self.noise)

    def surprise(self, cells: Array, delay: Array | float, jitter: Array | float) -> Array:
        """Minus the logarithm of the likelihood; what is beyond the cells counts as being in the outermost."""
        below = ndtr((self.edges[:, np.newaxis] - delay) / jitter)
        below[0], below[-1] = 0.0, 1.0
        return -np.log((1.0 - _OUTLIERS) * (cells @ np.diff(below, axis=0)) + _OUTLIERS).sum(axis=0)


def _fit(model: _Model, part: Array, noise: float) -> _Fit:
    """Most likely delay, jitter, rise and fall; sigma of the delay from the likelihood's curvature."""
    likelihood = _Likelihood(model, part, noise)
    shortest = _RESOLUTION * model.exposure_time / 4

    def with_decays(rise: float, fall: float) -> tuple[float, Array]:
        cells = np.vstack([likelihood.of_cells(0, rise), likelihood.of_cells(1, fall)])
        return _best_delay(likelihood, cells, model.exposure_time)

    rise, fall, of_decay = _decays(with_decays, model.exposure_time)
    least, found = with_decays(rise, fall)
    delay = float(found[0])
    jitter = shortest + math.exp(float(found[1]))
    cells = np.vstack([likelihood.of_cells(0, rise), likelihood.of_cells(1, fall)])
    step, worse = shortest, 0.0
    while worse < 0.5 and step < 100 * model.exposure_time:
        step *= 2.0
        worse = float(likelihood.surprise(cells, delay + np.array([step, -step]), jitter).mean()) - least
    sigma = step / math.sqrt(2.0 * worse) if worse > 0.0 else math.nan
    return _Fit(delay, math.hypot(sigma, of_decay), jitter if jitter > 8 * shortest else 0.0, rise, fall)


def _best_delay(likelihood: _Likelihood, cells: Array, exposure_time: float) -> tuple[float, Array]:
    """Least surprise with these cells, and the delay and the logarithm of the jitter above the shortest there."""
    shortest = _RESOLUTION * exposure_time / 4
    tried = np.meshgrid(
        np.linspace(likelihood.edges[0], likelihood.edges[-1], 60), exposure_time * 3.0 ** np.arange(-3, 3)
    )
    delays, jitters = (each.ravel() for each in tried)

    def surprise(values: Array) -> float:
        return float(np.squeeze(likelihood.surprise(cells, values[0], shortest + math.exp(min(values[1], 5.0)))))

    best = int(likelihood.surprise(cells, delays, jitters).argmin())
    begin = np.array([delays[best], math.log(jitters[best])])
    simplex = np.vstack([begin, begin + np.diag([jitters[best], -1.0])])
    options: Any = {"initial_simplex": simplex, "xatol": 1e-6, "fatol": 1e-4, "maxiter": 150}
    found = minimize(surprise, begin, method="Nelder-Mead", options=options)
    return float(found.fun), found.x


def _decays(
    with_decays: Callable[[float, float], tuple[float, Array]], exposure_time: float
) -> tuple[float, float, float]:
    """Most likely time constants of rise and fall, and what not knowing them adds to the sigma of the delay."""
    tried = [0.0, *(exposure_time * 4.0 ** np.arange(-1, 3))]
    # each time constant has to explain more than chance would
    decay = min(tried, key=lambda each: with_decays(each, each)[0] + (_WORTH if each > 0.0 else 0.0))
    if decay <= 0.0:
        return 0.0, 0.0, 0.0
    rise = fall = decay

    def scaled(rises: float, falls: float) -> tuple[float, Array]:
        return with_decays(rise * math.exp(rises), fall * math.exp(falls))

    def best(surprise: Callable[[float], float]) -> float:
        options: Any = {"xatol": 0.02, "maxiter": 12}
        found = minimize_scalar(surprise, bounds=(-1.5, 1.5), method="bounded", options=options)
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


# pulses of the light


def _refresh(samples: TimingSamples, settled: NDArray[np.bool_], dark: float) -> Refresh | None:
    """Pulses of settled bright light."""
    time, light = samples.stamp[settled], samples.brightness[settled] - dark
    if len(time) < 3 * _FEWEST:
        return None
    span = float(time.max() - time.min())
    light = light / light.mean() - 1.0
    tried = np.arange(*_FREQUENCIES, 0.2 / span)
    power = _line_strength(time, light, tried)
    strongest = float(tried[int(power.argmax())])
    if not _is_line(float(power.max()), len(time), len(tried)):
        return None
    strongest = _refined(time, light, strongest, span, 1)
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
    frequency = _refined(time, light, fundamental, span, fewest)
    sigma = _frequency_sigma(time, light, frequency, span, fewest)
    begin = time - samples.exposure_time / 2
    return Refresh(frequency, sigma, _waveform(begin * frequency, samples.exposure_time * frequency, light + 1.0))


def _waveform(begin: Array, length: float, seen: Array) -> Array:
    """Light in the bins of a period from means over times of a length [periods]: not negative, as even as can be."""
    edges = np.arange(_BINS + 1) / _BINS
    # how often each bin is met: whole periods, and the parts of a last one that begins in this and ends in the next
    whole, part = divmod(length, 1.0)
    phase = (begin % 1.0)[:, np.newaxis]
    met = np.zeros((len(begin), _BINS))
    for shift in (0.0, 1.0):
        met += np.diff(np.clip(edges + shift, phase, phase + part), axis=1)
    met += whole / _BINS
    even = _EVENNESS * (np.eye(_BINS) - np.roll(np.eye(_BINS), 1, axis=1))
    light, _ = nnls(np.vstack([met / length, even]), np.concatenate([seen, np.zeros(_BINS)]))
    return light / light.mean()


def _line_strength(time: Array, light: Array, frequencies: Array) -> Array:
    """Part of the variance that a sine of each frequency explains (Lomb 1976)."""
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
    """Noise explains that part of itself at one of so many frequencies with less than the allowed probability."""
    chance = frequencies * (1.0 - min(strength, 1.0 - 1e-12)) ** ((samples - 3) / 2)
    return chance < _FALSE_ALARM


def _harmonics(time: Array, light: Array, frequency: float, count: int) -> tuple[Array, Array]:
    """Amplitudes (2, harmonic) of cosines and sines, and what they and a constant make of each sample."""
    angle = 2.0 * np.pi * np.outer(time, frequency * np.arange(1, count + 1))
    matrix = np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(time))])
    solution, *_ = np.linalg.lstsq(matrix, light, rcond=None)
    return solution[:-1].reshape(2, count), matrix @ solution


def _left_over(time: Array, light: Array, frequency: float, count: int) -> float:
    return float(((light - _harmonics(time, light, frequency, count)[1]) ** 2).sum())


def _refined(time: Array, light: Array, frequency: float, span: float, count: int) -> float:
    """Frequency nearby that leaves the least squares."""
    width = 0.3 / span
    found = minimize_scalar(
        lambda each: _left_over(time, light, each, count),
        bounds=(frequency - width, frequency + width),
        method="bounded",
        options={"xatol": 1e-5 * width},
    )
    return float(found.x)


def _frequency_sigma(time: Array, light: Array, frequency: float, span: float, count: int) -> float:
    step = 0.02 / span
    least, *beside = (_left_over(time, light, frequency + shift, count) for shift in (0.0, step, -step))
    curvature = (sum(beside) - 2.0 * least) / step**2
    variance = least / max(len(time) - 2 * count - 2, 1)
    return math.sqrt(2.0 * variance / curvature) if curvature > 0.0 else math.nan


def _rounded(value: float, digits: int = 4) -> float | None:
    """Value for a file: so many significant digits; None for NaN."""
    return None if math.isnan(value) else float(f"{value:.{digits}g}")
