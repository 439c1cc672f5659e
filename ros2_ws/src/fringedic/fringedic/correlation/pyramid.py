"""Image pyramid with gradients and splines, and resampling of node fields between its levels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringedic.correlation import image_kernels, node_kernels, resampling_kernels
from fringedic.frames import interpolation_kernels
from fringedic.frames.interpolation import INVERSE
from fringedic.frames.interpolation_kernels import BORDER

f4 = np.float32

COARSEST = 24  # [px] of the shorter side: on smaller levels the borders of the gradient would leave too little
DERIVATIVE = np.array([3 / 4, -3 / 20, 1 / 60], dtype=f4)  # central difference of sixth order, from the centre on
DERIVATIVE_NOISE = 2 * float(np.sum(DERIVATIVE.astype(float) ** 2))


@dataclass(frozen=True)
class Level:
    """One level of the pyramid of a reference.

    Attributes
    ----------
    values : (row, column) float32
        Grey levels, NaN where not usable.
    along_x, along_y : (row, column) float32
        Derivatives by column and by row [1/px].
    slope
        Root mean square of the gradient along one axis [1/px].
    """

    values: np.ndarray
    along_x: np.ndarray
    along_y: np.ndarray
    slope: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.values.shape[0], self.values.shape[1]


def build_pyramid(image: np.ndarray) -> list[np.ndarray]:
    """Return the image and its halves down to COARSEST, finest first."""
    levels = [image]
    while min(levels[-1].shape) // 2 >= COARSEST:
        rows, columns = levels[-1].shape
        half = np.empty((rows // 2, columns // 2), f4)
        image_kernels.downsample(levels[-1], half)
        levels.append(half)
    return levels


def find_level(images: list[np.ndarray], widest: int) -> int:
    """Return the finest level whose longer side is at most `widest` [px], or the coarsest one."""
    return next((k for k, image in enumerate(images) if max(image.shape) <= widest), len(images) - 1)


def prepare_level(image: np.ndarray) -> Level:
    """Compute the gradient of an image and the pixels where it is known."""
    values, along_x, along_y = np.empty_like(image), np.empty_like(image), np.empty_like(image)
    image_kernels.differentiate(image, DERIVATIVE, values, along_x, along_y)
    slope = float(np.sqrt(np.mean(along_x[::4, ::4] ** 2 + along_y[::4, ::4] ** 2) / 2))
    return Level(values, along_x, along_y, slope)


def fit_spline(image: np.ndarray) -> np.ndarray:
    """Compute the coefficients of the interpolation of an image, NaN around missing pixels and outside.

    Single missing pixels are interpolated. Others are filled with the mean of their surroundings first. The effect of
    the filling decreases by .54 per pixel; the coefficients of the pixels next to it are set to NaN.
    """
    rows, columns = image.shape
    out = np.full((rows + 2 * BORDER, columns + 2 * BORDER), np.nan, dtype=f4)
    missing = np.isnan(image)
    if missing.any():
        whole = np.empty_like(image)
        image_kernels.fill_isolated(image, whole)
        image, missing = whole, np.isnan(whole)
    if not missing.any():
        interpolation_kernels.fit_spline(image, INVERSE, out)
        return out
    interpolation_kernels.fit_spline(inpaint(image[None])[0], INVERSE, out)
    near = missing.copy()
    near[1:] |= missing[:-1]
    near[:-1] |= missing[1:]
    across = near.copy()
    across[:, 1:] |= near[:, :-1]
    across[:, :-1] |= near[:, 1:]
    out[BORDER:-BORDER, BORDER:-BORDER][across] = np.nan
    return out


_SURROUNDINGS = np.full(node_kernels.REACH + 1, 1 / (2 * node_kernels.REACH + 1), dtype=f4)
_SPREAD = np.array([6, 4, 1] + [0] * (node_kernels.REACH - 2), dtype=f4) / 16


def inpaint(nodes: np.ndarray) -> np.ndarray:
    """Fill the NaN of an array (channel, row, column) from their neighbours, on coarser levels where necessary."""
    missing = np.isnan(nodes[0])
    if not missing.any():
        return nodes
    known = np.where(missing, f4(0), f4(1))[None]
    weighted = np.where(missing, f4(0), nodes).astype(f4)
    spread, weight = np.empty_like(weighted), np.empty_like(known)
    node_kernels.apply_window(weighted, _SPREAD, spread)
    node_kernels.apply_window(known, _SPREAD, weight)
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
            fine = np.repeat(np.repeat(inpaint(coarse), 2, axis=1), 2, axis=2)[:, :rows, :columns]
            around = np.where(np.isnan(around), fine, around)
    return np.where(missing, around, nodes).astype(f4)


def blur(image: np.ndarray) -> np.ndarray:
    """Blur an image by about one pixel; its missing pixels stay missing."""
    out = np.empty_like(image[None])
    node_kernels.apply_window(inpaint(image[None]), _SPREAD, out)
    return np.where(np.isnan(image), f4(np.nan), out[0])


def remove_shading(image: np.ndarray) -> np.ndarray:
    """Remove shading: subtract the local mean, divide by the local standard deviation; NaN become zero."""
    known = np.where(np.isnan(image), f4(0), f4(1))
    grey = np.where(np.isnan(image), f4(0), image)
    local = np.empty((3, *image.shape), f4)
    node_kernels.apply_window(np.stack([known, grey, grey * grey]), _SURROUNDINGS, local)
    weight = np.maximum(local[0], f4(1e-6))
    mean = local[1] / weight
    deviation = np.sqrt(np.maximum(local[2] / weight - mean * mean, 0))
    return np.asarray(known * (grey - mean) / np.maximum(deviation, f4(0.1) * np.mean(deviation) + f4(1e-6)))


def count_nodes(shape: tuple[int, int], cell: int) -> tuple[int, int]:
    """Count the cells along rows and columns that cover an image."""
    return -(-shape[0] // cell), -(-shape[1] // cell)


def resample(nodes: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Interpolate node arrays at row and column positions given in nodes."""
    lines = np.empty((nodes.shape[0], nodes.shape[1] + 4, columns.size), f4)
    resampling_kernels.resample_columns(np.ascontiguousarray(nodes), columns, lines)
    out = np.empty((nodes.shape[0], rows.size, columns.size), f4)
    resampling_kernels.resample_rows(lines, rows, out)
    return out


