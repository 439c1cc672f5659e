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

from fringedic.correlation import kernels
from fringedic.correlation.images import SMALLEST_WINDOW
from fringedic.correlation.pyramid import (
    DERIVATIVE_NOISE,
    INTERPOLATION_NOISE,
    Level,
    node_counts,
    spline_of,
    transferred,
)
from fringedic.correlation.start import WIDEST, affine_field, global_motion
from fringedic.errors import NoCorrelationError

f4 = np.float32

ORDER = 4
NARROWER = 0.75  # the Gaussian of S against that of W
ITERATIONS = 5  # of the fixed point per warp; it contracts by about a half each time
# Displacement errors [px] that may be left at each warp of the finest, a middle and the coarsest level.
EXPECTED = ((0.2, 0.05, 0.05, 0.05), (0.3, 0.1, 0.1), (0.5, 0.3, 0.1, 0.1, 0.1, 0.1))
SETTLED = 0.02  # [px], root mean square change after which a level is left


@dataclass(frozen=True)
class Window:
    """Scale of the filters: nodes on square cells, Gaussian taps of W and of S in cells, and their noise gain.

    `noise` is the mean of T^2 over the frequencies of the nodes: the variance at a node over that of one cell.
    """

    width: int
    deviation: float  # of W [px]
    cell: int
    taps: np.ndarray
    smoothing: np.ndarray
    noise: float


def _transfer(window: np.ndarray, smoothing: np.ndarray) -> np.ndarray:
    """T of the fixed point from the transfers of W and of the Gaussian that S is made of."""
    return window / (window + (1 - window) * (1 - smoothing) ** ORDER)


def _gaussian(deviation: float) -> np.ndarray:
    """Taps from the centre on, of unit sum over both sides."""
    taps = np.exp(-0.5 * (np.arange(kernels.REACH + 1) / deviation) ** 2)
    return taps / (taps[0] + 2 * taps[1:].sum())


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
    taps, smoothing = _gaussian(deviation / cell), _gaussian(NARROWER * deviation / cell)
    waves = np.cos(2 * np.pi * np.outer(np.fft.fftfreq(128), np.arange(kernels.REACH + 1)))
    waves[:, 1:] *= 2
    gain = _transfer(np.outer(waves @ taps, waves @ taps), np.outer(waves @ smoothing, waves @ smoothing))
    return Window(width, deviation, cell, taps.astype(f4), smoothing.astype(f4), float(np.mean(gain**2)))


@dataclass
class Field:
    """What is known at the nodes of a level: displacement and brightness, and sums over cells and over windows."""

    nodes: np.ndarray  # (4, node row, node column): d_x, d_y [px of the level], gain and offset of g
    cells: np.ndarray  # (CHANNELS, node row, node column)
    sums: np.ndarray  # the same, windowed


