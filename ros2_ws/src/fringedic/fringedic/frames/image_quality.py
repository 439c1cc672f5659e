"""Quality of images before a measurement: full scale, noise, gradient, size and contrast of the texture."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.interpolate import CubicSpline

Image = NDArray[np.float64]


def full_scale_of(images: Sequence[np.ndarray]) -> float:
    """Return the full scale of the smallest usual number of bits (8, 10, 12, 14, 16) that holds every pixel.

    Parameters
    ----------
    images
        Grey levels, any shapes.

    Returns
    -------
    float
        Largest grey level; NaN for real numbers.

    Examples
    --------
    >>> full_scale_of([np.array([3, 700], np.uint16)])
    1023.0
    """
    if not all(np.issubdtype(image.dtype, np.integer) for image in images):
        return math.nan
    if all(image.dtype == np.uint8 for image in images):
        return 255.0
    brightest = max(int(image.max()) for image in images)
    return float(next(2**bits - 1 for bits in (8, 10, 12, 14, 16) if brightest < 2**bits))


def image_noise(first: Image, second: Image, seen: NDArray[np.bool_]) -> float:
    """Return the noise of a pixel from the difference of two exposures, corrected for small drift and flicker.

    The difference is regressed on a constant, the image and its gradient: a brightness change of the form a + b f and a
    motion d (as -d.grad f, to first order) do not count as noise.

    Parameters
    ----------
    first, second
        Images (row, column) [grey level] of the same scene.
    seen
        Booleans (row, column), True for the pixels that count.

    Returns
    -------
    float
        Standard deviation of one pixel's noise [grey level].
    """
    mean = np.asarray(0.5 * (first + second))
    along_x, along_y = _gradient(mean)
    inner = _interior(seen)
    basis = np.stack([np.ones(int(inner.sum())), mean[inner], along_x[inner], along_y[inner]], axis=1)
    difference = second[inner] - first[inner]
    return float(np.std(difference - _projection(basis, difference)) / math.sqrt(2))


def _projection(basis: Image, values: Image) -> Image:
    """Return the least-squares fit of a basis (value, function) to values, by normal equations."""
    return np.asarray(basis @ np.linalg.lstsq(basis.T @ basis, basis.T @ values, rcond=None)[0])


def _gradient(image: Image) -> tuple[Image, Image]:
    """Return central differences along x and along y."""
    return np.asarray(np.gradient(image, axis=1)), np.asarray(np.gradient(image, axis=0))


def _interior(seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels whose four neighbours are also in the mask, where central differences are valid."""
    inner = np.zeros_like(seen)
    inner[1:-1, 1:-1] = seen[1:-1, 1:-1] & seen[:-2, 1:-1] & seen[2:, 1:-1] & seen[1:-1, :-2] & seen[1:-1, 2:]
    return inner


def mean_gradient(image: Image, seen: NDArray[np.bool_]) -> float:
    """Return the mean intensity gradient [grey level / px]: mean magnitude of central differences.

    Parameters
    ----------
    image
        Grey levels (row, column).
    seen
        Booleans (row, column), True for the pixels that count.

    References
    ----------
    B. Pan, Z. Lu, H. Xie, "Mean intensity gradient: an effective global parameter for quality assessment of the speckle
    patterns used in digital image correlation", Optics and Lasers in Engineering 48 (2010) 469-477.
    """
    along_x, along_y = _gradient(image)
    return float(np.mean(np.hypot(along_x, along_y)[_interior(seen)]))


def texture(first: Image, second: Image, seen: NDArray[np.bool_]) -> tuple[tuple[float, float], float]:
    """Return the feature size along x and y [px] and the standard deviation of the texture [grey level].

    Both come from the correlation of two exposures, to which their independent noise does not contribute, after shading
    of second order is removed.

    Parameters
    ----------
    first, second
        Images (row, column) [grey level] of the same scene.
    seen
        Booleans (row, column), True for the pixels that count.

    Returns
    -------
    tuple
        ((along x, along y), standard deviation): full width at half maximum of the autocorrelation, NaN where it does
        not fall to a half.
    """
    rows, columns = first.shape
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    basis = np.stack([part[seen] for part in (np.ones_like(x), x, y, x * x, x * y, y * y)], axis=1)

    def without_shading(image: Image) -> Image:
        out = np.zeros_like(image)
        out[seen] = image[seen] - _projection(basis, image[seen])
        return out

    size = (next_fast_len(2 * rows, real=True), next_fast_len(2 * columns, real=True))

    def correlate(a: Image, b: Image) -> Image:
        return np.asarray(irfft2(np.conj(rfft2(a, size)) * rfft2(b, size), size))

    overlap = correlate(seen.astype(np.float64), seen.astype(np.float64))
    covariance = correlate(without_shading(first), without_shading(second)) / np.maximum(overlap, 0.5)
    height = float(covariance[0, 0])
    if height <= 0:
        return (math.nan, math.nan), 0.0
    along_x, along_y = covariance[0, : columns // 2] / height, covariance[: rows // 2, 0] / height
    return (_half_height_width(along_x), _half_height_width(along_y)), math.sqrt(height)


def _half_height_width(correlation: Image) -> float:
    """Return the full width at half maximum [px] of a symmetric peak that starts at its centre, or NaN."""
    below = np.flatnonzero(correlation < 0.5)
    if below.size == 0:
        return math.nan
    last = min(int(below[0]) + 3, correlation.size - 1)
    lags = np.arange(-last, last + 1)
    crossings = np.asarray(CubicSpline(lags, correlation[np.abs(lags)]).solve(0.5, extrapolate=False))
    return float(2 * crossings[crossings > 0].min())
