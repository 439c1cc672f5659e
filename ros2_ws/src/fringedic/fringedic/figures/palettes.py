"""Colour palettes as tables, for programs that colour maps themselves."""

from __future__ import annotations

import numpy as np

from fringedic.wording.optional_packages import optional_import

COLOURS = 256
PALETTES = ("viridis", "RdBu_r", "gray")


def palette(name: str) -> np.ndarray:
    """Return the colours of a palette of matplotlib, from the lowest value to the highest.

    Parameters
    ----------
    name
        Name of the palette, such as those of `PALETTES`.

    Returns
    -------
    ndarray
        uint8 (256, 3), red green blue.

    Raises
    ------
    FringedicError
        The package ``matplotlib`` is not installed.

    Examples
    --------
    >>> palette("gray")[[0, 128, 255]].tolist()
    [[0, 0, 0], [128, 128, 128], [255, 255, 255]]
    """
    with optional_import("figures"):
        from matplotlib import colormaps
    colours = colormaps[name](np.arange(COLOURS) / (COLOURS - 1))
    return np.asarray(np.round(255 * colours[:, :3]), np.uint8)
