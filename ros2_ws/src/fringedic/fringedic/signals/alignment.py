"""Offset and drift between the clocks of two recordings of one quantity, from the quantity itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.signal import fftconvolve
from scipy.sparse import csr_array

from fringedic.errors import RecordingError
from fringedic.signals.signal import Signal
from fringedic.wording.numbers import counted, number_text

CRYSTAL_DRIFT = 1e-4  # standard uncertainty of the drift between two crystal clocks, before anything is measured
_BANDWIDTHS = (1.0, 2.0, 4.0, 8.0)  # of the smoothing, in sample intervals of the slower recording
_REACH = 4.0  # bandwidths after which the weights are nothing
_MARGIN = 3.0  # bandwidths beside an end or a gap, where the two would be smoothed differently
_MOST_POINTS = 40_000  # of the common times; a longer record is compared at longer intervals
_LEAST_OVERLAP = 0.25  # of the shorter recording
_FEWEST = 12  # common times
_ITERATIONS = 30
_CONVERGED_S = 1e-6
_LARGEST_DRIFT = 0.02
_SINGULAR = 1e-9
_UNFIXED_S = 0.5  # a standard uncertainty of the offset beyond which the shape of the signal fixes nothing
_AGREEMENT = 0.02  # squared difference over the variance, below which both signals have the same gain and level
_LEAST_MISFIT = 1e-4  # of signals without noise
_RIDGE = 3.0  # times the misfit, between two offsets that are not the same one
_AS_GOOD = 1.5  # another offset with less than this misfit cannot be excluded
_NO_DRIFT = 4.0  # standard uncertainties beyond which the drift is none of crystal clocks
_GAP = 10.0  # sample intervals without a sample, after which the clock may have jumped
_MOST_GAPS = 5  # that are examined
_JUMP = 5.0  # standard uncertainties


@dataclass(frozen=True)
class ClockFit:
    """How the clock of a file ran against the clock of the rig.

    Attributes
    ----------
    offset
        Clock of the file minus that of the rig [s] at `since`.
    drift
        Growth of this offset [s/s].
    since
        Stamp on the clock of the file [ns].
    sigma_offset, sigma_drift, correlation
        Standard uncertainties of both, and their correlation.
    """

    offset: float
    drift: float
    since: int
    sigma_offset: float
    sigma_drift: float
    correlation: float = 0.0

    def applied_to(self, signal: Signal) -> Signal:
        """Return a signal of the file with the stamps of the rig's clock."""
        return signal.on_the_clock_of_the_rig(self.offset, self.drift, self.since)

    def sigma_at(self, stamps: np.ndarray) -> np.ndarray:
        """Return the standard uncertainty [s] of times on the clock of the file [ns].

        Examples
        --------
        >>> ClockFit(0.0, 0.0, 0, 3e-3, 4e-5).sigma_at(np.array([0, 100 * 10**9])).round(6).tolist()
        [0.003, 0.005]
        """
        since = 1e-9 * (stamps - self.since)
        mixed = 2 * self.correlation * self.sigma_offset * self.sigma_drift * since
        return np.sqrt(np.maximum(self.sigma_offset**2 + mixed + (self.sigma_drift * since) ** 2, 0.0))


@dataclass(frozen=True)
class Alignment:
    """The clocks of two recordings, and the values that they were fitted to.

    Attributes
    ----------
    clock
        Clock of the file against that of the rig.
    gain, level
        The signal of the rig is `gain` times that of the file plus `level`.
    stamps
        Common times on the clock of the rig [ns], shape (n,).
    rig, file
        Smoothed values of the rig, and of the file with gain and level, shape (n,).
    residual_sigma
        Root mean square of their difference.
    unusual_drift
        Whether the drift is larger than that of crystal clocks, and was fitted without assuming them.
    """

    clock: ClockFit
    gain: float
    level: float
    stamps: np.ndarray
    rig: np.ndarray
    file: np.ndarray
    residual_sigma: float
    unusual_drift: bool


class _Series(NamedTuple):
    """Times [s], values, and the noise of the values."""

    time: np.ndarray
    value: np.ndarray
    noise: np.ndarray


class _Fit(NamedTuple):
    """Solution of one bandwidth: offset at the middle, drift, gain and level, their covariance, and the data."""

    parameters: np.ndarray
    covariance: np.ndarray
    middle: float
    time: np.ndarray
    rig: np.ndarray
    file: np.ndarray

    @property
    def sigma(self) -> float:
        return float(np.sqrt(self.covariance[0, 0]))


