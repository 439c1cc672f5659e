"""Noise of the camera from a sample of a stack that may be faulty."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import nnls
from scipy.special import chdtri  # scipy.stats takes each node half a second to load

from fringedic.frames.noise import ROUNDING_NOISE, CameraNoise
from fringedic.phase.checks.sampling import Sample
from fringedic.phase.sinusoids import fit_wave, remove_harmonics, wave_levels

_LEVELS = 8  # brightness classes
_PIXELS = 2000  # the median of 250 pixels of each class errs by some per cent


def estimate_sample_noise(sample: Sample) -> CameraNoise:
    """Return the noise of a grey level from the differences of two pixels along the fringes.

    A fault of a frame gives both pixels residuals in proportion to their brightness, so that it does not count as
    noise, on a texture neither. Three frames of a pitch leave no residual; where no pitch has more, the means of the
    pitches are compared. A single pitch of three frames gives the noise of rounding.
    """
    freedom = sum(max(count - 3, 0) for count in sample.layout.counts)
    residuals = _residuals if freedom else _differences_of_means
    freedom = freedom or len(sample.layout.counts) - 1
    if freedom == 0 or sample.levels.shape[1] < _LEVELS:
        return CameraNoise(ROUNDING_NOISE)
    sample = sample.thin(_PIXELS)
    neighbours = sample.along_fringes()
    first, second = (residuals(each, sample) for each in neighbours)
    one, other = (each[sample.layout.code :].mean(axis=0) for each in neighbours)
    away = first * other - second * one  # 0 where both residuals are the same part of the brightness
    squares = np.sum(away**2, axis=0) / np.maximum(one**2 + other**2, np.float32(1e-6))
    level = np.mean([fit[0] for fit in sample.fits], axis=0)
    classes = np.array_split(np.argsort(level, kind="stable"), _LEVELS)
    means = np.array([level[each].mean() for each in classes])
    variance = np.array([np.median(squares[each]) for each in classes]) / chdtri(freedom, 0.5)
    read, shot = nnls(np.stack([np.ones_like(means), np.maximum(means, 0)], axis=1), variance)[0]
    return CameraNoise(max(math.sqrt(read), ROUNDING_NOISE), float(shot))


def _residuals(levels: np.ndarray, sample: Sample) -> np.ndarray:
    """Return the residuals of the sinusoids of all pitches, shape (frame, pixel)."""
    parts = []
    for where, angles in zip(sample.layout.slices(), sample.angles, strict=True):
        if len(angles) > 3:
            fit = fit_wave(levels[where], angles)
            parts.append(remove_harmonics(levels[where] - wave_levels(fit, angles), fit, angles))
    return np.concatenate(parts)


def _differences_of_means(levels: np.ndarray, sample: Sample) -> np.ndarray:
    """Return the mean of each pitch minus that of all, with the variance of a frame, shape (pitch, pixel)."""
    means = np.stack([levels[where].mean(axis=0) for where in sample.layout.slices()])
    counts = np.array(sample.layout.counts)[:, None]
    return np.asarray(np.sqrt(counts) * (means - np.sum(counts * means, axis=0) / counts.sum()))
