"""Compression blocks (JPEG) of 8 x 8 pixels whose edges are as strong as a faint texture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fringedic.correlation.pyramid import Level

BLOCK = 8  # [px]
# [grey level], standard deviation: the quantisation of the mean of a block at quality 50 (JPEG, table K.1)
FAINT = 16.0
# [grey level], standard deviation below which compression leaves hardly anything of a texture, and the ratio of the
# steps from which on an image is compressed: 1.8 and 2.2 for noise at quality 75; test_faint_texture_in_jpeg_images
HIDDEN, COMPRESSED = 4.0, 1.5
# Mean absolute step across the edges of blocks over that within them, along both axes: 1 without compression and up to
# 2.5 in faint images of quality 90, where the texture is measured; test_blocks_of_dark_jpeg_images_are_no_texture
STRONG = 3.0


def leave_out_block_edges(level: Level, deviation: float) -> Level:
    """Return a level without the gradient across the edges of its compression blocks, if these are its texture.

    The edges are at the same pixels in all images, so that they agree without displacement, whatever the images show.
    Without a gradient they have no influence on the displacement.

    Parameters
    ----------
    level
        The full image.
    deviation
        Standard deviation of its grey levels.
    """
    if not _shows_blocks(level, deviation, FAINT, STRONG):
        return level
    along_x, along_y = level.along_x.copy(), level.along_y.copy()
    for edge in (BLOCK - 1, 0):
        along_x[:, edge::BLOCK] = 0
        along_y[edge::BLOCK] = 0
    return replace(level, along_x=along_x, along_y=along_y)


def explain_compression(level: Level, deviation: float) -> str:
    """Return why a compressed reference shows no texture, and what helps; empty where it does or is not compressed.

    Parameters
    ----------
    level
        The full image.
    deviation
        Standard deviation of its grey levels.
    """
    if not _shows_blocks(level, deviation, HIDDEN, COMPRESSED):
        return ""
    return (
        "the contrast of the reference is so faint that its compression (JPEG) hides texture. Use more light or a "
        "stronger pattern, and save images without loss"
    )


def _shows_blocks(level: Level, deviation: float, faint: float, ratio: float) -> bool:
    """Return whether an image with a smaller deviation than `faint` has edges of blocks, in both directions."""
    return deviation < faint and min(level.shape) >= 4 * BLOCK and min(_edge_ratios(level.values)) > ratio


def _edge_ratios(values: np.ndarray) -> tuple[float, float]:
    """Return the mean absolute step across the edges of blocks over that within them, along x and along y."""
    ratios = []
    for image in (values[::3], values.T[::3]):
        steps = np.abs(np.diff(image[:, 3:-3], axis=1))  # from column k + 3 to k + 4
        known = np.isfinite(steps)
        total, count = np.where(known, steps, 0).sum(axis=0, dtype=float), known.sum(axis=0)
        across = np.arange(count.size) % BLOCK == BLOCK - 4
        edge, inside = (total[part].sum() / max(int(count[part].sum()), 1) for part in (across, ~across))
        ratios.append(float(edge) / max(float(inside), 1e-12))
    return ratios[0], ratios[1]