def align_clocks(rig: Signal, file: Signal) -> Alignment:
    """Estimate offset and drift between two clocks from a quantity that was recorded with both.

    Both recordings are smoothed with the same kernel (local lines with Gaussian weights), so that neither noise nor
    sampling attracts the estimate; the signal of the rig is fitted by that of the file with an offset and a drift of
    the clock, a gain and a level. The uncertainty contains the noise of both, and deviations that the noise does not
    explain. The drift has the prior of crystal clocks, 0 with a standard uncertainty of 100 ppm, unless the signals
    contradict it.

    Parameters
    ----------
    rig, file
        The same quantity on the clocks of the rig and of the file, in the same unit; sign, gain and zero may differ.

    Returns
    -------
    Alignment
        Its clock is that of the file against the rig.

    Raises
    ------
    RecordingError
        The recordings have too few samples in common; the quantity has too little structure: it is constant, a
        straight line, or repeats itself; or the clock of the file jumped while it had no samples.

    References
    ----------
    J. Fan, I. Gijbels (1996), Local Polynomial Modelling and Its Applications, chapter 2. W. A. Fuller (1987),
    Measurement Error Models, for the correction of noisy regressors.

    Examples
    --------
    >>> from fringedic.signals.signal import FORCE
    >>> time = np.arange(0, 120, 0.1)
    >>> def force(t):
    ...     return 100.0 * np.interp(t, [0, 20, 40, 60, 80, 110], [0, 2, 2, 6, 6, 7]) + 3 * np.sin(200 * t)
    >>> rig, file = (Signal(FORCE, np.rint(1e9 * (time + o)).astype(np.int64), force(time), 0 * time) for o in (0, 7))
    >>> round(align_clocks(rig, file).clock.offset, 2)
    7.0
    """
    slower = max(_interval(rig), _interval(file), _duration(rig, file) / _MOST_POINTS)
    series = _series(rig, slower), _series(file, slower)
    _refuse_jumps(*series, slower)
    start = _coarse_offset(*series, slower)
    fits = [fit for scale in _BANDWIDTHS if (fit := _fit(*series, slower, scale * slower, start)) is not None]
    if not fits or min(fit.sigma for fit in fits) > _UNFIXED_S:
        raise RecordingError(_unfixed(rig))
    best = min(fits, key=lambda fit: fit.sigma)
    parameters, covariance, unusual = _with_prior(best)
    origin = int(rig.stamps[0])
    drift = parameters[1] / (1 + parameters[1])
    sigmas = np.sqrt(np.diag(covariance)[:2])
    clock = ClockFit(
        offset=float(parameters[0]) + 1e-9 * (int(file.stamps[0]) - origin),
        drift=float(drift),
        since=int(file.stamps[0]) + round(1e9 * (best.middle + parameters[0])),
        sigma_offset=float(sigmas[0]),
        sigma_drift=float(sigmas[1]),
        correlation=float(covariance[0, 1] / (sigmas[0] * sigmas[1])),
    )
    return Alignment(
        clock=clock,
        gain=float(parameters[2]),
        level=float(parameters[3]),
        stamps=origin + np.rint(1e9 * best.time).astype(np.int64),
        rig=best.rig,
        file=best.file,
        residual_sigma=float(np.sqrt(np.mean((best.rig - best.file) ** 2))),
        unusual_drift=unusual,
    )


def _unfixed(signal: Signal) -> str:
    return (
        f"the {signal.channel.name} has too little structure to fix the offset of the clocks: a constant or a straight "
        "ramp fits at any offset; use another signal that both have (--by), or give the offset (--offset)"
    )


def _interval(signal: Signal) -> float:
    """Return the usual time between two samples [s]."""
    measured = signal.stamps[np.isfinite(signal.values)]
    steps = np.diff(measured)
    if measured.size < _FEWEST or not (steps > 0).any():
        raise RecordingError(_few_samples(signal, measured.size))
    return 1e-9 * float(np.median(steps[steps > 0]))


def _few_samples(signal: Signal, count: int) -> str:
    owner = signal.channel.source or "one recording"
    return (
        f"the {signal.channel.name} of {owner} has {counted(count, 'sample')}: the clocks need {_FEWEST} or more; use "
        "another signal (--by), or give the offset (--offset)"
    )


