"""Global start: the affine motion of the whole image, found without any prediction.

The peak of the cross-correlation (Molimard et al., eq. 3) on several levels proposes translations. Each is refined to
an affine motion by the least squares of `dense` with the whole image as the window, from coarse to fine. Where none
of them makes the images agree, as after a rotation of 20 degrees, keypoints are matched.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import scipy.fft

from fringedic.correlation import cell_kernels, resampling_kernels
from fringedic.correlation.interpolation import WEIGHTS
from fringedic.correlation.keypoints import match_keypoints
from fringedic.correlation.pyramid import (
    Level,
    blur,
    count_nodes,
    fit_spline,
    locate_nodes,
    prepare_level,
    remove_shading,
)

f4 = np.float32

CELL = 4  # [px] is the side of a cell
WIDEST = 160  # [px] of the finest level used: it gives the motion to a fraction of a pixel of the full image
# Standard deviations of the correlation surface above which no other start is tried; the maximum of 10^5 values of
# noise is about 4.5. Here and below: test_large_motion_without_prediction.
CLEAR_PEAK = 15.0
# Largest rotation [rad] or strain of a motion that the gradient of the reference describes; beyond it, the error of a
# step is this part of it, and with it the uncertainty.
LARGE_GRADIENT = 0.05
SETTLED = 0.05  # [px of the level], motion of the corners below which the iteration ends
# Correlation coefficient of the whole images below which keypoints are matched: it is 0.04 after a wrong start, and 0.6
# where a strain of 60 % moves much of the surface out of the image. test_any_rotation_without_prediction
AGREES = 0.5
COARSE_PASSES, FINER_PASSES = 12, 8


@dataclass(frozen=True, eq=False)
class AffineFrame:
    """A large affine motion, beside which displacements are measured in the directions of the reference.

    The point x of the reference is at x + c + L x + (1 + L) r in the deformed image, with the displacement r in the
    frame. The gradient of the moved image by r is that of the reference.

    Attributes
    ----------
    motion
        c and L (2, 3) [px of the full image], as `make_affine_nodes` takes them; None is no motion.
    """

    motion: np.ndarray | None

    @classmethod
    def of(cls, motion: np.ndarray) -> Self:
        """Return the frame of a motion: none where it turns and stretches so little that the gradient suffices."""
        return cls(motion if np.linalg.norm(motion[:, 1:], 2) > LARGE_GRADIENT else None)

    @property
    def matrix(self) -> np.ndarray:
        """1 + L, (2, 2)."""
        return np.eye(2) if self.motion is None else np.eye(2) + self.motion[:, 1:]

    def total(self, nodes: np.ndarray, k: int, cell: int) -> np.ndarray:
        """Return nodes (2 or more channels) of level k with the displacement from the reference in the first two."""
        if self.motion is None:
            return nodes
        base = _evaluate_affine(self.motion, k, (nodes.shape[1], nodes.shape[2]), cell)
        total = nodes.copy()
        total[:2] = base + self._turned(self.matrix, nodes[:2])
        return total

    def inside(self, displacement: np.ndarray, k: int, cell: int) -> np.ndarray:
        """Return the displacement (2, node row, node column) in the frame, the inverse of `total`."""
        if self.motion is None:
            return displacement
        base = _evaluate_affine(self.motion, k, (displacement.shape[1], displacement.shape[2]), cell)
        return self._turned(np.linalg.inv(self.matrix), displacement - base)

    def turn_sigma(self, sigma: np.ndarray) -> np.ndarray:
        """Return the standard uncertainty (2, ...) along x and y of the image from that along those of the frame."""
        return sigma if self.motion is None else np.sqrt(self._turned(self.matrix**2, sigma**2))

    @staticmethod
    def _turned(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("ij,j...->i...", matrix.astype(f4), values))


def fit_motion(displacement: np.ndarray, cell: int) -> np.ndarray:
    """Return the affine motion (2, 3) [px] closest to a displacement (2, node row, node column) of the full image."""
    rows, columns = (locate_nodes(count, cell) for count in displacement.shape[1:])
    basis = np.stack(np.broadcast_arrays(1.0, columns, rows[:, None]), axis=-1).reshape(-1, 3)
    found: np.ndarray = np.linalg.lstsq(basis, displacement.reshape(2, -1).T.astype(float), rcond=None)[0].T
    return found


def _evaluate_affine(affine: np.ndarray, k: int, counts: tuple[int, int], cell: int) -> np.ndarray:
    """Return the displacement (2, node row, node column) [px of level k] of an affine motion at nodes of level k.

    The columns of `affine` are the displacement at the image's corner pixel (0, 0) and its derivatives by x and by y.
    """
    scale = 2**k
    rows, columns = (scale * locate_nodes(count, cell) + (scale - 1) / 2 for count in counts)
    field = affine[:, 0, None, None] + affine[:, 1, None, None] * columns + affine[:, 2, None, None] * rows[:, None]
    return np.asarray(field / scale, dtype=f4)


def find_correlation_peak(reference: np.ndarray, deformed: np.ndarray) -> tuple[float, float, float]:
    """Return the whole-pixel displacement (d_x, d_y) at the peak of the cross-correlation, and its height."""
    shape = [scipy.fft.next_fast_len(2 * n, real=True) for n in reference.shape]
    f = scipy.fft.rfft2(remove_shading(reference), shape)
    g = scipy.fft.rfft2(remove_shading(deformed), shape)
    surface = scipy.fft.irfft2(np.conj(f) * g, shape)
    peak = np.unravel_index(int(np.argmax(surface)), surface.shape)
    dy, dx = (float((p + n // 2) % n - n // 2) for p, n in zip(peak, shape, strict=True))
    return dx, dy, float(surface[peak] / max(float(surface.std()), 1e-30))


def make_affine_nodes(
    affine: np.ndarray, k: int, shape: tuple[int, int], cell: int, gain: float, offset: float
) -> np.ndarray:
    """Make nodes (4, node row, node column) of level k with an affine motion and a uniform brightness."""
    nodes = np.empty((4, *count_nodes(shape, cell)), f4)
    nodes[:2] = _evaluate_affine(affine, k, count_nodes(shape, cell), cell)
    nodes[2], nodes[3] = gain, offset
    return nodes


def _refine(level: Level, spline: np.ndarray, k: int, affine: np.ndarray, passes: int) -> tuple[np.ndarray, float]:
    """Refine an affine motion by some Gauss-Newton steps on level k; return it with the correlation coefficient."""
    shape = level.shape
    scale = 2**k
    counts = count_nodes(shape, CELL)
    rows, columns = (scale * locate_nodes(n, CELL) + (scale - 1) / 2 for n in counts)
    corners = np.array([[1, x * columns[-1], y * rows[-1]] for x in (0, 1) for y in (0, 1)]).T
    ones = np.ones(counts)
    basis = np.stack([ones, ones * columns, ones * rows[:, None]]) / scale
    images = cell_kernels.ImagePair(level.values, level.along_x, level.along_y, spline, WEIGHTS)
    lines = np.empty((4, counts[0] + 4, shape[1]), f4)
    mean, unresolved = np.empty(counts, f4), np.zeros(counts, f4)
    sums = np.empty((cell_kernels.CHANNELS, *counts), f4)
    correlation = -1.0
    for _ in range(passes):
        resampling_kernels.upsample_nodes(make_affine_nodes(affine, k, shape, CELL, 1.0, 0.0), CELL, lines)
        cell_kernels.average_residuals(images, lines, CELL, 1, mean)
        if not np.isfinite(mean).any():
            return affine, -1.0
        # Images without shading are zero where nothing is known: no residual there, and no information on the noise.
        known = mean[mean > 0]
        if not known.size:
            return affine, 1.0
        limit = 4 * float(np.median(known))
        cell_kernels.accumulate_cells(images, lines, CELL, limit, unresolved, (-np.inf, np.inf), sums)
        s = sums.astype(np.float64)
        normal = np.empty((6, 6))
        gxx, gxy, gyy = cell_kernels.GXX, cell_kernels.GXY, cell_kernels.GYY
        for a, b, channel in ((0, 0, gxx), (0, 1, gxy), (1, 0, gxy), (1, 1, gyy)):
            normal[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] = np.einsum("iyx,jyx,yx->ij", basis, basis, s[channel])
        right = [np.einsum("iyx,yx->i", basis, s[channel]) for channel in (cell_kernels.GXE, cell_kernels.GYE)]
        change = np.asarray(np.linalg.lstsq(normal, np.concatenate(right), rcond=1e-9)[0].reshape(2, 3))
        affine = affine + change
        # Pixels that left the image or are outliers count as uncorrelated.
        seen = s[cell_kernels.W].sum() / np.count_nonzero(np.isfinite(level.values))
        correlation = _correlate(s, seen)
        if np.abs(change @ corners).max() < SETTLED * scale:
            break
    return affine, correlation


def _correlate(sums: np.ndarray, seen: float) -> float:
    """Return the correlation coefficient of both images over all cells, times the share of the pixels that is seen."""
    w, wf, wff, we, wef, wee = (sums[channel].sum() for channel in range(cell_kernels.W, cell_kernels.GXE))
    var_f = wff / w - (wf / w) ** 2
    common = var_f - (wef / w - wf * we / w**2)
    var_g = 2 * common - var_f + wee / w - (we / w) ** 2
    return float(seen * common / np.sqrt(max(var_f * var_g, 1e-30)))


def estimate_global_motion(reference: list[np.ndarray], deformed: list[np.ndarray]) -> np.ndarray:
    """Estimate the affine motion (2, 3) [px of the full image] with the best agreement of two pyramids."""
    top = len(reference) - 1
    finest = next((k for k, image in enumerate(reference) if max(image.shape) <= WIDEST), top)
    starts: list[np.ndarray] = []
    for k in range(finest, top + 1):
        dx, dy, height = find_correlation_peak(reference[k], deformed[k])
        starts.append(np.array([[dx * 2**k, 0.0, 0.0], [dy * 2**k, 0.0, 0.0]]))
        if height > CLEAR_PEAK:
            break
    else:
        starts.append(np.zeros((2, 3)))
    flat = {
        k: (prepare_level(remove_shading(reference[k])), fit_spline(remove_shading(deformed[k])))
        for k in range(finest, top + 1)
    }
    smooth = prepare_level(blur(remove_shading(reference[top]))), fit_spline(blur(remove_shading(deformed[top])))
    best, agreement = starts[0], -2.0
    for start in starts:
        affine, _ = _refine(*smooth, top, start, COARSE_PASSES)
        for k in range(top, finest - 1, -1):
            affine, correlation = _refine(*flat[k], k, affine, FINER_PASSES)
        if correlation > agreement:
            best, agreement = affine, correlation
    matched = match_keypoints(reference, deformed) if agreement < AGREES else None
    return best if matched is None else matched
