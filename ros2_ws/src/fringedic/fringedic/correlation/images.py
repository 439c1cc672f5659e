"""Checks of what people hand in, and images as float32 arrays in which NaN means "not measured"."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fringedic.correlation import kernels
from fringedic.errors import (
    ColourImageError,
    EmptyMaskError,
    ImageSizeError,
    ImageTypeError,
    ShapeMismatchError,
    TexturelessImageError,
    WindowError,
)

SMALLEST_WINDOW = 8


def checked_image(image: ArrayLike, name: str) -> np.ndarray:
    """A grey image (row, column) of a real pixel type; `name` is what messages call it.

    Raises
    ------
    ColourImageError, ImageTypeError, ImageSizeError, TexturelessImageError
    """
    array = np.asarray(image)
    if array.ndim == 3 and array.shape[-1] in (3, 4):
        raise ColourImageError(
            f"the {name} image is in colour (shape {array.shape}): convert it to grey first, for instance with "
            "cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)"
        )
    if array.ndim != 2:
        raise ImageSizeError(f"the {name} image must have the dimensions (row, column), not the shape {array.shape}")
    if not (np.issubdtype(array.dtype, np.integer) or np.issubdtype(array.dtype, np.floating)):
        raise ImageTypeError(f"the {name} image holds {array.dtype}: grey levels must be integers or real numbers")
    if min(array.shape) < SMALLEST_WINDOW:
        raise ImageSizeError(
            f"the {name} image has {array.shape[0]} x {array.shape[1]} pixels (rows x columns): "
            f"at least {SMALLEST_WINDOW} each way are needed"
        )
    if array.dtype not in (np.uint8, np.uint16, np.float32):
        array = array.astype(np.float32)
    return np.ascontiguousarray(array)


def grey_range(image: np.ndarray, name: str) -> tuple[float, float]:
    """Mean and standard deviation of the measured pixels of an image.

    Raises
    ------
    TexturelessImageError
        When no pixel is measured or all are equal.
    """
    rows = np.empty((image.shape[0], 3))
    kernels.row_moments(image, rows)
    count, total, squares = rows.sum(axis=0)
    if count == 0:
        raise TexturelessImageError(f"the {name} image holds no measured pixel: all are NaN or infinite")
    mean = float(total / count)
    deviation = float(np.sqrt(max(squares / count - mean * mean, 0.0)))
    if not deviation > 1e-6 * max(1.0, abs(mean)):
        raise TexturelessImageError(
            f"the {name} image is constant (grey level {mean:g}): a displacement needs a surface texture in focus"
        )
    return mean, deviation


SATURATED = 0.01  # share of the pixels that must have the same extreme grey level
CROWDED = 4.0  # and how many more they must be than those of the next 1/64 of the range


def saturation(image: np.ndarray) -> tuple[float, float]:
    """Grey levels at which an image of integers is cut off at its dark and at its bright end, infinite where it is not.

    A level that is reached and never passed shows as a crowd of pixels at the end of the histogram. An image of two
    levels is not cut off; nor is one of real numbers judged: means of several images have no common end.
    """
    if not np.issubdtype(image.dtype, np.integer):
        return -np.inf, np.inf
    lowest, highest = int(image.min()), int(image.max())
    margin = max(1, (highest - lowest) // 64)
    counts = np.empty((image.shape[0], 4), np.int64)
    kernels.ends(image, lowest, highest, margin, counts)
    at_low, near_low, at_high, near_high = counts.sum(axis=0)
    least = max(SATURATED * image.size, 16)
    if at_low + at_high > image.size / 2:
        return -np.inf, np.inf
    cut_low = at_low > least and at_low > CROWDED * (near_low - at_low)
    cut_high = at_high > least and at_high > CROWDED * (near_high - at_high)
    return float(lowest) if cut_low else -np.inf, float(highest) if cut_high else np.inf


def checked_mask(mask: ArrayLike | None, shape: tuple[int, int]) -> np.ndarray | None:
    """The pixels to use as a boolean array of the image's shape, or None for all.

    Raises
    ------
    ShapeMismatchError, EmptyMaskError
    """
    if mask is None:
        return None
    array = np.asarray(mask).astype(bool)
    if array.shape != shape:
        raise ShapeMismatchError(f"the mask has the shape {array.shape}, the images {shape}: they must be equal")
    if not array.any():
        raise EmptyMaskError("the mask excludes every pixel: it must be True where the surface is to be measured")
    return array


def checked_window(window: int, spacing: int, shape: tuple[int, int]) -> tuple[int, int]:
    """Window and spacing as integers that fit the image.

    Raises
    ------
    WindowError
    """
    if int(window) != window or window < SMALLEST_WINDOW:
        raise WindowError(f"window = {window} px: it must be a whole number of at least {SMALLEST_WINDOW} px")
    if int(spacing) != spacing or spacing < 1:
        raise WindowError(f"spacing = {spacing} px: it must be a whole number of at least 1 px")
    if window > min(shape):
        raise WindowError(
            f"window = {window} px is larger than the image of {shape[0]} x {shape[1]} pixels (rows x columns)"
        )
    return int(window), int(spacing)