def _duration(rig: Signal, file: Signal) -> float:
    return 1e-9 * min(float(np.ptp(rig.stamps)), float(np.ptp(file.stamps)))


def _series(signal: Signal, slower: float) -> _Series:
    """Return a signal since its first stamp, without NaN; samples that are much denser than the other's are averaged.

    The noise of a sample is its deviation from the line through its neighbours (T. Gasser et al. 1986).
    """
    measured = np.isfinite(signal.values)
    time = 1e-9 * (signal.stamps[measured] - signal.stamps[0])
    value = signal.values[measured]
    bins = np.floor(time / (slower / 4)).astype(np.int64)
    _, place, counts = np.unique(bins, return_inverse=True, return_counts=True)
    if counts.size < time.size:
        time, value = (np.bincount(place, weights=each) / counts for each in (time, value))
    if time.size < _FEWEST:
        raise RecordingError(_few_samples(signal, time.size))
    order = np.argsort(time, kind="stable")
    time, value = time[order], value[order]
    before, after = time[1:-1] - time[:-2], time[2:] - time[1:-1]
    weight = after / (before + after)
    deviation = value[1:-1] - weight * value[:-2] - (1 - weight) * value[2:]
    deviation /= np.sqrt(1 + weight**2 + (1 - weight) ** 2)
    return _Series(time, value, np.pad(np.abs(deviation), 1, mode="edge"))


def _coarse_offset(rig: _Series, file: _Series, slower: float) -> float:
    """Return the offset at which the signals correlate best [s], to a sample of the slower one."""
    step = max(slower, (rig.time[-1] + file.time[-1]) / (8 * _MOST_POINTS))
    grids = [np.arange(0, each.time[-1], step) for each in (rig, file)]
    a, b = (np.interp(grid, each.time, each.value) for grid, each in zip(grids, (rig, file), strict=True))
    level, scale = a.mean(), a.std() or 1.0
    a, b = ((each - level) / scale for each in (a, b))
    one_a, one_b = np.ones_like(a), np.ones_like(b)
    count, sum_a, sum_b, aa, bb, ab = (
        fftconvolve(first[::-1], second)
        for first, second in ((one_a, one_b), (a, one_b), (one_a, b), (a * a, one_b), (one_a, b * b), (a, b))
    )
    count = np.maximum(np.rint(count), 1)
    enough = count >= max(_FEWEST, _LEAST_OVERLAP * min(a.size, b.size))
    spread_a, spread_b = aa - sum_a**2 / count, bb - sum_b**2 / count
    varied = enough & (spread_a > 1e-3 * aa.max()) & (spread_b > 1e-3 * bb.max())
    if not varied.any():
        raise RecordingError(
            "the signals of recording and file do not change while both may have been recorded; use another signal "
            "(--by), or give the offset (--offset)"
        )
    with np.errstate(all="ignore"):
        correlation = np.where(varied, (ab - sum_a * sum_b / count) / np.sqrt(spread_a * spread_b), 0.0)
        scaled = 1 - correlation**2
        # as they are, without a gain and a level, under which each step of a staircase equals the next one
        direct = np.where(varied, (aa + bb - 2 * ab) / count / np.sqrt(spread_a * spread_b) * count, np.inf)
    overlap = np.sqrt(count / count.max())
    direct_best, scaled_best = int(np.argmin(direct / overlap)), int(np.argmax(np.abs(correlation) * overlap))
    agree = direct[direct_best] < _AGREEMENT
    misfit, best = (direct, direct_best) if agree else (scaled, scaled_best)
    _refuse_repetition(misfit, best, step, count)
    return float((best - (a.size - 1)) * step)


def _refuse_repetition(misfit: np.ndarray, best: int, step: float, count: np.ndarray) -> None:
    """Refuse signals that fit at another offset about as well: the misfit there is compared with that at the best."""
    floor = max(float(misfit[best]), _LEAST_MISFIT)
    ridges = np.flatnonzero(misfit > _RIDGE * floor)
    place = int(np.searchsorted(ridges, best))
    lower = int(ridges[place - 1]) if place > 0 else 0
    upper = int(ridges[place]) if place < ridges.size else misfit.size
    others = count >= count[best] / 2
    others[lower:upper] = False
    if others.any() and float(misfit[others].min()) < _AS_GOOD * floor:
        as_good = np.flatnonzero(others & (misfit < _AS_GOOD * floor))
        other = int(as_good[np.argmin(np.abs(as_good - best))])
        raise RecordingError(
            f"the signal repeats itself: the file fits as well {number_text(abs(other - best) * step, 4)} s "
            f"{'later' if other < best else 'earlier'}; use another signal (--by), or give the offset (--offset)"
        )


