"""Small pictures of maps, drawn without axes."""

from __future__ import annotations

import cv2
import numpy as np

from fringedic.errors import DatasetError
from fringedic.figures.palettes import palette
from fringedic.figures.previews import NOT_MEASURED


def thumbnail_png(values: np.ndarray, *, width: int = 160) -> tuple[bytes, tuple[float, float]]:
    """Return a small picture of a map, and the values of its darkest and brightest colour.

    Parameters
    ----------
    values
        The map (row, column), NaN where not measured.
    width
        Largest width of the picture [px]; the map is decimated.

    Returns
    -------
    bytes, (float, float)
        The PNG, and the 1st and 99th percentile of the map, between which the colours lie; NaN of an empty map.

    Raises
    ------
    DatasetError
        The picture cannot be encoded.

    Examples
    --------
    >>> picture, (low, high) = thumbnail_png(np.linspace(0, 1, 10000).reshape(100, 100))
    >>> picture[1:4], round(low, 2), round(high, 2)
    (b'PNG', 0.01, 0.99)
    """
    step = max(1, -(-values.shape[1] // width))
    small = np.asarray(values, np.float64)[::step, ::step]
    measured = np.isfinite(small)
    low, high = np.percentile(small[measured], (1, 99)) if measured.any() else (np.nan, np.nan)
    scaled = np.zeros(small.shape)
    np.divide(small - low, high - low, out=scaled, where=measured & (high > low))
    colours = palette("viridis")[np.clip(255 * scaled, 0, 255).astype(np.uint8)]
    colours[~measured] = NOT_MEASURED
    done, data = cv2.imencode(".png", colours[..., ::-1])
    if not done:
        raise DatasetError(f"a picture of {small.shape[1]}x{small.shape[0]} px cannot be encoded as PNG")
    return data.tobytes(), (float(low), float(high))
