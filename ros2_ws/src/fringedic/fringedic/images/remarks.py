"""What needs attention in an image of a series, as data; `sentences` puts it into words."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from fringedic.correlation.images import CROWDED

SATURATED_SHARE = 0.05  # of the pixels, from which an image has a remark


class ImageRemark(StrEnum):
    """Codes of the remarks of an image, with their values by name.

    Attributes
    ----------
    DUPLICATE
        All pixels are equal to those of the image number ``step``.
    SATURATED
        The part ``share`` of the pixels is at an end of the grey levels.
    MOSAIC
        It contains the colour mosaic of a sensor, which was smoothed in all images; no values.
    """

    DUPLICATE = "duplicate"
    SATURATED = "saturated"
    MOSAIC = "mosaic"


def saturated_share(image: np.ndarray) -> float:
    """Return the part of the pixels at the lowest or highest grey level, where these are more than the levels beside.

    Parameters
    ----------
    image
        Grey levels of any shape, uint8 or uint16.

    Returns
    -------
    float
        An end with at most four times as many pixels as the next 1/64 of the range is not saturated.

    Examples
    --------
    >>> grey = np.random.default_rng(1).normal(180, 60, 10_000)
    >>> round(saturated_share(np.clip(grey, 0, 255).astype(np.uint8)), 2)
    0.1
    """
    counts = np.bincount(image.ravel())
    used = np.flatnonzero(counts)
    if used.size < 2:
        return 0.0
    margin = max(1, int(used[-1] - used[0]) // 64)
    low, high = int(used[0]), int(used[-1])
    ends = (
        (counts[low], counts[low + 1 : low + margin + 1].sum()),
        (counts[high], counts[high - margin : high].sum()),
    )
    return float(sum(at for at, beside in ends if at > CROWDED * beside)) / image.size