def locate_nodes(count: int, cell: int) -> np.ndarray:
    """Return the pixel positions of nodes along one axis."""
    return np.arange(count) * cell + 0.5 * (cell - 1)


def change_level(
    nodes: np.ndarray, source: tuple[int, int], target: tuple[int, int], shape: tuple[int, int]
) -> np.ndarray:
    """Resample nodes (4, ...) of one level and cell size (`source`) at those of another (`target`).

    `shape` is the size of the target level. Pixel p of level k is at 2^k (p + 1/2) - 1/2 in the full image.
    """
    (source_level, source_cell), (target_level, target_cell) = source, target
    ratio = 2.0 ** (target_level - source_level)

    def positions(count: int) -> np.ndarray:
        pixels = ratio * (locate_nodes(count, target_cell) + 0.5) - 0.5
        return (pixels - 0.5 * (source_cell - 1)) / source_cell

    rows, columns = count_nodes(shape, target_cell)
    out = resample(nodes, positions(rows), positions(columns))
    out[:2] /= f4(ratio)
    return out


def sample_initial(start: np.ndarray, shape: tuple[int, int], cell: int, spacing: int) -> np.ndarray:
    """Sample a displacement (2, row, column), given at every `spacing`-th pixel, at the nodes; gaps are filled."""
    counts = count_nodes(shape, cell)
    if spacing > 1:
        rows, columns = (locate_nodes(count, cell) / spacing for count in counts)
        return resample(inpaint(start), rows, columns)
    means = np.empty((2, *counts), f4)
    for channel in range(2):
        image_kernels.average_cells(start[channel], cell, means[channel])
    return inpaint(means)
