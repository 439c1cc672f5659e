"""Compiled loops of the dense correlation: elementwise over rows or cells, so results do not depend on the threads.

Images are float32 arrays (row, column) in which NaN means "not measured". Node arrays (channel, node row, node column)
hold fields on the centres of square cells of `cell` pixels: node (i, j) stands at pixel row i * cell + (cell - 1) / 2.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

f4 = np.float32

# Pixels that are interpolated together, and the NaN border of the coefficients that such a group may reach into.
GROUP = 16
BORDER = GROUP + 8
# Columns that are worked on together for all rows of a cell: their scratch stays in the fastest cache.
BLOCK = 256


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
def ends(image: np.ndarray, lowest: int, highest: int, margin: int, out: np.ndarray) -> None:
    """Pixels of each row that have the lowest or the highest value, or lie within `margin` of either, out (row, 4)."""
    for r in prange(image.shape[0]):
        at_low, near_low, at_high, near_high = 0, 0, 0, 0
        for c in range(image.shape[1]):
            value = np.int32(image[r, c])
            at_low += 1 if value == np.int32(lowest) else 0
            near_low += 1 if value <= np.int32(lowest + margin) else 0
            at_high += 1 if value == np.int32(highest) else 0
            near_high += 1 if value >= np.int32(highest - margin) else 0
        out[r, 0], out[r, 1], out[r, 2], out[r, 3] = at_low, near_low, at_high, near_high


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


@njit(nogil=True, error_model="numpy")
def _between(line: np.ndarray, k: int) -> np.float32:
    """Value in the middle of three pixels on either side (polynomial of degree 5), NaN where one is not measured."""
    if k < 3 or k >= line.size - 3:
        return f4(np.nan)
    near, middle, far = line[k - 1] + line[k + 1], line[k - 2] + line[k + 2], line[k - 3] + line[k + 3]
    return f4(0.75) * near - f4(0.3) * middle + f4(0.05) * far


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def mended(image: np.ndarray, out: np.ndarray) -> None:
    """Image in which single missing pixels, and lines of them, have the value between their neighbours.

    A pixel is mended along its row or its column, or by the mean of both, where three pixels on either side are
    measured; others stay NaN.
    """
    for r in prange(image.shape[0]):
        for c in range(image.shape[1]):
            value = image[r, c]
            if value != value:
                along, across = _between(image[r], c), _between(image[:, c], r)
                value = along if across != across else across if along != along else f4(0.5) * (along + across)
            out[r, c] = value


@njit(nogil=True, error_model="numpy")
def _mirrored(index: int, size: int) -> int:
    """Where the line of pixels that is mirrored at its first and last one, over and over, repeats the real one."""
    index = abs(index) % (2 * size - 2)
    return index if index < size else 2 * size - 2 - index


@njit(nogil=True, error_model="numpy")
def _scaled(factor: np.float32, line: np.ndarray, out: np.ndarray) -> None:
    for c in range(out.size):
        out[c] = factor * line[c]


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _add_pairs(
    taps: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    d: np.ndarray,
    e: np.ndarray,
    f: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add three taps of a symmetric filter: each times the sum of the two lines at its distance."""
    p, q, s = taps[0], taps[1], taps[2]
    for k in range(out.size):
        out[k] += p * (a[k] + b[k]) + q * (c[k] + d[k]) + s * (e[k] + f[k])


@njit(cache=True, nogil=True, parallel=True, error_model="numpy", fastmath={"contract"})
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
        _scaled(taps[0], image[r], body)
        for k in range(1, reach + 1, 3):
            a, b, c = k, k + 1, k + 2
            _add_pairs(
                taps[k : k + 3],
                image[_mirrored(r - a, rows)], image[_mirrored(r + a, rows)],
                image[_mirrored(r - b, rows)], image[_mirrored(r + b, rows)],
                image[_mirrored(r - c, rows)], image[_mirrored(r + c, rows)],
                body,
            )  # fmt: skip
        for k in range(1, reach + 1):
            line[reach - k] = line[reach + k]
            line[reach + columns - 1 + k] = line[reach + columns - 1 - k]
        target = out[r + BORDER, BORDER : BORDER + columns]
        _scaled(taps[0], body, target)
        for k in range(1, reach + 1, 3):
            m, n = reach - k, reach + k
            _add_pairs(
                taps[k : k + 3],
                line[m : m + columns], line[n : n + columns],
                line[m - 1 : m - 1 + columns], line[n + 1 : n + 1 + columns],
                line[m - 2 : m - 2 + columns], line[n + 2 : n + 2 + columns],
                target,
            )  # fmt: skip


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


