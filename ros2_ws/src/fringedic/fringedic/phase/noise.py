"""Noise of the camera, estimated from the residuals of phase-shifted frames."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls
from scipy.special import chdtri  # scipy.stats takes each node half a second to load

from fringedic.frames.exposures import ExposedStack
from fringedic.frames.noise import ROUNDING_NOISE, CameraNoise, saturation_level
from fringedic.patterns.pattern import ProjectedPattern
from fringedic.phase.layout import check_frames, layout_of, shift_angles
from fringedic.phase.sinusoids import fit_wave, remove_harmonics, wave_levels

# test_noise_is_estimated_from_the_stack: with so many pixels and classes read noise errs by less than 6 %, shot by 10 %
_SAMPLES = 15_000  # the noise is estimated from so many pixels
_LEVELS = 16  # brightness classes of that estimate
_NOISE_PIXELS = 60_000  # the estimate takes its sample from so many pixels of each exposure


def estimate_noise(
    frames: np.ndarray, patterns: Sequence[ProjectedPattern], *, saturation: float | None = None
) -> CameraNoise | None:
    """Estimate the noise of grey levels from the residuals of the fitted sinusoids.

    The variance of the residuals is sorted into classes of brightness. Medians are robust against edges and moving
    objects; the line of non-negative coefficients through them is the noise model. Harmonics of a nonlinear response
    are fitted first, with one strength for all pixels, and do not count as noise.

    Parameters
    ----------
    frames, patterns, saturation
        See `absolute_phase`; saturated pixels are left out.

    Returns
    -------
    CameraNoise or None
        None when no pitch has more than 3 frames, which leaves no residuals, or all pixels saturate.

    Raises
    ------
    PhaseError, ImageError
        See `absolute_phase`.

    Examples
    --------
    >>> from fringedic.patterns import fringe_sequence
    >>> sequence = fringe_sequence(200, 200, [200, 20], shifts=8)
    >>> noise = np.random.default_rng(1).normal(0.0, 2.0, (len(sequence), 200, 200))
    >>> frames = (np.array(list(sequence)) * 0.5 + noise).astype(np.float32)
    >>> round(estimate_noise(frames, sequence.patterns).read, 1)
    2.0
    """
    layout = layout_of(patterns)
    check_frames(frames, patterns)
    freedom = sum(count - 3 for count in layout.counts)
    if freedom == 0:
        return None
    skip = math.ceil(math.sqrt(frames[0].size / _SAMPLES))
    sample = frames[:, ::skip, ::skip].reshape(len(frames), -1)
    sample = sample[:, sample.max(axis=0) < saturation_level(frames, saturation)].astype(float)
    if sample.shape[1] == 0:
        return None
    unexplained = np.zeros(sample.shape[1])
    for period, where in zip(layout.periods, layout.slices(), strict=True):
        if len(period) > 3:
            levels, angles = sample[where], shift_angles(period)
            fit = fit_wave(levels, angles)
            unexplained += np.sum(remove_harmonics(levels - wave_levels(fit, angles), fit, angles) ** 2, axis=0)
    return noise_of_residuals(sample[layout.code :].mean(axis=0), unexplained, freedom)


def noise_of_residuals(texture: np.ndarray, unexplained: np.ndarray, freedom: int) -> CameraNoise:
    """Return the noise of grey levels from the sums of squared residuals of pixels, see `estimate_noise`.

    Parameters
    ----------
    texture
        Mean grey level of each pixel, shape (pixel,).
    unexplained, freedom
        Sum of the squared residuals of each pixel [grey level^2] and its degrees of freedom.
    """
    classes = np.array_split(np.argsort(texture, kind="stable"), min(_LEVELS, len(texture)))
    level = np.array([texture[each].mean() for each in classes])
    variance = np.array([np.median(unexplained[each]) for each in classes]) / chdtri(freedom, 0.5)
    read_variance, shot = nnls(np.stack([np.ones_like(level), level], axis=1), variance)[0]
    return CameraNoise(max(math.sqrt(read_variance), ROUNDING_NOISE), float(shot))


def phase_deviation(deviation: ArrayLike, modulation: ArrayLike, frames: int) -> np.ndarray:
    """Return the standard deviation of the phase of `frames` phase-shifted frames, sqrt(2/N) sigma_I / B.

    Parameters
    ----------
    deviation, modulation
        Standard deviation of a grey level and modulation B [grey level], arrays that broadcast.
    frames
        Number of frames of the pitch, whole cycles of its shifts.

    Returns
    -------
    ndarray
        [rad], float64; infinite where there is no modulation.

    References
    ----------
    Y. Surrel, "Additive noise effect in digital phase detection", Applied Optics 36 (1997) 271-276.

    Examples
    --------
    >>> round(float(phase_deviation(1.0, 50.0, 8)), 3)
    0.01
    """
    with np.errstate(divide="ignore"):
        return np.asarray(math.sqrt(2 / frames) * np.asarray(deviation, float) / np.asarray(modulation, float))


def noise_of_exposures(exposures: Sequence[ExposedStack], saturation: float | None) -> CameraNoise | None:
    """Estimate the noise, which does not depend on the exposure time, from all exposures together."""
    skip = max(1, math.isqrt(exposures[0].frames[0].size // _NOISE_PIXELS))
    pixels = np.concatenate([each.frames[:, ::skip, ::skip] for each in exposures], axis=2)
    return estimate_noise(pixels, exposures[0].patterns, saturation=saturation)
