"""Compiled loops of the dense correlation: elementwise over rows or cells, so results do not depend on the threads.

Images are float32 arrays (row, column) in which NaN means "not measured". Node arrays (channel, node row, node column)
hold fields on the centres of square cells of `cell` pixels: node (i, j) stands at pixel row i * cell + (cell - 1) / 2.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

f4 = np.float32

# Taps on either side of the centre of a filter of nodes.
REACH = 6
# Columns of one block of the warp, and the NaN border of the coefficients that a block may reach into.
BLOCK = 32
BORDER = BLOCK + 8


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def normalised(image: np.ndarray, offset: float, factor: float, out: np.ndarray) -> None:
    """out = (image - offset) * factor as float32, for any real pixel type; NaN stays NaN."""
    shift, gain = f4(offset), f4(factor)
    for r in prange(image.shape[0]):
        for c in range(image.shape[1]):
            out[r, c] = (f4(image[r, c]) - shift) * gain


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def row_moments(image: np.ndarray, out: np.ndarray) -> None:
    """Number, sum and sum of squares of the finite pixels of each row, out (row, 3)."""
    for r in prange(image.shape[0]):
        count, total, squares = 0.0, 0.0, 0.0
        for c in range(image.shape[1]):
            value = float(image[r, c])
            if np.isfinite(value):
                count += 1.0
                total += value
                squares += value * value
        out[r, 0], out[r, 1], out[r, 2] = count, total, squares


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def halved(image: np.ndarray, out: np.ndarray) -> None:
    """Image of half the size through the taps (1, 3, 3, 1)/8; pixel (i, j) stands at (2 i + 1/2, 2 j + 1/2).

    Pixels that are not measured, or outside, are left out of the mean; NaN where less than half of the weight is left.
    """
    rows, columns = image.shape
    for r in prange(out.shape[0]):
        total, weight = np.zeros(columns + 3, f4), np.zeros(columns + 3, f4)
        inner, inner_weight = total[1 : 1 + columns], weight[1 : 1 + columns]
        for i in range(max(2 * r - 1, 0), min(2 * r + 3, rows)):
            source = image[i]
            w = f4(3) if i // 2 == r else f4(1)
            for c in range(columns):
                inner[c] += w * source[c] if source[c] == source[c] else f4(0)
            for c in range(columns):
                inner_weight[c] += w if source[c] == source[c] else f4(0)
        target = out[r]
        for c in range(target.size):
            k = 2 * c
            value = total[k] + total[k + 3] + f4(3) * (total[k + 1] + total[k + 2])
            seen = weight[k] + weight[k + 3] + f4(3) * (weight[k + 1] + weight[k + 2])
            target[c] = value / seen if seen >= f4(32) else f4(np.nan)


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def gradient(image: np.ndarray, taps: np.ndarray, values: np.ndarray, along_x: np.ndarray, along_y: np.ndarray) -> None:
    """Antisymmetric 7-tap derivatives; where a tap is not measured, `values` is NaN and the gradient zero."""
    rows, columns = image.shape
    a, b, c3 = taps[0], taps[1], taps[2]
    for r in prange(rows):
        if r < 3 or r >= rows - 3:
            for c in range(columns):
                values[r, c] = f4(np.nan)
                along_x[r, c] = f4(0)
                along_y[r, c] = f4(0)
            continue
        middle = image[r]
        u1, u2, u3 = image[r - 1], image[r - 2], image[r - 3]
        d1, d2, d3 = image[r + 1], image[r + 2], image[r + 3]
        for c in range(columns):
            if c < 3 or c >= columns - 3:
                values[r, c] = f4(np.nan)
                along_x[r, c] = f4(0)
                along_y[r, c] = f4(0)
        for c in range(3, columns - 3):
            gx = (
                a * (middle[c + 1] - middle[c - 1])
                + b * (middle[c + 2] - middle[c - 2])
                + c3 * (middle[c + 3] - middle[c - 3])
            )
            gy = a * (d1[c] - u1[c]) + b * (d2[c] - u2[c]) + c3 * (d3[c] - u3[c])
            value = middle[c]
            good = (gx == gx) and (gy == gy) and (value == value)
            values[r, c] = value if good else f4(np.nan)
            along_x[r, c] = gx if good else f4(0)
            along_y[r, c] = gy if good else f4(0)


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def spline_coefficients(image: np.ndarray, taps: np.ndarray, out: np.ndarray) -> None:
    """Coefficients of the quintic B-spline through the pixels of an image without NaN, mirrored at its edges.

    `taps` is the (symmetric, truncated) inverse of the sampled B-spline from its centre on; `out` has a border of
    BORDER pixels on every side, which stays as it is.
    """
    rows, columns = image.shape
    reach = taps.size - 1
    for r in prange(rows):
        line = np.empty(columns + 2 * reach, f4)
        body = line[reach : reach + columns]
        centre = image[r]
        for c in range(columns):
            body[c] = taps[0] * centre[c]
        for k in range(1, reach + 1):
            above = r - k if r >= k else k - r
            below = r + k if r + k < rows else 2 * (rows - 1) - r - k
            up, down = image[above], image[below]
            tap = taps[k]
            for c in range(columns):
                body[c] += tap * (up[c] + down[c])
        for k in range(1, reach + 1):
            line[reach - k] = line[reach + k]
            line[reach + columns - 1 + k] = line[reach + columns - 1 - k]
        target = out[r + BORDER, BORDER : BORDER + columns]
        for c in range(columns):
            target[c] = taps[0] * line[c + reach]
        for k in range(1, reach + 1):
            left, right = line[reach - k : reach - k + columns], line[reach + k : reach + k + columns]
            tap = taps[k]
            for c in range(columns):
                target[c] += tap * (left[c] + right[c])


@njit(nogil=True, error_model="numpy")
def _cubic(position: float, count: int) -> tuple[int, np.float32, np.float32, np.float32, np.float32]:
    """First of the four nodes around a position given in nodes, and their weights (Catmull and Rom).

    Two nodes, which continue the field linearly, are meant to stand before the first and after the last one; the
    index counts them.
    """
    before = min(max(int(np.floor(position)), -1), count - 1)
    t = f4(min(max(position - before, 0.0), 1.0))
    half = f4(0.5)
    a = half * t * (t * (f4(2) - t) - f4(1))
    b = half * (t * t * (f4(3) * t - f4(5)) + f4(2))
    c = half * t * (t * (f4(4) - f4(3) * t) + f4(1))
    return before + 1, a, b, c, f4(1) - a - b - c


@njit(nogil=True, error_model="numpy")
def _continued(lines: np.ndarray) -> None:
    """Fill the two outer entries at either end of axis 0 with the linear continuation of the inner ones."""
    last = lines.shape[0] - 1
    two = f4(2)
    for k in range(lines.shape[1]):
        lines[1, k] = two * lines[2, k] - lines[3, k]
        lines[0, k] = two * lines[1, k] - lines[2, k]
        lines[last - 1, k] = two * lines[last - 2, k] - lines[last - 3, k]
        lines[last, k] = two * lines[last - 1, k] - lines[last - 2, k]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def widened(nodes: np.ndarray, positions: np.ndarray, out: np.ndarray) -> None:
    """Node lines interpolated at column positions given in nodes.

    nodes (channel, node row, node column) -> out (channel, 2 + node row + 2, position): two lines more at either end.
    """
    channels, rows, columns = nodes.shape
    n = positions.size
    first = np.empty(n, np.int32)
    weights = np.empty((4, n), f4)
    for k in range(n):
        first[k], weights[0, k], weights[1, k], weights[2, k], weights[3, k] = _cubic(positions[k], columns)
    for r in prange(rows):
        line = np.empty((columns + 4, 1), f4)
        for channel in range(channels):
            line[2 : 2 + columns, 0] = nodes[channel, r]
            _continued(line)
            values = line[:, 0]
            target = out[channel, r + 2]
            for k in range(n):
                i = first[k]
                target[k] = (
                    weights[0, k] * values[i]
                    + weights[1, k] * values[i + 1]
                    + weights[2, k] * values[i + 2]
                    + weights[3, k] * values[i + 3]
                )
    for channel in range(channels):
        _continued(out[channel])


@njit(nogil=True, error_model="numpy")
def _row_between(lines: np.ndarray, position: float, out: np.ndarray) -> None:
    """One image row of a field of widened node lines (2 + node row + 2, column), at a position given in nodes."""
    first, a, b, c, d = _cubic(position, lines.shape[0] - 4)
    p0, p1, p2, p3 = lines[first], lines[first + 1], lines[first + 2], lines[first + 3]
    for k in range(out.size):
        out[k] = a * p0[k] + b * p1[k] + c * p2[k] + d * p3[k]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def heightened(lines: np.ndarray, positions: np.ndarray, out: np.ndarray) -> None:
    """Widened node lines (channel, 2 + node row + 2, n) at row positions given in nodes: out (channel, m, n)."""
    channels = lines.shape[0]
    rows = positions.size
    for flat in prange(channels * rows):
        channel, r = flat // rows, flat % rows
        _row_between(lines[channel], positions[r], out[channel, r])


@njit(nogil=True, error_model="numpy")
def _add_up(line: np.ndarray, cell: int, out: np.ndarray) -> None:
    """Sums over the cells of a line, the last of which may be cut."""
    whole = line.size // cell
    for j in range(whole):
        out[j] = line[j * cell]
    for k in range(1, cell):
        for j in range(whole):
            out[j] += line[j * cell + k]
    if whole < out.size:
        out[whole] = np.sum(line[whole * cell :])


@njit(nogil=True, error_model="numpy")
def _quintic(
    c0: np.ndarray,
    c1: np.ndarray,
    c2: np.ndarray,
    c3: np.ndarray,
    c4: np.ndarray,
    c5: np.ndarray,
    along_x: np.ndarray,
    along_y: np.ndarray,
    keys: np.ndarray,
    key: int,
    out: np.ndarray,
) -> None:
    """Spline values of those pixels of a block whose integer displacement is `key`: contiguous loads, no gathers."""
    k = f4(1.0 / 120.0)
    for i in range(out.size):
        x = along_x[i]
        y = along_y[i]
        x1 = f4(1) - x
        y1 = f4(1) - y
        x2 = x * x
        x4 = x2 * x2
        z2 = x1 * x1
        z4 = z2 * z2
        a0 = z4 * x1 * k
        a5 = x4 * x * k
        a1 = (f4(26) - f4(50) * x + x2 * (f4(20) + f4(20) * x) + x4 * (f4(5) * x - f4(20))) * k
        a4 = (f4(26) - f4(50) * x1 + z2 * (f4(20) + f4(20) * x1) + z4 * (f4(5) * x1 - f4(20))) * k
        a2 = (f4(66) - f4(60) * x2 + x4 * (f4(30) - f4(10) * x)) * k
        a3 = (f4(66) - f4(60) * z2 + z4 * (f4(30) - f4(10) * x1)) * k
        y2 = y * y
        y4 = y2 * y2
        v2 = y1 * y1
        v4 = v2 * v2
        b0 = v4 * y1 * k
        b5 = y4 * y * k
        b1 = (f4(26) - f4(50) * y + y2 * (f4(20) + f4(20) * y) + y4 * (f4(5) * y - f4(20))) * k
        b4 = (f4(26) - f4(50) * y1 + v2 * (f4(20) + f4(20) * y1) + v4 * (f4(5) * y1 - f4(20))) * k
        b2 = (f4(66) - f4(60) * y2 + y4 * (f4(30) - f4(10) * y)) * k
        b3 = (f4(66) - f4(60) * v2 + v4 * (f4(30) - f4(10) * y1)) * k
        s = b0 * (a0 * c0[i] + a1 * c0[i + 1] + a2 * c0[i + 2] + a3 * c0[i + 3] + a4 * c0[i + 4] + a5 * c0[i + 5])
        s += b1 * (a0 * c1[i] + a1 * c1[i + 1] + a2 * c1[i + 2] + a3 * c1[i + 3] + a4 * c1[i + 4] + a5 * c1[i + 5])
        s += b2 * (a0 * c2[i] + a1 * c2[i + 1] + a2 * c2[i + 2] + a3 * c2[i + 3] + a4 * c2[i + 4] + a5 * c2[i + 5])
        s += b3 * (a0 * c3[i] + a1 * c3[i + 1] + a2 * c3[i + 2] + a3 * c3[i + 3] + a4 * c3[i + 4] + a5 * c3[i + 5])
        s += b4 * (a0 * c4[i] + a1 * c4[i + 1] + a2 * c4[i + 2] + a3 * c4[i + 3] + a4 * c4[i + 4] + a5 * c4[i + 5])
        s += b5 * (a0 * c5[i] + a1 * c5[i + 1] + a2 * c5[i + 2] + a3 * c5[i + 3] + a4 * c5[i + 4] + a5 * c5[i + 5])
        if keys[i] == key:
            out[i] = s


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def residuals(
    values: np.ndarray, coefficients: np.ndarray, lines: np.ndarray, cell: int, out: np.ndarray, mean: np.ndarray
) -> None:
    """e(p) = f(p) - gain(p) g(p + d(p)) - offset(p), and the mean of abs(e) in each cell (NaN where nothing is seen).

    `lines` (4, 2 + node row + 2, column) holds d_x, d_y, gain and offset widened to the columns of the image; g is the
    spline of `coefficients`. A pixel that any of its 36 coefficients does not cover is NaN.
    """
    rows, columns = values.shape
    for node in prange(mean.shape[0]):
        field = np.empty((4, columns), f4)
        along_x = np.empty(columns, f4)
        along_y = np.empty(columns, f4)
        keys = np.empty(columns, np.int32)
        total = np.zeros(columns, f4)
        count = np.zeros(columns, f4)
        first = node * cell
        last = min(first + cell, rows)
        for r in range(first, last):
            position = (r - 0.5 * (cell - 1)) / cell
            for channel in range(4):
                _row_between(lines[channel], position, field[channel])
            dx, dy, gain, offset = field[0], field[1], field[2], field[3]
            lowest, leftmost = f4(-4), f4(-4)
            highest, rightmost = f4(rows + 3), f4(columns + 3)
            for c in range(columns):
                y = min(max(dy[c] + f4(r), lowest), highest)
                fy = np.floor(y)
                along_y[c] = y - fy
                keys[c] = np.int32(fy) << 15
            for c in range(columns):
                x = min(max(dx[c] + f4(c), leftmost), rightmost)
                fx = np.floor(x)
                along_x[c] = x - fx
                keys[c] += np.int32(fx) - np.int32(c) + np.int32(16384)
            target = out[r]
            for begin in range(0, columns, BLOCK):
                end = min(begin + BLOCK, columns)
                done = begin
                while done < end:
                    key = keys[done]
                    row = (key >> 15) + BORDER - 2
                    column = (key & 32767) - 16384 + begin + BORDER - 2
                    stop = column + end - begin + 5
                    _quintic(
                        coefficients[row, column:stop],
                        coefficients[row + 1, column:stop],
                        coefficients[row + 2, column:stop],
                        coefficients[row + 3, column:stop],
                        coefficients[row + 4, column:stop],
                        coefficients[row + 5, column:stop],
                        along_x[begin:end],
                        along_y[begin:end],
                        keys[begin:end],
                        key,
                        target[begin:end],
                    )
                    while done < end and keys[done] == key:
                        done += 1
            source = values[r]
            for c in range(columns):
                target[c] = source[c] - gain[c] * target[c] - offset[c]
            for c in range(columns):
                good = target[c] == target[c]
                total[c] += abs(target[c]) if good else f4(0)
                count[c] += f4(1) if good else f4(0)
        numbers = np.empty(mean.shape[1], f4)
        means = mean[node]
        _add_up(total, cell, means)
        _add_up(count, cell, numbers)
        for j in range(means.size):
            means[j] = means[j] / numbers[j] if numbers[j] > f4(0) else f4(np.nan)


# Channels of the sums of each cell.
GXX, GXY, GYY, GXE, GYE, W, WF, WFF, WE, WEF, WEE = range(11)
CHANNELS = 11


@njit(nogil=True, error_model="numpy")
def _add_products(
    w: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, sum_ab: np.ndarray, sum_ac: np.ndarray
) -> None:
    """Add w a b and w a c."""
    for k in range(w.size):
        wa = w[k] * a[k]
        sum_ab[k] += wa * b[k]
        sum_ac[k] += wa * c[k]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def accumulated(
    values: np.ndarray,
    along_x: np.ndarray,
    along_y: np.ndarray,
    residual: np.ndarray,
    limit: float,
    cell: int,
    out: np.ndarray,
) -> None:
    """Weighted sums over each cell, out (CHANNELS, node row, node column).

    Weights are one up to abs(e) = limit, fall as Tukey's biweight and are zero from twice the limit on: noise keeps
    its full weight, glare and decorrelated pixels have none.
    """
    rows, columns = values.shape
    inverse = f4(1.0 / limit)
    for node in prange(out.shape[1]):
        sums = np.zeros((CHANNELS, columns), f4)
        weight, clean_f, clean_e = np.empty(columns, f4), np.empty(columns, f4), np.empty(columns, f4)
        for r in range(node * cell, min(node * cell + cell, rows)):
            f, gx, gy, e = values[r], along_x[r], along_y[r], residual[r]
            for c in range(columns):
                good = e[c] == e[c]
                clean_e[c] = e[c] if good else f4(0)
                clean_f[c] = f[c] if good else f4(0)
            for c in range(columns):
                over = min(max(abs(clean_e[c]) * inverse - f4(1), f4(0)), f4(1))
                kept = f4(1) - over * over
                weight[c] = kept * kept if e[c] == e[c] else f4(0)
            # Two sums at a time: compilers vectorise loops that write to few arrays.
            _add_products(weight, gx, gx, gy, sums[GXX], sums[GXY])
            _add_products(weight, gy, gy, clean_e, sums[GYY], sums[GYE])
            _add_products(weight, clean_e, gx, clean_e, sums[GXE], sums[WEE])
            _add_products(weight, clean_f, clean_f, clean_e, sums[WFF], sums[WEF])
            total, total_f, total_e = sums[W], sums[WF], sums[WE]
            for c in range(columns):
                total[c] += weight[c]
                total_f[c] += weight[c] * clean_f[c]
            for c in range(columns):
                total_e[c] += weight[c] * clean_e[c]
        for channel in range(CHANNELS):
            _add_up(sums[channel], cell, out[channel, node])


@njit(nogil=True, error_model="numpy")
def _smoothed(padded: np.ndarray, taps: np.ndarray, line: np.ndarray, r: int, out: np.ndarray) -> None:
    """Row r of the separable filter of an array that has REACH rows of zeros above and below.

    `line` is a scratch of REACH zeros at either end. Loops over a few rows at a time are what compilers vectorise.
    """
    columns = out.size
    body = line[REACH : REACH + columns]
    t0, t1, t2, t3, t4, t5, t6 = taps[0], taps[1], taps[2], taps[3], taps[4], taps[5], taps[6]
    c = r + REACH
    m3, m2, m1, p0, p1, p2, p3 = (
        padded[c - 3], padded[c - 2], padded[c - 1], padded[c], padded[c + 1], padded[c + 2], padded[c + 3],
    )  # fmt: skip
    for k in range(columns):
        body[k] = t0 * p0[k] + t1 * (m1[k] + p1[k]) + t2 * (m2[k] + p2[k]) + t3 * (m3[k] + p3[k])
    m6, m5, m4, p4, p5, p6 = padded[c - 6], padded[c - 5], padded[c - 4], padded[c + 4], padded[c + 5], padded[c + 6]
    for k in range(columns):
        body[k] += t4 * (m4[k] + p4[k]) + t5 * (m5[k] + p5[k]) + t6 * (m6[k] + p6[k])
    for k in range(columns):
        out[k] = (
            t0 * line[k + 6]
            + t1 * (line[k + 5] + line[k + 7])
            + t2 * (line[k + 4] + line[k + 8])
            + t3 * (line[k + 3] + line[k + 9])
            + t4 * (line[k + 2] + line[k + 10])
            + t5 * (line[k + 1] + line[k + 11])
            + t6 * (line[k] + line[k + 12])
        )


@njit(cache=True, nogil=True, error_model="numpy")
def windowed(nodes: np.ndarray, taps: np.ndarray, out: np.ndarray) -> None:
    """Separable symmetric filter of node arrays (channel, node row, node column), zero outside.

    `taps` are REACH + 1 from the centre on.
    """
    channels, rows, columns = nodes.shape
    line = np.zeros(columns + 2 * REACH, f4)
    padded = np.zeros((rows + 2 * REACH, columns), f4)
    for channel in range(channels):
        padded[REACH : REACH + rows] = nodes[channel]
        for r in range(rows):
            _smoothed(padded, taps, line, r, out[channel, r])


@njit(cache=True, nogil=True, error_model="numpy")
def fixed_point(
    cells: np.ndarray,
    sums: np.ndarray,
    seen: np.ndarray,
    start: np.ndarray,
    taps: np.ndarray,
    smoothing: np.ndarray,
    tau: float,
    order: int,
    iterations: int,
    out: np.ndarray,
) -> None:
    """u = S u + H^-1 W * (grad f (e - grad f . (S u - start))) on the nodes; `out` holds the first u (2, row, column).

    S = 1 - (1 - V)^order with V, the filter of the taps `smoothing`, normalised by the weights `seen`; W has `taps`.
    Steps are limited to one pixel. The nodes are few, and one thread works on them without waiting for another.
    """
    _, rows, columns = start.shape
    line = np.zeros(columns + 2 * REACH, f4)
    padded = np.zeros((rows + 2 * REACH, columns), f4)
    padded_y = np.zeros((rows + 2 * REACH, columns), f4)
    filtered, filtered_y = np.empty(columns, f4), np.empty(columns, f4)
    smooth, rest = np.empty((2, rows, columns), f4), np.empty((rows, columns), f4)
    inverse_seen = np.empty((rows, columns), f4)
    padded[REACH : REACH + rows] = seen
    for r in range(rows):
        _smoothed(padded, smoothing, line, r, filtered)
        for c in range(columns):
            inverse_seen[r, c] = f4(1) / filtered[c]
    add = f4(tau)
    for _ in range(iterations):
        for channel in range(2):
            for r in range(rows):
                total, left, first = smooth[channel, r], rest[r], out[channel, r]
                for c in range(columns):
                    total[c] = f4(0)
                    left[c] = first[c]
            for _ in range(order):
                for r in range(rows):
                    target, weight, left = padded[r + REACH], seen[r], rest[r]
                    for c in range(columns):
                        target[c] = weight[c] * left[c]
                for r in range(rows):
                    _smoothed(padded, smoothing, line, r, filtered)
                    total, left, inverse = smooth[channel, r], rest[r], inverse_seen[r]
                    for c in range(columns):
                        value = filtered[c] * inverse[c]
                        total[c] += value
                        left[c] -= value
        for r in range(rows):
            u, v, u0, v0 = smooth[0, r], smooth[1, r], start[0, r], start[1, r]
            gxx, gxy, gyy = cells[GXX, r], cells[GXY, r], cells[GYY, r]
            target, source = padded[r + REACH], cells[GXE, r]
            for c in range(columns):
                target[c] = source[c] - gxx[c] * (u[c] - u0[c]) - gxy[c] * (v[c] - v0[c])
            target, source = padded_y[r + REACH], cells[GYE, r]
            for c in range(columns):
                target[c] = source[c] - gxy[c] * (u[c] - u0[c]) - gyy[c] * (v[c] - v0[c])
        for r in range(rows):
            _smoothed(padded, taps, line, r, filtered)
            _smoothed(padded_y, taps, line, r, filtered_y)
            hxx, hxy, hyy = sums[GXX, r], sums[GXY, r], sums[GYY, r]
            u, target = smooth[0, r], out[0, r]
            for c in range(columns):
                xx, xy, yy = hxx[c] + add, hxy[c], hyy[c] + add
                step = (yy * filtered[c] - xy * filtered_y[c]) / (xx * yy - xy * xy)
                target[c] = u[c] + min(max(step, f4(-1)), f4(1))
            v, target = smooth[1, r], out[1, r]
            for c in range(columns):
                xx, xy, yy = hxx[c] + add, hxy[c], hyy[c] + add
                step = (xx * filtered_y[c] - xy * filtered[c]) / (xx * yy - xy * xy)
                target[c] = v[c] + min(max(step, f4(-1)), f4(1))


@njit(cache=True, nogil=True, error_model="numpy")
def equalised(nodes: np.ndarray, sums: np.ndarray, floor: float) -> None:
    """Give g, by gain (channel 2) and offset (channel 3), the mean and the standard deviation of f in every window.

    `floor` is a variance below which contrast is not compared.
    """
    least = f4(floor)
    for r in range(nodes.shape[1]):
        for c in range(nodes.shape[2]):
            w = sums[W, r, c]
            if not w > f4(0):
                continue
            mean_f, mean_e = sums[WF, r, c] / w, sums[WE, r, c] / w
            mean_g = mean_f - mean_e
            var_f = max(sums[WFF, r, c] / w - mean_f * mean_f, f4(0))
            second_g = (sums[WFF, r, c] - f4(2) * sums[WEF, r, c] + sums[WEE, r, c]) / w
            var_g = max(second_g - mean_g * mean_g, f4(0))
            ratio = min(max(np.sqrt((var_f + least) / (var_g + least)), f4(0.5)), f4(2))
            nodes[2, r, c] = min(max(ratio * nodes[2, r, c], f4(0.1)), f4(10))
            nodes[3, r, c] = ratio * nodes[3, r, c] + mean_f - ratio * mean_g


@njit(nogil=True, error_model="numpy")
def _median(a: np.float32, b: np.float32, c: np.float32) -> np.float32:
    return max(min(a, b), min(max(a, b), c))


@njit(cache=True, nogil=True, error_model="numpy")
def median3(nodes: np.ndarray, out: np.ndarray) -> None:
    """Median over 3 x 3 nodes of each channel; the outermost nodes are repeated.

    The median of nine is the median of the greatest of the row minima, the median of the row medians and the smallest
    of the row maxima, rows being sorted triples.
    """
    channels, rows, columns = nodes.shape
    lowest, middle, highest = np.empty(columns, f4), np.empty(columns, f4), np.empty(columns, f4)
    for channel in range(channels):
        for r in range(rows):
            above, here, below = nodes[channel, max(r - 1, 0)], nodes[channel, r], nodes[channel, min(r + 1, rows - 1)]
            for c in range(columns):
                x, y, z = above[c], here[c], below[c]
                lowest[c] = min(min(x, y), z)
                middle[c] = _median(x, y, z)
                highest[c] = max(max(x, y), z)
            for c in range(columns):
                left, right = max(c - 1, 0), min(c + 1, columns - 1)
                out[channel, r, c] = _median(
                    max(max(lowest[left], lowest[c]), lowest[right]),
                    _median(middle[left], middle[c], middle[right]),
                    min(min(highest[left], highest[c]), highest[right]),
                )


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def cell_means(image: np.ndarray, cell: int, out: np.ndarray) -> None:
    """Mean of the measured pixels of each cell, NaN where there is none."""
    rows, columns = image.shape
    for i in prange(out.shape[0]):
        for j in range(out.shape[1]):
            total = 0.0
            count = 0
            for r in range(i * cell, min(i * cell + cell, rows)):
                for c in range(j * cell, min(j * cell + cell, columns)):
                    if image[r, c] == image[r, c]:
                        total += image[r, c]
                        count += 1
            out[i, j] = f4(total / count) if count else f4(np.nan)


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def points(
    lines: np.ndarray,
    positions: np.ndarray,
    valid_nodes: np.ndarray,
    node_rows: np.ndarray,
    node_columns: np.ndarray,
    measured: np.ndarray,
    fields: np.ndarray,
    valid: np.ndarray,
) -> None:
    """Widened node lines at row positions given in nodes, NaN where the nearest node or the pixel is not valid."""
    for r in prange(positions.size):
        for channel in range(fields.shape[0]):
            _row_between(lines[channel], positions[r], fields[channel, r])
        good, nodes, pixels = valid[r], valid_nodes[node_rows[r]], measured[r]
        for c in range(good.size):
            good[c] = nodes[node_columns[c]] and pixels[c] == pixels[c]
        for channel in range(fields.shape[0]):
            field = fields[channel, r]
            for c in range(good.size):
                field[c] = field[c] if good[c] else f4(np.nan)
