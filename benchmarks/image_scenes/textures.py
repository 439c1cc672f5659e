"""Textures: the brightness of a surface, 0 to 1, at any material point [px]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numba import njit

Box = tuple[float, float, float, float]  # least and largest x, least and largest y [px] that are evaluated

HALF_INK = 0.454  # relative radius at which a spot has half of its ink: (1 - r^2)^3 = 0.5
COVERAGE = 0.7  # mean ink


class Texture(Protocol):
    """A surface whose brightness is known at any material point."""

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the brightness at material points of any shape."""
        ...


@njit(cache=True)
def _sum_spots(
    x: np.ndarray,
    y: np.ndarray,
    spots: np.ndarray,
    first: np.ndarray,
    corner: tuple[float, float],
    cell: float,
    out: np.ndarray,
) -> None:
    """Sum the ink of spots (x, y, squared reach, ink), sorted by square cells no smaller than the largest reach.

    `first` (row, column) is the number of the first spot of each cell, with the end of each row of cells after it.
    """
    rows, columns = first.shape[0], first.shape[1] - 1
    for k in range(x.size):
        column = int(np.floor((x[k] - corner[0]) / cell))
        row = int(np.floor((y[k] - corner[1]) / cell))
        left, right = max(column - 1, 0), min(column + 1, columns - 1)
        total = 0.0
        if left <= right:
            for r in range(max(row - 1, 0), min(row + 1, rows - 1) + 1):
                for m in range(first[r, left], first[r, right + 1]):
                    d = ((x[k] - spots[m, 0]) ** 2 + (y[k] - spots[m, 1]) ** 2) / spots[m, 2]
                    if d < 1:
                        total += spots[m, 3] * (1 - d) ** 3
        out[k] = total


def _flat(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, float).ravel()


