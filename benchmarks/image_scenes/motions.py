"""Motions of a surface: maps of material points to their places in the deformed image, with exact inverses [px]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

Points = tuple[np.ndarray, np.ndarray]


class Motion(Protocol):
    """A map of the plane that can be inverted."""

    def forward(self, x: np.ndarray, y: np.ndarray) -> Points:
        """Return the places of material points."""
        ...

    def inverse(self, x: np.ndarray, y: np.ndarray) -> Points:
        """Return the material points at places."""
        ...


@dataclass(frozen=True)
class Affine:
    """Deformation gradient about a fixed point, then a translation [px]."""

    gradient: np.ndarray
    centre: tuple[float, float]
    translation: tuple[float, float]

    def forward(self, x: np.ndarray, y: np.ndarray) -> Points:
        (a, b), (c, d) = self.gradient
        u, v = x - self.centre[0], y - self.centre[1]
        # integers stay exact where nothing turns or stretches
        return (
            x + (a - 1) * u + b * v + self.translation[0],
            y + c * u + (d - 1) * v + self.translation[1],
        )

    def inverse(self, x: np.ndarray, y: np.ndarray) -> Points:
        (a, b), (c, d) = np.linalg.inv(self.gradient)
        x, y = x - self.translation[0], y - self.translation[1]
        u, v = x - self.centre[0], y - self.centre[1]
        return x + (a - 1) * u + b * v, y + c * u + (d - 1) * v


@dataclass(frozen=True)
class Wave:
    """A plane wave of the displacement; it is written down in the deformed image, where its inverse is explicit."""

    amplitude: tuple[float, float]
    number: tuple[float, float]  # [rad/px]
    phase: float

    def inverse(self, x: np.ndarray, y: np.ndarray) -> Points:
        wave = np.sin(self.number[0] * x + self.number[1] * y + self.phase)
        return x - self.amplitude[0] * wave, y - self.amplitude[1] * wave

    def forward(self, x: np.ndarray, y: np.ndarray) -> Points:
        at_x, at_y = x, y
        for _ in range(100):
            back_x, back_y = self.inverse(at_x, at_y)
            at_x, at_y = at_x + (x - back_x), at_y + (y - back_y)
            if max(np.abs(x - back_x).max(), np.abs(y - back_y).max()) < 1e-11:
                return at_x, at_y
        raise ArithmeticError("the wave is too steep: the iteration does not converge")


@dataclass(frozen=True)
class Opening:
    """One side of a crack: it moves along the normal of the crack, and as a whole along the crack.

    The opening is `width` where the crack begins and falls to zero at `length` along it, with a continuous slope;
    it is the same all along the crack where `length` is infinite.
    """

    place: tuple[float, float]
    angle: float  # of the crack [rad]
    width: float  # of this side: half of the crack's, negative on the other side
    length: float
    shear: float

    def _open(self, x: np.ndarray, y: np.ndarray, direction: int) -> Points:
        c, s = np.cos(self.angle), np.sin(self.angle)
        along = c * (x - self.place[0]) + s * (y - self.place[1])
        if direction < 0:
            along = along - self.shear
        width: np.ndarray | float = self.width
        if np.isfinite(self.length):
            width = self.width * np.clip(1 - along / self.length, 0, None) ** 2
        return (
            x + direction * (self.shear * c - width * s),
            y + direction * (self.shear * s + width * c),
        )

    def forward(self, x: np.ndarray, y: np.ndarray) -> Points:
        return self._open(x, y, 1)

    def inverse(self, x: np.ndarray, y: np.ndarray) -> Points:
        return self._open(x, y, -1)


@dataclass(frozen=True)
class Sequence:
    """Motions one after the other."""

    parts: tuple[Motion, ...]

    def forward(self, x: np.ndarray, y: np.ndarray) -> Points:
        for part in self.parts:
            x, y = part.forward(x, y)
        return x, y

    def inverse(self, x: np.ndarray, y: np.ndarray) -> Points:
        for part in reversed(self.parts):
            x, y = part.inverse(x, y)
        return x, y


STILL = Sequence(())
