"""Noise gain of slopes over a window that is caused by the correlation of neighbouring errors.

Errors of the in-plane displacement are correlated over the width of its window, those of the height over the width of
the Gaussian that smoothed it and of the interpolation. For weights k of a fit and errors of equal variance with the
correlation rho, the variance of the fitted slope is larger than with independent errors by

    sum over lags of A(lag) rho(lag) / A(0),   A(lag) = sum_i k_i k_(i + lag)
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fringedic.correlation.transfer import error_correlation
from fringedic.surface.coupling_kernels import cubic
from fringedic.surface.prepared import sample_gaussian

_FRACTIONS = 16  # the interpolation is averaged over so many parts of a pixel


def height_correlation(z_filter: float, interpolated: bool) -> np.ndarray:
    """Return the covariance of errors of the height at lags 0, 1, 2... along an axis, over the variance at a pixel.

    `z_filter` is the standard deviation of the Gaussian [px]. Interpolation is averaged over all fractions of a pixel.
    """
    half = sample_gaussian(z_filter)
    kernel = np.concatenate([half[:0:-1], half])
    own = np.correlate(kernel, kernel, "full")[len(kernel) - 1]
    if not interpolated:
        return np.asarray(np.correlate(kernel, kernel, "full")[len(kernel) - 1 :] / own)
    fractions = (np.arange(_FRACTIONS) + 0.5) / _FRACTIONS
    both = [np.convolve(kernel, cubic(fraction)) for fraction in fractions]
    return np.asarray(np.mean([np.correlate(each, each, "full")[len(each) - 1 :] for each in both], axis=0) / own)


@lru_cache(maxsize=64)
def height_gains(z_filter: float, interpolated: bool, half: tuple[int, int], spacing: tuple[int, int]) -> np.ndarray:
    """Return the gains of the variance of slopes of the height by x and by y, shape (2,).

    `half` is the half-width of the window in points (rows, columns), `spacing` their distance [px].
    """
    along = height_correlation(z_filter, interpolated)
    ramp, flat = (
        np.array([weight(n) @ _at(along, step, n) for n, step in zip(half, spacing, strict=True)])
        for weight in (_ramp, _flat)
    )
    return np.array([ramp[1] * flat[0], flat[1] * ramp[0]])


@lru_cache(maxsize=64)
def displacement_gains(window: int, method: str, half: tuple[int, int], spacing: tuple[int, int]) -> np.ndarray:
    """Return the gains of the variance of slopes of the in-plane displacement by x and by y, shape (2,).

    `window` [px] and `method` are those of `measure_displacement`; `half` and `spacing` as in `height_gains`.
    """
    reach = max(n * step for n, step in zip(half, spacing, strict=True)) * 2 + 1
    correlation = error_correlation(window, method, reach)
    rows, columns = (np.arange(2 * n + 1) * step for n, step in zip(half, spacing, strict=True))
    lags = correlation[np.ix_(rows, columns)]
    return np.array([_flat(half[0]) @ lags @ _ramp(half[1]), _ramp(half[0]) @ lags @ _flat(half[1])])


def _at(values: np.ndarray, spacing: int, half: int) -> np.ndarray:
    """Return the values at multiples of the spacing, as many as a window has lags."""
    found = values[::spacing][: 2 * half + 1]
    return np.pad(found, (0, 2 * half + 1 - len(found)))


def _both_signs(weights: np.ndarray) -> np.ndarray:
    """Return the autocorrelation of weights over that at lag 0, lags of both signs summed."""
    lags = np.correlate(weights, weights, "full")[len(weights) - 1 :]
    lags[1:] *= 2
    return np.asarray(lags / lags[0])


def _ramp(half: int) -> np.ndarray:
    return _both_signs(np.arange(-half, half + 1.0))


def _flat(half: int) -> np.ndarray:
    return _both_signs(np.ones(2 * half + 1))
