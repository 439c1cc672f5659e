"""The amplitude-weighted phase fit over all frequencies, at every pixel, as a windowed gradient least squares.

By Parseval's theorem the phase fit of the zone method (paper, eq. 4-5, weighted by abs(C)) equals, up to slopes of the
window, the minimum over d of W * (f - g(x + d))^2. With the gradient of the reference f this is solved at all points
at once, around a smoothed predictor S u:

    u = S u + H^-1 W * (grad f e),   e = f - g(x + S u),   H = W * (grad f grad f^T) + tau I

W is a Gaussian of transfer h, S = 1 - (1 - W)^ORDER. The fixed point has the transfer
T = h / (h + (1 - h)^(ORDER + 1)): flat to the order 2 (ORDER + 1), with bounded noise gain. The sums over pixels are
taken once per warp and per cell of a few pixels; the fixed point is found on the cells, where a step costs little.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.fft

from fringedic.correlation import kernels
from fringedic.errors import NoCorrelationError

f4 = np.float32

ORDER = 4
DERIVATIVE = np.array([3 / 4, -3 / 20, 1 / 60], dtype=f4)  # of sixth order, so exact enough up to 2 px per period
DERIVATIVE_NOISE = 2 * float(np.sum(DERIVATIVE.astype(float) ** 2))


def _spline_inverse(reach: int) -> np.ndarray:
    """Taps of the inverse of the sampled quintic B-spline, from the centre to `reach` pixels, of unit sum."""
    angle = 2 * np.pi * np.fft.fftfreq(256)
    taps = np.fft.ifft(120 / (66 + 52 * np.cos(angle) + 2 * np.cos(2 * angle))).real[: reach + 1]
    return np.asarray(taps / (taps[0] + 2 * taps[1:].sum()), dtype=f4)


SPLINE_INVERSE = _spline_inverse(10)


def _interpolation_noise(positions: int = 64) -> np.ndarray:
    """Variance of white noise of unit variance after interpolation along one axis at k / positions, k = 0...positions.

    The spline averages noise between pixels; what it averages away lies at frequencies without texture.
    """
    t = np.arange(positions + 1) / positions
    spline = np.zeros((positions + 1, 6))
    for k in range(6):
        distance = np.abs(t - (k - 2))
        spline[:, k] = np.where(
            distance < 1,
            66 - 60 * distance**2 + 30 * distance**4 - 10 * distance**5,
            np.where(
                distance < 2,
                51 + 75 * distance - 210 * distance**2 + 150 * distance**3 - 45 * distance**4 + 5 * distance**5,
                np.clip(3 - distance, 0, None) ** 5,
            ),
        )
    inverse = np.concatenate([SPLINE_INVERSE[:0:-1], SPLINE_INVERSE]).astype(float)
    return np.array([np.sum(np.convolve(row / 120, inverse) ** 2) for row in spline])


INTERPOLATION_NOISE = _interpolation_noise()


@dataclass(frozen=True)
class Window:
    """Scale of the filters: nodes on square cells, Gaussian taps in cells, and their noise gain.

    `noise` is the mean of T^2 over the frequencies of the nodes: the variance at a node over that of one cell.
    """

    width: int
    deviation: float  # of the Gaussian [px]
    cell: int
    taps: np.ndarray
    noise: float


@lru_cache(maxsize=16)
def window_of(width: int) -> Window:
    """Filters with the noise of a bi-triangular window of `width` pixels used on both images.

    Such a window averages noise over the effective length (sum w^2)^2 / sum w^4 = (width - 1) / 1.8 per axis. For the
    Gaussian of standard deviation s, the integral of T^2 over the frequencies is (n / (sqrt(2) pi s))^2 with
    n^2 = pi times the integral of T^2 over q^2, h = exp(-q^2); both are made equal.
    """
    q2 = np.linspace(0, 40, 40001)
    h = np.exp(-q2)
    transfer = h / (h + (1 - h) ** (ORDER + 1))
    n = np.sqrt(np.pi * np.sum(transfer**2) * (q2[1] - q2[0]))
    deviation = n / (np.sqrt(2) * np.pi) * (width - 1) / 1.8
    cell = max(1, width // 8)
    s = deviation / cell
    k = np.arange(int(np.ceil(3.2 * s)) + 1)
    taps = np.exp(-0.5 * (k / s) ** 2)
    taps /= taps[0] + 2 * taps[1:].sum()
    angle = 2 * np.pi * np.fft.fftfreq(128)
    along = taps[0] + 2 * np.cos(np.outer(angle, k[1:])) @ taps[1:]
    window = np.outer(along, along)
    smoothed = 1 - (1 - window) ** ORDER
    gain = window / (1 - smoothed * (1 - window))
    return Window(width, float(deviation), cell, taps.astype(f4), float(np.mean(gain**2)))


@dataclass(frozen=True)
class Level:
    """One image size of the pyramid of a reference: grey levels (NaN where not usable) and their gradient."""

    values: np.ndarray
    along_x: np.ndarray
    along_y: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        return self.values.shape[0], self.values.shape[1]


def pyramid_of(image: np.ndarray, width: int) -> list[np.ndarray]:
    """The image and its halves, as long as they hold the window: finest first."""
    levels = [image]
    while min(levels[-1].shape) // 2 >= max(width, 24):
        rows, columns = levels[-1].shape
        half = np.empty((rows // 2, columns // 2), f4)
        kernels.halved(levels[-1], half)
        levels.append(half)
    return levels


def reference_level(image: np.ndarray) -> Level:
    """Gradient of an image and the pixels where it is known."""
    values, along_x, along_y = np.empty_like(image), np.empty_like(image), np.empty_like(image)
    kernels.gradient(image, DERIVATIVE, values, along_x, along_y)
    return Level(values, along_x, along_y)


def spline_of(image: np.ndarray) -> np.ndarray:
    """Coefficients of the quintic spline through an image, NaN around pixels that are not measured, and outside.

    Missing pixels are filled with the mean of their surroundings first; what the fill changes dies out as .43 per
    pixel, so two pixels around it are given up.
    """
    rows, columns = image.shape
    border = kernels.BORDER
    out = np.full((rows + 2 * border, columns + 2 * border), np.nan, dtype=f4)
    missing = np.isnan(image)
    if not missing.any():
        kernels.spline_coefficients(image, SPLINE_INVERSE, out)
        return out
    filled = _filled(image[None])[0]
    kernels.spline_coefficients(filled, SPLINE_INVERSE, out)
    grown = missing.copy()
    for shift in (1, 2):
        grown[shift:] |= missing[:-shift]
        grown[:-shift] |= missing[shift:]
    across = grown.copy()
    for shift in (1, 2):
        across[:, shift:] |= grown[:, :-shift]
        across[:, :-shift] |= grown[:, shift:]
    out[border:-border, border:-border][across] = np.nan
    return out


_SPREAD = np.array([6, 4, 1], dtype=f4) / 16


def _filled(nodes: np.ndarray) -> np.ndarray:
    """Array (channel, row, column) whose NaN are filled from their neighbours inwards, ever coarser if need be."""
    missing = np.isnan(nodes[0])
    if not missing.any():
        return nodes
    known = np.where(missing, f4(0), f4(1))[None]
    weighted = np.where(missing, f4(0), nodes).astype(f4)
    spread, weight = np.empty_like(weighted), np.empty_like(known)
    kernels.windowed(weighted, _SPREAD, spread)
    kernels.windowed(known, _SPREAD, weight)
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
            fine = np.repeat(np.repeat(_filled(coarse), 2, axis=1), 2, axis=2)[:, :rows, :columns]
            around = np.where(np.isnan(around), fine, around)
    return np.where(missing, around, nodes).astype(f4)


@dataclass
class Field:
    """What is known at the nodes of a level: displacement and brightness, windowed sums and the noise of a pixel."""

    nodes: np.ndarray  # (4, node row, node column): d_x, d_y [px of the level], gain and offset of g
    sums: np.ndarray  # (CHANNELS, node row, node column), windowed
    noise: float  # standard deviation of the residual of a pixel


def _solve(sums: np.ndarray, moment: np.ndarray, tau: float) -> np.ndarray:
    """H^-1 times a moment (2, row, column)."""
    xx, xy, yy = sums[kernels.GXX] + f4(tau), sums[kernels.GXY], sums[kernels.GYY] + f4(tau)
    inverse = f4(1) / (xx * yy - xy * xy)
    return np.stack([(yy * moment[0] - xy * moment[1]) * inverse, (xx * moment[1] - xy * moment[0]) * inverse])


def _refine(
    level: Level, spline: np.ndarray, nodes: np.ndarray, window: Window, *, expected: float, iterations: int
) -> Field:
    """One warp of the deformed image and the fixed point around it.

    `expected` [px] is the displacement error that may still be there: residuals it explains are not taken for outliers.
    """
    cell = window.cell
    rows, columns = level.shape
    _, node_rows, node_columns = nodes.shape
    lines = np.empty((4, node_rows, columns), f4)
    kernels.widened(nodes, (np.arange(columns) - 0.5 * (cell - 1)) / cell, lines)
    residual = np.empty((rows, columns), f4)
    mean = np.empty((node_rows, node_columns), f4)
    kernels.residuals(level.values, spline, lines, cell, residual, mean)
    seen = mean[np.isfinite(mean)]
    if seen.size == 0:
        raise NoCorrelationError("no pixel of the reference is seen in the deformed image: nothing can be measured")
    noise = float(np.median(seen)) * (1.4826 if cell == 1 else np.sqrt(np.pi / 2))
    slope = float(np.sqrt(np.mean(level.along_x[::4, ::4] ** 2 + level.along_y[::4, ::4] ** 2) / 2))
    limit = 3 * np.hypot(noise, expected * slope)
    cells = np.empty((kernels.CHANNELS, node_rows, node_columns), f4)
    kernels.accumulated(level.values, level.along_x, level.along_y, residual, limit, cell, cells)
    sums = np.empty_like(cells)
    kernels.windowed(cells, window.taps, sums)

    # tau: the gradient that the noise of one image alone would show, as an energy per cell.
    tau = cell * cell * max(DERIVATIVE_NOISE * noise**2 / 2, 1e-6 * slope**2)
    seen_cells = cells[kernels.W] / f4(cell * cell) + f4(1e-3)
    weight = np.empty_like(seen_cells)
    kernels.windowed(seen_cells[None], window.taps, weight[None])
    inverse_weight = f4(1) / weight
    start = nodes[:2]
    u = start
    gxx, gxy, gyy = cells[kernels.GXX], cells[kernels.GXY], cells[kernels.GYY]
    moment, filtered = np.empty_like(start), np.empty_like(start)
    for _ in range(iterations):
        rest, smooth = u, np.zeros_like(u)
        for _ in range(ORDER):
            kernels.windowed(rest * seen_cells, window.taps, filtered)
            filtered *= inverse_weight
            smooth = smooth + filtered
            rest = rest - filtered
        change = smooth - start
        moment[0] = cells[kernels.GXE] - gxx * change[0] - gxy * change[1]
        moment[1] = cells[kernels.GYE] - gxy * change[0] - gyy * change[1]
        kernels.windowed(moment, window.taps, filtered)
        u = smooth + np.clip(_solve(sums, filtered, tau), -1, 1)
    fresh = nodes.copy()
    fresh[:2] = u
    _update_brightness(fresh, sums, noise)
    return Field(fresh, sums, noise)


def _moments(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Means of f and e, variances of f and e and their covariance in the window."""
    inverse = f4(1) / np.maximum(sums[kernels.W], f4(1e-6))
    mean_f, mean_e = sums[kernels.WF] * inverse, sums[kernels.WE] * inverse
    var_f = np.maximum(sums[kernels.WFF] * inverse - mean_f**2, 0)
    var_e = np.maximum(sums[kernels.WEE] * inverse - mean_e**2, 0)
    return mean_f, mean_e, var_f, var_e, sums[kernels.WEF] * inverse - mean_f * mean_e


