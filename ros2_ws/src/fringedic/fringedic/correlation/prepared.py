"""A reference that is prepared once, and the dense measurement of one motion against it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from fringedic.correlation.agreement import Nodes, Texture, assess, measure_texture
from fringedic.correlation.blocks import leave_out_block_edges
from fringedic.correlation.dense import estimate_nodes
from fringedic.correlation.images import Photometry
from fringedic.correlation.lattice import Lattice, find_lattice, keep_resolved
from fringedic.correlation.pyramid import Level, build_pyramid, prepare_level, resample
from fringedic.correlation.texture_noise import CLEAR, FAINT, TextureNoise
from fringedic.correlation.window import Window, design_window
from fringedic.errors import CorrelationError, ErrorCode

f4 = np.float32

FEWEST_FEATURES = 8.0  # in a window of averaged pixels: with fewer, any two of them can be made to agree


def _prepare_levels(images: list[np.ndarray], deviation: float) -> list[Level]:
    levels = [prepare_level(image) for image in images]
    return [leave_out_block_edges(levels[0], deviation), *levels[1:]]


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
    texture
        Of the finest level, at its nodes.
    deviation
        Standard deviation of the image [grey level].
    binning
        Side [px] of the blocks whose mean is a pixel of the finest level.
    """

    values: np.ndarray
    window: Window
    lattice: Lattice | None
    images: list[np.ndarray]
    levels: list[Level]
    texture: Texture
    deviation: float
    binning: int = 1

    @property
    def cell(self) -> int:
        """Distance of the nodes [px of the image]."""
        return self.window.cell * self.binning

    @property
    def width(self) -> int:
        """Width of the window [px of the image]."""
        return self.window.width * self.binning

    @classmethod
    def of(cls, values: np.ndarray, width: int, deviation: float) -> Self:
        """Prepare the grey levels of a reference for a window of a width [px].

        `deviation` is the standard deviation of the image [grey level], the unit of the values.
        """
        images, window = build_pyramid(values), design_window(width)
        lattice = find_lattice(images)
        images = keep_resolved(images, lattice)
        levels = _prepare_levels(images, deviation)
        return cls(values, window, lattice, images, levels, measure_texture(levels[0], window.cell), deviation)

    def without(self, pixels: np.ndarray) -> Self:
        """Return the reference without some pixels, (row, column) bool."""
        values = np.where(pixels, f4(np.nan), self.values)
        images = self._own_levels(build_pyramid(values))
        levels = _prepare_levels(images, self.deviation)
        texture = measure_texture(levels[0], self.window.cell)
        texture = replace(texture, rich=texture.rich & self.texture.rich)
        return replace(self, values=values, images=images, levels=levels, texture=texture)

    def binned(self) -> Self | None:
        """Return the reference with blocks of pixels averaged so that a faint texture stands out from the noise.

        None where the texture is not faint, or where no binning makes it stand out or leaves enough pixels.
        """
        if self.lattice is not None:
            return None
        chosen, found = 0, TextureNoise.of(self.levels[0])
        if found.ratio > FAINT:
            return None
        for k, level in enumerate(self.levels[1:], 1):
            if min(level.shape) < self.window.width + 2 * self.window.cell or found.ratio > CLEAR:
                break
            chosen, found = k, TextureNoise.of(level)
        if found.ratio < FAINT or self.window.width**2 < FEWEST_FEATURES * found.feature:
            return None
        images, levels = self.images[chosen:], self.levels[chosen:]
        texture = measure_texture(levels[0], self.window.cell)
        return replace(self, images=images, levels=levels, texture=texture, binning=2**chosen)

    def _own_levels(self, pyramid: list[np.ndarray]) -> list[np.ndarray]:
        first = self.binning.bit_length() - 1
        return pyramid[first : first + len(self.images)]

    def measure(self, deformed: np.ndarray, photometry: Photometry, prediction: np.ndarray | None = None) -> Nodes:
        """Measure a motion at the nodes of the finest level.

        Parameters
        ----------
        deformed
            Grey levels (row, column) in standard deviations of the reference; NaN where nothing is known.
        photometry
            Their brightness and saturation.
        prediction
            (2, node row, node column) [px of the image]; without it the search is global.

        Returns
        -------
        Nodes
            [px of the image]

        Raises
        ------
        CorrelationError
            Hardly any point agrees.
        """
        pyramid = self._own_levels(build_pyramid(deformed))
        if prediction is not None:
            prediction = prediction / f4(self.binning)
        estimated = estimate_nodes(self.levels, self.images, pyramid, self.window.width, prediction, photometry)
        nodes = assess(estimated, self.window, self.texture)
        return Nodes(f4(self.binning) * nodes.displacement, f4(self.binning) * nodes.sigma, nodes.valid)

    def attempt(
        self, deformed: np.ndarray, photometry: Photometry, prediction: np.ndarray | None = None
    ) -> Nodes | None:
        """Do as `measure`; None where hardly any point agrees."""
        try:
            return self.measure(deformed, photometry, prediction)
        except CorrelationError as error:
            if error.code is not ErrorCode.NO_CORRELATION:
                raise
            return None

    def at_pixels(self, nodes: np.ndarray) -> np.ndarray:
        """Interpolate values of nodes (channel, node row, node column) at all pixels."""
        rows, columns = ((np.arange(n) - 0.5 * (self.cell - 1)) / self.cell for n in self.values.shape)
        return resample(nodes, rows, columns)

    def spread(self, nodes: np.ndarray) -> np.ndarray:
        """Return values of nodes (node row, node column) at all pixels of their cells; False beyond the last ones."""
        pixels = np.repeat(np.repeat(nodes, self.cell, axis=0), self.cell, axis=1)
        rows, columns = self.values.shape
        beyond = ((0, max(rows - pixels.shape[0], 0)), (0, max(columns - pixels.shape[1], 0)))
        return np.asarray(np.pad(pixels, beyond)[:rows, :columns])
