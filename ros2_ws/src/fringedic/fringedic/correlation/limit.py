"""Cramer-Rao bound of the displacement: the noise that no unbiased measurement with the same window can go below."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from fringedic.correlation.transfer import noise_gain, window_deviation
from fringedic.errors import CorrelationError
from fringedic.wording.arguments import array, check_arguments


@check_arguments(CorrelationError, texture=array(2), variance=array(2))
def displacement_limit(texture: np.ndarray, variance: np.ndarray, window: int) -> np.ndarray:
    """Return the Cramer-Rao bound of a displacement between two images with the same noise.

    The Fisher matrix of a displacement d is the sum of g g^T / (2 s^2) over the pixels that the window averages, g
    being the gradient of the texture and s^2 the noise of each image. It grows with the number of pixels: the bound is
    that of the window, not of the image.

    Parameters
    ----------
    texture
        (row, column) [grey level]; NaN is not measured.
    variance
        Of its noise, same shape [grey level^2]. The part of the gradients that is noise is subtracted.
    window
        Of `measure_displacement` [px].

    Returns
    -------
    ndarray
        Standard deviations along x (right) and y (down) [px], float64 (2, row, column); infinity where the texture
        does not fix both components, NaN where it is not measured.

    Raises
    ------
    CorrelationError
        The shapes differ.

    References
    ----------
    S. M. Kay, "Fundamentals of Statistical Signal Processing: Estimation Theory" (1993), chapter 3.

    Examples
    --------
    >>> texture = 100 + 20 * np.random.default_rng(1).normal(size=(64, 64))
    >>> smooth = gaussian_filter(texture, 1.5)
    >>> noise = np.full(texture.shape, 0.1**2)
    >>> small, large = (displacement_limit(smooth, noise, window)[0, 32, 32] for window in (16, 32))
    >>> bool(1.7 < small / large < 2.5)
    True
    """
    if texture.shape != variance.shape:
        raise CorrelationError(
            f"texture of shape {texture.shape} and variance of shape {variance.shape}: give one shape"
        )
    measured = np.isfinite(texture) & np.isfinite(variance) & (variance > 0)
    down, right = np.gradient(np.where(measured, texture, np.nan))
    noise = variance / 2  # of a central difference
    deviation = window_deviation(window)
    fisher = [_average(each, 2 * variance, deviation) for each in (right**2 - noise, down**2 - noise, right * down)]
    xx, yy, xy = (each / noise_gain(window) for each in fisher)
    determinant = xx * yy - xy**2
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = np.stack([yy, xx]) / determinant
    fixed = (determinant > 0) & (xx > 0) & (yy > 0)
    limits: np.ndarray = np.where(measured, np.sqrt(np.where(fixed, bounds, np.inf)), np.nan)
    return limits


def _average(product: np.ndarray, noise: np.ndarray, deviation: float) -> np.ndarray:
    """Return the local mean of a product of gradients over the noise, of what is measured."""
    known = np.isfinite(product)
    weight = gaussian_filter(known.astype(float), deviation)
    values = gaussian_filter(np.where(known, product / np.where(known, noise, 1.0), 0.0), deviation)
    result: np.ndarray = values / np.maximum(weight, 1e-12)
    return result