def _plane(field: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Affine part of a field (2, row, column): smoothing the rest keeps it exact up to the edges of what is seen."""
    _, rows, columns = field.shape
    y, x = np.mgrid[:rows, :columns].astype(f4)
    basis = np.stack([np.ones_like(x), x / columns, y / rows])
    few = np.s_[..., ::4, ::4]
    some, weighted = basis[few], basis[few] * weight[few]
    normal = np.einsum("iyx,jyx->ij", weighted, some, dtype=np.float64)
    right = np.einsum("iyx,cyx->ic", weighted, field[few], dtype=np.float64)
    a = np.linalg.lstsq(normal, right, rcond=1e-9)[0].astype(f4)
    return a[0, :, None, None] + a[1, :, None, None] * basis[1] + a[2, :, None, None] * basis[2]


def _summed(
    level: Level, spline: np.ndarray, nodes: np.ndarray, window: Window, expected: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Sums over cells and windows after one warp of the deformed image, and the noise of a pixel's residual.

    `expected` [px] is the displacement error that may still be there: residuals it explains are not taken for outliers.
    """
    cell = window.cell
    rows, columns = level.shape
    _, node_rows, node_columns = nodes.shape
    lines = np.empty((4, node_rows + 4, columns), f4)
    kernels.widened(nodes, (np.arange(columns) - 0.5 * (cell - 1)) / cell, lines)
    residual = np.empty((rows, columns), f4)
    mean = np.empty((node_rows, node_columns), f4)
    kernels.residuals(level.values, spline, lines, cell, residual, mean)
    seen = mean[np.isfinite(mean)]
    if seen.size == 0:
        raise NoCorrelationError("no pixel of the reference is seen in the deformed image: nothing can be measured")
    noise = float(np.median(seen)) * (1.4826 if cell == 1 else np.sqrt(np.pi / 2))
    limit = 3 * np.hypot(noise, expected * level.slope)
    cells = np.empty((kernels.CHANNELS, node_rows, node_columns), f4)
    kernels.accumulated(level.values, level.along_x, level.along_y, residual, limit, cell, cells)
    sums = np.empty_like(cells)
    kernels.windowed(cells, window.taps, sums)
    return cells, sums, noise


def _equalise(nodes: np.ndarray, sums: np.ndarray, seen: np.ndarray, window: Window, floor: float) -> None:
    """Follow the brightness of every window; where little is seen, under glare, the neighbours' holds."""
    kernels.equalised(nodes, sums, floor)
    plane = _plane(nodes[2:], seen)
    weighted, spread = np.empty((3, *seen.shape), f4), np.empty((3, *seen.shape), f4)
    weighted[0], weighted[1:] = seen, (nodes[2:] - plane) * seen
    kernels.windowed(weighted, window.taps, spread)
    own = np.clip(2 * spread[0], 0, 1)
    nodes[2:] = own * nodes[2:] + (1 - own) * (plane + spread[1:] / spread[0])


def _refine(level: Level, spline: np.ndarray, nodes: np.ndarray, window: Window, expected: float) -> Field:
    """One warp of the deformed image and the fixed point around it."""
    cells, sums, noise = _summed(level, spline, nodes, window, expected)
    # tau: the gradient that the noise of one image alone would show, as an energy per cell.
    cell2 = window.cell**2
    tau = cell2 * max(DERIVATIVE_NOISE * noise**2 / 2, 1e-6 * level.slope**2)
    seen = _rich(cells, tau) / f4(cell2) + f4(1e-3)
    plane = _plane(nodes[:2], seen)
    start = nodes[:2] - plane
    u = start.copy()
    kernels.fixed_point(cells, sums, seen, start, window.taps, window.smoothing, tau, ORDER, ITERATIONS, u)
    fresh = nodes.copy()
    fresh[:2] = u + plane
    _equalise(fresh, sums, seen, window, noise**2 + 1e-6)
    return Field(fresh, cells, sums)


def _moments(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Means of f and e, variances of f and e and their covariance in the window."""
    inverse = f4(1) / np.maximum(sums[kernels.W], f4(1e-6))
    mean_f, mean_e = sums[kernels.WF] * inverse, sums[kernels.WE] * inverse
    var_f = np.maximum(sums[kernels.WFF] * inverse - mean_f**2, 0)
    var_e = np.maximum(sums[kernels.WEE] * inverse - mean_e**2, 0)
    return mean_f, mean_e, var_f, var_e, sums[kernels.WEF] * inverse - mean_f * mean_e


def _correlation(sums: np.ndarray) -> np.ndarray:
    """Zero-normalised cross-correlation coefficient of f and g in every window."""
    _, _, var_f, var_e, covariance = _moments(sums)
    var_g = np.maximum(var_f - 2 * covariance + var_e, 0)
    return (var_f - covariance) / np.sqrt(np.maximum(var_f * var_g, f4(1e-12)))


def explained(correlation: np.ndarray, speckles: np.ndarray) -> np.ndarray:
    """Coefficient of determination r^2 of a fit, adjusted for its parameters (two of motion, two of brightness).

    A window with few independent speckles can be made to agree with anything; the adjustment is limited to a factor 10.
    """
    freedom = np.maximum(speckles - 1, 1e-6)
    return 1 - (1 - np.clip(correlation, 0, 1) ** 2) * freedom / np.maximum(freedom - 4, freedom / 10)


SMALLEST_EXPLAINED = 0.25
SMALLEST_AGREEMENT = 0.1
TEXTURE = 1.5  # gradient energy of a texture over that of noise alone
# Texture is looked for in 3 x 3 cells, sharply bounded: a window's far end must not lend its texture to a bare middle.
AROUND = np.array([1, 1] + [0] * (kernels.REACH - 1), dtype=f4) / 3


def _gradient_energy(cells: np.ndarray) -> np.ndarray:
    """Sum of (df/dx)^2 + (df/dy)^2 per cell, averaged over 3 x 3 cells."""
    energy = np.empty_like(cells[:1])
    kernels.windowed(cells[kernels.GXX : kernels.GXX + 1] + cells[kernels.GYY : kernels.GYY + 1], AROUND, energy)
    return energy[0]


def _rich(cells: np.ndarray, tau: np.ndarray | float) -> np.ndarray:
    """Weight of the cells that have texture, zero for the others; tau is the energy of noise along one axis."""
    return np.where(_gradient_energy(cells) > 2 * TEXTURE * tau, cells[kernels.W], f4(0))


def textured_cells(level: Level, cell: int) -> int:
    """Cells of a reference with a tenth of the gradient energy of its richest parts: where a match can be expected."""
    cells = np.empty((kernels.CHANNELS, *node_counts(level.shape, cell)), f4)
    still = np.where(np.isnan(level.values), f4(np.nan), f4(0))
    kernels.accumulated(level.values, level.along_x, level.along_y, still, 1.0, cell, cells)
    energy = _gradient_energy(cells)
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
) -> Field:
    """Displacement at the nodes of the finest level, coarse to fine.

    `initial` (2, node row, node column) at the finest level replaces the global start. `brightness` are the gain and
    offset that give the deformed image the mean and standard deviation of the reference.
    """
    if initial is not None:
        # A prediction is trusted to a few pixels: two halvings find the rest.
        top = min(len(levels) - 1, 2)
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
        spline = spline_of(deformed[k])
        if k == top:
            # Shading first: mean and contrast of every window, before any residual is called an outlier.
            _, sums, _ = _summed(levels[k], spline, nodes, window, np.inf)
            kernels.equalised(nodes, sums, 1e-3)
        steps = EXPECTED[0] if k == 0 else EXPECTED[1] if k < top else EXPECTED[2]
        least = steps[-1]
        for expected in steps:
            field = _refine(levels[k], spline, nodes, window, expected)
            change = float(np.sqrt(np.mean((field.nodes[:2] - nodes[:2]) ** 2)))
            nodes = field.nodes
            if change < SETTLED and (k or expected == least):
                break
        if k:
            smooth = np.empty_like(nodes[:2])
            kernels.median3(nodes[:2], smooth)
            nodes[:2] = smooth
    return field


@dataclass(frozen=True)
class Nodes:
    """Result at the nodes: displacement (2, ...) and its standard deviation (2, ...) [px], and where it holds."""

    displacement: np.ndarray
    sigma: np.ndarray
    valid: np.ndarray


def judged(field: Field, window: Window, offered: int) -> Nodes:
    """Uncertainty and validity of a finished field, of which `offered` nodes could have been measured.

    The covariance of a point is s^2 H^-1 times the mean of T^2, with s^2 the local variance of the residual, set right
    for what interpolation averages away of the deformed image's noise. A point is valid where at least half of its
    window is seen and has texture beyond what noise alone would show, and where f and g correlate.

    Raises
    ------
    NoCorrelationError
    """
    cells, sums, cell2 = field.cells, field.sums, f4(window.cell**2)
    gain = field.nodes[2]
    _, _, var_f, var_e, _ = _moments(sums)
    fraction = field.nodes[:2] - np.floor(field.nodes[:2])
    steps = INTERPOLATION_NOISE.size - 1
    kept = INTERPOLATION_NOISE[np.rint(fraction * steps).astype(np.intp)].prod(axis=0)
    pixel = (var_e * (1 + gain**2) / (1 + gain**2 * kept)).astype(f4)
    tau = f4(DERIVATIVE_NOISE / 2) * cell2 * pixel
    xx, xy, yy = sums[kernels.GXX], sums[kernels.GXY], sums[kernels.GYY]
    variance = pixel * f4(window.noise) / np.maximum(xx * yy - xy * xy, f4(1e-30))
    sigma = np.sqrt(np.stack([variance * yy, variance * xx]))

    covered = np.empty_like(cells[:1])
    kernels.windowed(_rich(cells, tau)[None], window.taps, covered)
    smallest = (xx + yy) / 2 - np.sqrt((xx - yy) ** 2 / 4 + xy * xy)
    # Speckles in a window of the effective area 4 pi s^2, each of the area 2 pi r^2 with r^2 = var f / (2 var df/dx).
    speckle = np.pi * var_f / np.maximum((xx + yy) / 2, f4(1e-12)) * np.maximum(sums[kernels.W], f4(1e-6))
    speckles = 4 * np.pi * window.deviation**2 / np.maximum(speckle, f4(1e-6))
    # Agreement is looked for in a window twice as large: a few speckles can be made to agree with anything.
    wide = np.empty_like(sums)
    kernels.windowed(sums, window.taps, wide)
    agreed = explained(_correlation(wide), 2 * speckles) > SMALLEST_EXPLAINED
    valid = (covered[0] >= cell2 / 2) & (smallest > TEXTURE * tau) & agreed
    check_agreement(int(valid.sum()), offered)
    # What is not valid keeps a usual value, so that interpolation between nodes does not overshoot next to it.
    sigma = np.where(valid, sigma, np.median(sigma[:, valid]))
    return Nodes(field.nodes[:2], sigma.astype(f4), valid)
