"""Grey levels of colour images."""

from __future__ import annotations

import numpy as np

# weights of ITU-R BT.601 in 16 binary digits; they add up to 1, so that grey stays grey
_BLUE_GREEN_RED = np.array([7471, 38470, 19595], np.uint64)


def luminance(colours: np.ndarray) -> np.ndarray:
    """Return the luminance by ITU-R BT.601, of the type of the colours.

    Parameters
    ----------
    colours
        uint8 or uint16, shape (row, column, channel): blue, green, red; further channels are ignored.

    Returns
    -------
    ndarray
        Shape (row, column).

    Examples
    --------
    >>> luminance(np.array([[[9, 9, 9], [255, 0, 0]]], np.uint8))
    array([[ 9, 29]], dtype=uint8)
    """
    weighted = colours[:, :, :3].astype(np.uint64) @ _BLUE_GREEN_RED
    return np.asarray((weighted + 0x8000) >> 16).astype(colours.dtype)
