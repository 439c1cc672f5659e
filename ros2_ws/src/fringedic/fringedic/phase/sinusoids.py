"""Least-squares sinusoids through the shifts of a pitch, and the harmonics of a nonlinear response around them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

HARMONICS = (2, 3, 4)
"""Of the response, which all pixels have in common; of gamma 1 to 2.4, the next is below 0.2 % of the modulation."""

_STRONGEST = 0.4  # harmonic over the modulation: (g - 1) / (g + 2) for a response with the exponent g, 0.32 at 2.4


def fit_wave(levels: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Fit sinusoids to grey levels (frame, pixel) at these angles; return mean, B cos(phi), B sin(phi): (3, pixel)."""
    return np.asarray(_inverse(tuple(angles.tolist())) @ levels)


@lru_cache(maxsize=1024)  # the explanations of a stack of 30 frames repeat most of their combinations
def _inverse(angles: tuple[float, ...]) -> np.ndarray:
    return np.asarray(np.linalg.pinv(waves(np.array(angles))), np.float32)


def wave_levels(fit: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return the grey levels of fitted sinusoids at these angles; shape (frame, pixel)."""
    return np.asarray(waves(angles).astype(np.float32) @ fit)


def waves(angles: np.ndarray) -> np.ndarray:
    """Return 1, cos and sin of the angles, shape (frame, 3)."""
    return np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles)], axis=1)


def residual_maker(angles: np.ndarray) -> np.ndarray:
    """Return 1 - (hat matrix), which gives the residuals of the fitted sinusoids from grey levels; (frame, frame)."""
    basis = waves(angles)
    return np.asarray(np.eye(len(angles)) - basis @ np.linalg.pinv(basis))


def remove_harmonics(rest: np.ndarray, fit: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return residuals (frame, pixel) without the harmonics of the response, whose strength all pixels share.

    A harmonic stronger than that of any response remains in part: dark frames among lit ones look like one, where all
    pixels have the same phase.
    """
    parts = harmonic_levels(fit, angles)
    if not len(parts):
        return rest
    stacked = parts.reshape(len(parts), -1)
    strength = np.linalg.lstsq(stacked @ stacked.T, stacked @ rest.ravel(), rcond=1e-6)[0]
    strength = np.clip(strength, -_STRONGEST, _STRONGEST)
    return np.asarray(rest - np.tensordot(strength, parts, axes=1))


def harmonic_levels(fit: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return ``B cos(m (phi - a))`` of the harmonics m that leave a residual, shape (harmonic, frame, pixel).

    A response without memory shifts no harmonic against the fringes. Over q shifts a harmonic with m - 1, m or m + 1 a
    multiple of q looks like the fringes or their mean.
    """
    strength = np.sqrt(square_modulation(fit))
    turn = (fit[1] + 1j * fit[2]) / strength
    levels, parts = strength * turn, []
    for sides in _harmonic_sides(tuple(angles.tolist())):
        levels = levels * turn
        if sides is not None:
            parts.append(sides @ np.stack([levels.real, levels.imag]).astype(np.float32))
    return np.stack(parts) if parts else np.empty((0, len(angles), fit.shape[1]), np.float32)


@lru_cache(maxsize=1024)
def _harmonic_sides(angles: tuple[float, ...]) -> list[np.ndarray | None]:
    """Return what cos(m a) and sin(m a) leave beside a sinusoid, (frame, 2), for each harmonic m; None for nothing."""
    shifts = [residual_maker(np.array(angles)) @ np.exp(-1j * harmonic * np.array(angles)) for harmonic in HARMONICS]
    return [
        np.stack([each.real, -each.imag], axis=1).astype(np.float32) if np.abs(each).max() > 1e-6 else None
        for each in shifts
    ]


def square_modulation(fit: np.ndarray) -> np.ndarray:
    """Return the square of the modulation of fitted sinusoids (3, pixel), not 0."""
    return np.asarray(np.maximum(fit[1] ** 2 + fit[2] ** 2, np.float32(1e-6)))