class Spots:
    """Ink spots on white paper; where spots overlap, their densities add.

    Parameters
    ----------
    x, y, reach, ink
        Place and outer radius [px] of each spot, and the optical density (natural logarithm) in its middle.
    """

    def __init__(self, x: np.ndarray, y: np.ndarray, reach: np.ndarray, ink: np.ndarray) -> None:
        self.cell = float(reach.max())
        self.corner = float(x.min()), float(y.min())
        columns, rows = (int((each.max() - each.min()) // self.cell) + 1 for each in (x, y))
        column, row = (((each - each.min()) // self.cell).astype(np.intp) for each in (x, y))
        number = row * columns + column
        order = np.argsort(number, kind="stable")
        self.spots = np.stack([x, y, reach**2, ink], axis=1)[order]
        before = np.concatenate([[0], np.cumsum(np.bincount(number, minlength=rows * columns))])
        self.first = before[np.arange(rows)[:, None] * columns + np.arange(columns + 1)]

    @classmethod
    def speckle(cls, diameter: float, box: Box, random: np.random.Generator) -> Spots:
        """Random places; `diameter` [px] is that of a spot of mean size at half of its ink."""
        reach = diameter / (2 * HALF_INK)
        area = (box[1] - box[0]) * (box[3] - box[2])
        number = int(area * COVERAGE / (1.5 * np.pi * reach**2 / 4))  # 1.5: mean ink of a spot
        return cls(
            random.uniform(box[0], box[1], number),
            random.uniform(box[2], box[3], number),
            reach * random.uniform(0.7, 1.4, number),
            random.uniform(1, 2, number),
        )

    @classmethod
    def lattice(
        cls, periods: np.ndarray, diameter: float, jitter: float, box: Box, random: np.random.Generator
    ) -> Spots:
        """Equal dots on a lattice; `jitter` is the largest deviation of a dot along both axes [px]."""
        nodes = lattice_points(periods, box)
        nodes = nodes + random.uniform(-jitter, jitter, nodes.shape)
        reach = np.full(len(nodes), diameter / (2 * HALF_INK))
        return cls(nodes[:, 0], nodes[:, 1], reach, np.full(len(nodes), 1.5))

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        out = np.empty(x.size)
        _sum_spots(_flat(x), _flat(y), self.spots, self.first, self.corner, self.cell, out)
        return np.exp(-out).reshape(x.shape)


def lattice_points(periods: np.ndarray, box: Box) -> np.ndarray:
    """Return the points (n, 2) of a lattice with two periods (rows) in a box."""
    corners = np.array([[x, y] for x in box[:2] for y in box[2:]])
    span = corners @ np.linalg.inv(periods)
    low, high = np.floor(span.min(axis=0)).astype(int), np.ceil(span.max(axis=0)).astype(int)
    i, j = np.mgrid[low[0] : high[0] + 1, low[1] : high[1] + 1]
    points: np.ndarray = np.stack([i.ravel(), j.ravel()], axis=1) @ periods
    inside = (points[:, 0] >= box[0]) & (points[:, 0] <= box[1]) & (points[:, 1] >= box[2]) & (points[:, 1] <= box[3])
    return points[inside]


@dataclass(frozen=True)
class Printed:
    """A pattern that repeats in two directions at right angles, `angle` [rad] from the axes of the image."""

    pitch: float
    angle: float

    def phases(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the places in both directions [rad], one turn for each pitch."""
        c, s = (2 * np.pi / self.pitch * f(self.angle) for f in (np.cos, np.sin))
        return c * x + s * y, -s * x + c * y

    @property
    def sides(self) -> np.ndarray:
        """One pitch in both directions (rows) [px]."""
        c, s = self.pitch * np.cos(self.angle), self.pitch * np.sin(self.angle)
        return np.array([[c, s], [-s, c]])


class Grid(Printed):
    """Dark lines in two directions."""

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        lines = [1 - 0.9 * np.exp(5 * (np.cos(phase) - 1)) for phase in self.phases(x, y)]
        return np.asarray(lines[0] * lines[1])

    @property
    def periods(self) -> np.ndarray:
        """Two periods (rows) [px]."""
        return self.sides


class Weave(Printed):
    """Plain weave of yarns `pitch` wide, which cross over and under."""

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        u, v = self.phases(x, y)
        return np.asarray(0.6 + 0.25 * np.sin(u / 2) * np.sin(v / 2) - 0.1 * np.cos(u) - 0.05 * np.cos(v))

    @property
    def periods(self) -> np.ndarray:
        """Two periods (rows) [px]: the diagonals of a yarn's square."""
        across, along = self.sides
        return np.array([across + along, across - along])


@dataclass(frozen=True)
class Stripes:
    """Lines of one direction only: waves (wavelength [px], phase [rad]) across them."""

    angle: float
    waves: np.ndarray

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        u = np.cos(self.angle) * x + np.sin(self.angle) * y
        total = sum(np.sin(2 * np.pi / wavelength * u + phase) for wavelength, phase in self.waves)
        return np.asarray(0.5 + 0.5 * np.tanh(1.5 * total / np.sqrt(len(self.waves))))


@njit(cache=True)
def _measure_furrows(
    x: np.ndarray, y: np.ndarray, sites: np.ndarray, corner: tuple[float, float], pitch: float, out: np.ndarray
) -> None:
    """Return the distance to the second nearest less that to the nearest site, of those in the nine cells around."""
    rows, columns = sites.shape[:2]
    for k in range(x.size):
        column = min(max(int(np.floor((x[k] - corner[0]) / pitch)), 1), columns - 2)
        row = min(max(int(np.floor((y[k] - corner[1]) / pitch)), 1), rows - 2)
        nearest, second = np.inf, np.inf
        for r in range(row - 1, row + 2):
            for c in range(column - 1, column + 2):
                d = (x[k] - sites[r, c, 0]) ** 2 + (y[k] - sites[r, c, 1]) ** 2
                if d < nearest:
                    nearest, second = d, nearest
                elif d < second:
                    second = d
        out[k] = np.sqrt(second) - np.sqrt(nearest)


class Skin:
    """Plateaus of irregular shape between furrows, with a faint grain.

    Parameters
    ----------
    pitch
        Mean distance of the plateaus [px].
    box, random
        Area that is evaluated, and the generator of the places.
    """

    def __init__(self, pitch: float, box: Box, random: np.random.Generator) -> None:
        self.pitch, self.corner = pitch, (box[0] - pitch, box[2] - pitch)
        columns, rows = (int((high - low) // pitch) + 4 for low, high in (box[:2], box[2:]))
        cells = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) + 0.5
        self.sites = np.array(self.corner) + pitch * (cells + random.uniform(-0.4, 0.4, cells.shape))
        self.grain = Spots.speckle(random.uniform(3, 6), box, random)

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        distance = np.empty(x.size)
        _measure_furrows(_flat(x), _flat(y), self.sites, self.corner, self.pitch, distance)
        furrow = np.exp(-((distance.reshape(x.shape) / (0.2 * self.pitch)) ** 2))
        return (1 - 0.6 * furrow) * (0.8 + 0.2 * self.grain.at(x, y))


@dataclass(frozen=True)
class Mixture:
    """A printed pattern with an irregularity: `share` of the brightness is that of another texture."""

    pattern: Texture
    irregularity: Texture
    share: float

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (1 - self.share) * self.pattern.at(x, y) + self.share * self.irregularity.at(x, y)


@dataclass(frozen=True)
class Plain:
    """A surface without texture."""

    brightness: float

    def at(self, x: np.ndarray, _y: np.ndarray) -> np.ndarray:
        return np.full(x.shape, self.brightness)
