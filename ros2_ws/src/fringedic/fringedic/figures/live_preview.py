"""Preview of a live image with marked pixels."""

from __future__ import annotations

import math
from functools import reduce

import cv2
import numpy as np

from fringedic.rig_setup.live_figures import Figures

PREVIEW_WIDTH = 640
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
