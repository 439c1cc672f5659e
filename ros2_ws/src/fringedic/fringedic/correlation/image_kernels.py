"""Compiled loops over the pixels of an image: preparation of reference and deformed image.

Images are float32 arrays (row, column) in which NaN means "not measured". Loops are parallel over rows and nothing is
summed across rows, so results do not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

f4 = np.float32


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def normalise(image: np.ndarray, offset: float, factor: float, out: np.ndarray) -> None:
    """Set out = (image - offset) * factor as float32, for any real pixel type; NaN stays NaN."""
    shift, gain = f4(offset), f4(factor)
    for r in prange(image.shape[0]):
        for c in range(image.shape[1]):
            out[r, c] = (f4(image[r, c]) - shift) * gain


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def sum_moments(image: np.ndarray, out: np.ndarray) -> None:
    """Sum number, value and square of the finite pixels of each row, out (row, 3)."""
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
def count_saturated(image: np.ndarray, lowest: int, highest: int, margin: int, out: np.ndarray) -> None:
    """Count the pixels of each row at the lowest value, within `margin` of it, and the same for the highest one.

    out (row, 4).
    """
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
def downsample(image: np.ndarray, out: np.ndarray) -> None:
    """Low-pass by the taps (1, 3, 3, 1)/8 and decimate by two: pixel (i, j) is at (2 i + 1/2, 2 j + 1/2).

    Pixels that are not measured or outside are omitted from the mean; NaN where less than half of the weight is left.
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
def differentiate(
    image: np.ndarray, taps: np.ndarray, values: np.ndarray, along_x: np.ndarray, along_y: np.ndarray
) -> None:
    """Differentiate by 7 antisymmetric taps; where a tap is not measured, `values` is NaN and the gradient zero."""
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
def _interpolate_gap(line: np.ndarray, k: int) -> np.float32:
    """Interpolate a pixel from three on either side (polynomial of degree 5); NaN where one is not measured."""
    if k < 3 or k >= line.size - 3:
        return f4(np.nan)
    near, middle, far = line[k - 1] + line[k + 1], line[k - 2] + line[k + 2], line[k - 3] + line[k + 3]
    return f4(f4(0.75) * near - f4(0.3) * middle + f4(0.05) * far)


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def fill_isolated(image: np.ndarray, out: np.ndarray) -> None:
    """Fill single missing pixels, and lines of them, by interpolation between their neighbours.

    A pixel is filled along its row or its column, or by the mean of both, where three pixels on either side are
    measured; others stay NaN.
    """
    for r in prange(image.shape[0]):
        for c in range(image.shape[1]):
            value = image[r, c]
            if value != value:
                along, across = _interpolate_gap(image[r], c), _interpolate_gap(image[:, c], r)
                value = along if across != across else across if along != along else f4(0.5) * (along + across)
            out[r, c] = value


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def average_cells(image: np.ndarray, cell: int, out: np.ndarray) -> None:
    """Average the measured pixels of each cell; NaN where there is none."""
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
