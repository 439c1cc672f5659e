"""The noise model of a camera: standard deviation of a grey level, and the level of saturation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

ROUNDING_NOISE = 1 / math.sqrt(12)  # of a grey level: standard deviation of a uniform error of one level


@dataclass(frozen=True)
class CameraNoise:
    """Noise of one grey level: ``sigma_I^2 = read^2 + shot * level``.

    Attributes
    ----------
    read
        Standard deviation without light, rounding included [grey level].
    shot
        Growth of the variance with the level, which is the gain of the camera [grey level / electron].

    References
    ----------
    European Machine Vision Association, "EMVA Standard 1288: Standard for characterization of image sensors and
    cameras", release 4.0 (2021), linear camera model.

    Examples
    --------
    >>> CameraNoise(read=1.0, shot=0.02).variance(np.array([0.0, 150.0]))
    array([1., 4.])
    """

    read: float
    shot: float = 0.0

    def variance(self, level: np.ndarray) -> np.ndarray:
        """Return the variance of grey levels, same shape [grey level^2]."""
        return self.read**2 + self.shot * level


def saturation_level(frames: np.ndarray, saturation: float | None = None) -> float:
    """Return the grey level from which a pixel counts as saturated.

    Parameters
    ----------
    frames
        Grey levels, any shape; only their type counts.
    saturation
        The level where it is known.

    Returns
    -------
    float
        `saturation` where given, the largest value of an unsigned integer type, infinity for real numbers.

    Examples
    --------
    >>> saturation_level(np.zeros(3, np.uint8)), saturation_level(np.zeros(3, np.uint16), 4095)
    (255.0, 4095)
    """
    if saturation is not None:
        return saturation
    return float(np.iinfo(frames.dtype).max) if frames.dtype.kind == "u" else math.inf