@njit(cache=True, nogil=True, parallel=True, error_model="numpy", fastmath={"contract"})
def spread_out(nodes: np.ndarray, cell: int, out: np.ndarray) -> None:
    """`widened` to every column of the image: the weights repeat from cell to cell."""
    channels, rows, columns = nodes.shape
    n = out.shape[2]
    weights = np.empty((cell, 4), f4)
    before = np.empty(cell, np.int64)
    for p in range(cell):
        first, weights[p, 0], weights[p, 1], weights[p, 2], weights[p, 3] = _cubic(
            (p - 0.5 * (cell - 1)) / cell + 2.0, columns + 4
        )
        before[p] = first - 2
    for flat in prange(channels * rows):
        channel, r = flat // rows, flat % rows
        line = np.empty((columns + 4, 1), f4)
        line[2 : 2 + columns, 0] = nodes[channel, r]
        _continued(line)
        values, target = line[:, 0].copy(), out[channel, r + 2]
        whole = n // cell
        if cell == 4:
            # Strides known beforehand are what is vectorised. Nodes: 1.5 pixels from either end of a cell.
            a0, b0, c0, d0 = weights[0, 0], weights[0, 1], weights[0, 2], weights[0, 3]
            a1, b1, c1, d1 = weights[1, 0], weights[1, 1], weights[1, 2], weights[1, 3]
            a2, b2, c2, d2 = weights[2, 0], weights[2, 1], weights[2, 2], weights[2, 3]
            a3, b3, c3, d3 = weights[3, 0], weights[3, 1], weights[3, 2], weights[3, 3]
            for j in range(whole):
                v0, v1, v2, v3, v4 = values[j], values[j + 1], values[j + 2], values[j + 3], values[j + 4]
                target[4 * j] = a0 * v0 + b0 * v1 + c0 * v2 + d0 * v3
                target[4 * j + 1] = a1 * v0 + b1 * v1 + c1 * v2 + d1 * v3
                target[4 * j + 2] = a2 * v1 + b2 * v2 + c2 * v3 + d2 * v4
                target[4 * j + 3] = a3 * v1 + b3 * v2 + c3 * v3 + d3 * v4
        else:
            for p in range(cell):
                a, b, c, d = weights[p, 0], weights[p, 1], weights[p, 2], weights[p, 3]
                shift = before[p]
                for j in range(whole):
                    k = j + shift
                    target[j * cell + p] = a * values[k] + b * values[k + 1] + c * values[k + 2] + d * values[k + 3]
        for column in range(whole * cell, n):
            p = column - whole * cell
            k = whole + before[p]
            target[column] = (
                weights[p, 0] * values[k]
                + weights[p, 1] * values[k + 1]
                + weights[p, 2] * values[k + 2]
                + weights[p, 3] * values[k + 3]
            )
    for channel in range(channels):
        _continued(out[channel])


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _row_between(lines: np.ndarray, position: float, begin: int, out: np.ndarray) -> None:
    """Part of an image row of a field of widened node lines (2 + node row + 2, column), at a position given in nodes.

    The part is as long as `out` and begins at column `begin`.
    """
    first, a, b, c, d = _cubic(position, lines.shape[0] - 4)
    end = begin + out.size
    p0, p1, p2, p3 = (
        lines[first, begin:end], lines[first + 1, begin:end], lines[first + 2, begin:end], lines[first + 3, begin:end],
    )  # fmt: skip
    for k in range(out.size):
        out[k] = a * p0[k] + b * p1[k] + c * p2[k] + d * p3[k]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def heightened(lines: np.ndarray, positions: np.ndarray, out: np.ndarray) -> None:
    """Widened node lines (channel, 2 + node row + 2, n) at row positions given in nodes: out (channel, m, n)."""
    channels = lines.shape[0]
    rows = positions.size
    for flat in prange(channels * rows):
        channel, r = flat // rows, flat % rows
        _row_between(lines[channel], positions[r], 0, out[channel, r])