def _smoother(series: _Series, at: np.ndarray, width: float) -> csr_array:
    """Return the operator of local lines with Gaussian weights: one row per time, one column per sample."""
    first = np.searchsorted(series.time, at - _REACH * width)
    last = np.searchsorted(series.time, at + _REACH * width, "right")
    counts = last - first
    begins = np.concatenate([[0], np.cumsum(counts)])
    rows = np.repeat(np.arange(at.size), counts)
    columns = np.arange(begins[-1]) + (first - begins[:-1])[rows]
    distance = (series.time[columns] - at[rows]) / width
    # every sample stands for the time between its neighbours, so that denser parts have no larger weight
    weight = np.exp(-0.5 * distance**2) * np.gradient(series.time)[columns]
    moments = [np.bincount(rows, weights=weight * distance**power, minlength=at.size) for power in range(3)]
    determinant = moments[0] * moments[2] - moments[1] ** 2
    known = determinant > _SINGULAR * moments[0] ** 2
    scale = np.where(known, 1 / np.where(known, determinant, 1.0), 0.0)
    values = weight * (moments[2][rows] - distance * moments[1][rows]) * scale[rows]
    return csr_array((values, columns, begins), shape=(at.size, series.time.size))


def _well_inside(series: _Series, at: np.ndarray, width: float) -> np.ndarray:
    """Return the times that are away from the ends and gaps of a series."""
    margin = _MARGIN * width
    inside = (at >= series.time[0] + margin) & (at <= series.time[-1] - margin)
    steps = np.diff(series.time)
    for gap in np.flatnonzero(steps > max(3 * width, _GAP * float(np.median(steps)))):
        inside &= (at < series.time[gap] - margin) | (at > series.time[gap + 1] + margin)
    return np.asarray(inside)


def _fit(rig: _Series, file: _Series, step: float, width: float, start: float) -> _Fit | None:
    """Fit offset, drift, gain and level at one bandwidth; None if the signals do not fix them."""
    begin, end = max(0.0, -start), min(rig.time[-1], file.time[-1] - start)
    grid = np.arange(begin, end, step)
    grid = grid[_well_inside(rig, grid, width) & _well_inside(file, grid + start, width + step)]
    if grid.size < _FEWEST:
        return None
    middle = float(0.5 * (grid[0] + grid[-1]))
    of_rig = _smoother(rig, grid, width)
    smooth = of_rig @ rig.value
    since = grid - middle
    parameters = np.array([start, 0.0, 1.0, 0.0])
    model = _linearise(file, grid, since, width, parameters)
    parameters[2:] = np.polyfit(model.value, smooth, 1)
    for _ in range(_ITERATIONS):
        model = _linearise(file, grid, since, width, parameters)
        residual = smooth - parameters[2] * model.value - parameters[3]
        right = model.jacobian.T @ residual
        right[2] += parameters[2] * model.value_noise
        scale = 1 / np.maximum(np.sqrt(np.sum(model.jacobian**2, axis=0)), 1e-300)
        scaled = scale * model.jacobian
        change = scale * np.linalg.lstsq(scaled.T @ scaled, scale * right, rcond=1e-12)[0]
        parameters = parameters + change
        if abs(parameters[0] - start) > 2 * width + step or abs(parameters[1]) > _LARGEST_DRIFT:
            return None
        if abs(change[0]) < _CONVERGED_S and abs(change[1]) * np.ptp(grid) < _CONVERGED_S:
            break
    inverse = _inverse(model.normal)
    if inverse is None:
        return None
    gain = parameters[2]
    parts = ((of_rig, rig.noise), (model.smoother, gain * file.noise))
    projected = [(operator.T @ model.jacobian) * noise[:, None] for operator, noise in parts]
    explained = (of_rig.power(2) @ rig.noise**2).sum() + gain**2 * model.value_noise
    unexplained = max(float(residual @ residual - explained), 0.0) / grid.size
    moment = sum(part.T @ part for part in projected)
    moment = moment + unexplained * _correlated_moment(model.jacobian, width / step)
    covariance = inverse @ moment @ inverse
    return _Fit(parameters, covariance, middle, grid, smooth, gain * model.value + parameters[3])


