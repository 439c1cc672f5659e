"""Fringe order of a surface whose phase is known up to whole fringes only."""

from __future__ import annotations

import numpy as np

from fringedic.patterns.pattern import Orientation
from fringedic.rig.model import RigModel

_PIXELS = 100  # along each axis are enough for a median


def nearest_order_to_plane(
    phase: np.ndarray, calibration: RigModel, pitch: float, orientation: Orientation
) -> np.ndarray:
    """Return a relative phase with the orders that put its surface nearest to the reference plane.

    Correct for a surface whose median is within half a fringe of the plane; otherwise wrong by whole fringes.

    Parameters
    ----------
    phase
        Phase [rad] up to the same number of whole turns everywhere, shape (row, column), NaN where not measured.
    calibration
        Of the rig. The distortion of the lens is neglected: it is less than half a fringe.
    pitch, orientation
        Of the fringes, pitch in projector pixels.

    Returns
    -------
    ndarray
        Phase [rad], shape (row, column).
    """
    part = np.s_[:: max(1, phase.shape[0] // _PIXELS), :: max(1, phase.shape[1] // _PIXELS)]
    rows, columns = (np.asarray(axis)[part] for axis in np.mgrid[: phase.shape[0], : phase.shape[1]])
    known = np.isfinite(phase[part])
    if not known.any():
        return phase
    pixels = np.stack([columns[known], rows[known], np.ones(known.sum())])
    x, y, z = calibration.ray_matrix @ pixels
    away = -calibration.camera_distance / z
    plane = calibration.phase(away * x, away * y, 0.0, pitch, orientation)
    turns = np.round(np.median(plane - phase[part][known]) / (2 * np.pi))
    return np.asarray(phase + np.float32(2 * np.pi * turns))
