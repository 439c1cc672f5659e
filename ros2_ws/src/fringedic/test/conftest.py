"""Images without interpolation: a speckle is a sum of Gaussian spots, evaluated where the spots have gone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numba import njit

Motion = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@njit
def _add_spots(x: np.ndarray, y: np.ndarray, amplitude: np.ndarray, radius: float, out: np.ndarray) -> None:
    reach = int(np.ceil(5 * radius))
    for k in range(x.size):
        column, row = int(np.rint(x[k])), int(np.rint(y[k]))
        for r in range(max(0, row - reach), min(out.shape[0], row + reach + 1)):
            for c in range(max(0, column - reach), min(out.shape[1], column + reach + 1)):
                out[r, c] += amplitude[k] * np.exp(-((c - x[k]) ** 2 + (r - y[k]) ** 2) / (2 * radius * radius))


class Speckle:
    """A surface of random spots of 1.4 px, whose contrast is 15 % of the full scale of 12 bits.

    `image(motion)` is the surface displaced by d = motion(x, y) [px]; the spots move as rigid bodies, which changes a
    texture as a homogeneous deformation of its autocorrelation would only to second order of the strain.
    """

    def __init__(self, shape: tuple[int, int], seed: int, *, radius: float = 1.4, margin: int = 100) -> None:
        generator = np.random.default_rng(seed)
        rows, columns = shape
        count = int(0.35 * (rows + 2 * margin) * (columns + 2 * margin))
        self.shape, self.radius = shape, radius
        self.x = generator.uniform(-margin, columns + margin, count)
        self.y = generator.uniform(-margin, rows + margin, count)
        self.amplitude = generator.choice([-1.0, 1.0], count)
        # Variance of a sum of spots: density * integral of the squared spot.
        self.gain = 0.15 * 4096 / np.sqrt(0.35 * np.pi * radius**2)

    def image(self, motion: Motion | None = None, *, noise: float = 0.0, seed: int = 0, bits: int = 12) -> np.ndarray:
        x, y = self.x, self.y
        if motion is not None:
            dx, dy = motion(x, y)
            x, y = x + dx, y + dy
        grey = np.zeros(self.shape)
        _add_spots(x, y, self.amplitude, self.radius, grey)
        grey = 2048 + self.gain * grey
        if noise:
            grey += np.random.default_rng(seed).normal(0, noise, self.shape)
        scaled = np.rint(grey * 2.0 ** (bits - 12))
        return np.clip(scaled, 0, 2**bits - 1).astype(np.uint8 if bits == 8 else np.uint16)


@pytest.fixture(scope="session")
def speckle() -> type[Speckle]:
    return Speckle
