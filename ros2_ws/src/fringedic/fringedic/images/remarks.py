"""What needs attention in an image of a series, as data; `sentences` puts it into words."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

import numpy as np

from fringedic.correlation.images import CROWDED
from fringedic.steps.remarks import Remark

SATURATED_SHARE = 0.05  # of the pixels, from which an image has a remark
UNMATCHED_SHARE = 0.02  # of the texture, from which an image has a remark; less are weak spots


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
    REPEATS
        Its texture repeats after ``period`` [px], and nothing in it decides between displacements that differ by that.
    UNMATCHED
        The part ``share`` of the texture has no displacement although its place is inside of the image.
    BINNED
        ``binning`` times ``binning`` pixels were averaged, which makes the window ``window`` [px] wide.
    """

    DUPLICATE = "duplicate"
    SATURATED = "saturated"
    MOSAIC = "mosaic"
    REPEATS = "repeats"
    UNMATCHED = "unmatched"
    BINNED = "binned"


def field_remarks(attributes: Mapping[str, Any]) -> tuple[Remark, ...]:
    """Return what the attributes of a displacement say of its image.

    Parameters
    ----------
    attributes
        Of the result of `fringedic.measure_displacement`.
    """
    remarks = []
    if "repeats_px" in attributes:
        x, y = attributes["repeats_px"][:2]
        remarks.append(Remark(ImageRemark.REPEATS, {"period": float(np.hypot(x, y))}))
    if attributes.get("unmatched_fraction", 0.0) >= UNMATCHED_SHARE:
        remarks.append(Remark(ImageRemark.UNMATCHED, {"share": attributes["unmatched_fraction"]}))
    if "binning_px" in attributes:
        values = {"binning": attributes["binning_px"], "window": attributes["window_px"]}
        remarks.append(Remark(ImageRemark.BINNED, values))
    return tuple(remarks)


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