class _Linear(NamedTuple):
    """The file smoothed at the common times: value, derivatives by the parameters, and what its noise adds to both."""

    smoother: csr_array
    value: np.ndarray
    jacobian: np.ndarray
    normal: np.ndarray
    value_noise: float


def _linearise(file: _Series, grid: np.ndarray, since: np.ndarray, width: float, parameters: np.ndarray) -> _Linear:
    at = grid + parameters[0] + parameters[1] * since
    half = width / 10
    smoother = _smoother(file, at, width)
    derivative = (_smoother(file, at + half, width) - _smoother(file, at - half, width)) / (2 * half)
    value, slope, gain = smoother @ file.value, derivative @ file.value, parameters[2]
    jacobian = np.column_stack([gain * slope, gain * slope * since, value, np.ones_like(value)])
    slope_noise = gain**2 * (derivative.power(2) @ file.noise**2)
    value_noise = float((smoother.power(2) @ file.noise**2).sum())
    # noise increases the squares of its regressors, which would promise a smaller uncertainty
    normal = jacobian.T @ jacobian
    normal[0, 0] -= slope_noise.sum()
    normal[[0, 1], [1, 0]] -= slope_noise @ since
    normal[1, 1] -= slope_noise @ since**2
    normal[2, 2] -= value_noise
    return _Linear(smoother, value, jacobian, normal, value_noise)


def _inverse(normal: np.ndarray) -> np.ndarray | None:
    """Return the inverse of a normal matrix; None if the data do not fix the parameters."""
    if np.any(np.diag(normal) <= 0):
        return None
    scale = 1 / np.sqrt(np.diag(normal))
    scaled = scale[:, None] * normal * scale
    if np.linalg.eigvalsh(scaled)[0] <= _SINGULAR:
        return None
    return np.asarray(scale[:, None] * np.linalg.inv(scaled) * scale)


def _correlated_moment(jacobian: np.ndarray, width: float) -> np.ndarray:
    """Return J' K J, where K is the correlation of deviations that were smoothed with a width [points]."""
    reach = int(np.ceil(3 * np.sqrt(2) * width))
    kernel = np.exp(-0.25 * (np.arange(-reach, reach + 1) / width) ** 2)
    smoothed = np.column_stack([fftconvolve(column, kernel, "same") for column in jacobian.T])
    return np.asarray(jacobian.T @ smoothed)


def _with_prior(fit: _Fit) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return parameters and covariance with the prior of the drift, unless the fit contradicts it."""
    variance = fit.covariance[1, 1] + CRYSTAL_DRIFT**2
    if abs(fit.parameters[1]) > _NO_DRIFT * np.sqrt(variance):
        return fit.parameters, fit.covariance, True
    gain = fit.covariance[:, 1] / variance
    return fit.parameters - gain * fit.parameters[1], fit.covariance - np.outer(gain, fit.covariance[1]), False


def _refuse_jumps(rig: _Series, file: _Series, slower: float) -> None:
    """Refuse a file whose clock changed against that of the rig while it has no samples."""
    gaps = np.flatnonzero(np.diff(file.time) > max(_GAP * slower, 1.0))
    if not 0 < gaps.size <= _MOST_GAPS:
        return
    for gap in gaps:
        parts = [_Series(*(each[part] for each in file)) for part in (slice(None, gap + 1), slice(gap + 1, None))]
        before, after = (_fit_alone(rig, part, slower, 2 * slower) for part in parts)
        if before is None or after is None:
            continue
        jump = float(after.parameters[0] - before.parameters[0])
        if abs(jump) > max(_JUMP * np.hypot(before.sigma, after.sigma), slower):
            raise RecordingError(
                f"the clock of the file jumps by {number_text(jump, 3)} s while it has no samples, "
                f"{number_text(float(file.time[gap]), 6)} s after its first one; attach the lines before and after it "
                "as two files (--lines, --name)"
            )


def _fit_alone(rig: _Series, part: _Series, slower: float, width: float) -> _Fit | None:
    """Fit a part of a file; None if it does not fix the clock."""
    begin = part.time[0]
    if part.time.size < _FEWEST:
        return None
    try:
        start = _coarse_offset(rig, part._replace(time=part.time - begin), slower) + begin
    except RecordingError:
        return None
    return _fit(rig, part, slower, width, start)
