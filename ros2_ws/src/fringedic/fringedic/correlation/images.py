"""Checks of images, masks and settings, and the brightness of an image relative to its reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fringedic.correlation import image_kernels
from fringedic.errors import CorrelationError, ErrorCode, ImageError
from fringedic.wording.numbers import number_text

SMALLEST_WINDOW = 8  # [px], one cell of a pixel per node: see `window`
# An end of the grey levels is saturated if at least this share of the pixels is there, and this many times those in the
# next 1/64 of the range; test_saturated_ends_of_the_grey_levels.
SATURATED = 0.01
CROWDED = 4.0
MOST_CONTRAST = 10.0  # ratio of standard deviations; test_images_of_another_bit_depth_are_refused
# Standard deviations of the grey levels next to a saturated one: the interpolation between its neighbours is wrong
# there; test_saturation_on_one_side.
CUT = 0.5


@dataclass(frozen=True)
class Photometry:
    """Grey levels of a deformed image in standard deviations of its reference from the reference's mean.

    Attributes
    ----------
    gain, offset
        Give the deformed image the mean and the standard deviation of the reference.
    limits
        Grey levels between which the deformed image is not saturated; infinite where it has no such end.
    """

    gain: float
    offset: float
    limits: tuple[float, float]


def require_image(image: ArrayLike, name: str) -> np.ndarray:
    """Return a grey image (row, column) as uint8, uint16 or float32; `name` is its name in messages.

    Raises
    ------
    ImageError
        The image is in colour, has not two dimensions, no real pixel type, or fewer than 8 x 8 pixels.
    """
    array = np.asarray(image)
    if array.ndim == 3 and array.shape[-1] in (3, 4):
        raise ImageError(
            f"the {name} image is in colour (shape {array.shape}): convert it to grey first, for instance with "
            "cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)"
        )
    if array.ndim != 2:
        raise ImageError(f"the {name} image must have the dimensions (row, column), not the shape {array.shape}")
    if not (np.issubdtype(array.dtype, np.integer) or np.issubdtype(array.dtype, np.floating)):
        raise ImageError(f"the {name} image holds {array.dtype}: grey levels must be integers or real numbers")
    if min(array.shape) < SMALLEST_WINDOW:
        raise ImageError(
            f"the {name} image has {array.shape[0]} x {array.shape[1]} pixels (rows x columns): "
            f"at least {SMALLEST_WINDOW} each way are needed"
        )
    if array.dtype not in (np.uint8, np.uint16, np.float32):
        with np.errstate(over="ignore"):  # a number beyond all grey levels becomes infinite, which is not measured
            array = array.astype(np.float32)
    return np.ascontiguousarray(array)


def measure_grey_range(image: np.ndarray, name: str) -> tuple[float, float]:
    """Return mean and standard deviation of the measured pixels of an image.

    Raises
    ------
    CorrelationError
        No pixel is measured or all are equal.
    """
    rows = np.empty((image.shape[0], 3))
    image_kernels.sum_moments(image, rows)
    count, total, squares = rows.sum(axis=0)
    if count == 0:
        raise CorrelationError(
            f"the {name} image holds no measured pixel: all are NaN or infinite", code=ErrorCode.NO_TEXTURE
        )
    mean = float(total / count)
    deviation = float(np.sqrt(max(squares / count - mean * mean, 0.0)))
    if not deviation > 1e-6 * max(1.0, abs(mean)):
        raise CorrelationError(
            f"the {name} image is constant (grey level {mean:g}): a displacement needs a surface texture in focus",
            code=ErrorCode.NO_TEXTURE,
        )
    return mean, deviation


def find_saturation(image: np.ndarray) -> tuple[float, float]:
    """Return the grey levels at which an image of integers is saturated, dark and bright; infinite where it is not.

    A saturated end shows as a peak of the histogram. An image of two levels is not saturated. Real numbers are not
    examined: means of several images have no common end.
    """
    if not np.issubdtype(image.dtype, np.integer):
        return -np.inf, np.inf
    lowest, highest = int(image.min()), int(image.max())
    margin = max(1, (highest - lowest) // 64)
    counts = np.empty((image.shape[0], 4), np.int64)
    image_kernels.count_saturated(image, lowest, highest, margin, counts)
    at_low, near_low, at_high, near_high = counts.sum(axis=0)
    least = max(SATURATED * image.size, 16)
    if at_low + at_high > image.size / 2:
        return -np.inf, np.inf
    cut_low = at_low > least and at_low > CROWDED * (near_low - at_low)
    cut_high = at_high > least and at_high > CROWDED * (near_high - at_high)
    return float(lowest) if cut_low else -np.inf, float(highest) if cut_high else np.inf


def measure_photometry(image: np.ndarray, mean: float, deviation: float) -> Photometry:
    """Compare a deformed image with the mean and the standard deviation of its reference.

    Raises
    ------
    CorrelationError
        No pixel is measured, all are equal, or the contrast is that of another bit depth (code NO_CORRELATION).
    """
    own_mean, own_deviation = measure_grey_range(image, "deformed")
    if not 1 / MOST_CONTRAST < own_deviation / deviation < MOST_CONTRAST:
        raise CorrelationError(
            f"the grey levels of the deformed image vary by {number_text(own_deviation, 3)}, those of the reference by "
            f"{number_text(deviation, 3)} (standard deviations): save all images with the same bit depth, 8 or 16, and "
            "the same exposure time",
            code=ErrorCode.NO_CORRELATION,
        )
    lowest, highest = ((end - mean) / deviation for end in find_saturation(image))
    return Photometry(deviation / own_deviation, (mean - own_mean) / own_deviation, (lowest + CUT, highest - CUT))


def require_mask(mask: ArrayLike | None, shape: tuple[int, int]) -> np.ndarray | None:
    """Return the pixels to use as a boolean array of the image's shape, or None for all.

    Raises
    ------
    ImageError
        The mask has another shape than the images or excludes every pixel.
    """
    if mask is None:
        return None
    array = np.asarray(mask).astype(bool)
    if array.shape != shape:
        raise ImageError(f"the mask has the shape {array.shape}, the images {shape}: they must be equal")
    if not array.any():
        raise ImageError("the mask excludes every pixel: it must be True where the surface is to be measured")
    return array


def require_window(window: int, spacing: int, shape: tuple[int, int]) -> tuple[int, int]:
    """Return window and spacing as integers that fit the image.

    Raises
    ------
    CorrelationError
        One of them is no whole number or too small, or the window is larger than the image.
    """
    if int(window) != window or window < SMALLEST_WINDOW:
        raise CorrelationError(f"window = {window} px: it must be a whole number of at least {SMALLEST_WINDOW} px")
    if int(spacing) != spacing or spacing < 1:
        raise CorrelationError(f"spacing = {spacing} px: it must be a whole number of at least 1 px")
    if window > min(shape):
        raise CorrelationError(
            f"window = {window} px is larger than the image of {shape[0]} x {shape[1]} pixels (rows x columns)"
        )
    return int(window), int(spacing)
