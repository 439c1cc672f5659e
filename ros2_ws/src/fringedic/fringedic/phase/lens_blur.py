"""Corrects the phase on a textured surface for the blur of the lens, which mixes bright spots into dark neighbours."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numba import njit, prange

from fringedic.errors import ImageError


def correct_lens_blur(
    phase: np.ndarray | xr.DataArray, modulation: np.ndarray | xr.DataArray, blur: float
) -> np.ndarray:
    """Correct the phase of a textured surface for the blur of the camera's lens.

    A blur of variance sigma^2 turns ``B exp(i phi)`` into its local mean, whose phase is
    ``phi + sigma^2 (grad(ln B) . grad(phi) + laplace(phi) / 2)`` to first order in sigma^2. The first term is
    subtracted; the second one is negligible on a smooth surface. Both gradients are central differences.

    Parameters
    ----------
    phase
        Absolute phase [rad], shape (row, column), NaN where not measured.
    modulation
        Modulation [any unit], same shape.
    blur
        Standard deviation of the lens's point spread [camera pixel].

    Returns
    -------
    ndarray
        float32, same shape. A pixel whose two neighbours along an axis are not both measured keeps its phase along that
        axis.

    Raises
    ------
    ImageError
        Phase and modulation differ in size.

    Examples
    --------
    >>> phase = 0.2 * np.arange(5.0) * np.ones((3, 1))
    >>> modulation = np.exp(0.5 * np.arange(5.0)) * np.ones((3, 1))
    >>> (correct_lens_blur(phase, modulation, 0.5) - phase).round(3)[1].tolist()
    [0.0, -0.025, -0.025, -0.025, 0.0]
    """
    values, strength = np.asarray(phase, np.float32), np.asarray(modulation, np.float32)
    if values.shape != strength.shape:
        raise ImageError(f"a phase of {values.shape} and a modulation of {strength.shape} do not belong together")
    corrected = np.empty(values.shape, np.float32)
    _correct(np.ascontiguousarray(values), np.ascontiguousarray(strength), np.float32(blur**2), corrected)
    return corrected


@njit(cache=True, nogil=True)
def _product(before: np.float32, after: np.float32, weak: np.float32, strong: np.float32) -> np.float32:
    """Return the slope of the phase times that of ln B between two neighbours of a pixel; 0 where one is missing."""
    if math.isnan(before) or math.isnan(after) or not (weak > 0 and strong > 0):
        return np.float32(0)
    return np.float32(0.25) * (after - before) * np.float32(math.log(strong / weak))


@njit(cache=True, nogil=True, parallel=True)
def _correct(phase: np.ndarray, modulation: np.ndarray, variance: np.float32, corrected: np.ndarray) -> None:
    rows, columns = phase.shape
    for row in prange(rows):
        for column in range(columns):
            bias = np.float32(0)
            if 0 < column < columns - 1:
                bias += _product(
                    phase[row, column - 1],
                    phase[row, column + 1],
                    modulation[row, column - 1],
                    modulation[row, column + 1],
                )
            if 0 < row < rows - 1:
                bias += _product(
                    phase[row - 1, column],
                    phase[row + 1, column],
                    modulation[row - 1, column],
                    modulation[row + 1, column],
                )
            corrected[row, column] = phase[row, column] - variance * bias
