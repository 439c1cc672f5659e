"""Filters of the dense method for a window: Gaussian taps on cells of a few pixels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from fringedic.correlation import node_kernels
from fringedic.correlation.images import SMALLEST_WINDOW
from fringedic.correlation.transfer import NARROWER, NodeGains, node_gains, window_deviation

CELLS_PER_WINDOW = 8  # the Gaussian W then has a standard deviation of about two cells, enough to sample it


@dataclass(frozen=True)
class Window:
    """Filters of the dense method.

    Attributes
    ----------
    width
        Of the bi-triangular window with the same noise [px].
    deviation
        Standard deviation of the Gaussian W [px].
    cell
        Side of the square cells around the nodes [px].
    taps, narrow_taps
        Of W and of the narrower Gaussian V of the predictor, in cells from the centre on, float32.
    gains
        What they do to noise.
    """

    width: int
    deviation: float
    cell: int
    taps: np.ndarray
    narrow_taps: np.ndarray
    gains: NodeGains


@lru_cache(maxsize=16)
def design_window(width: int) -> Window:
    """Design the filters with the noise of a bi-triangular window of `width` pixels used on both images."""
    deviation = window_deviation(width)
    cell = round(width / CELLS_PER_WINDOW)
    taps = _sample_gaussian(deviation / cell, node_kernels.REACH)
    narrow = _sample_gaussian(NARROWER * deviation / cell, node_kernels.NARROW_REACH)
    return Window(width, deviation, cell, taps.astype(np.float32), narrow.astype(np.float32), node_gains(taps, narrow))


def window_at_level(width: int, level: int) -> Window:
    """Return the window on a level of the pyramid: narrower where pixels are few and noise is averaged out."""
    return design_window(width if level < 2 else max(SMALLEST_WINDOW, min(width, 2 * SMALLEST_WINDOW)))


def _sample_gaussian(deviation: float, reach: int) -> np.ndarray:
    """Taps from the centre on, of unit sum over both sides."""
    taps = np.exp(-0.5 * (np.arange(reach + 1) / deviation) ** 2)
    return np.asarray(taps / (taps[0] + 2 * taps[1:].sum()))
