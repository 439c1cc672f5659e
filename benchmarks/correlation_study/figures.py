"""Figures of merit from measured fields: noise, transfer, bias with its standard error, autocorrelation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from correlation_study.estimators import Measured
from correlation_study.scenes import AMPLITUDE, DIRECTIONS, PERIODS, SHIFTS, Task
from fringedic.correlation.transfer import KEPT

MARGIN = 56  # [px] left out at the border by every estimator alike


def static_noise(task: Task, measured: Measured) -> float:
    """Standard deviation over the points and pairs, the worse component [px]."""
    errors = measured.inside(task.images.shape[1:], MARGIN).errors(task)
    return float(np.sqrt(np.nanmean(np.nanvar(errors, axis=(2, 3)), axis=0).max()))


def gains(task: Task, measured: Measured) -> np.ndarray:
    """Gain (direction, period, component) of the waves against the longest one's."""
    inner = measured.inside(task.images.shape[1:], MARGIN)
    x, y = np.meshgrid(inner.columns.astype(float), inner.rows.astype(float))
    found = []
    for field, motion in zip(inner.fields, task.truth, strict=True):
        wave = motion(x, y)[0] / AMPLITUDE
        seen = np.isfinite(field).all(axis=0)
        basis = np.stack([wave[seen], np.ones(seen.sum())], axis=1)
        found.append(np.linalg.lstsq(basis, field[:, seen].T, rcond=None)[0][0] / AMPLITUDE)
    gain = np.array(found).reshape(len(DIRECTIONS), len(PERIODS), 2)
    return gain / gain[:, :1]


def cut_off(gain: np.ndarray) -> float:
    """Longest period [px] at which any wave and component has lost 10 %."""
    worst = 0.0
    periods = np.array(PERIODS)
    for one in gain.transpose(0, 2, 1).reshape(-1, periods.size):
        if not (one < KEPT).any():
            worst = max(worst, periods[-1])
            continue
        k = int(np.argmax(one < KEPT))
        worst = max(worst, float(np.interp(KEPT, one[[k, k - 1]], periods[[k, k - 1]])))
    return worst


@dataclass(frozen=True)
class Filter:
    """What an estimator at one setting does to waves and noise."""

    noise: float  # [px]
    period: float  # with 10 % amplitude loss [px]
    overshoot: float  # of the gain over 1
    gain: np.ndarray

    @property
    def product(self) -> float:
        """Noise times period [px^2]."""
        return self.noise * self.period


def filter_of(static: Task, still: Measured, moving: Task, waves: Measured) -> Filter:
    """Noise and transfer of an estimator at one setting."""
    gain = gains(moving, waves)
    return Filter(static_noise(static, still), cut_off(gain), float(gain.max()) - 1, gain)


@dataclass(frozen=True)
class Translations:
    """Errors of rigid translations: mean and standard deviation by shift, and the standard error of the mean."""

    shifts: np.ndarray
    mean: np.ndarray  # over both components, points and repeats [px]
    deviation: np.ndarray  # (shift, component) [px]
    standard_error: float  # of one mean [px]

    @property
    def resolution(self) -> float:
        """Standard deviation of the error over all shifts and components [px]."""
        return float(np.sqrt(np.mean(self.deviation**2)))

    @property
    def bias(self) -> float:
        """Largest mean error over the shifts [px]."""
        return float(np.abs(self.mean).max())

    @property
    def bias_rms(self) -> float:
        """Root mean square of the mean errors [px]."""
        return float(np.sqrt(np.mean(self.mean**2)))


BLOCKS = 4  # per axis, for the standard error: far wider than a window, so that they are independent


def translation_errors(
    task: Task, measured: Measured, shifts: np.ndarray = SHIFTS, margin: int = MARGIN
) -> Translations:
    """Bias and resolution over the shifts; every shift has the same number of pairs, one after the other."""
    e = measured.inside(task.images.shape[1:], margin).errors(task)
    e = e.reshape(len(shifts), -1, *e.shape[1:])  # shift, repeat, component, row, column
    mean = np.nanmean(e, axis=(1, 2, 3, 4))
    deviation = np.sqrt(np.nanmean(np.nanvar(e, axis=(3, 4)), axis=1))
    blocks = [
        np.nanmean(part, axis=(3, 4))
        for rows in np.array_split(e, BLOCKS, axis=3)
        for part in np.array_split(rows, BLOCKS, axis=4)
    ]
    scattered = np.stack(blocks, axis=-1).reshape(len(shifts), -1)
    spread = np.sqrt(np.mean(np.var(scattered, axis=1, ddof=1)))
    return Translations(np.asarray(shifts), mean, deviation, float(spread / np.sqrt(scattered.shape[1])))


def root_mean_square(task: Task, measured: Measured, margin: int = MARGIN) -> np.ndarray:
    """RMSE [px] of each pair, the worse component."""
    errors = measured.inside(task.images.shape[1:], margin).errors(task)
    return np.sqrt(np.nanmean(errors**2, axis=(2, 3))).max(axis=1)


def autocorrelation_diameter(fields: np.ndarray, spacing: int) -> float:
    """Diameter [px] at which the autocorrelation of error maps (map, row, column) has fallen to a half.

    Of the circle with the area in which it is above a half, by linear interpolation along rays from the centre.
    """
    rows, columns = fields.shape[-2:]
    padded = np.fft.rfft2(fields - fields.mean(axis=(-2, -1), keepdims=True), (2 * rows, 2 * columns))
    total = np.fft.irfft2(np.mean(np.abs(padded) ** 2, axis=tuple(range(fields.ndim - 2))), (2 * rows, 2 * columns))
    overlap = np.outer(*(n - np.abs(np.fft.fftfreq(2 * n) * 2 * n) for n in (rows, columns)))
    correlation = np.fft.fftshift(total / np.maximum(overlap, 1))[rows - 60 : rows + 61, columns - 60 : columns + 61]
    correlation /= correlation[60, 60]
    radius = np.arange(0, 55, 0.1)
    half = []
    for angle in np.linspace(0, np.pi, 24, endpoint=False):
        ray = map_coordinates(correlation, [60 + radius * np.sin(angle), 60 + radius * np.cos(angle)], order=3)
        half.append(radius[np.argmax(ray < 0.5)])
    return float(2 * np.sqrt(np.mean(np.square(half))) * spacing)


def brick_wall_bound(contrast: float, radius: float, noise: float) -> float:
    """Noise times period [px^2] of an ideal low-pass filter at the Cramer-Rao bound.

    Spots of standard deviation `radius` [px] give a gradient of contrast / (sqrt(2) radius) along either axis; the
    noise of one pixel's displacement is sqrt(2) `noise` over it, of which a brick wall at the period P keeps pi / P^2.
    """
    return float(np.sqrt(2 * np.pi) * noise * np.sqrt(2) * radius / contrast)
