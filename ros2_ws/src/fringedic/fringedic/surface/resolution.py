"""Error of a strain map by the smoothing of its own window, estimated from the map itself.

The measured strain is the true one smoothed by the window, S e. What smoothing takes away, e - S e, is estimated along
rows and along columns by three terms of the van Cittert iteration from the measured strain m,

    (1 - S) m + (1 - S)^2 m + (1 - S)^3 m

with the moving mean over the window for S. The first term is -M/2 times the second derivative of the strain, with the
second moment M of the window; at an edge, where windows are one-sided, it contains the first derivative too. The
contributions of both directions are added as squares, because they often have opposite signs while the errors remain,
and averaged over two thirds of the window, because the estimate changes its sign beside a maximum.

Noise has second derivatives too. The mean square is multiplied by 1 - 1.5 / F, at least 0, with the mean square F of
the first term over its expectation for noise alone, averaged over the components: where the strain is uniform the
estimate is zero at most points.

It is a size without a sign, for a strain that the window resolves at least in part; it cannot contain what the window
has removed completely.

Reference: P. H. van Cittert (1931), Zum Einfluss der Spaltbreite auf die Intensitaetsverteilung in Spektrallinien II,
Zeitschrift fuer Physik 69, 298-308.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit, prange

from fringedic.correlation.transfer import noise_transfer
from fringedic.surface.coarse_grid import (
    by_point,
    coarse_half,
    fill_from_nearest,
    interpolate_column,
    interpolate_row,
    window_means,
)

_TERMS = 3
_NOISE_FACTOR = 1.5  # the mean square of the first term has to exceed this multiple of that for noise
_FREQUENCIES = 2048


def estimate_resolution(
    strain: np.ndarray, sigmas: np.ndarray, half: tuple[int, int], step: int, gain: float
) -> np.ndarray:
    """Return the expected error of strain maps by the smoothing of their window.

    Parameters
    ----------
    strain : (component, row, column)
        Measured strain.
    sigmas : (component, row, column)
        Their standard deviations.
    half
        Half-width of the window in points (rows, columns).
    step
        Distance of the points that the result is computed at, in points.
    gain
        From `smoothing_gain`.

    Returns
    -------
    ndarray
        Of the shape and precision of `strain`, NaN where it is NaN.
    """
    coarse = strain[:, ::step, ::step].astype(float)
    known = np.isfinite(coarse).all(axis=0)
    rows, columns = coarse_half(half, step)
    near = (max(1, 2 * rows // 3), max(1, 2 * columns // 3))
    along = [_removed(coarse, known, each) for each in ((rows, 0), (0, columns))]
    first, squares = (window_means(one**2 + other**2, known, near) for one, other in zip(*along, strict=True))
    noise = gain * sigmas[:, ::step, ::step].astype(float) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):  # without noise, or without any change of the strain
        squares = squares * np.maximum(0.0, 1.0 - _NOISE_FACTOR / (first / noise).mean(axis=0))
    found = np.empty_like(strain)
    _interpolate_roots(by_point(fill_from_nearest(squares)), step, strain, found)
    return found


@lru_cache(maxsize=64)
def smoothing_gain(window: int, method: str, half: tuple[int, int], spacing: tuple[int, int], step: int) -> float:
    """Return the mean square of the first term for noise, over the variance of the noise of the strain.

    `window` [px] and `method` are those of `measure_displacement`; `half` and `spacing` [px] as in
    `fringedic.surface.noise_correlation`, `step` as in `estimate_resolution`.
    """
    frequency = np.arange(_FREQUENCIES) / (2 * _FREQUENCIES)  # [1/point]
    gain = 0.0
    for points, coarse, distance in zip(half, coarse_half(half, step), spacing, strict=True):
        spectrum = noise_transfer(frequency / distance, window, method) ** 2
        waves = 2 * np.pi * np.outer(frequency, np.arange(1, points + 1))
        ramp, flat = np.sin(waves) @ np.arange(1, points + 1), 1 + 2 * np.cos(waves).sum(axis=1)
        mean = np.cos(2 * np.pi * step * np.outer(frequency, np.arange(-coarse, coarse + 1))).mean(axis=1)
        for weights in (ramp, flat):  # e_11 and e_22 contain one of each, e_12 half of both
            power = spectrum * weights**2
            gain += 0.5 * float(power @ (1 - mean) ** 2 / power.sum())
    return gain


def _removed(strain: np.ndarray, known: np.ndarray, half: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the first term, and the sum of all terms, for windows of a half-width in coarse points."""
    first = strain - window_means(strain, known, half)
    term = total = first
    for _ in range(_TERMS - 1):
        term = term - window_means(term, known, half)
        total = total + term
    return first, total


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _interpolate_roots(squares: np.ndarray, step: int, strain: np.ndarray, found: np.ndarray) -> None:
    count, rows, columns = strain.shape
    for i in prange(rows):
        line, values = np.empty(squares.shape[1:]), np.empty(count)
        interpolate_row(squares, step, i, line)
        for j in range(columns):
            interpolate_column(line, step, j, values)
            for k in range(count):
                found[k, i, j] = np.sqrt(values[k]) if np.isfinite(strain[k, i, j]) else np.nan
