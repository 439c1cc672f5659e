"""Compiled loops of one warp: residuals of the displaced image and their weighted sums over cells.

Sums are taken inside a cell only, so results do not depend on the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from fringedic.correlation.resampling_kernels import interpolate_row
from fringedic.frames.interpolation_kernels import GROUP, interpolate_block

f4 = np.float32

# Columns that are processed together for all rows of a cell: their scratch arrays stay in the fastest cache.
BLOCK = 256


class ImagePair(NamedTuple):
    """Arrays of a reference and a deformed image on one level, as the kernels take them.

    Attributes
    ----------
    values, along_x, along_y : (row, column) float32
        Grey levels of the reference, NaN where not usable, and its derivatives [1/px].
    coefficients : (row + 2 BORDER, column + 2 BORDER) float32
        Spline coefficients of the deformed image.
    weights : (3, 6) float32
        Polynomials of the interpolation kernel, `interpolation.WEIGHTS`.
    """

    values: np.ndarray
    along_x: np.ndarray
    along_y: np.ndarray
    coefficients: np.ndarray
    weights: np.ndarray


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _sum_cells(line: np.ndarray, cell: int, out: np.ndarray) -> None:
    """Sum a line over its cells; the last cell may be incomplete. Only strides known to the compiler are vectorised."""
    whole = line.size // cell
    if cell == 4:
        for j in range(whole):
            out[j] = (line[4 * j] + line[4 * j + 1]) + (line[4 * j + 2] + line[4 * j + 3])
    else:
        for j in range(whole):
            out[j] = line[j * cell]
        for k in range(1, cell):
            for j in range(whole):
                out[j] += line[j * cell + k]
    if whole < out.size:
        out[whole] = np.sum(line[whole * cell :])


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _compute_residual(
    images: ImagePair,
    lines: np.ndarray,
    cell: int,
    r: int,
    begin: int,
    scratch: np.ndarray,
    keys: np.ndarray,
    out: np.ndarray,
) -> None:
    """Compute e(p) = f(p) - gain(p) g(p + d(p)) - offset(p) in row r for the `out.size` pixels from column `begin` on.

    `lines` (4, 2 + node row + 2, column) contains d_x, d_y, gain and offset resampled to the columns of the image. A
    pixel is NaN if any of its 36 coefficients is. `scratch` (7, at least GROUP more than `out`) and `keys` are work
    arrays; rows 2 and 3 of `scratch` contain gain and offset afterwards.
    """
    rows, columns = images.values.shape
    size = out.size
    whole = -(-size // GROUP) * GROUP
    position = (r - 0.5 * (cell - 1)) / cell
    for channel in range(4):
        interpolate_row(lines[channel], position, begin, scratch[channel, :size])
    dx, dy, gain, offset = scratch[0, :whole], scratch[1, :whole], scratch[2, :whole], scratch[3, :whole]
    along_x, along_y, grey = scratch[4, :whole], scratch[5, :whole], scratch[6, :whole]
    key = keys[:whole]
    lowest, leftmost = f4(-4), f4(-4)
    highest, rightmost = f4(rows + 3), f4(columns + 3)
    for c in range(whole):
        y = min(max(dy[c] + f4(r), lowest), highest)
        fy = np.floor(y)
        along_y[c] = y - fy - f4(0.5)
        key[c] = (np.int32(fy) - np.int32(r) + np.int32(16384)) << 15
    for c in range(whole):
        x = min(max(dx[c] + f4(begin + c), leftmost), rightmost)
        fx = np.floor(x)
        along_x[c] = x - fx - f4(0.5)
        key[c] += np.int32(fx) - np.int32(begin + c) + np.int32(16384)
    key[size:] = key[size - 1]
    interpolate_block(images.coefficients, images.weights, r, begin, along_x, along_y, key, grey)
    source = images.values[r, begin : begin + size]
    for c in range(size):
        out[c] = source[c] - gain[c] * grey[c] - offset[c]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy", fastmath={"contract"})
def average_residuals(images: ImagePair, lines: np.ndarray, cell: int, every: int, out: np.ndarray) -> None:
    """Average abs(e), see `_compute_residual`, over each cell of every `every`-th node row.

    NaN where no pixel is seen in both images.
    """
    rows, columns = images.values.shape
    block = BLOCK // cell * cell
    for line in prange(out.shape[0]):
        scratch, keys = np.zeros((7, block + GROUP), f4), np.empty(block + GROUP, np.int32)
        residual, numbers = np.empty(block, f4), np.empty(block // cell, f4)
        total, count = np.empty(block, f4), np.empty(block, f4)
        first = line * every * cell
        for begin in range(0, columns, block):
            size = min(block, columns - begin)
            total[:] = f4(0)
            count[:] = f4(0)
            e = residual[:size]
            for r in range(first, min(first + cell, rows)):
                _compute_residual(images, lines, cell, r, begin, scratch, keys, e)
                for c in range(size):
                    good = e[c] == e[c]
                    total[c] += abs(e[c]) if good else f4(0)
                    count[c] += f4(1) if good else f4(0)
            means = out[line, begin // cell : begin // cell + -(-size // cell)]
            _sum_cells(total[:size], cell, means)
            _sum_cells(count[:size], cell, numbers[: means.size])
            for k in range(means.size):
                means[k] = means[k] / numbers[k] if numbers[k] > f4(0) else f4(np.nan)


# Channels of the sums of each cell. The last one is the number of pixels that could be compared.
GXX, GXY, GYY, W, WF, WFF, WE, WEF, WEE, GXE, GYE, SEEN = range(12)
CHANNELS = 12


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _add_products(
    w: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, sum_ab: np.ndarray, sum_ac: np.ndarray
) -> None:
    """Add w a b to one line and w a c to another."""
    for k in range(w.size):
        wa = w[k] * a[k]
        sum_ab[k] += wa * b[k]
        sum_ac[k] += wa * c[k]


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _weigh(residual: np.ndarray, inverse: np.float32, out: np.ndarray) -> None:
    """Set Tukey's weights of residuals, 1 up to the inverse of `inverse` and 0 from twice this on."""
    for c in range(out.size):
        over = min(max(abs(residual[c]) * inverse - f4(1), f4(0)), f4(1))
        share = f4(1) - over * over
        out[c] = share * share


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _weigh_within(
    residual: np.ndarray, limit: np.float32, reach: np.ndarray, gradient: tuple[np.ndarray, np.ndarray], out: np.ndarray
) -> None:
    """Do as `_weigh` with the limit plus what a displacement `reach` [px] causes at the gradient of each pixel."""
    gx, gy = gradient
    for c in range(out.size):
        bound = limit + reach[c] * np.sqrt(gx[c] * gx[c] + gy[c] * gy[c])
        over = min(max(abs(residual[c]) / bound - f4(1), f4(0)), f4(1))
        share = f4(1) - over * over
        out[c] = share * share


