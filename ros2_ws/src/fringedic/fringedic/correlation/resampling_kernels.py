"""Compiled loops that resample fields between nodes and pixels by cubic convolution (Catmull-Rom weights).

Node arrays (channel, node row, node column) contain fields at the centres of square cells of `cell` pixels: node (i, j)
is at pixel row i * cell + (cell - 1) / 2. Loops are parallel over rows, so results do not depend on the threads.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

f4 = np.float32

# A function without `fastmath` inherits it from the first caller that is compiled. It is stated wherever callers
# differ, so that results do not depend on the order of compilation.


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _weigh_cubic(position: float, count: int) -> tuple[int, np.float32, np.float32, np.float32, np.float32]:
    """Return the first of the four nodes around a position given in nodes, and their weights (Catmull and Rom).

    The index counts two extra nodes before the first one, which continue the field linearly (and two after the last).
    """
    before = min(max(int(np.floor(position)), -1), count - 1)
    t = f4(min(max(position - before, 0.0), 1.0))
    half = f4(0.5)
    a = half * t * (t * (f4(2) - t) - f4(1))
    b = half * (t * t * (f4(3) * t - f4(5)) + f4(2))
    c = half * t * (t * (f4(4) - f4(3) * t) + f4(1))
    return before + 1, a, b, c, f4(1) - a - b - c


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _continue_linearly(lines: np.ndarray) -> None:
    """Extrapolate linearly into the two outer entries at either end of axis 0."""
    last = lines.shape[0] - 1
    two = f4(2)
    for k in range(lines.shape[1]):
        lines[1, k] = two * lines[2, k] - lines[3, k]
        lines[0, k] = two * lines[1, k] - lines[2, k]
        lines[last - 1, k] = two * lines[last - 2, k] - lines[last - 3, k]
        lines[last, k] = two * lines[last - 1, k] - lines[last - 2, k]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def resample_columns(nodes: np.ndarray, positions: np.ndarray, out: np.ndarray) -> None:
    """Interpolate node lines at column positions given in nodes.

    nodes (channel, node row, node column) -> out (channel, 2 + node row + 2, position), with two extrapolated lines at
    either end.
    """
    channels, rows, columns = nodes.shape
    n = positions.size
    first = np.empty(n, np.int32)
    weights = np.empty((4, n), f4)
    for k in range(n):
        first[k], weights[0, k], weights[1, k], weights[2, k], weights[3, k] = _weigh_cubic(positions[k], columns)
    for r in prange(rows):
        line = np.empty((columns + 4, 1), f4)
        for channel in range(channels):
            line[2 : 2 + columns, 0] = nodes[channel, r]
            _continue_linearly(line)
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
        _continue_linearly(out[channel])


@njit(cache=True, nogil=True, parallel=True, error_model="numpy", fastmath={"contract"})
def upsample_nodes(nodes: np.ndarray, cell: int, out: np.ndarray) -> None:
    """Do as `resample_columns` for every column of the image, whose weights repeat from cell to cell."""
    channels, rows, columns = nodes.shape
    n = out.shape[2]
    weights = np.empty((cell, 4), f4)
    before = np.empty(cell, np.int64)
    for p in range(cell):
        first, weights[p, 0], weights[p, 1], weights[p, 2], weights[p, 3] = _weigh_cubic(
            (p - 0.5 * (cell - 1)) / cell + 2.0, columns + 4
        )
        before[p] = first - 2
    for flat in prange(channels * rows):
        channel, r = flat // rows, flat % rows
        line = np.empty((columns + 4, 1), f4)
        line[2 : 2 + columns, 0] = nodes[channel, r]
        _continue_linearly(line)
        values, target = line[:, 0].copy(), out[channel, r + 2]
        whole = n // cell
        if cell == 4:
            # Only strides known to the compiler are vectorised. A node is 1.5 pixels from either end of its cell.
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
        _continue_linearly(out[channel])


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def interpolate_row(lines: np.ndarray, position: float, begin: int, out: np.ndarray) -> None:
    """Interpolate between resampled node lines (2 + node row + 2, column) at a row position given in nodes.

    Computes the `out.size` columns from `begin` on.
    """
    first, a, b, c, d = _weigh_cubic(position, lines.shape[0] - 4)
    end = begin + out.size
    p0, p1, p2, p3 = (
        lines[first, begin:end], lines[first + 1, begin:end], lines[first + 2, begin:end], lines[first + 3, begin:end],
    )  # fmt: skip
    for k in range(out.size):
        out[k] = a * p0[k] + b * p1[k] + c * p2[k] + d * p3[k]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def resample_rows(lines: np.ndarray, positions: np.ndarray, out: np.ndarray) -> None:
    """Interpolate node lines (channel, 2 + node row + 2, n) at m row positions in nodes, out (channel, m, n)."""
    channels = lines.shape[0]
    rows = positions.size
    for flat in prange(channels * rows):
        channel, r = flat // rows, flat % rows
        interpolate_row(lines[channel], positions[r], 0, out[channel, r])


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def evaluate_points(
    lines: np.ndarray,
    positions: np.ndarray,
    valid_nodes: np.ndarray,
    node_rows: np.ndarray,
    node_columns: np.ndarray,
    measured: np.ndarray,
    fields: np.ndarray,
    valid: np.ndarray,
) -> None:
    """Interpolate node lines at row positions in nodes; NaN where the nearest node or the pixel is not valid."""
    for r in prange(positions.size):
        for channel in range(fields.shape[0]):
            interpolate_row(lines[channel], positions[r], 0, fields[channel, r])
        good, nodes, pixels = valid[r], valid_nodes[node_rows[r]], measured[r]
        for c in range(good.size):
            good[c] = nodes[node_columns[c]] and pixels[c] == pixels[c]
        for channel in range(fields.shape[0]):
            field = fields[channel, r]
            for c in range(good.size):
                field[c] = field[c] if good[c] else f4(np.nan)
