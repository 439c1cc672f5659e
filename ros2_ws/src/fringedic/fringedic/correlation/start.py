"""Where to begin: the affine motion of the whole image, found without any prediction.

The peak of the cross-correlation (eq. 3) on several image sizes proposes translations; each is refined to an affine
motion by the windowed least squares of `dense`, with the whole image as the window, from coarse to fine.
"""

from __future__ import annotations

import numpy as np
import scipy.fft

from fringedic.correlation import kernels
from fringedic.correlation.interpolation import WEIGHTS
from fringedic.correlation.pyramid import (
    Level,
    blurred,
    flattened,
    node_counts,
    node_pixels,
    reference_level,
    spline_of,
)

f4 = np.float32

CELL = 4
WIDEST = 160  # [px]; an affine motion found on such an image is known to a fraction of a pixel of the full one
CLEAR_PEAK = 15.0  # standard deviations of the correlation surface: no other start need be tried


def correlation_peak(reference: np.ndarray, deformed: np.ndarray) -> tuple[float, float, float]:
    """Whole-pixel displacement (d_x, d_y) at the peak of the cross-correlation, and its height in deviations."""
    shape = [scipy.fft.next_fast_len(2 * n, real=True) for n in reference.shape]
    f = scipy.fft.rfft2(flattened(reference), shape)
    g = scipy.fft.rfft2(flattened(deformed), shape)
    surface = scipy.fft.irfft2(np.conj(f) * g, shape)
    peak = np.unravel_index(int(np.argmax(surface)), surface.shape)
    dy, dx = (float((p + n // 2) % n - n // 2) for p, n in zip(peak, shape, strict=True))
    return dx, dy, float(surface[peak] / max(float(surface.std()), 1e-30))


def _affine_nodes(affine: np.ndarray, k: int, shape: tuple[int, int], cell: int) -> np.ndarray:
    """Displacement (2, node row, node column) [px of level k] of an affine motion (2, 3) [px of the full image].

    The columns of `affine` are the displacement at the image's corner pixel (0, 0) and its derivatives by x and by y.
    """
    scale = 2**k
    rows, columns = (scale * node_pixels(n, cell) + (scale - 1) / 2 for n in node_counts(shape, cell))
    field = affine[:, 0, None, None] + affine[:, 1, None, None] * columns + affine[:, 2, None, None] * rows[:, None]
    return np.asarray(field / scale, dtype=f4)


def affine_field(
    affine: np.ndarray, k: int, shape: tuple[int, int], cell: int, gain: float, offset: float
) -> np.ndarray:
    """Nodes (4, node row, node column) of level k with an affine motion and a uniform brightness."""
    nodes = np.empty((4, *node_counts(shape, cell)), f4)
    nodes[:2] = _affine_nodes(affine, k, shape, cell)
    nodes[2], nodes[3] = gain, offset
    return nodes


def _refined(level: Level, spline: np.ndarray, k: int, affine: np.ndarray, passes: int) -> tuple[np.ndarray, float]:
    """Affine motion after some Gauss-Newton steps on level k, and the correlation coefficient that it reached."""
    shape = level.shape
    scale = 2**k
    counts = node_counts(shape, CELL)
    rows, columns = (scale * node_pixels(n, CELL) + (scale - 1) / 2 for n in counts)
    corners = np.array([[1, x * columns[-1], y * rows[-1]] for x in (0, 1) for y in (0, 1)]).T
    ones = np.ones(counts)
    basis = np.stack([ones, ones * columns, ones * rows[:, None]]) / scale
    lines = np.empty((4, counts[0] + 4, shape[1]), f4)
    mean = np.empty(counts, f4)
    sums = np.empty((kernels.CHANNELS, *counts), f4)
    correlation = -1.0
    for _ in range(passes):
        kernels.spread_out(affine_field(affine, k, shape, CELL, 1.0, 0.0), CELL, lines)
        kernels.residual_means(level.values, spline, WEIGHTS, lines, CELL, 1, mean)
        if not np.isfinite(mean).any():
            return affine, -1.0
        # flattened images are zero where nothing is known: no residual there, and nothing about the noise either
        known = mean[mean > 0]
        if not known.size:
            return affine, 1.0
        limit = 4 * float(np.median(known))
        kernels.summed(
            level.values, level.along_x, level.along_y, spline, WEIGHTS, lines, CELL, limit, -np.inf, np.inf, sums
        )
        s = sums.astype(np.float64)
        normal = np.empty((6, 6))
        for a, b, channel in ((0, 0, kernels.GXX), (0, 1, kernels.GXY), (1, 0, kernels.GXY), (1, 1, kernels.GYY)):
            normal[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] = np.einsum("iyx,jyx,yx->ij", basis, basis, s[channel])
        right = np.concatenate([np.einsum("iyx,yx->i", basis, s[channel]) for channel in (kernels.GXE, kernels.GYE)])
        change = np.linalg.lstsq(normal, right, rcond=1e-9)[0].reshape(2, 3)
        affine = affine + change
        w, wf, wff, we, wef, wee = (s[c].sum() for c in range(kernels.W, kernels.GXE))
        var_f = wff / w - (wf / w) ** 2
        common = var_f - (wef / w - wf * we / w**2)
        var_g = 2 * common - var_f + wee / w - (we / w) ** 2
        # Pixels that left the image, or that were thrown out, count as uncorrelated.
        seen = w / np.count_nonzero(np.isfinite(level.values))
        correlation = float(seen * common / np.sqrt(max(var_f * var_g, 1e-30)))
        if np.abs(change @ corners).max() < 0.05 * scale:
            break
    return affine, correlation


def global_motion(reference: list[np.ndarray], deformed: list[np.ndarray]) -> np.ndarray:
    """Affine motion (2, 3) [px of the full image] that brings the images to the best agreement."""
    top = len(reference) - 1
    finest = next((k for k, image in enumerate(reference) if max(image.shape) <= WIDEST), top)
    starts: list[np.ndarray] = []
    for k in range(finest, top + 1):
        dx, dy, height = correlation_peak(reference[k], deformed[k])
        starts.append(np.array([[dx * 2**k, 0.0, 0.0], [dy * 2**k, 0.0, 0.0]]))
        if height > CLEAR_PEAK:
            break
    else:
        starts.append(np.zeros((2, 3)))
    flat = {
        k: (reference_level(flattened(reference[k])), spline_of(flattened(deformed[k]))) for k in range(finest, top + 1)
    }
    smooth = reference_level(blurred(flattened(reference[top]))), spline_of(blurred(flattened(deformed[top])))
    best, agreement = starts[0], -2.0
    for start in starts:
        affine, _ = _refined(*smooth, top, start, 12)
        for k in range(top, finest - 1, -1):
            affine, correlation = _refined(*flat[k], k, affine, 8)
        if correlation > agreement:
            best, agreement = affine, correlation
    return best