@njit(nogil=True, error_model="numpy")
def _repeat_cells(values: np.ndarray, cell: int, out: np.ndarray) -> None:
    """Set each pixel of a line to the value of its cell."""
    for c in range(out.size):
        out[c] = values[c // cell]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy", fastmath={"contract"})
def accumulate_cells(
    images: ImagePair,
    lines: np.ndarray,
    cell: int,
    limit: float,
    unresolved: np.ndarray,
    saturation: tuple[float, float],
    out: np.ndarray,
) -> None:
    """Sum f, its gradient and the residual e with weights over each cell, out (CHANNELS, node row, node column).

    See `_compute_residual` for e. Weights are one up to abs(e) = limit + unresolved abs(grad f), decrease as Tukey's
    biweight and are zero from twice this bound on: noise keeps its full weight, glare and decorrelated pixels have
    none. `unresolved` (node row, node column) [px] is a displacement that may remain in a cell. Pixels where g would
    have to be outside of `saturation`, the lowest and highest grey level, have no weight either: it cuts their
    residuals on one side.
    """
    values, along_x, along_y, _, _ = images
    rows, columns = values.shape
    least, inverse = f4(limit), f4(1.0 / limit)
    low, high = f4(saturation[0]), f4(saturation[1])
    block = BLOCK // cell * cell
    for node in prange(out.shape[1]):
        sums = np.empty((CHANNELS, block), f4)
        scratch, keys = np.zeros((7, block + GROUP), f4), np.empty(block + GROUP, np.int32)
        allowed, residual, kept, clean_f, clean_e = (
            np.empty(block, f4),
            np.empty(block, f4),
            np.empty(block, f4),
            np.empty(block, f4),
            np.empty(block, f4),
        )
        for begin in range(0, columns, block):
            size = min(block, columns - begin)
            end = begin + size
            sums[:] = f4(0)
            reach = allowed[:size]
            _repeat_cells(unresolved[node, begin // cell :], cell, reach)
            resolved = np.max(reach) == f4(0)
            e, weight, grey, rest = residual[:size], kept[:size], clean_f[:size], clean_e[:size]
            w, wf, we, seen = sums[W, :size], sums[WF, :size], sums[WE, :size], sums[SEEN, :size]
            for r in range(node * cell, min(node * cell + cell, rows)):
                _compute_residual(images, lines, cell, r, begin, scratch, keys, e)
                f, gx, gy = values[r, begin:end], along_x[r, begin:end], along_y[r, begin:end]
                gain, offset = scratch[2, :size], scratch[3, :size]
                for c in range(size):
                    good = e[c] == e[c]
                    rest[c] = e[c] if good else f4(0)
                    grey[c] = f[c] if good else f4(0)
                if resolved:
                    _weigh(rest, inverse, weight)
                else:
                    _weigh_within(rest, least, reach, (gx, gy), weight)
                for c in range(size):
                    inside = gain[c] * low < f[c] - offset[c] and f[c] - offset[c] < gain[c] * high and e[c] == e[c]
                    weight[c] = weight[c] if inside else f4(0)
                    seen[c] += f4(1) if inside else f4(0)
                # Two sums at a time: compilers vectorise loops that write to few arrays.
                _add_products(weight, gx, gx, gy, sums[GXX, :size], sums[GXY, :size])
                _add_products(weight, gy, gy, rest, sums[GYY, :size], sums[GYE, :size])
                _add_products(weight, rest, gx, rest, sums[GXE, :size], sums[WEE, :size])
                _add_products(weight, grey, grey, rest, sums[WFF, :size], sums[WEF, :size])
                for c in range(size):
                    w[c] += weight[c]
                    wf[c] += weight[c] * grey[c]
                for c in range(size):
                    we[c] += weight[c] * rest[c]
            for channel in range(CHANNELS):
                _sum_cells(
                    sums[channel, :size], cell, out[channel, node, begin // cell : begin // cell + -(-size // cell)]
                )


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def accumulate_gradients(along_x: np.ndarray, along_y: np.ndarray, cell: int, out: np.ndarray) -> None:
    """Sum the products of the gradient over each cell, out (GYY + 1, node row, node column)."""
    rows, columns = along_x.shape
    for node in prange(out.shape[1]):
        sums, one = np.zeros((GYY + 1, columns), f4), np.ones(columns, f4)
        unused = np.empty(columns, f4)
        for r in range(node * cell, min(node * cell + cell, rows)):
            _add_products(one, along_x[r], along_x[r], along_y[r], sums[GXX], sums[GXY])
            _add_products(one, along_y[r], along_y[r], along_x[r], sums[GYY], unused)
        for channel in range(GYY + 1):
            _sum_cells(sums[channel], cell, out[channel, node])
