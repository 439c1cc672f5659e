"""Brightness samples of a projector that changes between dark and bright."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LEFT_OVER = 0.002  # of a pattern's light may remain when the exposure of the next one begins: half a level of 8 bits
FEWEST_CHANGES = 12  # samples of dark and of bright each, for four parameters of the changes


@dataclass(frozen=True)
class TimingSamples:
    """Exposures of a scene on which dark and bright patterns alternate.

    Attributes
    ----------
    since : (sample,)
        From the request of the latest pattern to the middle of the exposure [s].
    stamp : (sample,)
        Middle of the exposure [s], from an arbitrary origin.
    bright : (sample,) bool
        The latest pattern is the bright one.
    brightness : (sample,)
        Mean of the lit pixels [grey level].
    exposure_time
        Exposure time of all samples [s].
    """

    since: Array
    stamp: Array
    bright: NDArray[np.bool_]
    brightness: Array
    exposure_time: float
