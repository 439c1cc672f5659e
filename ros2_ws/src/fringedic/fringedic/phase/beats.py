"""Fringe orders of pitches that are nearly alike, from their beats (method of excess fractions).

No fringe covers the view, but the phases of all pitches agree at one position within the range in which no two
positions have the same phases, as the marks of several scales do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit, prange
from scipy.stats import chi2

from fringedic.phase.demodulation_kernel import CONFIDENCE
from fringedic.phase.layout import unambiguous_range

_FALSE_ALARM = 1e-6  # of a pixel whose phases agree, to be left out as one whose phases contradict each other


def combine_beats(
    phases: np.ndarray, sigmas: np.ndarray, pitches: Sequence[float], *, known_noise: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the absolute phase at the finest pitch from the wrapped phases of all pitches, and its deviation.

    At each pixel the position is chosen at which the phases agree best. It is measured where they agree as well as
    their noise allows (false alarm 1e-6), and where the next best position deviates by 5 standard deviations more. The
    position is the weighted mean of all pitches: n pitches that are alike have sqrt(n) less noise than one.

    Parameters
    ----------
    phases, sigmas
        Wrapped phases, zero on the projector axis, and their standard deviations [rad], float32, shape (pitch, row,
        column); NaN where not measured.
    pitches
        Coarse to fine [projector px].
    known_noise
        Whether `sigmas` are right; otherwise their scale is estimated from the disagreement of the phases.

    Returns
    -------
    phase, sigma : ndarray
        [rad at the finest pitch], float32, shape (row, column); NaN where not measured.

    References
    ----------
    C. Reich, R. Ritter, J. Thesing, "White light heterodyne principle for 3D-measurement", SPIE 3100 (1997) 236-244.

    C. E. Towers, D. P. Towers, J. D. C. Jones, "Absolute fringe order calculation using optimised multi-frequency
    selection in full-field profilometry", Optics and Lasers in Engineering 43 (2005) 788-800.

    Examples
    --------
    >>> truth = np.linspace(-900.0, 900.0, 7, dtype=np.float32).reshape(1, 7)  # [projector px]
    >>> pitches = [48.0, 45.0, 42.0]
    >>> wrapped = np.array([np.angle(np.exp(2j * np.pi * truth / pitch)) for pitch in pitches], np.float32)
    >>> phase, _ = combine_beats(wrapped, np.full(wrapped.shape, 0.01, np.float32), pitches, known_noise=True)
    >>> bool(abs(phase * 42 / (2 * np.pi) - truth).max() < 1e-3)
    True
    """
    shape = phases.shape[1:]
    position, variance, least, second = (np.full(shape, np.nan, np.float32) for _ in range(4))
    half = 0.5 * unambiguous_range(pitches)
    _excess_fractions(phases, sigmas, np.array(pitches), half, position, variance, least, second)
    freedom = len(pitches) - 1
    scale = 1.0
    if np.isfinite(least).any():
        scale = float(np.nanmedian(least)) / float(chi2.median(freedom))
        scale = max(scale, 1.0) if known_noise else scale
    with np.errstate(invalid="ignore"):
        sure = (least <= scale * chi2.isf(_FALSE_ALARM, freedom)) & (second - least > scale * CONFIDENCE**2)
    per_pixel = 2 * math.pi / pitches[-1]
    phase = np.where(sure, position * np.float32(per_pixel), np.float32(np.nan))
    sigma = np.where(sure, np.sqrt(scale * variance) * np.float32(per_pixel), np.float32(np.nan))
    return phase.astype(np.float32), sigma.astype(np.float32)


@njit(cache=True, nogil=True, parallel=True)
def _excess_fractions(
    phases: np.ndarray,
    sigmas: np.ndarray,
    pitches: np.ndarray,
    half: float,
    position: np.ndarray,
    variance: np.ndarray,
    least: np.ndarray,
    second: np.ndarray,
) -> None:
    """Write the position at which the phases agree best and its variance, and chi square there and at the next best."""
    count, rows, columns = phases.shape
    for row in prange(rows):
        fraction = np.empty(count)
        weight = np.empty(count)
        for column in range(columns):
            known = True
            total = 0.0
            for k in range(count):
                fraction[k] = phases[k, row, column] / (2 * np.pi)
                weight[k] = (2 * np.pi / (pitches[k] * sigmas[k, row, column])) ** 2
                total += weight[k]
                known &= np.isfinite(fraction[k]) and np.isfinite(weight[k])
            if not known:
                continue
            best = np.inf
            next_best = np.inf
            at = 0.0
            first = math.ceil(-half / pitches[0] - fraction[0])
            last = math.floor(half / pitches[0] - fraction[0])
            for order in range(first, last + 1):
                start = pitches[0] * (fraction[0] + order)
                mean = 0.0
                square = 0.0
                for k in range(1, count):
                    away = start / pitches[k] - fraction[k]
                    away = (np.floor(away + 0.5) - away) * pitches[k]
                    mean += weight[k] * away
                    square += weight[k] * away * away
                deviation = square - mean * mean / total
                if deviation < best:
                    next_best = best
                    best = deviation
                    at = start + mean / total
                elif deviation < next_best:
                    next_best = deviation
            position[row, column] = at
            variance[row, column] = 1.0 / total
            least[row, column] = best
            second[row, column] = next_best
