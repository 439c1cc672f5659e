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

from fringedic.correlation import cell_kernels, image_kernels, resampling_kernels
from fringedic.correlation.affine import make_affine_nodes
from fringedic.correlation.keypoints import match_keypoints
from fringedic.correlation.pyramid import (
    Level,
    blur,
    count_nodes,
    find_level,
    fit_spline,
    locate_nodes,
    prepare_level,
    remove_shading,
)
from fringedic.frames.interpolation import WEIGHTS

f4 = np.float32

CELL = 4  # [px] is the side of a cell
WIDEST = 160  # [px] of the finest level used: it gives the motion to a fraction of a pixel of the full image
# Standard deviations of the correlation surface above which no other start is tried; the maximum of 10^5 values of
# noise is about 4.5. Here and below: test_large_motion_without_prediction.
CLEAR_PEAK = 15.0
SETTLED = 0.05  # [px of the level], motion of the corners below which the iteration ends
# Correlation coefficient of the whole images below which keypoints are matched: it is 0.04 after a wrong start, and 0.6
# where a strain of 60 % moves much of the surface out of the image. test_any_rotation_without_prediction
AGREES = 0.5
COARSE_PASSES, FINER_PASSES = 12, 8


def find_correlation_peak(reference: np.ndarray, deformed: np.ndarray) -> tuple[float, float, float]:
    """Return the whole-pixel displacement (d_x, d_y) at the peak of the cross-correlation, and its height."""
    shape = [scipy.fft.next_fast_len(2 * n, real=True) for n in reference.shape]
    f = scipy.fft.rfft2(remove_shading(reference), shape)
    g = scipy.fft.rfft2(remove_shading(deformed), shape)
    surface = scipy.fft.irfft2(np.conj(f) * g, shape)
    peak = np.unravel_index(int(np.argmax(surface)), surface.shape)
    dy, dx = (float((p + n // 2) % n - n // 2) for p, n in zip(peak, shape, strict=True))
    return dx, dy, float(surface[peak] / max(float(surface.std()), 1e-30))


@dataclass(frozen=True, eq=False)
class _Flat:
    """Both images on a level without their shading, zero where nothing is known of them.

    Attributes
    ----------
    level, spline
        Of the reference and of the deformed image.
    known : (node row, node column) float32
        Known part of the pixels of the reference's cells.
    """

    level: Level
    spline: np.ndarray
    known: np.ndarray

    @classmethod
    def of(cls, reference: np.ndarray, deformed: np.ndarray, blurred: bool = False) -> Self:
        images = [remove_shading(image) for image in (reference, deformed)]
        if blurred:
            images = [blur(image) for image in images]
        known = np.empty(count_nodes((reference.shape[0], reference.shape[1]), CELL), f4)
        image_kernels.average_cells(np.isfinite(reference).astype(f4), CELL, known)
        return cls(prepare_level(images[0]), fit_spline(images[1]), known)


def _refine(flat: _Flat, k: int, affine: np.ndarray, passes: int) -> tuple[np.ndarray, float]:
    """Refine an affine motion by some Gauss-Newton steps on level k; return it with the correlation coefficient."""
    level, spline = flat.level, flat.spline
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
    usable = np.empty(counts, f4)
    image_kernels.average_cells(np.isfinite(level.values).astype(f4), CELL, usable)
    usable *= CELL**2
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
        # Pixels that left the image or are outliers count as uncorrelated, those that are not known do not count.
        seen = (s[cell_kernels.W] * flat.known).sum() / (usable * flat.known).sum()
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
    top, finest = len(reference) - 1, find_level(reference, WIDEST)
    starts: list[np.ndarray] = []
    for k in range(finest, top + 1):
        dx, dy, height = find_correlation_peak(reference[k], deformed[k])
        starts.append(np.array([[dx * 2**k, 0.0, 0.0], [dy * 2**k, 0.0, 0.0]]))
        if height > CLEAR_PEAK:
            break
    else:
        starts.append(np.zeros((2, 3)))
    flat = {k: _Flat.of(reference[k], deformed[k]) for k in range(finest, top + 1)}
    smooth = _Flat.of(reference[top], deformed[top], blurred=True)
    best, agreement = starts[0], -2.0
    for start in starts:
        affine, _ = _refine(smooth, top, start, COARSE_PASSES)
        for k in range(top, finest - 1, -1):
            affine, correlation = _refine(flat[k], k, affine, FINER_PASSES)
        if correlation > agreement:
            best, agreement = affine, correlation
    matched = match_keypoints(reference, deformed) if agreement < AGREES else None
    return best if matched is None else matched