@njit(nogil=True, error_model="numpy")
def _add_up(line: np.ndarray, cell: int, out: np.ndarray) -> None:
    """Sums over the cells of a line, the last of which may be cut. Strides known beforehand are what is vectorised."""
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
def _quintic(
    c0: np.ndarray,
    c1: np.ndarray,
    c2: np.ndarray,
    c3: np.ndarray,
    c4: np.ndarray,
    c5: np.ndarray,
    along_x: np.ndarray,
    along_y: np.ndarray,
    weights: np.ndarray,
    keys: np.ndarray,
    key: int,
    out: np.ndarray,
) -> None:
    """Interpolated values of those pixels of a block whose integer displacement is `key`: contiguous loads, no gathers.

    `along_x` and `along_y` are distances from the middle of the six pixels; see `interpolation.WEIGHTS`.
    """
    p0, p1, p2, p3, p4, p5 = weights[0, 0], weights[0, 1], weights[0, 2], weights[0, 3], weights[0, 4], weights[0, 5]
    q0, q1, q2, q3, q4, q5 = weights[1, 0], weights[1, 1], weights[1, 2], weights[1, 3], weights[1, 4], weights[1, 5]
    r0, r1, r2, r3, r4, r5 = weights[2, 0], weights[2, 1], weights[2, 2], weights[2, 3], weights[2, 4], weights[2, 5]
    for i in range(out.size):
        x = along_x[i]
        y = along_y[i]
        x2 = x * x
        y2 = y * y
        even0, odd0 = p0 + x2 * (p2 + x2 * p4), x * (p1 + x2 * (p3 + x2 * p5))
        even1, odd1 = q0 + x2 * (q2 + x2 * q4), x * (q1 + x2 * (q3 + x2 * q5))
        even2, odd2 = r0 + x2 * (r2 + x2 * r4), x * (r1 + x2 * (r3 + x2 * r5))
        a0, a5 = even0 + odd0, even0 - odd0
        a1, a4 = even1 + odd1, even1 - odd1
        a2, a3 = even2 + odd2, even2 - odd2
        even0, odd0 = p0 + y2 * (p2 + y2 * p4), y * (p1 + y2 * (p3 + y2 * p5))
        even1, odd1 = q0 + y2 * (q2 + y2 * q4), y * (q1 + y2 * (q3 + y2 * q5))
        even2, odd2 = r0 + y2 * (r2 + y2 * r4), y * (r1 + y2 * (r3 + y2 * r5))
        b0, b5 = even0 + odd0, even0 - odd0
        b1, b4 = even1 + odd1, even1 - odd1
        b2, b3 = even2 + odd2, even2 - odd2
        s = b0 * (a0 * c0[i] + a1 * c0[i + 1] + a2 * c0[i + 2] + a3 * c0[i + 3] + a4 * c0[i + 4] + a5 * c0[i + 5])
        s += b1 * (a0 * c1[i] + a1 * c1[i + 1] + a2 * c1[i + 2] + a3 * c1[i + 3] + a4 * c1[i + 4] + a5 * c1[i + 5])
        s += b2 * (a0 * c2[i] + a1 * c2[i + 1] + a2 * c2[i + 2] + a3 * c2[i + 3] + a4 * c2[i + 4] + a5 * c2[i + 5])
        s += b3 * (a0 * c3[i] + a1 * c3[i + 1] + a2 * c3[i + 2] + a3 * c3[i + 3] + a4 * c3[i + 4] + a5 * c3[i + 5])
        s += b4 * (a0 * c4[i] + a1 * c4[i + 1] + a2 * c4[i + 2] + a3 * c4[i + 3] + a4 * c4[i + 4] + a5 * c4[i + 5])
        s += b5 * (a0 * c5[i] + a1 * c5[i + 1] + a2 * c5[i + 2] + a3 * c5[i + 3] + a4 * c5[i + 4] + a5 * c5[i + 5])
        if keys[i] == key:
            out[i] = s


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _interpolated(
    coefficients: np.ndarray,
    weights: np.ndarray,
    row: int,
    column: int,
    along_x: np.ndarray,
    along_y: np.ndarray,
    keys: np.ndarray,
    out: np.ndarray,
) -> None:
    """Interpolated values of a block of whole groups of pixels that begins at (row, column).

    `keys` hold the integer displacement of each pixel; pixels between which it does not change are done together.
    """
    other = 0
    for c in range(keys.size):
        other += keys[c] != keys[0]
    done = 0
    while done < keys.size:
        key = keys[done]
        begin = done - done % GROUP
        if other == 0:
            done = keys.size
        while done < keys.size and keys[done] == key:
            done += 1
        end = min(done + (GROUP - 1) - (done - 1 + GROUP) % GROUP, keys.size)
        top = row + (key >> 15) - 16384 + BORDER - 2
        left = column + begin + (key & 32767) - 16384 + BORDER - 2
        right = left + end - begin + 5
        _quintic(
            coefficients[top, left:right],
            coefficients[top + 1, left:right],
            coefficients[top + 2, left:right],
            coefficients[top + 3, left:right],
            coefficients[top + 4, left:right],
            coefficients[top + 5, left:right],
            along_x[begin:end],
            along_y[begin:end],
            weights,
            keys[begin:end],
            key,
            out[begin:end],
        )


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _residual(
    values: np.ndarray,
    coefficients: np.ndarray,
    weights: np.ndarray,
    lines: np.ndarray,
    cell: int,
    r: int,
    begin: int,
    scratch: np.ndarray,
    keys: np.ndarray,
    out: np.ndarray,
) -> None:
    """e(p) = f(p) - gain(p) g(p + d(p)) - offset(p) in row r from column `begin` on, as many pixels as `out` has.

    `lines` (4, 2 + node row + 2, column) holds d_x, d_y, gain and offset widened to the columns of the image; g is
    interpolated with `coefficients` and `weights`. A pixel that any of its 36 coefficients does not cover is NaN.
    `scratch` (7, at least GROUP more than `out`) and `keys` hold what passes between the loops.
    """
    rows, columns = values.shape
    size = out.size
    whole = -(-size // GROUP) * GROUP
    position = (r - 0.5 * (cell - 1)) / cell
    for channel in range(4):
        _row_between(lines[channel], position, begin, scratch[channel, :size])
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
    _interpolated(coefficients, weights, r, begin, along_x, along_y, key, grey)
    source = values[r, begin : begin + size]
    for c in range(size):
        out[c] = source[c] - gain[c] * grey[c] - offset[c]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy", fastmath={"contract"})
def residual_means(
    values: np.ndarray,
    coefficients: np.ndarray,
    weights: np.ndarray,
    lines: np.ndarray,
    cell: int,
    every: int,
    out: np.ndarray,
) -> None:
    """Mean of abs(e), see `_residual`, in each cell of every `every`-th node row; NaN where nothing is seen."""
    rows, columns = values.shape
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
                _residual(values, coefficients, weights, lines, cell, r, begin, scratch, keys, e)
                for c in range(size):
                    good = e[c] == e[c]
                    total[c] += abs(e[c]) if good else f4(0)
                    count[c] += f4(1) if good else f4(0)
            means = out[line, begin // cell : begin // cell + -(-size // cell)]
            _add_up(total[:size], cell, means)
            _add_up(count[:size], cell, numbers[: means.size])
            for k in range(means.size):
                means[k] = means[k] / numbers[k] if numbers[k] > f4(0) else f4(np.nan)


# Channels of the sums of each cell, the last of which is the number of pixels that could be compared.
GXX, GXY, GYY, W, WF, WFF, WE, WEF, WEE, GXE, GYE, SEEN = range(12)
CHANNELS = 12


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _add_products(
    w: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, sum_ab: np.ndarray, sum_ac: np.ndarray
) -> None:
    """Add w a b and w a c."""
    for k in range(w.size):
        wa = w[k] * a[k]
        sum_ab[k] += wa * b[k]
        sum_ac[k] += wa * c[k]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy", fastmath={"contract"})
def summed(
    values: np.ndarray,
    along_x: np.ndarray,
    along_y: np.ndarray,
    coefficients: np.ndarray,
    weights: np.ndarray,
    lines: np.ndarray,
    cell: int,
    limit: float,
    lowest: float,
    highest: float,
    out: np.ndarray,
) -> None:
    """Weighted sums of f, its gradient and the residual e over each cell, out (CHANNELS, node row, node column).

    See `_residual` for e. Weights are one up to abs(e) = limit, fall as Tukey's biweight and are zero from twice the
    limit on: noise keeps its full weight, glare and decorrelated pixels have none. Nor have pixels at which g would
    have to be below `lowest` or above `highest`: one-sided limits of the deformed image, which pull the others.
    """
    rows, columns = values.shape
    inverse = f4(1.0 / limit)
    low, high = f4(lowest), f4(highest)
    block = BLOCK // cell * cell
    for node in prange(out.shape[1]):
        sums = np.empty((CHANNELS, block), f4)
        scratch, keys = np.zeros((7, block + GROUP), f4), np.empty(block + GROUP, np.int32)
        residual, kept, clean_f, clean_e = (
            np.empty(block, f4),
            np.empty(block, f4),
            np.empty(block, f4),
            np.empty(block, f4),
        )
        for begin in range(0, columns, block):
            size = min(block, columns - begin)
            end = begin + size
            sums[:] = f4(0)
            e, weight, grey, rest = residual[:size], kept[:size], clean_f[:size], clean_e[:size]
            w, wf, we, seen = sums[W, :size], sums[WF, :size], sums[WE, :size], sums[SEEN, :size]
            for r in range(node * cell, min(node * cell + cell, rows)):
                _residual(values, coefficients, weights, lines, cell, r, begin, scratch, keys, e)
                f, gx, gy = values[r, begin:end], along_x[r, begin:end], along_y[r, begin:end]
                gain, offset = scratch[2, :size], scratch[3, :size]
                for c in range(size):
                    good = e[c] == e[c]
                    rest[c] = e[c] if good else f4(0)
                    grey[c] = f[c] if good else f4(0)
                for c in range(size):
                    over = min(max(abs(rest[c]) * inverse - f4(1), f4(0)), f4(1))
                    share = f4(1) - over * over
                    weight[c] = share * share if e[c] == e[c] else f4(0)
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
                _add_up(
                    sums[channel, :size], cell, out[channel, node, begin // cell : begin // cell + -(-size // cell)]
                )


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def gradient_sums(along_x: np.ndarray, along_y: np.ndarray, cell: int, out: np.ndarray) -> None:
    """Sums of the products of the gradient over each cell, out (GYY + 1, node row, node column)."""
    rows, columns = along_x.shape
    for node in prange(out.shape[1]):
        sums, one = np.zeros((GYY + 1, columns), f4), np.ones(columns, f4)
        unused = np.empty(columns, f4)
        for r in range(node * cell, min(node * cell + cell, rows)):
            _add_products(one, along_x[r], along_x[r], along_y[r], sums[GXX], sums[GXY])
            _add_products(one, along_y[r], along_y[r], along_x[r], sums[GYY], unused)
        for channel in range(GYY + 1):
            _add_up(sums[channel], cell, out[channel, node])


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
            _row_between(lines[channel], positions[r], 0, fields[channel, r])
        good, nodes, pixels = valid[r], valid_nodes[node_rows[r]], measured[r]
        for c in range(good.size):
            good[c] = nodes[node_columns[c]] and pixels[c] == pixels[c]
        for channel in range(fields.shape[0]):
            field = fields[channel, r]
            for c in range(good.size):
                field[c] = field[c] if good[c] else f4(np.nan)
