"""Compiled loops of the interpolation of grey levels: spline coefficients of an image, and its values between pixels.

The kernel is that of `fringedic.frames.interpolation`.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

f4 = np.float32

# [px], NaN border of the spline coefficients: a group of 16 pixels that are interpolated together may reach into it.
BORDER = 24
# Pixels that are interpolated together.
GROUP = 16


@njit(nogil=True, error_model="numpy")
def _mirror(index: int, size: int) -> int:
    """Return the index inside a line of pixels that is mirrored repeatedly at its first and last one."""
    index = abs(index) % (2 * size - 2)
    return index if index < size else 2 * size - 2 - index


@njit(nogil=True, error_model="numpy")
def _scale(factor: np.float32, line: np.ndarray, out: np.ndarray) -> None:
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
    """Add three taps of a symmetric filter, each times the sum of the two lines at its distance."""
    p, q, s = taps[0], taps[1], taps[2]
    for k in range(out.size):
        out[k] += p * (a[k] + b[k]) + q * (c[k] + d[k]) + s * (e[k] + f[k])


@njit(cache=True, nogil=True, parallel=True, error_model="numpy", fastmath={"contract"})
def fit_spline(image: np.ndarray, taps: np.ndarray, out: np.ndarray) -> None:
    """Compute the coefficients of the spline through the pixels of an image without NaN, mirrored at its edges.

    `taps` is the (symmetric, truncated) inverse of the sampled kernel from its centre on. `out` has a border of BORDER
    pixels on every side, which is not changed.
    """
    rows, columns = image.shape
    reach = taps.size - 1
    for r in prange(rows):
        line = np.empty(columns + 2 * reach, f4)
        body = line[reach : reach + columns]
        _scale(taps[0], image[r], body)
        for k in range(1, reach + 1, 3):
            a, b, c = k, k + 1, k + 2
            _add_pairs(
                taps[k : k + 3],
                image[_mirror(r - a, rows)], image[_mirror(r + a, rows)],
                image[_mirror(r - b, rows)], image[_mirror(r + b, rows)],
                image[_mirror(r - c, rows)], image[_mirror(r + c, rows)],
                body,
            )  # fmt: skip
        for k in range(1, reach + 1):
            line[reach - k] = line[reach + k]
            line[reach + columns - 1 + k] = line[reach + columns - 1 - k]
        target = out[r + BORDER, BORDER : BORDER + columns]
        _scale(taps[0], body, target)
        for k in range(1, reach + 1, 3):
            m, n = reach - k, reach + k
            _add_pairs(
                taps[k : k + 3],
                line[m : m + columns], line[n : n + columns],
                line[m - 1 : m - 1 + columns], line[n + 1 : n + 1 + columns],
                line[m - 2 : m - 2 + columns], line[n + 2 : n + 2 + columns],
                target,
            )  # fmt: skip


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _interpolate_group(
    coefficients: np.ndarray,
    weights: np.ndarray,
    corner: tuple[int, int],
    along_x: np.ndarray,
    along_y: np.ndarray,
    keys: np.ndarray,
    key: int,
    out: np.ndarray,
) -> None:
    """Interpolate those pixels of a block whose integer displacement is `key`, with contiguous loads and no gathers.

    `corner` is the place of the first of the 6 x 6 coefficients of the first pixel. `along_x` and `along_y` are
    distances from the middle of the six pixels, see `interpolation.WEIGHTS`.
    """
    top, left = corner
    right = left + out.size + 5
    c0, c1, c2 = coefficients[top, left:right], coefficients[top + 1, left:right], coefficients[top + 2, left:right]
    c3, c4, c5 = coefficients[top + 3, left:right], coefficients[top + 4, left:right], coefficients[top + 5, left:right]
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
def interpolate_block(
    coefficients: np.ndarray,
    weights: np.ndarray,
    row: int,
    column: int,
    along_x: np.ndarray,
    along_y: np.ndarray,
    keys: np.ndarray,
    out: np.ndarray,
) -> None:
    """Interpolate a block of whole groups of pixels that begins at (row, column).

    `keys` contains the integer displacement of each pixel; neighbours with the same one are processed together.
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
        _interpolate_group(
            coefficients,
            weights,
            (top, left),
            along_x[begin:end],
            along_y[begin:end],
            keys[begin:end],
            key,
            out[begin:end],
        )
