"""Noise of the camera from a sample of a stack that may be faulty."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import nnls
from scipy.special import chdtri  # scipy.stats takes each node half a second to load

from fringedic.frames.noise import ROUNDING_NOISE, CameraNoise
from fringedic.phase.checks.misfit import remove_harmonics
from fringedic.phase.checks.sampling import Sample, fit_wave, wave_levels

_LEVELS = 8  # brightness classes


def estimate_sample_noise(sample: Sample) -> CameraNoise:
    """Return the noise of a grey level from the differences of two pixels along the fringes.

    A fault of a frame gives both pixels nearly the same residual, so that it does not count as noise. Without a pitch
    of more than three frames there are no residuals, and the noise of rounding is returned.
    """
    freedom = sum(max(count - 3, 0) for count in sample.layout.counts)
    if freedom == 0 or sample.levels.shape[1] < _LEVELS:
        return CameraNoise(ROUNDING_NOISE)
    squares = np.zeros(sample.levels.shape[1])
    for where, angles in zip(sample.layout.slices(), sample.angles, strict=True):
        if len(angles) == 3:
            continue
        first, second = (_residual(each[where], angles) for each in sample.along_fringes())
        squares += 0.5 * np.sum((first - second) ** 2, axis=0)
    level = np.mean([fit[0] for fit in sample.fits], axis=0)
    classes = np.array_split(np.argsort(level, kind="stable"), _LEVELS)
    means = np.array([level[each].mean() for each in classes])
    variance = np.array([np.median(squares[each]) for each in classes]) / chdtri(freedom, 0.5)
    read, shot = nnls(np.stack([np.ones_like(means), np.maximum(means, 0)], axis=1), variance)[0]
    return CameraNoise(max(math.sqrt(read), ROUNDING_NOISE), float(shot))


def _residual(levels: np.ndarray, angles: np.ndarray) -> np.ndarray:
    fit = fit_wave(levels, angles)
    return remove_harmonics(levels - wave_levels(fit, angles), fit, angles)
