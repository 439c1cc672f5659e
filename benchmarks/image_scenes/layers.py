"""A camera that sees surfaces behind each other, before and after each has moved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from image_scenes.motions import Motion
from image_scenes.textures import Texture

BORDER = 2.0  # [px] on each side of an edge are mixed
_AROUND = np.linspace(0, 2 * np.pi, 16, endpoint=False)  # directions in which an edge is looked for

Cover = Callable[[np.ndarray, np.ndarray], np.ndarray]
Shape = tuple[int, int]


def _ramp(distance: np.ndarray) -> np.ndarray:
    """Return the cover of a surface at a distance [px] inside of its edge, which is one pixel wide."""
    return np.clip(0.5 + distance, 0, 1)


def everywhere(x: np.ndarray, _y: np.ndarray) -> np.ndarray:
    """Return the cover of a surface without an edge."""
    return np.ones(x.shape)


@dataclass(frozen=True)
class Rectangle:
    """A rectangle with rounded corners: half of its sides, radius of its corners [px]."""

    centre: tuple[float, float]
    half: tuple[float, float]
    angle: float
    corner: float

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the distance from the edge [px], positive inside."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        u, v = x - self.centre[0], y - self.centre[1]
        beyond = (
            np.abs(c * u + s * v) - self.half[0] + self.corner,
            np.abs(-s * u + c * v) - self.half[1] + self.corner,
        )
        outside = np.hypot(np.clip(beyond[0], 0, None), np.clip(beyond[1], 0, None))
        return np.asarray(self.corner - outside - np.clip(np.maximum(*beyond), None, 0))

    def inside(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the cover of the rectangle."""
        return _ramp(self.distance(x, y))

    def outside(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the cover of what is around it, which reaches below its edge: no seam is seen."""
        return _ramp(1 - self.distance(x, y))


@dataclass(frozen=True)
class Line:
    """A wavy line: its distance is counted across the straight one."""

    place: tuple[float, float]
    angle: float
    height: float
    wavelength: float

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the distance [px], positive on the side to which the normal (-sin, cos) points."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        u, v = x - self.place[0], y - self.place[1]
        return np.asarray(-s * u + c * v - self.height * np.sin(2 * np.pi / self.wavelength * (c * u + s * v)))

    def above(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the cover of one side."""
        return _ramp(self.distance(x, y))

    def below(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the cover of the other side, which reaches below the edge of the first: no seam is seen."""
        return _ramp(1 - self.distance(x, y))

    def band(self, half_width: float) -> Cover:
        """Return the cover of a band along the line."""
        return lambda x, y: _ramp(half_width - np.abs(self.distance(x, y)))


@dataclass(frozen=True)
class Layer:
    """A surface, where it is, and how it moves; `later` is another surface that is in its place afterwards."""

    texture: Texture
    motion: Motion
    cover: Cover = everywhere
    later: Texture | None = None


@dataclass(frozen=True)
class Truth:
    """Exact motion of the material at points of the reference.

    Attributes
    ----------
    x, y
        Displacement of the material [px], whether it is visible afterwards or not; NaN where another surface is in its
        place.
    visible
        The material is in the deformed image and nothing covers it.
    layer
        Number of the layer that is seen in the reference.
    mixed
        The pixel of the reference is within 2 px of a border between surfaces: there the image shows both.
    """

    x: np.ndarray
    y: np.ndarray
    visible: np.ndarray
    layer: np.ndarray
    mixed: np.ndarray


@dataclass(frozen=True)
class View:
    """Layers from the front to the back, of which the last covers the whole image.

    Attributes
    ----------
    shape
        Rows and columns of the image.
    layers
        From the front to the back.
    samples
        Gauss points of a pixel along each axis; they are the aperture of the camera.
    """

    shape: Shape
    layers: tuple[Layer, ...]
    samples: int = 2

    def brightness(self, x: np.ndarray, y: np.ndarray, *, moved: bool) -> np.ndarray:
        """Return the brightness at points of the image, 0 to 1."""
        seen = np.ones(x.shape)  # part of the light that comes from deeper layers
        total = np.zeros(x.shape)
        for layer in self.layers:
            at = layer.motion.inverse(x, y) if moved else (x, y)
            texture = layer.later if moved and layer.later is not None else layer.texture
            covered = seen * layer.cover(*at)
            some = covered > 0
            if some.all():
                total += covered * texture.at(*at)
            elif some.any():
                total[some] += covered[some] * texture.at(at[0][some], at[1][some])
            seen = seen - covered
            if not (seen > 0).any():
                break
        return total

    def image(self, *, moved: bool) -> np.ndarray:
        """Return the brightness of every pixel, the mean over its aperture."""
        row, column = np.mgrid[: self.shape[0], : self.shape[1]].astype(float)
        nodes, weights = np.polynomial.legendre.leggauss(self.samples)
        total = np.zeros(self.shape)
        for dy, vertical in zip(nodes / 2, weights / 2, strict=True):
            for dx, horizontal in zip(nodes / 2, weights / 2, strict=True):
                total += vertical * horizontal * self.brightness(column + dx, row + dy, moved=moved)
        return total

    def _shares(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the part of each layer in the reference at points of the image."""
        seen, shares = np.ones(x.shape), []
        for layer in self.layers:
            shares.append(seen * layer.cover(x, y))
            seen = seen - shares[-1]
        return np.stack(shares)

    def truth(self, spacing: int = 1) -> Truth:
        """Return the motion of the points (row, column) of a grid in the reference."""
        y, x = np.mgrid[: self.shape[0] : spacing, : self.shape[1] : spacing].astype(float)
        shares = self._shares(x, y)
        front, mixed = np.argmax(shares, axis=0), np.max(shares, axis=0) < 1
        for angle in _AROUND:
            beside = self._shares(x + BORDER * np.cos(angle), y + BORDER * np.sin(angle))
            mixed |= np.argmax(beside, axis=0) != front
        dx, dy, visible = np.full(x.shape, np.nan), np.full(x.shape, np.nan), np.zeros(x.shape, bool)
        for k, layer in enumerate(self.layers):
            own = front == k
            if layer.later is not None or not own.any():
                continue
            to_x, to_y = layer.motion.forward(x[own], y[own])
            dx[own], dy[own] = to_x - x[own], to_y - y[own]
            inside = (to_x >= 0) & (to_x <= self.shape[1] - 1) & (to_y >= 0) & (to_y <= self.shape[0] - 1)
            for other in self.layers[:k]:
                inside &= other.cover(*other.motion.inverse(to_x, to_y)) < 0.5
            visible[own] = inside
        return Truth(dx, dy, visible, front, mixed)
