"""Cramer-Rao bound of the phase: the noise that no unbiased measurement from the same frames can go below."""

from __future__ import annotations

import numpy as np

from fringedic.errors import PhaseError
from fringedic.frames.noise import CameraNoise
from fringedic.wording.arguments import array, check_arguments


@check_arguments(PhaseError, texture=array(2), modulation=array(2), phase=array(2))
def phase_limit(
    texture: np.ndarray, modulation: np.ndarray, phase: np.ndarray, shifts: int, noise: CameraNoise
) -> np.ndarray:
    """Return the Cramer-Rao bound of the phase of the finest fringes, with texture and modulation unknown as well.

    The bound is the element of the phase in the inverse of the Fisher matrix, the sum of g g^T / s_k^2 over the frames
    I_k = A + B cos(phi - 2 pi k / q), g being the derivatives by A, B and phi. Bright frames have more shot noise,
    which equal weights, the usual phase stepping, do not use.

    Parameters
    ----------
    texture, modulation, phase
        A and B [grey level] and phi [rad] of each pixel, (row, column); NaN is not measured.
    shifts
        Number q of frames of the finest pitch, at least 3.
    noise
        Of the camera.

    Returns
    -------
    ndarray
        Standard deviation of the phase [rad], float64 in the shape of the maps.

    Raises
    ------
    PhaseError
        The shapes differ, or fewer than three shifts leave the phase unknown.

    References
    ----------
    S. M. Kay, "Fundamentals of Statistical Signal Processing: Estimation Theory" (1993), chapter 3.

    Examples
    --------
    With the same noise in all frames the bound is sqrt(2 / q) s / B, that of phase stepping:

    >>> level = np.full((2, 2), 100.0)
    >>> limit = phase_limit(level, level / 2, np.array([[0.0, 1.0], [2.0, 3.0]]), 8, CameraNoise(read=1.0))
    >>> bool(np.allclose(limit, np.sqrt(2 / 8) * 1.0 / 50))
    True
    """
    if not texture.shape == modulation.shape == phase.shape or shifts < 3:
        raise PhaseError(
            f"texture {texture.shape}, modulation {modulation.shape}, phase {phase.shape} and {shifts} shifts: give "
            "maps of one shape and at least 3 shifts"
        )
    fisher = np.zeros((*phase.shape, 3, 3))
    for k in range(1, shifts + 1):
        away = phase - 2 * np.pi * k / shifts
        derivatives = np.stack([np.ones_like(away), np.cos(away), -modulation * np.sin(away)], axis=-1)
        weight = 1 / noise.variance(texture + modulation * np.cos(away))
        fisher += weight[..., None, None] * derivatives[..., :, None] * derivatives[..., None, :]
    known = np.isfinite(fisher).all(axis=(-1, -2)) & (modulation > 0)
    fisher[~known] = np.eye(3)
    limit: np.ndarray = np.where(known, np.sqrt(np.linalg.inv(fisher)[..., 2, 2]), np.nan)
    return limit
