"""Compiled loops of the dense correlation: elementwise over rows or cells, so results do not depend on the threads.

Images are float32 arrays (row, column) in which NaN means "not measured". Node arrays (channel, node row, node column)
hold fields on the centres of square cells of `cell` pixels: node (i, j) stands at pixel row i * cell + (cell - 1) / 2.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

f4 = np.float32

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
def halved(image: np.ndarray, out: np.ndarray) -> None:
    """Image of half the size through the taps (1, 3, 3, 1)/8; pixel (i, j) stands at (2 i + 1/2, 2 j + 1/2).

    Pixels that are not measured, or outside, are left out of the mean; NaN where less than half of the weight is left.
    """
    rows, columns = image.shape
    for r in prange(out.shape[0]):
        for c in range(out.shape[1]):
            total = f4(0)
            weight = f4(0)
            for i in range(4):
                y = 2 * r + i - 1
                if y < 0 or y >= rows:
                    continue
                wy = f4(3) if i == 1 or i == 2 else f4(1)
                for j in range(4):
                    x = 2 * c + j - 1
                    if x < 0 or x >= columns:
                        continue
                    value = image[y, x]
                    if value == value:
                        w = wy * (f4(3) if j == 1 or j == 2 else f4(1))
                        total += w * value
                        weight += w
            out[r, c] = total / weight if weight >= f4(32) else f4(np.nan)


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
def _cubic(t: np.float32) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Weights of the interpolating cubic (Catmull and Rom) for the nodes -1, 0, 1, 2 at 0 <= t <= 1."""
    half = f4(0.5)
    a = half * t * (t * (f4(2) - t) - f4(1))
    b = half * (t * t * (f4(3) * t - f4(5)) + f4(2))
    c = half * t * (t * (f4(4) - f4(3) * t) + f4(1))
    return a, b, c, f4(1) - a - b - c


@njit(nogil=True, error_model="numpy")
def _place(position: float, count: int) -> tuple[int, float]:
    """Node before a position given in nodes, and the rest; beyond the outer nodes the rest leaves 0..1."""
    before = int(np.floor(position))
    before = min(max(before, 0), count - 2)
    return before, position - before


@njit(nogil=True, error_model="numpy")
def _neighbours(line: np.ndarray, i: int) -> tuple[float, float, float, float]:
    """The four nodes around an interval of a line, continued linearly over its ends."""
    count = line.size
    first = line[i - 1] if i > 0 else f4(2) * line[0] - line[1]
    last = line[i + 2] if i + 2 < count else f4(2) * line[count - 1] - line[count - 2]
    return first, line[i], line[i + 1], last


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def widened(nodes: np.ndarray, positions: np.ndarray, out: np.ndarray) -> None:
    """Node lines interpolated at column positions given in nodes: (channel, node row, node column) -> (.., .., n)."""
    channels, rows, columns = nodes.shape
    for flat in prange(channels * rows):
        channel, r = flat // rows, flat % rows
        line = nodes[channel, r]
        for k in range(positions.size):
            i, t = _place(positions[k], columns)
            p0, p1, p2, p3 = _neighbours(line, i)
            if t < 0.0 or t > 1.0:
                out[channel, r, k] = p1 + f4(t) * (p2 - p1)
            else:
                a, b, c, d = _cubic(f4(t))
                out[channel, r, k] = a * p0 + b * p1 + c * p2 + d * p3


