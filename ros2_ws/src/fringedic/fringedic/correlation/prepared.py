"""A reference that is prepared once, and the dense measurement of one motion against it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from fringedic.correlation.agreement import Nodes, assess, find_textured_cells
from fringedic.correlation.dense import estimate_nodes
from fringedic.correlation.images import Photometry
from fringedic.correlation.lattice import Lattice, find_lattice, keep_resolved
from fringedic.correlation.pyramid import Level, build_pyramid, locate_nodes, prepare_level, resample
from fringedic.correlation.window import Window, design_window

f4 = np.float32


@dataclass(frozen=True, eq=False)
class Prepared:
    """A reference with what every measurement against it needs.

    Attributes
    ----------
    values : (row, column) float32
        Grey levels in standard deviations; NaN where nothing is known.
    window
        Filters of the dense method.
    lattice
        How its texture repeats; None where it does not.
    images
        Its pyramid, finest first; of a periodic texture the levels that show it.
    levels
        They with their gradients.
    textured : (node row, node column) bool
        Where a match is expected.
    """

    values: np.ndarray
    window: Window
    lattice: Lattice | None
    images: list[np.ndarray]
    levels: list[Level]
    textured: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray, width: int) -> Self:
        """Prepare the grey levels of a reference for a window of a width [px]."""
        images, window = build_pyramid(values), design_window(width)
        lattice = find_lattice(images)
        images = keep_resolved(images, lattice)
        levels = [prepare_level(level) for level in images]
        return cls(values, window, lattice, images, levels, find_textured_cells(levels[0], window.cell))

    def without(self, pixels: np.ndarray) -> Self:
        """Return the reference without some pixels, (row, column) bool."""
        values = np.where(pixels, f4(np.nan), self.values)
        images = build_pyramid(values)[: len(self.images)]
        levels = [prepare_level(level) for level in images]
        textured = find_textured_cells(levels[0], self.window.cell) & self.textured
        return replace(self, values=values, images=images, levels=levels, textured=textured)

    def measure(self, deformed: np.ndarray, photometry: Photometry, prediction: np.ndarray | None = None) -> Nodes:
        """Measure a motion at the nodes of the finest level.

        Parameters
        ----------
        deformed
            Grey levels (row, column) in standard deviations of the reference; NaN where nothing is known.
        photometry
            Their brightness and saturation.
        prediction
            (2, node row, node column) [px]; without it the search is global.

        Raises
        ------
        CorrelationError
            Hardly any point agrees.
        """
        pyramid = build_pyramid(deformed)[: len(self.images)]
        estimated = estimate_nodes(self.levels, self.images, pyramid, self.window.width, prediction, photometry)
        return assess(estimated, self.window, int(np.count_nonzero(self.textured)))

    def at_pixels(self, nodes: np.ndarray) -> np.ndarray:
        """Interpolate values of nodes (channel, node row, node column) at all pixels."""
        first, cell = locate_nodes(1, self.window.cell)[0], self.window.cell
        rows, columns = ((np.arange(n) - first) / cell for n in self.values.shape)
        return resample(nodes, rows, columns)

    def spread(self, nodes: np.ndarray) -> np.ndarray:
        """Return values of nodes (node row, node column) at all pixels of their cells."""
        cell = self.window.cell
        pixels = np.repeat(np.repeat(nodes, cell, axis=0), cell, axis=1)
        return np.asarray(pixels[: self.values.shape[0], : self.values.shape[1]])
