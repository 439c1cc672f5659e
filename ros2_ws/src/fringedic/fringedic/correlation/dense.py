"""Dense method: amplitude-weighted phase fit over all frequencies, solved as a windowed gradient least squares.

By Parseval's theorem the phase fit of the zone method (Molimard et al., eq. 4-5, weighted by abs(C)) equals, up to
slopes of the window, the minimum over d of W * (f - g(x + d))^2. With the gradient of the reference f this is solved at
all points at once, around a smoothed predictor S u (Lucas and Kanade 1981, at every point):

    u = S u + H^-1 W * (grad f e),   e = f - g(x + S u),   H = W * (grad f grad f^T) + tau I

W is a Gaussian and S = 1 - (1 - V)^ORDER with V a narrower Gaussian; `transfer` contains the transfer of the fixed
point. Updating without the predictor would amplify noise with every iteration. The sums over pixels are computed once
per warp and per cell of a few pixels; the fixed point is iterated on the cells, where a step costs little.

The gradient of f is that of g(x + d) by d only as long as the surface hardly turns and stretches. A large affine part
of the motion is therefore a frame of its own, see `affine.AffineFrame`: d is what remains in the frame of f.

References
----------
B. D. Lucas, T. Kanade (1981), An iterative image registration technique with an application to stereo vision, IJCAI,
674-679.
J. W. Tukey's biweight: A. E. Beaton, J. W. Tukey (1974), Technometrics 16, 147-185.
P. H. van Cittert (1931), Zeitschrift fuer Physik 69, 298-308.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringedic.correlation import cell_kernels, node_kernels, resampling_kernels
from fringedic.correlation.affine import AffineFrame, fit_motion, make_affine_nodes
from fringedic.correlation.images import Photometry
from fringedic.correlation.pyramid import DERIVATIVE_NOISE, Level, change_level, count_nodes, find_level, fit_spline
from fringedic.correlation.start import WIDEST, estimate_global_motion
from fringedic.correlation.transfer import NARROWER, ORDER
from fringedic.correlation.window import Window, design_window, window_at_level
from fringedic.errors import CorrelationError, ErrorCode
from fringedic.frames.interpolation import WEIGHTS

f4 = np.float32

# Displacement errors [px] that may be left at each warp of the finest, a middle and the coarsest level; they limit what
# counts as an outlier. test_large_motion_without_prediction and test_a_prediction_may_be_off_by_what_moved_since.
EXPECTED = ((0.2, 0.05, 0.05, 0.05), (0.3, 0.1, 0.1), (0.5, 0.3, 0.1, 0.1, 0.1, 0.1))
# Root mean square change [px] below which the finest level, or a coarser one, is left: far below the noise.
SETTLED = (0.02, 0.05)
# Gradient energy of a texture over that of noise alone; test_a_bare_patch_is_not_measured.
TEXTURE = 1.5
# Level at which a given start is taken up: a prediction that is wrong by a dozen pixels is wrong by less than one after
# four halvings. From two halvings on, some furrows were matched with their neighbours.
PREDICTION_LEVEL = 4
# Part of the known pixels whose gradient is known, below which a region is too narrow for a level.
# test_disk_that_turns
NARROW = 0.25
OUTLIER = 3.0  # standard deviations of noise and remaining displacement error from which on Tukey's weights decrease
BRIGHTNESS_PASSES = 3  # of the deconvolution of gain and offset; test_shading_is_followed


def _derive_relaxations(count: int) -> np.ndarray:
    """Return the steps of the fixed point, as multiples of the plain ones, that reduce its error the most.

    A plain step multiplies the error of a frequency by (1 - h) s, s = 1 - (1 - v)^ORDER, which lies between 0 and a
    largest value r. With the zeros m_k of Chebyshev's polynomial on (0, r), `count` steps of 1 / (1 - m_k) reduce it
    more than any others (Richardson's iteration). Three of them replace a dozen plain steps.
    """
    q2 = np.linspace(0, 10, 1001)
    largest = np.max((1 - np.exp(-q2)) * (1 - (1 - np.exp(-q2 * NARROWER**2)) ** ORDER))
    zeros = largest / 2 * (1 + np.cos(np.pi * (np.arange(count) + 0.5) / count))
    return np.asarray(1 / (1 - zeros), dtype=f4)


RELAXATIONS = {count: _derive_relaxations(count) for count in (2, 3)}


@dataclass
class Field:
    """Result at the nodes of a level.

    Attributes
    ----------
    frame
        The affine part of the motion, beside which displacements count.
    nodes : (4, node row, node column)
        d_x, d_y [px of the level] in this frame, gain and offset of the deformed image.
    moved : (2, node row, node column)
        Change of d_x and d_y since the sums were computed.
    cells : (CHANNELS, node row, node column)
        Sums over cells.
    sums : (GXE, node row, node column)
        The first of them through the window.
    """

    frame: AffineFrame
    nodes: np.ndarray
    moved: np.ndarray
    cells: np.ndarray
    sums: np.ndarray


def estimate_noise(images: cell_kernels.ImagePair, lines: np.ndarray, cell: int) -> float:
    """Estimate the standard deviation of a pixel's residual from the median over cells of the mean absolute residual.

    Raises
    ------
    CorrelationError
        No pixel is seen in both images.
    """
    rows, columns = count_nodes((images.values.shape[0], images.values.shape[1]), cell)
    # Every eighth row of cells is enough for the noise; for a narrow strip of surface all rows are needed.
    for every in (max(1, min(8, rows // 16)), 1):
        mean = np.empty((-(-rows // every), columns), f4)
        cell_kernels.average_residuals(images, lines, cell, every, mean)
        seen = mean[np.isfinite(mean)]
        if 4 * seen.size > mean.size:
            break
    if seen.size == 0:
        raise CorrelationError(
            "no pixel of the reference is seen in the deformed image: nothing can be measured",
            code=ErrorCode.NO_CORRELATION,
        )
    middle = seen.size // 2
    # standard deviation of a normal distribution over its median absolute value, or over its mean absolute value
    return float(np.partition(seen, middle)[middle]) * float(1.4826 if cell == 1 else np.sqrt(np.pi / 2))


def _fit_planes(field: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Fit the affine parts (channel, 3) of a field: smoothing the rest is exact for them up to the edges."""
    out = np.empty((field.shape[0], 3), f4)
    node_kernels.fit_planes(field, weight, out)
    return out


class _LevelPair:
    """Reference and deformed image on one level, and the arrays that every warp fills again."""

    def __init__(
        self,
        level: Level,
        deformed: np.ndarray,
        window: Window,
        limits: tuple[float, float],
        frame: AffineFrame,
        k: int,
    ) -> None:
        self.level, self.window, self.limits, self.frame, self.k = level, window, limits, frame, k
        self.images = cell_kernels.ImagePair(level.values, level.along_x, level.along_y, fit_spline(deformed), WEIGHTS)
        rows, columns = count_nodes(level.shape, window.cell)
        self.lines = np.empty((4, rows + 4, level.shape[1]), f4)
        self.cells = np.empty((cell_kernels.CHANNELS, rows, columns), f4)
        self.sums = np.empty((cell_kernels.GXE, rows, columns), f4)
        self.seen, self.unresolved = np.empty((rows, columns), f4), np.zeros((rows, columns), f4)
        self.start, self.moved = np.empty((2, rows, columns), f4), np.empty((2, rows, columns), f4)

    def warp(self, nodes: np.ndarray, expected: float) -> float:
        """Fill the sums over cells and windows after one warp; return the noise of a pixel's residual.

        `expected` [px] is the displacement error that may remain: residuals that it explains are no outliers, nor are
        those of a displacement that the window does not resolve, see `node_kernels.bound_unresolved`.
        """
        cell = self.window.cell
        resampling_kernels.upsample_nodes(self.frame.total(nodes, self.k, cell), cell, self.lines)
        noise = estimate_noise(self.images, self.lines, cell)
        limit = OUTLIER * np.hypot(noise, expected * self.level.slope)
        images, lines, unresolved = self.images, self.lines, self.unresolved
        cell_kernels.accumulate_cells(images, lines, cell, limit, unresolved, self.limits, self.cells)
        node_kernels.apply_window(self.cells, self.window.taps, self.sums)
        return noise

    def refine(self, nodes: np.ndarray, expected: float) -> float:
        """Move `nodes` by one warp and the fixed point around it; return the root mean square change [px]."""
        noise = self.warp(nodes, expected)
        level, window, cells, sums, seen, u = self.level, self.window, self.cells, self.sums, self.seen, self.moved
        steps = 2 if expected > 0.1 else 3  # more warps follow a first one
        # tau: the gradient energy per cell that the noise of one image alone would have
        cell2 = window.cell**2
        tau = cell2 * max(DERIVATIVE_NOISE * noise**2 / 2, 1e-6 * level.slope**2)
        node_kernels.weigh_texture(cells, 2 * TEXTURE * tau, 1 / cell2, 1e-3, seen)
        node_kernels.subtract_planes(nodes[:2], _fit_planes(nodes[:2], seen), self.start)
        u[:] = self.start
        filters = (window.taps, window.narrow_taps)
        node_kernels.iterate_fixed_point(cells, sums, seen, self.start, filters, tau, RELAXATIONS[steps], u)
        u -= self.start
        nodes[:2] += u
        node_kernels.bound_unresolved(cells, u, self.unresolved)
        brightness = nodes[2:]
        before = brightness.copy()
        node_kernels.match_gain_offset(nodes, self.sums, noise**2 + 1e-6)
        node_kernels.van_cittert(brightness, before, self.seen, self.window.taps, BRIGHTNESS_PASSES)
        node_kernels.extrapolate(brightness, _fit_planes(brightness, self.seen), self.seen, self.window.taps)
        few = np.s_[..., ::2, ::2]
        return float(np.sqrt(np.sum(seen[few] * u[few] ** 2) / np.sum(seen[few])))


def estimate_nodes(
    levels: list[Level],
    reference: list[np.ndarray],
    deformed: list[np.ndarray],
    width: int,
    initial: np.ndarray | None,
    photometry: Photometry,
) -> Field:
    """Estimate the displacement at the nodes of the finest level, from coarse to fine.

    Parameters
    ----------
    levels, reference, deformed
        Pyramid of the reference with its gradients, and those of both images, finest first.
    width
        Of the window [px].
    initial
        (2, node row, node column) [px] at the finest level; replaces the global search.
    photometry
        Brightness and saturation of the deformed image.
    """
    if initial is not None:
        top, source = min(len(levels) - 1, PREDICTION_LEVEL), (0, design_window(width).cell)
        frame = AffineFrame.of(fit_motion(initial, source[1]))
        nodes = np.empty((4, *initial.shape[1:]), f4)
        nodes[2], nodes[3] = photometry.gain, photometry.offset
        nodes[:2] = frame.inside(initial, *source)
        nodes = change_level(nodes, source, (top, window_at_level(width, top).cell), levels[top].shape)
    else:
        top = find_level(reference, WIDEST)
        while top and np.isfinite(levels[top].values).sum() < NARROW * np.isfinite(reference[top]).sum():
            top -= 1
        motion = estimate_global_motion(reference, deformed)
        frame, cell = AffineFrame.of(motion), window_at_level(width, top).cell
        nodes = make_affine_nodes(motion, top, levels[top].shape, cell, photometry.gain, photometry.offset)
        nodes[:2] = frame.inside(nodes[:2], top, cell)
    for k in range(top, -1, -1):
        window = window_at_level(width, k)
        if k < top:
            nodes = change_level(nodes, (k + 1, window_at_level(width, k + 1).cell), (k, window.cell), levels[k].shape)
        pair = _LevelPair(levels[k], deformed[k], window, photometry.limits, frame, k)
        if k == top:
            # Shading first: mean and contrast of every window, before any residual is called an outlier.
            pair.warp(nodes, np.inf)
            node_kernels.match_gain_offset(nodes, pair.sums, 1e-3)
        steps = EXPECTED[0] if k == 0 else EXPECTED[1] if k < top else EXPECTED[2]
        for expected in steps:
            change = pair.refine(nodes, expected)
            if change < SETTLED[min(k, 1)] and (k or expected == steps[-1]):
                break
        if k:
            smooth = np.empty_like(nodes[:2])
            node_kernels.filter_median(nodes[:2], smooth)
            nodes[:2] = smooth
    return Field(frame, nodes, pair.moved, pair.cells, pair.sums)