@njit(nogil=True, error_model="numpy")
def _row_between(lines: np.ndarray, position: float, out: np.ndarray) -> None:
    """One image row of a field of widened node lines (node row, column), at a position given in nodes."""
    count = lines.shape[0]
    i, t = _place(position, count)
    p1, p2 = lines[i], lines[i + 1]
    if t < 0.0 or t > 1.0:
        w = f4(t)
        for k in range(out.size):
            out[k] = p1[k] + w * (p2[k] - p1[k])
        return
    a, b, c, d = _cubic(f4(t))
    if i == 0:  # linear continuation: p0 = 2 p1 - p2
        b += f4(2) * a
        c -= a
        a = f4(0)
    if i + 2 >= count:  # p3 = 2 p2 - p1
        c += f4(2) * d
        b -= d
        d = f4(0)
    p0, p3 = lines[max(i - 1, 0)], lines[min(i + 2, count - 1)]
    for k in range(out.size):
        out[k] = a * p0[k] + b * p1[k] + c * p2[k] + d * p3[k]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def heightened(lines: np.ndarray, positions: np.ndarray, out: np.ndarray) -> None:
    """Widened node lines (channel, node row, n) interpolated at row positions given in nodes: -> (channel, m, n)."""
    channels = lines.shape[0]
    rows = positions.size
    for flat in prange(channels * rows):
        channel, r = flat // rows, flat % rows
        _row_between(lines[channel], positions[r], out[channel, r])


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

    `lines` (4, node row, column) holds d_x, d_y, gain and offset widened to the columns of the image; g is the
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
                x = min(max(dx[c] + f4(c), leftmost), rightmost)
                y = min(max(dy[c] + f4(r), lowest), highest)
                fx = np.floor(x)
                fy = np.floor(y)
                along_x[c] = x - fx
                along_y[c] = y - fy
                keys[c] = (np.int32(fx) - np.int32(c) + np.int32(16384)) + (np.int32(fy) << 15)
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
                e = source[c] - gain[c] * target[c] - offset[c]
                target[c] = e
                good = e == e
                total[c] += abs(e) if good else f4(0)
                count[c] += f4(1) if good else f4(0)
        for j in range(mean.shape[1]):
            t = f4(0)
            n = f4(0)
            for c in range(j * cell, min(j * cell + cell, columns)):
                t += total[c]
                n += count[c]
            mean[node, j] = t / n if n > f4(0) else f4(np.nan)


# Channels of the sums of each cell.
GXX, GXY, GYY, GXE, GYE, W, WF, WFF, WE, WEF, WEE = range(11)
CHANNELS = 11


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
        sxx, sxy, syy, sxe, sye = sums[0], sums[1], sums[2], sums[3], sums[4]
        sw, swf, swff, swe, swef, swee = sums[5], sums[6], sums[7], sums[8], sums[9], sums[10]
        for r in range(node * cell, min(node * cell + cell, rows)):
            f, gx, gy, e = values[r], along_x[r], along_y[r], residual[r]
            for c in range(columns):
                good = e[c] == e[c]
                ec = e[c] if good else f4(0)
                fc = f[c] if good else f4(0)
                over = min(max(abs(ec) * inverse - f4(1), f4(0)), f4(1))
                kept = f4(1) - over * over
                w = kept * kept if good else f4(0)
                wx = w * gx[c]
                wy = w * gy[c]
                wf = w * fc
                we = w * ec
                sxx[c] += wx * gx[c]
                sxy[c] += wx * gy[c]
                syy[c] += wy * gy[c]
                sxe[c] += wx * ec
                sye[c] += wy * ec
                sw[c] += w
                swf[c] += wf
                swff[c] += wf * fc
                swe[c] += we
                swef[c] += we * fc
                swee[c] += we * ec
        for channel in range(CHANNELS):
            line = sums[channel]
            for j in range(out.shape[2]):
                t = f4(0)
                for c in range(j * cell, min(j * cell + cell, columns)):
                    t += line[c]
                out[channel, node, j] = t


@njit(cache=True, nogil=True, error_model="numpy")
def windowed(nodes: np.ndarray, taps: np.ndarray, out: np.ndarray) -> None:
    """Separable symmetric filter of node arrays (channel, node row, node column), zero outside."""
    channels, rows, columns = nodes.shape
    reach = taps.size - 1
    for flat in range(channels * rows):
        channel, r = flat // rows, flat % rows
        line = np.zeros(columns + 2 * reach, f4)
        body = line[reach : reach + columns]
        for k in range(-reach, reach + 1):
            if 0 <= r + k < rows:
                source = nodes[channel, r + k]
                tap = taps[abs(k)]
                for c in range(columns):
                    body[c] += tap * source[c]
        target = out[channel, r]
        for c in range(columns):
            target[c] = taps[0] * line[c + reach]
        for k in range(1, reach + 1):
            left, right = line[reach - k : reach - k + columns], line[reach + k : reach + k + columns]
            tap = taps[k]
            for c in range(columns):
                target[c] += tap * (left[c] + right[c])


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def median3(nodes: np.ndarray, out: np.ndarray) -> None:
    """Median over 3 x 3 nodes (fewer at the edges), each channel for itself."""
    channels, rows, columns = nodes.shape
    for flat in prange(channels * rows):
        channel, r = flat // rows, flat % rows
        around = np.empty(9, f4)
        for c in range(columns):
            n = 0
            for i in range(max(r - 1, 0), min(r + 2, rows)):
                for j in range(max(c - 1, 0), min(c + 2, columns)):
                    around[n] = nodes[channel, i, j]
                    n += 1
            around[:n].sort()
            out[channel, r, c] = around[n // 2]


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
