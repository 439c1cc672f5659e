"""The amplitude-weighted phase fit over all frequencies, at every pixel, as a windowed gradient least squares.

By Parseval's theorem the phase fit of the zone method (paper, eq. 4-5, weighted by abs(C)) equals, up to slopes of the
window, the minimum over d of W * (f - g(x + d))^2. With the gradient of the reference f this is solved at all points
at once, around a smoothed predictor S u:

    u = S u + H^-1 W * (grad f e),   e = f - g(x + S u),   H = W * (grad f grad f^T) + tau I

W is a Gaussian of transfer h, S = 1 - (1 - V)^ORDER with V a narrower Gaussian of transfer v. The fixed point has the
transfer T = h / (h + (1 - h) (1 - v)^ORDER): flat up to the order 2 (ORDER + 1), then falling like h, with a bounded
noise gain and without overshoot. The sums over pixels are taken once per warp and per cell of a few pixels; the fixed
point is found on the cells, where a step costs little.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from fringedic.correlation import kernels, node_kernels
from fringedic.correlation.images import SMALLEST_WINDOW
from fringedic.correlation.interpolation import WEIGHTS, noise_kept
from fringedic.correlation.pyramid import (
    DERIVATIVE_NOISE,
    Level,
    node_counts,
    spline_of,
    transferred,
)
from fringedic.correlation.start import WIDEST, affine_field, global_motion
from fringedic.errors import NoCorrelationError

f4 = np.float32

NOISE_KEPT = noise_kept()
ORDER = 6
NARROWER = 0.75  # the Gaussian of S against that of W
# Displacement errors [px] that may be left at each warp of the finest, a middle and the coarsest level.
EXPECTED = ((0.2, 0.05, 0.05, 0.05), (0.3, 0.1, 0.1), (0.5, 0.3, 0.1, 0.1, 0.1, 0.1))
# [px], root mean square change after which the finest level, or a coarser one, is left.
SETTLED = (0.02, 0.05)


def _gaussian(deviation: float, reach: int) -> np.ndarray:
    """Taps from the centre on, of unit sum over both sides."""
    taps = np.exp(-0.5 * (np.arange(reach + 1) / deviation) ** 2)
    return taps / (taps[0] + 2 * taps[1:].sum())


@dataclass(frozen=True)
class Window:
    """Scale of the filters: nodes on square cells, Gaussian taps of W and of S in cells, and their noise gain.

    `noise` is the mean of T^2 over the frequencies of the nodes: the variance at a node over that of one cell.
    Of white noise that has passed through V the fit leaves the share `left`, the mean of v^2 (1 - T)^2 over that of
    v^2; `independent` is the number of independent values per node of what it leaves.
    """

    width: int
    deviation: float  # of W [px]
    cell: int
    taps: np.ndarray
    smoothing: np.ndarray
    noise: float
    left: float
    independent: float


def _transfer(window: np.ndarray, smoothing: np.ndarray) -> np.ndarray:
    """T of the fixed point from the transfers of W and of the Gaussian that S is made of."""
    return window / (window + (1 - window) * (1 - smoothing) ** ORDER)


def _relaxations(count: int) -> np.ndarray:
    """Steps of the fixed point, as multiples of the plain ones, that shrink its error the most.

    A plain step multiplies the error of a frequency by (1 - h) s, s = 1 - (1 - v)^ORDER, which lies between 0 and a
    largest value r; `count` steps of 1 / (1 - m_k), m_k the zeros of Chebyshev's polynomial on (0, r), multiply it by
    less than any others (Richardson's second-degree iteration). Three of them do what a dozen of plain steps do.
    """
    q2 = np.linspace(0, 10, 1001)
    largest = np.max((1 - np.exp(-q2)) * (1 - (1 - np.exp(-q2 * NARROWER**2)) ** ORDER))
    zeros = largest / 2 * (1 + np.cos(np.pi * (np.arange(count) + 0.5) / count))
    return np.asarray(1 / (1 - zeros), dtype=f4)


RELAXATIONS = {count: _relaxations(count) for count in (2, 3)}


def _response(taps: np.ndarray) -> np.ndarray:
    """Transfer of a symmetric filter at 128 frequencies of the nodes."""
    waves = np.cos(2 * np.pi * np.outer(np.fft.fftfreq(128), np.arange(taps.size)))
    waves[:, 1:] *= 2
    return np.asarray(waves @ taps)


@lru_cache(maxsize=16)
def window_of(width: int) -> Window:
    """Filters with the noise of a bi-triangular window of `width` pixels used on both images.

    Such a window averages noise over the effective length (sum w^2)^2 / sum w^4 = (width - 1) / 1.8 per axis. For a
    Gaussian W of standard deviation s, the integral of T^2 over the frequencies is (n / (sqrt(2) pi s))^2 with
    n^2 = pi times the integral of T^2 over q^2, h = exp(-q^2); both are made equal.
    """
    q2 = np.linspace(0, 40, 40001)
    transfer = _transfer(np.exp(-q2), np.exp(-q2 * NARROWER**2))
    n = np.sqrt(np.pi * np.sum(transfer**2) * (q2[1] - q2[0]))
    deviation = float(n / (np.sqrt(2) * np.pi) * (width - 1) / 1.8)
    cell = round(width / 8)
    taps = _gaussian(deviation / cell, node_kernels.REACH)
    smoothing = _gaussian(NARROWER * deviation / cell, node_kernels.NARROW_REACH)
    h, v = _response(taps), _response(smoothing)
    gain = _transfer(np.outer(h, h), np.outer(v, v))
    narrow = np.outer(v, v) ** 2
    remains = narrow * (1 - gain) ** 2
    return Window(
        width,
        deviation,
        cell,
        taps.astype(f4),
        smoothing.astype(f4),
        noise=float(np.mean(gain**2)),
        left=float(np.mean(remains) / np.mean(narrow)),
        independent=float(np.mean(remains) ** 2 / np.mean(remains**2)),
    )


@dataclass
class Field:
    """What is known at the nodes of a level: displacement and brightness, and sums over cells and over windows."""

    nodes: np.ndarray  # (4, node row, node column): d_x, d_y [px of the level], gain and offset of g
    moved: np.ndarray  # (2, node row, node column): what d_x and d_y have changed since the sums were taken
    cells: np.ndarray  # (CHANNELS, node row, node column)
    sums: np.ndarray  # the same, windowed, without the last two


def noise_of(level: Level, spline: np.ndarray, lines: np.ndarray, cell: int) -> float:
    """Standard deviation of a pixel's residual: the median over cells of what their mean absolute residuals tell.

    Raises
    ------
    NoCorrelationError
        No pixel is seen in both images.
    """
    rows, columns = node_counts(level.shape, cell)
    # Every eighth row of cells knows the noise; of a narrow strip of surface all are asked.
    for every in (max(1, min(8, rows // 16)), 1):
        mean = np.empty((-(-rows // every), columns), f4)
        kernels.residual_means(level.values, spline, WEIGHTS, lines, cell, every, mean)
        seen = mean[np.isfinite(mean)]
        if 4 * seen.size > mean.size:
            break
    if seen.size == 0:
        raise NoCorrelationError("no pixel of the reference is seen in the deformed image: nothing can be measured")
    middle = seen.size // 2
    return float(np.partition(seen, middle)[middle]) * float(1.4826 if cell == 1 else np.sqrt(np.pi / 2))


def _planes(field: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Affine parts (channel, 3) of a field: smoothing the rest keeps it exact up to the edges of what is seen."""
    out = np.empty((field.shape[0], 3), f4)
    node_kernels.planes(field, weight, out)
    return out


class _Pair:
    """Reference and deformed image on one level, and the arrays that every warp fills anew.

    `ends` are the grey levels between which the deformed image is not cut off.
    """

    def __init__(self, level: Level, deformed: np.ndarray, window: Window, ends: tuple[float, float]) -> None:
        self.level, self.window, self.ends = level, window, ends
        self.spline = spline_of(deformed)
        rows, columns = node_counts(level.shape, window.cell)
        self.lines = np.empty((4, rows + 4, level.shape[1]), f4)
        self.cells = np.empty((kernels.CHANNELS, rows, columns), f4)
        self.sums = np.empty((kernels.GXE, rows, columns), f4)
        self.seen = np.empty((rows, columns), f4)
        self.start, self.moved = np.empty((2, rows, columns), f4), np.empty((2, rows, columns), f4)

    def warp(self, nodes: np.ndarray, expected: float) -> float:
        """Fill the sums over cells and windows after one warp; returns the noise of a pixel's residual.

        `expected` [px] is the displacement error that may still be there: residuals it explains are no outliers.
        """
        level, cell = self.level, self.window.cell
        kernels.spread_out(nodes, cell, self.lines)
        noise = noise_of(level, self.spline, self.lines, cell)
        kernels.summed(
            level.values,
            level.along_x,
            level.along_y,
            self.spline,
            WEIGHTS,
            self.lines,
            cell,
            3 * np.hypot(noise, expected * level.slope),
            *self.ends,
            self.cells,
        )
        node_kernels.windowed(self.cells, self.window.taps, self.sums)
        return noise

    def refine(self, nodes: np.ndarray, expected: float) -> float:
        """One warp and the fixed point around it: moves `nodes`, returns by how much [px]."""
        noise = self.warp(nodes, expected)
        level, window, cells, sums, seen, u = self.level, self.window, self.cells, self.sums, self.seen, self.moved
        steps = 2 if expected > 0.1 else 3  # a first warp has others after it
        # tau: the gradient that the noise of one image alone would show, as an energy per cell.
        cell2 = window.cell**2
        tau = cell2 * max(DERIVATIVE_NOISE * noise**2 / 2, 1e-6 * level.slope**2)
        node_kernels.textured(cells, 2 * TEXTURE * tau, 1 / cell2, 1e-3, seen)
        node_kernels.without_plane(nodes[:2], _planes(nodes[:2], seen), self.start)
        u[:] = self.start
        node_kernels.fixed_point(
            cells, sums, seen, self.start, window.taps, window.smoothing, tau, ORDER, RELAXATIONS[steps], u
        )
        u -= self.start
        nodes[:2] += u
        brightness = nodes[2:]
        before = brightness.copy()
        node_kernels.equalised(nodes, sums, noise**2 + 1e-6)
        node_kernels.sharpened(brightness, before, seen, window.taps, 3)
        node_kernels.lent(brightness, _planes(brightness, seen), seen, window.taps)
        few = np.s_[..., ::2, ::2]
        return float(np.sqrt(np.sum(seen[few] * u[few] ** 2) / np.sum(seen[few])))


def explained(correlation: np.ndarray, speckles: np.ndarray) -> np.ndarray:
    """Coefficient of determination r^2 of a fit, adjusted for its parameters (two of motion, two of brightness).

    A window with few independent speckles can be made to agree with anything; the adjustment is limited to a factor 10.
    """
    freedom = np.maximum(speckles - 1, 1e-6)
    return 1 - (1 - np.clip(correlation, 0, 1) ** 2) * freedom / np.maximum(freedom - 4, freedom / 10)


SMALLEST_EXPLAINED = 0.25
SMALLEST_AGREEMENT = 0.1
FEW = 20  # values from which a variance is known to 30 %
TEXTURE = 1.5  # gradient energy of a texture over that of noise alone


def textured_cells(level: Level, cell: int) -> int:
    """Cells of a reference with a tenth of the gradient energy of its richest parts: where a match can be expected."""
    cells = np.empty((kernels.GYY + 1, *node_counts(level.shape, cell)), f4)
    kernels.gradient_sums(level.along_x, level.along_y, cell, cells)
    energy = np.empty(cells.shape[1:], f4)
    node_kernels.gradient_energy(cells, energy)
    return int(np.count_nonzero(energy > 0.1 * np.quantile(energy, 0.95)))


def check_agreement(agreed: int, offered: int) -> None:
    """Refuse a pair of images of which less than a tenth of the textured reference agrees.

    Raises
    ------
    NoCorrelationError
    """
    if agreed <= SMALLEST_AGREEMENT * offered:
        raise NoCorrelationError(
            f"the deformed image does not correlate with the reference: {agreed} of {offered} windows with texture "
            "agree. Check that both show the same surface, in focus; give `initial` from the step before if the motion "
            "between them is large"
        )


def window_at(width: int, k: int) -> Window:
    """Window on level k: narrower where pixels are few and noise is averaged out."""
    return window_of(width if k < 2 else max(SMALLEST_WINDOW, min(width, 2 * SMALLEST_WINDOW)))


def displacement_nodes(
    levels: list[Level],
    reference: list[np.ndarray],
    deformed: list[np.ndarray],
    width: int,
    initial: np.ndarray | None,
    brightness: tuple[float, float],
    ends: tuple[float, float],
) -> Field:
    """Displacement at the nodes of the finest level, coarse to fine.

    `initial` (2, node row, node column) at the finest level replaces the global start. `brightness` are the gain and
    offset that give the deformed image the mean and standard deviation of the reference, `ends` the grey levels between
    which it is not cut off.
    """
    if initial is not None:
        # A prediction is off by what moved since: a dozen pixels are less than one after four halvings. With two, some
        # furrows were taken for their neighbours.
        top = min(len(levels) - 1, 4)
        window = window_at(width, top)
        nodes = np.empty((4, *initial.shape[1:]), f4)
        nodes[:2], nodes[2], nodes[3] = initial, brightness[0], brightness[1]
        nodes = transferred(nodes, (0, window_of(width).cell), (top, window.cell), levels[top].shape)
    else:
        last = len(levels) - 1
        top = next((k for k, level in enumerate(levels) if max(level.shape) <= WIDEST), last)
        window = window_at(width, top)
        motion = global_motion(reference, deformed)
        nodes = affine_field(motion, top, levels[top].shape, window.cell, *brightness)
    for k in range(top, -1, -1):
        window = window_at(width, k)
        if k < top:
            nodes = transferred(nodes, (k + 1, window_at(width, k + 1).cell), (k, window.cell), levels[k].shape)
        pair = _Pair(levels[k], deformed[k], window, ends)
        if k == top:
            # Shading first: mean and contrast of every window, before any residual is called an outlier.
            pair.warp(nodes, np.inf)
            node_kernels.equalised(nodes, pair.sums, 1e-3)
        steps = EXPECTED[0] if k == 0 else EXPECTED[1] if k < top else EXPECTED[2]
        for expected in steps:
            change = pair.refine(nodes, expected)
            if change < SETTLED[min(k, 1)] and (k or expected == steps[-1]):
                break
        if k:
            smooth = np.empty_like(nodes[:2])
            node_kernels.median3(nodes[:2], smooth)
            nodes[:2] = smooth
    return Field(nodes, pair.moved, pair.cells, pair.sums)


@dataclass(frozen=True)
class Nodes:
    """Result at the nodes: displacement (2, ...) and its standard deviation (2, ...) [px], and where it holds."""

    displacement: np.ndarray
    sigma: np.ndarray
    valid: np.ndarray


def _felt(field: Field, window: Window, pixel: np.ndarray, valid: np.ndarray) -> float:
    """Variance that the residuals give to the sums of gradient times residual, over that of independent residuals.

    The displacement is moved by such sums alone. Residuals of noise are independent; those of interpolation, of grey
    levels that change faster than pixels follow, alternate from pixel to pixel, and the sums hardly feel them; those of
    an image with a blurred or compressed noise agree, and the sums feel them more. What the fit has left of the sums is
    compared with what it leaves of independent ones, both through V: close to what T passes.

    `pixel` is the local variance of the residual. Few values tell little, and count as independent.
    """
    u, v = field.moved
    gxx, gxy, gyy = field.cells[[kernels.GXX, kernels.GXY, kernels.GYY]]
    left = np.stack([field.cells[kernels.GXE] - gxx * u - gxy * v, field.cells[kernels.GYE] - gxy * u - gyy * v])
    white = pixel * np.stack([gxx, gyy])
    taps = np.zeros(node_kernels.REACH + 1, f4)
    taps[: window.smoothing.size] = window.smoothing
    through, expected = np.empty_like(left), np.empty_like(white)
    node_kernels.windowed(left, taps, through)
    node_kernels.windowed(white, taps**2, expected)
    values = through[:, valid] ** 2 / np.maximum(expected[:, valid], f4(1e-30))
    number = 2 * window.independent * values.shape[1]
    return (number * float(values.mean()) / window.left + FEW) / (number + FEW)


def judged(field: Field, window: Window, offered: int) -> Nodes:
    """Uncertainty and validity of a finished field, of which `offered` nodes could have been measured.

    The covariance of a point is s^2 H^-1 times the mean of T^2, with s^2 the local variance of the residual, set right
    for what interpolation averages away of the deformed image's noise, times the share of it that is felt. A point is
    valid where at least half of its window is seen and has texture beyond what noise alone would show, where a third of
    what is next to it agrees (a window that reaches over a border knows the motion of the other side as well), and
    where f and g correlate.

    Raises
    ------
    NoCorrelationError
    """
    cells, sums, cell2 = field.cells, field.sums, window.cell**2
    shape = sums.shape[1:]
    sigma, tau, rich = np.empty((2, *shape), f4), np.empty(shape, f4), np.empty((1, *shape), f4)
    own = np.empty(shape, f4)
    gain = window.noise
    node_kernels.uncertainty(
        field.nodes, cells, sums, NOISE_KEPT, gain, DERIVATIVE_NOISE / 2 * cell2, TEXTURE, sigma, tau, rich[0], own
    )
    covered = np.empty_like(rich)
    node_kernels.windowed(rich, window.taps, covered)
    # Agreement is looked for in a window twice as large: a few speckles can be made to agree with anything.
    wide = np.empty_like(sums)
    node_kernels.windowed(sums, window.taps, wide)
    share, smallest = np.empty(shape, f4), np.empty(shape, f4)
    node_kernels.agreement(sums, wide, 4 * np.pi * window.deviation**2, share, smallest)
    valid = (covered[0] >= f4(cell2 / 2)) & (own > f4(1 / 3))
    valid &= (smallest > f4(TEXTURE) * tau) & (share > SMALLEST_EXPLAINED)
    check_agreement(int(np.count_nonzero(valid)), offered)
    sigma *= f4(np.sqrt(_felt(field, window, tau / f4(DERIVATIVE_NOISE / 2 * cell2), valid)))
    # What is not valid keeps a usual value, so that interpolation between nodes does not overshoot next to it.
    usual = np.median(sigma[:, valid][:, ::8])
    return Nodes(field.nodes[:2], np.where(valid, sigma, usual), valid)
