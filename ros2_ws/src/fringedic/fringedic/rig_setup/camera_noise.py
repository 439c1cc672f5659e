"""Read noise and shot noise of the camera, estimated from frames of a scene at rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from fringedic.errors import RigSetupError
from fringedic.frames.image_quality import full_scale_of
from fringedic.frames.noise import CameraNoise

FEWEST_STEPS = 3  # a variance over fewer frames has an uncertainty of 100 %
_SAMPLED = 100_000  # pixels of each frame
_CLASSES = 24  # pixels are sorted into so many classes of brightness
_CLEAR = 4  # standard deviations between a pixel and either end of the scale, so that clipping is rarer than 1e-4


@dataclass(frozen=True)
class EstimatedCameraNoise:
    """Noise of the camera's pixels with the values that it was fitted to.

    Attributes
    ----------
    noise
        Read and shot noise, rounding to grey levels included.
    level, variance
        Means over the pixels of each class of brightness, shape (class,) [grey level, grey level^2].
    flicker
        Standard deviation of the light from step to step over its mean; it is not part of the noise.
    """

    noise: CameraNoise
    level: np.ndarray
    variance: np.ndarray
    flicker: float


def thinned(image: np.ndarray) -> np.ndarray:
    """Return every n-th pixel in both directions, about as many as the estimate of the noise needs."""
    every = math.ceil(math.sqrt(image.size / _SAMPLED))
    return image[::every, ::every]


def estimate_camera_noise(
    frames: Sequence[Sequence[np.ndarray]], *, full_scale: float | None = None
) -> EstimatedCameraNoise:
    """Estimate read and shot noise of a camera from frames of a scene at rest (photon transfer).

    Parameters
    ----------
    frames
        ``frames[k]``: images (row, column) of unsigned integers [grey level] with the same pattern, one per step and
        at least three. Each is scaled to their common mean first, which separates flicker from noise.
    full_scale
        Grey level of a saturated pixel; by default that of the fewest usual bits that hold all pixels.

    Raises
    ------
    RigSetupError
        There are fewer than three steps, or every pixel is black or saturated.

    References
    ----------
    Janesick, "Photon Transfer" (2007); European Machine Vision Association, "EMVA Standard 1288", release 4.0 (2021).

    Examples
    --------
    >>> import numpy as np
    >>> random = np.random.default_rng(1)
    >>> scene = np.tile(np.linspace(20, 220, 300), (300, 1))
    >>> images = [np.uint8(np.rint(random.normal(scene, np.sqrt(1.5**2 + 0.05 * scene)))) for _ in range(8)]
    >>> noise = estimate_camera_noise([images]).noise
    >>> round(noise.read, 1), round(noise.shot, 2)
    (1.5, 0.05)
    """
    if not frames or min(len(each) for each in frames) < FEWEST_STEPS:
        raise RigSetupError(f"a noise floor needs at least {FEWEST_STEPS} steps at rest")
    if full_scale is None:
        full_scale = full_scale_of([image for each in frames for image in each])
    moments = [found for found in (_pixel_moments(each, full_scale) for each in frames) if found is not None]
    if not moments:
        raise RigSetupError("every pixel is black or saturated: set the exposure first (`fringedic live`)")
    levels, variances, flickers = zip(*moments, strict=True)
    level = np.concatenate(levels)
    variance = np.concatenate(variances)
    margin = _CLEAR * math.sqrt(float(np.median(variance)))
    inner = (level > margin) & (level < full_scale - margin)
    level, variance = (level[inner], variance[inner]) if inner.any() else (level, variance)
    classes = np.array_split(np.argsort(level, kind="stable"), min(_CLASSES, level.size))
    mean_level = np.array([level[each].mean() for each in classes])
    mean_variance = np.array([variance[each].mean() for each in classes])
    weight = 1 / np.maximum(mean_variance, 1e-12)
    basis = np.stack([np.ones_like(mean_level), mean_level], axis=1) * weight[:, None]
    read_variance, shot = nnls(basis, mean_variance * weight)[0]
    return EstimatedCameraNoise(
        CameraNoise(math.sqrt(read_variance), float(shot)),
        mean_level,
        mean_variance,
        float(np.mean(np.array(flickers))),
    )


def _pixel_moments(images: Sequence[np.ndarray], full_scale: float) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Return mean and variance of the pixels that are never clipped, and the flicker; None where there are none."""
    sample = np.stack([thinned(image) for image in images]).reshape(len(images), -1)
    clipped = (sample == 0).any(axis=0) | (sample >= full_scale).any(axis=0)
    grey = sample[:, ~clipped].astype(np.float64)
    if grey.shape[1] == 0:
        return None
    brightness = grey.mean(axis=1)
    grey *= (brightness.mean() / brightness)[:, None]
    return grey.mean(axis=0), grey.var(axis=0, ddof=1), float(brightness.std(ddof=1) / brightness.mean())
