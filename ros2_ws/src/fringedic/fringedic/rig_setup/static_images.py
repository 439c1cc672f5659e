"""Three images of a specimen at rest: their check and their figures (grey levels, noise, features, gradient)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringedic.correlation.images import require_image, require_mask
from fringedic.errors import ImageError
from fringedic.frames.image_quality import full_scale_of, image_noise, mean_gradient, texture

NAMES = ("reference", "first static", "second static")


@dataclass(frozen=True)
class StaticImages:
    """A reference and two static images of one size.

    Attributes
    ----------
    stored
        The three images (row, column) with the grey levels as given.
    mask
        Booleans (row, column), True where the surface is to be measured; None for all of it.
    measured
        Booleans (row, column), True where the mask allows it and all three images have a value.
    """

    stored: tuple[np.ndarray, ...]
    mask: NDArray[np.bool_] | None
    measured: NDArray[np.bool_]

    @classmethod
    def checked(
        cls, reference: ArrayLike, static_1: ArrayLike, static_2: ArrayLike, mask: ArrayLike | None
    ) -> StaticImages:
        """Return the images after checking that they can be compared.

        Raises
        ------
        ImageError
            An image or the mask is invalid, or the sizes differ.
        """
        stored = tuple(
            require_image(image, name) for image, name in zip((reference, static_1, static_2), NAMES, strict=True)
        )
        shape = (stored[0].shape[0], stored[0].shape[1])
        for image, name in zip(stored[1:], NAMES[1:], strict=True):
            if image.shape != shape:
                raise ImageError(
                    f"the {name} image has the shape {image.shape}, the reference {shape}: they must be equal"
                )
        allowed = require_mask(mask, shape)
        measured = np.isfinite(stored[0]) & np.isfinite(stored[1]) & np.isfinite(stored[2])
        if allowed is not None:
            measured &= allowed
        if not measured.any():
            raise ImageError("no pixel is measured in all three images: all are NaN, infinite or outside the mask")
        return cls(stored, allowed, measured)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.stored[0].shape[0], self.stored[0].shape[1]


@dataclass(frozen=True)
class ImageFigures:
    """Figures of the images; the attributes are those of `fringedic.Advice`."""

    full_scale: float
    quantisation: float
    saturated: float
    dark: float
    grey_range: tuple[float, float]
    coverage: float
    image_noise: float
    contrast: float
    feature_size: tuple[float, float]
    mean_gradient: float


def describe_images(images: StaticImages, full_scale: float | None) -> ImageFigures:
    """Return the figures of the images; the full scale is estimated when it is None."""
    measured = images.measured
    grey = images.stored[0][measured]
    largest = full_scale_of(images.stored) if full_scale is None else float(full_scale)
    # Integers may be stored in steps: 16 for 12 bits in the upper part of 16.
    if not np.issubdtype(grey.dtype, np.integer):
        quantisation = math.nan
    else:
        levels = np.unique(grey)
        quantisation = float(np.gcd.reduce(np.diff(levels))) if levels.size > 1 else math.nan
    low, high = (float(value) for value in np.percentile(grey, (1, 99)))
    filled = [np.where(measured, image, 0).astype(np.float64) for image in images.stored]
    feature_size, contrast = texture(filled[1], filled[2], measured)
    if math.isnan(largest):
        saturated = math.nan
    else:
        saturated = float(np.mean(grey > largest - (quantisation if quantisation > 0 else 0.5)))
    return ImageFigures(
        full_scale=largest,
        quantisation=quantisation,
        saturated=saturated,
        dark=float(np.mean(grey <= 0)),
        grey_range=(low, high),
        coverage=float(np.mean(grey < 0.5 * (low + high))),
        image_noise=image_noise(filled[1], filled[2], measured),
        contrast=contrast,
        feature_size=feature_size,
        mean_gradient=mean_gradient(np.mean(filled, axis=0), measured),
    )
