"""Image sizes from full to coarse, their gradients and splines, and fields on the nodes between which they move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringedic.correlation import kernels, node_kernels
from fringedic.correlation.interpolation import INVERSE

f4 = np.float32

COARSEST = 24  # [px]: below, the borders of the gradient leave nothing
DERIVATIVE = np.array([3 / 4, -3 / 20, 1 / 60], dtype=f4)  # of sixth order
DERIVATIVE_NOISE = 2 * float(np.sum(DERIVATIVE.astype(float) ** 2))


@dataclass(frozen=True)
class Level:
    """One image size of the pyramid of a reference: grey levels (NaN where not usable) and their gradient."""

    values: np.ndarray
    along_x: np.ndarray
    along_y: np.ndarray
    slope: float  # root mean square of the gradient along one axis

    @property
    def shape(self) -> tuple[int, int]:
        return self.values.shape[0], self.values.shape[1]


def pyramid_of(image: np.ndarray) -> list[np.ndarray]:
    """The image and its halves down to COARSEST: finest first."""
    levels = [image]
    while min(levels[-1].shape) // 2 >= COARSEST:
        rows, columns = levels[-1].shape
        half = np.empty((rows // 2, columns // 2), f4)
        kernels.halved(levels[-1], half)
        levels.append(half)
    return levels


def reference_level(image: np.ndarray) -> Level:
    """Gradient of an image and the pixels where it is known."""
    values, along_x, along_y = np.empty_like(image), np.empty_like(image), np.empty_like(image)
    kernels.gradient(image, DERIVATIVE, values, along_x, along_y)
    slope = float(np.sqrt(np.mean(along_x[::4, ::4] ** 2 + along_y[::4, ::4] ** 2) / 2))
    return Level(values, along_x, along_y, slope)


def spline_of(image: np.ndarray) -> np.ndarray:
    """Coefficients of the interpolation of an image, NaN around pixels that are not measured, and outside.

    Single missing pixels are mended. Others are filled with the mean of their surroundings first; what the fill changes
    dies out as .54 per pixel, and the four pixels around it that a coefficient reaches are given up.
    """
    rows, columns = image.shape
    border = kernels.BORDER
    out = np.full((rows + 2 * border, columns + 2 * border), np.nan, dtype=f4)
    missing = np.isnan(image)
    if missing.any():
        whole = np.empty_like(image)
        kernels.mended(image, whole)
        image, missing = whole, np.isnan(whole)
    if not missing.any():
        kernels.spline_coefficients(image, INVERSE, out)
        return out
    kernels.spline_coefficients(filled(image[None])[0], INVERSE, out)
    near = missing.copy()
    near[1:] |= missing[:-1]
    near[:-1] |= missing[1:]
    across = near.copy()
    across[:, 1:] |= near[:, :-1]
    across[:, :-1] |= near[:, 1:]
    out[border:-border, border:-border][across] = np.nan
    return out


_SURROUNDINGS = np.full(node_kernels.REACH + 1, 1 / (2 * node_kernels.REACH + 1), dtype=f4)
_SPREAD = np.array([6, 4, 1] + [0] * (node_kernels.REACH - 2), dtype=f4) / 16


def filled(nodes: np.ndarray) -> np.ndarray:
    """Array (channel, row, column) whose NaN are filled from their neighbours inwards, ever coarser if need be."""
    missing = np.isnan(nodes[0])
    if not missing.any():
        return nodes
    known = np.where(missing, f4(0), f4(1))[None]
    weighted = np.where(missing, f4(0), nodes).astype(f4)
    spread, weight = np.empty_like(weighted), np.empty_like(known)
    node_kernels.windowed(weighted, _SPREAD, spread)
    node_kernels.windowed(known, _SPREAD, weight)
    around = np.where(weight > 0, spread / np.where(weight > 0, weight, 1), f4(np.nan))
    if np.isnan(around).any():
        rows, columns = missing.shape
        if min(rows, columns) < 4:
            around = np.where(np.isnan(around), np.nanmean(nodes, axis=(1, 2), keepdims=True), around)
        else:
            padded = np.pad(around, ((0, 0), (0, rows % 2), (0, columns % 2)), constant_values=np.nan)
            blocks = padded.reshape(len(nodes), padded.shape[1] // 2, 2, padded.shape[2] // 2, 2)
            seen = ~np.isnan(blocks)
            count = seen.sum(axis=(2, 4))
            total = np.where(seen, blocks, 0).sum(axis=(2, 4), dtype=f4)
            coarse = np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(f4)
            fine = np.repeat(np.repeat(filled(coarse), 2, axis=1), 2, axis=2)[:, :rows, :columns]
            around = np.where(np.isnan(around), fine, around)
    return np.where(missing, around, nodes).astype(f4)


def blurred(image: np.ndarray) -> np.ndarray:
    """Image seen through a blur of about one pixel; its missing pixels stay missing."""
    out = np.empty_like(image[None])
    node_kernels.windowed(filled(image[None]), _SPREAD, out)
    return np.where(np.isnan(image), f4(np.nan), out[0])


def flattened(image: np.ndarray) -> np.ndarray:
    """Image without shading: minus its local mean, over its local deviation; NaN become zero."""
    known = np.where(np.isnan(image), f4(0), f4(1))
    grey = np.where(np.isnan(image), f4(0), image)
    local = np.empty((3, *image.shape), f4)
    node_kernels.windowed(np.stack([known, grey, grey * grey]), _SURROUNDINGS, local)
    weight = np.maximum(local[0], f4(1e-6))
    mean = local[1] / weight
    deviation = np.sqrt(np.maximum(local[2] / weight - mean * mean, 0))
    return known * (grey - mean) / np.maximum(deviation, f4(0.1) * np.mean(deviation) + f4(1e-6))


def node_counts(shape: tuple[int, int], cell: int) -> tuple[int, int]:
    """Cells needed to cover an image."""
    return -(-shape[0] // cell), -(-shape[1] // cell)


def resampled(nodes: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Node arrays at row and column positions given in nodes."""
    lines = np.empty((nodes.shape[0], nodes.shape[1] + 4, columns.size), f4)
    kernels.widened(np.ascontiguousarray(nodes), columns, lines)
    out = np.empty((nodes.shape[0], rows.size, columns.size), f4)
    kernels.heightened(lines, rows, out)
    return out


