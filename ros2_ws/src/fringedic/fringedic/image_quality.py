"""What images are, before anything is measured in them: grey levels, noise, size and contrast of the texture."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.interpolate import CubicSpline

Image = NDArray[np.float64]


def full_scale_of(images: Sequence[np.ndarray]) -> float:
    """Full scale of the fewest usual bits (8, 10, 12, 14, 16) that hold every pixel; NaN for real numbers."""
    if not all(np.issubdtype(image.dtype, np.integer) for image in images):
        return math.nan
    if all(image.dtype == np.uint8 for image in images):
        return 255.0
    brightest = max(int(image.max()) for image in images)
    return float(next(2**bits - 1 for bits in (8, 10, 12, 14, 16) if brightest < 2**bits))


def image_noise(first: Image, second: Image, seen: NDArray[np.bool_]) -> float:
    """Noise of a pixel from the difference of two exposures, without what a small drift and flicker put into it.

    The difference is regressed on brightness, the image and its gradient: a brightness change of the form a + b f and a
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
    inner = _eroded(seen)
    basis = np.stack([np.ones(int(inner.sum())), mean[inner], along_x[inner], along_y[inner]], axis=1)
    difference = second[inner] - first[inner]
    return float(np.std(difference - _explained(basis, difference)) / math.sqrt(2))


def _explained(basis: Image, values: Image) -> Image:
    """The part of values that a basis (value, function) explains; by normal equations, as it has few functions."""
    return np.asarray(basis @ np.linalg.lstsq(basis.T @ basis, basis.T @ values, rcond=None)[0])


def _gradient(image: Image) -> tuple[Image, Image]:
    """Central differences along columns and rows."""
    return np.asarray(np.gradient(image, axis=1)), np.asarray(np.gradient(image, axis=0))


def _eroded(seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels whose four neighbours are seen, where central differences hold."""
    inner = np.zeros_like(seen)
    inner[1:-1, 1:-1] = seen[1:-1, 1:-1] & seen[:-2, 1:-1] & seen[2:, 1:-1] & seen[1:-1, :-2] & seen[1:-1, 2:]
    return inner


def mean_gradient(image: Image, seen: NDArray[np.bool_]) -> float:
    """Mean intensity gradient of the pixels `seen`: mean magnitude of central differences [grey level / px]."""
    along_x, along_y = _gradient(image)
    return float(np.mean(np.hypot(along_x, along_y)[_eroded(seen)]))


def texture(first: Image, second: Image, seen: NDArray[np.bool_]) -> tuple[tuple[float, float], float]:
    """Feature size along columns and rows [px] and standard deviation of the texture [grey level].

    From the correlation of two exposures, in which their noise has no part, after shading of second order is removed.

    Parameters
    ----------
    first, second
        Images (row, column) [grey level] of the same scene.
    seen
        Booleans (row, column), True for the pixels that count.

    Returns
    -------
    tuple
        ((along columns, along rows), standard deviation): full width at half height of the autocorrelation, NaN where
        it does not fall to a half.
    """
    rows, columns = first.shape
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    basis = np.stack([part[seen] for part in (np.ones_like(x), x, y, x * x, x * y, y * y)], axis=1)

    def flat(image: Image) -> Image:
        out = np.zeros_like(image)
        out[seen] = image[seen] - _explained(basis, image[seen])
        return out

    size = (next_fast_len(2 * rows, real=True), next_fast_len(2 * columns, real=True))

    def correlated(a: Image, b: Image) -> Image:
        return np.asarray(irfft2(np.conj(rfft2(a, size)) * rfft2(b, size), size))

    overlap = correlated(seen.astype(np.float64), seen.astype(np.float64))
    covariance = correlated(flat(first), flat(second)) / np.maximum(overlap, 0.5)
    height = float(covariance[0, 0])
    if height <= 0:
        return (math.nan, math.nan), 0.0
    along_x, along_y = covariance[0, : columns // 2] / height, covariance[: rows // 2, 0] / height
    return (_half_height_width(along_x), _half_height_width(along_y)), math.sqrt(height)


def _half_height_width(correlation: Image) -> float:
    """Full width [px] of a symmetric peak, given from its centre on, at half its height; NaN where it does not fall."""
    below = np.flatnonzero(correlation < 0.5)
    if below.size == 0:
        return math.nan
    last = min(int(below[0]) + 3, correlation.size - 1)
    lags = np.arange(-last, last + 1)
    crossings = np.asarray(CubicSpline(lags, correlation[np.abs(lags)]).solve(0.5, extrapolate=False))
    return float(2 * crossings[crossings > 0].min())