def _update_brightness(nodes: np.ndarray, sums: np.ndarray, noise: float) -> None:
    """Gain and offset of g that give it the mean and the standard deviation of f in every window."""
    mean_f, mean_e, var_f, var_e, covariance = _moments(sums)
    var_g = np.maximum(var_f - 2 * covariance + var_e, 0)
    floor = f4(noise**2 + 1e-6)
    ratio = np.clip(np.sqrt((var_f + floor) / (var_g + floor)), 0.5, 2)
    known = sums[kernels.W] > 0
    gain = np.where(known, ratio * nodes[2], nodes[2])
    offset = np.where(known, ratio * nodes[3] + mean_f - ratio * (mean_f - mean_e), nodes[3])
    nodes[2], nodes[3] = np.clip(gain, 0.1, 10), offset


def _correlation(sums: np.ndarray) -> np.ndarray:
    """Zero-normalised cross-correlation coefficient of f and g in every window."""
    _, _, var_f, var_e, covariance = _moments(sums)
    var_g = np.maximum(var_f - 2 * covariance + var_e, 0)
    return (var_f - covariance) / np.sqrt(np.maximum(var_f * var_g, f4(1e-12)))


def explained(correlation: np.ndarray, speckles: np.ndarray) -> np.ndarray:
    """Coefficient of determination r^2 of a fit, adjusted for its parameters (two of motion, two of brightness).

    A window with few independent speckles can be made to agree with anything; the adjustment is limited to a factor 5.
    """
    freedom = np.maximum(speckles - 1, 1e-6)
    return 1 - (1 - np.clip(correlation, 0, 1) ** 2) * freedom / np.maximum(freedom - 4, freedom / 5)


