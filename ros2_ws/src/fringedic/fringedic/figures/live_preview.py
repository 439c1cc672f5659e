"""Preview of a live image with marked pixels."""

from __future__ import annotations

import math
from functools import reduce

import cv2
import numpy as np

from fringedic.errors import ImageError
from fringedic.frames.image_quality import full_scale_of
from fringedic.rig_setup.live_figures import Figures

PREVIEW_WIDTH = 640
MOST_PIXELS = 1_000_000  # of a picture for a browser
# A single red pixel keeps its colour: the usual sampling mixes it with its neighbours.
JPEG = (cv2.IMWRITE_JPEG_QUALITY, 80, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
RED, BLUE, YELLOW = (255, 0, 0), (0, 60, 255), (255, 220, 0)


def preview(image: np.ndarray, figures: Figures, *, width: int = PREVIEW_WIDTH) -> np.ndarray:
    """Return a small picture of a frame: saturated pixels red, black ones blue, the region framed in yellow.

    Parameters
    ----------
    image
        uint8 or uint16 (row, column) [grey level].
    figures
        Figures of this frame.
    width
        Largest width of the picture [px]; a pixel of it is red when any of the pixels under it is saturated.

    Returns
    -------
    ndarray
        uint8 (row, column, 3), red green blue.
    """
    factor = max(math.ceil(image.shape[1] / width), 1)
    rows, columns = (size // factor for size in image.shape)
    whole = image[: rows * factor, : columns * factor]
    under = [whole[i::factor, j::factor] for i in range(factor) for j in range(factor)]
    grey = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA) * np.float32(255 / figures.full_scale)
    picture = np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
    picture[reduce(np.minimum, under) == 0] = BLUE
    picture[reduce(np.maximum, under) >= figures.full_scale] = RED
    column, row, wide, high = (part // factor for part in figures.region)
    if (wide, high) != (columns, rows):
        cv2.rectangle(picture, (column, row), (column + wide - 1, row + high - 1), YELLOW, 2)
    return picture


def browser_picture(image: np.ndarray) -> bytes:
    """Return a frame as a JPEG of at most one megapixel, with saturated pixels in red.

    Parameters
    ----------
    image
        uint8 or uint16 (row, column) [grey level].

    Returns
    -------
    bytes
        The JPEG. A pixel of it is red when any of the pixels under it is saturated.

    Raises
    ------
    ImageError
        It is not the image of a camera, or cannot be encoded.

    Examples
    --------
    >>> browser_picture(np.zeros((4, 6), np.uint8))[:3].hex()
    'ffd8ff'
    """
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16) or not image.size:
        raise ImageError(f"an image of shape {image.shape} and type {image.dtype} has no grey levels of a camera")
    full = full_scale_of([image])
    factor = math.ceil(math.sqrt(image.size / MOST_PIXELS))
    size = max(image.shape[1] // factor, 1), max(image.shape[0] // factor, 1)
    grey = image if image.dtype == np.uint8 else cv2.convertScaleAbs(image, alpha=255 / full)
    picture = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    if image.max() >= full:
        picture = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
        _, saturated = cv2.threshold(image, full - 1, 255, cv2.THRESH_BINARY)
        # the mean of the pixels under one is not 0 when any of them is 255: of up to 22 x 22
        picture[cv2.resize(saturated, size, interpolation=cv2.INTER_AREA) > 0] = RED[::-1]
    encoded, data = cv2.imencode(".jpg", picture, JPEG)
    if not encoded:
        raise ImageError("the frame cannot be encoded as JPEG")
    return data.tobytes()
