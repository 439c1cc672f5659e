"""Grey levels of colours."""

from __future__ import annotations

import numpy as np

# weights of ITU-R 601 in 16 binary digits; they add up to 1, so that grey stays grey
_BLUE_GREEN_RED = np.array([7471, 38470, 19595], np.uint64)


def luminance(colours: np.ndarray) -> np.ndarray:
    """Luminance by ITU-R 601, of the type of the colours.

    Parameters
    ----------
    colours
        uint8 or uint16, (row, column, channel): blue, green, red, and others that do not count.

    Returns
    -------
    numpy.ndarray
        (row, column).
    """
    weighted = colours[:, :, :3].astype(np.uint64) @ _BLUE_GREEN_RED
    return ((weighted + 0x8000) >> 16).astype(colours.dtype)