SMALLEST_EXPLAINED = 0.25
SMALLEST_AGREEMENT = 0.2


def check_agreement(agreed: int, measurable: int) -> None:
    """Refuse a pair of images of which less than a fifth of the measurable windows agree.

    Raises
    ------
    NoCorrelationError
    """
    if agreed <= SMALLEST_AGREEMENT * measurable:
        raise NoCorrelationError(
            f"the deformed image does not correlate with the reference: {agreed} of {measurable} windows with texture "
            "agree. Check that both show the same surface, in focus; give `initial` from the step before if the motion "
            "between them is large"
        )


def node_counts(shape: tuple[int, int], cell: int) -> tuple[int, int]:
    """Cells needed to cover an image."""
    return -(-shape[0] // cell), -(-shape[1] // cell)


def resampled(nodes: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Node arrays at row and column positions given in nodes."""
    lines = np.empty((nodes.shape[0], nodes.shape[1], columns.size), f4)
    kernels.widened(np.ascontiguousarray(nodes), columns, lines)
    out = np.empty((nodes.shape[0], rows.size, columns.size), f4)
    kernels.heightened(lines, rows, out)
    return out


def _finer(nodes: np.ndarray, shape: tuple[int, int], cell: int) -> np.ndarray:
    """Nodes of a level on the next finer one of the given image shape."""
    centre = 0.5 * (cell - 1)

    def positions(count: int) -> np.ndarray:
        fine = np.arange(count) * cell + centre
        return ((fine - 0.5) / 2 - centre) / cell

    node_rows, node_columns = node_counts(shape, cell)
    out = resampled(nodes, positions(node_rows), positions(node_columns))
    out[:2] *= 2
    return out


def whole_pixel_translation(reference: np.ndarray, deformed: np.ndarray) -> tuple[float, float]:
    """Whole-pixel displacement (d_x, d_y) at the peak of the cross-correlation, eq. 3."""
    shape = [scipy.fft.next_fast_len(2 * n, real=True) for n in reference.shape]
    f = scipy.fft.rfft2(np.nan_to_num(reference - np.nanmean(reference)), shape)
    g = scipy.fft.rfft2(np.nan_to_num(deformed - np.nanmean(deformed)), shape)
    peak = np.unravel_index(int(np.argmax(scipy.fft.irfft2(np.conj(f) * g, shape))), shape)
    dy, dx = (float((p + n // 2) % n - n // 2) for p, n in zip(peak, shape, strict=True))
    return dx, dy


def _uniform(shape: tuple[int, int], cell: int, values: tuple[float, float, float, float]) -> np.ndarray:
    return np.ascontiguousarray(np.broadcast_to(np.array(values, f4)[:, None, None], (4, *node_counts(shape, cell))))


def displacement_nodes(
    levels: list[Level],
    reference: list[np.ndarray],
    deformed: list[np.ndarray],
    window: Window,
    initial: np.ndarray | None,
    brightness: tuple[float, float],
) -> Field:
    """Displacement at the nodes of the finest level, coarse to fine.

    `initial` (2, node row, node column) at the finest level replaces the global start. `brightness` are the gain and
    offset that give the deformed image the mean and standard deviation of the reference.
    """
    cell = window.cell
    top = len(levels) - 1
    if initial is not None:
        # A prediction is trusted to a few pixels: two halvings find the rest.
        top = min(top, 2)
        nodes = np.empty((4, *initial.shape[1:]), f4)
        nodes[:2], nodes[2], nodes[3] = initial, brightness[0], brightness[1]
        for level in levels[1 : top + 1]:
            node_rows, node_columns = node_counts(level.shape, cell)
            centre = 0.5 * (cell - 1)
            rows = (2 * (np.arange(node_rows) * cell + centre) + 0.5 - centre) / cell
            columns = (2 * (np.arange(node_columns) * cell + centre) + 0.5 - centre) / cell
            nodes = resampled(nodes, rows, columns)
            nodes[:2] /= 2
        starts = [nodes]
    else:
        shape = levels[top].shape
        # Correlate where a speckle is still visible: at most about 320 pixels wide.
        wide = next((k for k, image in enumerate(reference) if max(image.shape) <= 320), top)
        dx, dy = whole_pixel_translation(reference[wide], deformed[wide])
        factor = 2.0 ** (wide - top)
        starts = [
            _uniform(shape, cell, (dx * factor, dy * factor, *brightness)),
            _uniform(shape, cell, (0.0, 0.0, *brightness)),
        ]
        if dx == dy == 0:
            starts.pop()
    fields = [_start(levels[top], spline_of(deformed[top]), start, window) for start in starts]
    field = max(fields, key=_quality)
    for k in range(top - 1, -1, -1):
        nodes = _finer(field.nodes, levels[k].shape, cell)
        spline = spline_of(deformed[k])
        if k:
            for expected in (0.3, 0.1, 0.1):
                field = _refine(levels[k], spline, nodes, window, expected=expected, iterations=5)
                nodes = field.nodes
            kernels.median3(nodes[:2].copy(), nodes[:2])
        else:
            for expected in (0.2, 0.05):
                field = _refine(levels[k], spline, nodes, window, expected=expected, iterations=6)
                nodes = field.nodes
    return field


def _start(level: Level, spline: np.ndarray, nodes: np.ndarray, window: Window) -> Field:
    for expected in (0.5, 0.5, 0.5, 0.3, 0.3, 0.3, 0.1, 0.1):
        field = _refine(level, spline, nodes, window, expected=expected, iterations=5)
        nodes = field.nodes
        smooth = np.empty_like(nodes[:2])
        kernels.median3(nodes[:2].copy(), smooth)
        nodes[:2] = smooth
    return field


def _quality(field: Field) -> float:
    """How well f and g agree over the whole image, to choose between starts."""
    seen = field.sums[kernels.W]
    return float(np.sum(_correlation(field.sums) * seen))


@dataclass(frozen=True)
class Nodes:
    """Result at the nodes: displacement (2, ...) and its standard deviation (2, ...) [px], and where it holds."""

    displacement: np.ndarray
    sigma: np.ndarray
    valid: np.ndarray


def judged(field: Field, window: Window) -> Nodes:
    """Uncertainty and validity of a finished field.

    The covariance of a point is s^2 H^-1 times the mean of T^2, with s^2 the local variance of the residual, set right
    for what interpolation averages away of the deformed image's noise. A point is valid where its window sees at least
    half of its pixels, where texture exceeds what noise alone would show, and where f and g correlate.
    """
    sums, cell2 = field.sums, window.cell**2
    gain = field.nodes[2]
    _, _, var_f, var_e, _ = _moments(sums)
    fraction = field.nodes[:2] - np.floor(field.nodes[:2])
    steps = INTERPOLATION_NOISE.size - 1
    kept = INTERPOLATION_NOISE[np.rint(fraction * steps).astype(np.intp)].prod(axis=0)
    pixel = (var_e * (1 + gain**2) / (1 + gain**2 * kept)).astype(f4)
    tau = f4(cell2 * DERIVATIVE_NOISE) * pixel / 2
    xx, xy, yy = sums[kernels.GXX], sums[kernels.GXY], sums[kernels.GYY]
    determinant = np.maximum(xx * yy - xy * xy, f4(1e-30))
    variance = pixel * f4(window.noise) / determinant
    sigma = np.sqrt(np.stack([variance * yy, variance * xx]))
    smallest = (xx + yy) / 2 - np.sqrt((xx - yy) ** 2 / 4 + xy * xy)
    textured = smallest > np.maximum(2 * tau, f4(1e-5) * np.median(xx + yy))
    covered = sums[kernels.W] >= f4(0.5 * cell2)
    # Speckles in a window of the effective area 4 pi s^2, each of the area 2 pi r^2 with r^2 = var f / (2 var df/dx).
    speckle = np.pi * var_f / np.maximum((xx + yy) / 2, f4(1e-12)) * np.maximum(sums[kernels.W], f4(1e-6))
    speckles = 4 * np.pi * window.deviation**2 / np.maximum(speckle, f4(1e-6))
    agreed = explained(_correlation(sums), speckles) > SMALLEST_EXPLAINED
    measurable = textured & covered
    valid = measurable & agreed
    check_agreement(int(valid.sum()), int(measurable.sum()))
    return Nodes(field.nodes[:2], sigma.astype(f4), valid)


def initial_nodes(start: np.ndarray, shape: tuple[int, int], cell: int, spacing: int) -> np.ndarray:
    """A displacement known at every `spacing`-th pixel (2, row, column), at the nodes; gaps are filled."""
    counts = node_counts(shape, cell)
    if spacing > 1:
        centre = 0.5 * (cell - 1)
        rows = (np.arange(counts[0]) * cell + centre) / spacing
        columns = (np.arange(counts[1]) * cell + centre) / spacing
        return resampled(_filled(start), rows, columns)
    means = np.empty((2, *counts), f4)
    for channel in range(2):
        kernels.cell_means(start[channel], cell, means[channel])
    return _filled(means)