def node_pixels(count: int, cell: int) -> np.ndarray:
    """Pixel positions of nodes along one axis."""
    return np.arange(count) * cell + 0.5 * (cell - 1)


def transferred(
    nodes: np.ndarray, source: tuple[int, int], target: tuple[int, int], shape: tuple[int, int]
) -> np.ndarray:
    """Nodes (4, ...) of one level and cell (`source`) at those of another (`target`), whose image has `shape`.

    Pixel p of level k stands at 2^k (p + 1/2) - 1/2 in the full image.
    """
    (source_level, source_cell), (target_level, target_cell) = source, target
    ratio = 2.0 ** (target_level - source_level)

    def positions(count: int) -> np.ndarray:
        pixels = ratio * (node_pixels(count, target_cell) + 0.5) - 0.5
        return (pixels - 0.5 * (source_cell - 1)) / source_cell

    rows, columns = node_counts(shape, target_cell)
    out = resampled(nodes, positions(rows), positions(columns))
    out[:2] /= f4(ratio)
    return out


def initial_nodes(start: np.ndarray, shape: tuple[int, int], cell: int, spacing: int) -> np.ndarray:
    """A displacement known at every `spacing`-th pixel (2, row, column), at the nodes; gaps are filled."""
    counts = node_counts(shape, cell)
    if spacing > 1:
        rows, columns = (node_pixels(count, cell) / spacing for count in counts)
        return resampled(filled(start), rows, columns)
    means = np.empty((2, *counts), f4)
    for channel in range(2):
        kernels.cell_means(start[channel], cell, means[channel])
    return filled(means)
