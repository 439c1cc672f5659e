"""How far the texture of a reference stands out from its noise, and what that says when nothing can be measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np

from fringedic.correlation.pyramid import DERIVATIVE_NOISE, Level

f4 = np.float32

# Ratio of the gradient energy of a texture to that of the noise alone, at which few windows have enough of it, and at
# which nearly all have. test_coarse_and_faint_texture
FAINT = 3.0
CLEAR = 30.0
# Second derivative along rows and columns: a texture of several pixels hardly changes it.
_NOISE_ALONE = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], f4) / 6
_MEDIAN = 1.4826  # standard deviation of a normal distribution over its median absolute value
_AROUND = 33  # [px], width of the local means
# Share of the windows with less energy than the one that counts: most of an image may be a plain background, and edges
# of a specimen are few. test_plain_background_is_no_faint_texture
_POORER = 0.8
_STRIPES = 0.1  # largest part of the gradient energy that a texture of one direction has along its stripes
_NOTHING_BUT_NOISE = 0.7  # standard deviations of an image, from which its noise is nearly all of it


@dataclass(frozen=True)
class TextureNoise:
    """Texture of a level against its noise.

    The noise is that of a mixed second derivative (J. Immerkaer 1996, Fast noise variance estimation, Computer Vision
    and Image Understanding 64, 300-302).

    Attributes
    ----------
    ratio
        Gradient energy over that of noise alone, in a rich window.
    noise
        Standard deviation of the noise in the unit of the level.
    feature
        Area of a feature (speckle) [px^2], in a rich window.
    across
        Smaller over larger eigenvalue of the structure tensor without the noise, in the median window with texture.
    """

    ratio: float
    noise: float
    feature: float
    across: float

    @classmethod
    def of(cls, level: Level) -> Self:
        """Measure it on a level of a reference."""
        fine = cv2.filter2D(level.values, -1, _NOISE_ALONE)
        known = np.isfinite(fine)
        if not known.any():
            return cls(0.0, 0.0, np.inf, 0.0)
        noise = _MEDIAN * float(np.median(np.abs(fine[known])))
        alone = max(DERIVATIVE_NOISE * noise**2, 1e-30)
        gx, gy = level.along_x, level.along_y
        xx, yy, xy = (cv2.blur(each, (_AROUND, _AROUND)) for each in (gx * gx, gy * gy, gx * gy))
        mean, half = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
        textured = known & (mean > FAINT * alone)
        smaller, larger = (mean - half)[textured] - alone, (mean + half)[textured] - alone
        across = float(np.median(smaller / larger)) if textured.any() else 0.0
        values = np.where(np.isfinite(level.values), level.values, f4(0))
        spread = cv2.blur(values * values, (_AROUND, _AROUND)) - cv2.blur(values, (_AROUND, _AROUND)) ** 2
        energy = float(np.quantile(mean[known], _POORER))
        contrast = float(np.quantile(spread[known], _POORER)) - noise**2
        feature = np.pi * contrast / (energy - alone) if energy > alone else np.inf
        return cls(energy / alone, noise, feature, across)

    @property
    def sentence(self) -> str:
        """Why the texture gives no displacement, and what helps; empty where the texture is not the cause."""
        if self.ratio > FAINT:
            if self.across < _STRIPES:
                return (
                    "the texture of the reference has one direction (stripes): only the displacement across them "
                    "shows. Add a random pattern"
                )
            return ""
        if self.noise > _NOTHING_BUT_NOISE:
            return (
                "the texture of the reference does not stand out from the noise: it is too faint, or finer than two "
                "pixels. Use more light, average images, or apply a pattern with spots of three to five pixels"
            )
        return (
            "the texture of the reference is so coarse and faint that its slopes do not stand out from the noise of "
            "single pixels. Use a larger window, more light, or a finer pattern"
        )
