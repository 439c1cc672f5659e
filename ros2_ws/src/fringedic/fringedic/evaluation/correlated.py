"""Correlation of errors between neighbouring points, from their map."""

from __future__ import annotations

import numpy as np
from scipy import fft
from scipy.ndimage import label

_CORRELATED = 0.1  # a smaller coefficient is the noise of its estimate


def correlated_points(errors: np.ndarray) -> float:
    """Return how many neighbouring points share one independent error.

    It is the sum of the correlation coefficient over all lags, estimated from the map itself (not from its deviation
    from the mean, so that a systematic error is correlated everywhere). The mean of n errors of standard deviation s
    has the variance s^2 times this number over n.

    Parameters
    ----------
    errors : (row, column)
        NaN where not measured.

    Returns
    -------
    float
        1 for independent errors, at most the number of points.

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(size=(100, 100))
    >>> round(correlated_points(noise)), round(correlated_points(np.kron(noise, np.ones((3, 3)))))
    (1, 9)
    """
    known = np.isfinite(errors)
    if not known.any() or not np.nanmax(np.abs(errors)) > 0:
        return 1.0
    shape = [fft.next_fast_len(2 * n, real=True) for n in errors.shape]
    products, pairs = (
        fft.irfft2(np.abs(fft.rfft2(values, shape)) ** 2, shape)
        for values in (np.where(known, errors, 0.0).astype(np.float32), known.astype(np.float32))
    )
    many = pairs > 0.5 * np.count_nonzero(known)  # fewer pairs give no coefficient
    coefficient = np.where(many, products / np.maximum(pairs, 1.0), 0.0) * pairs[0, 0] / products[0, 0]
    patches, _ = label(fft.fftshift(coefficient) > _CORRELATED)
    centre = patches[shape[0] // 2, shape[1] // 2]
    return float(np.sum(fft.fftshift(coefficient)[patches == centre]))
