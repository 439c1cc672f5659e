"""Compiled loops of the coupling: both surfaces interpolated at the places of each material point, and their noise.

Functions that take whole arrays are inlined: passing their descriptions at every point takes as long as the arithmetic.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange


class SurfaceArrays(NamedTuple):
    """Arrays of a prepared shape, as the kernels take them; see `prepared.PreparedShape` for their meaning."""

    z: np.ndarray
    variance: np.ndarray
    right: np.ndarray
    down: np.ndarray
    rays: np.ndarray


class InPlane(NamedTuple):
    """In-plane displacement and its standard uncertainties [px] at the points of the result, (row, column) float32."""

    x: np.ndarray
    y: np.ndarray
    sigma_x: np.ndarray
    sigma_y: np.ndarray


@njit(cache=True, nogil=True)
def cubic(f: float) -> tuple[float, float, float, float]:
    """Return the weights of cubic convolution (Keys 1981, a = -1/2) at the fraction f."""
    return (
        f * (-0.5 + f * (1.0 - 0.5 * f)),
        1.0 + f * f * (-2.5 + 1.5 * f),
        f * (0.5 + f * (2.0 - 1.5 * f)),
        f * f * (-0.5 + 0.5 * f),
    )


@njit(cache=True, nogil=True)
def _cubic_slope(f: float) -> tuple[float, float, float, float]:
    """Return the derivatives of `cubic` by f."""
    return (
        -0.5 + f * (2.0 - 1.5 * f),
        f * (-5.0 + 4.5 * f),
        0.5 + f * (4.0 - 4.5 * f),
        f * (-1.0 + 1.5 * f),
    )


@njit(cache=True, nogil=True)
def _squares(weight: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    return weight[0] ** 2, weight[1] ** 2, weight[2] ** 2, weight[3] ** 2


@njit(cache=True, nogil=True)
def _dot(weight: tuple[float, float, float, float], a: float, b: float, c: float, d: float) -> float:
    return weight[0] * a + weight[1] * b + weight[2] * c + weight[3] * d


@njit(cache=True, nogil=True)
def _along_row(image: np.ndarray, i: int, j: int, weight: tuple[float, float, float, float]) -> float:
    return _dot(weight, image[i, j - 1], image[i, j], image[i, j + 1], image[i, j + 2])


@njit(cache=True, nogil=True)
def _is_smooth(right: np.ndarray, down: np.ndarray, i: int, j: int) -> bool:
    """Tell whether the 4 x 4 pixels around the cell of pixel (i, j) are measured and without a discontinuity."""
    rows, columns = right.shape
    whole = 1 <= i < rows - 2 and 1 <= j < columns - 2
    if whole:
        whole = right[i - 1, j] and right[i, j] and right[i + 1, j] and right[i + 2, j]
        whole = whole and down[i, j - 1] and down[i, j] and down[i, j + 1] and down[i, j + 2]
    return bool(whole)


@njit(cache=True, nogil=True, inline="always")
def _interpolate(
    z: np.ndarray,
    variance: np.ndarray,
    right: np.ndarray,
    down: np.ndarray,
    noise_gain: np.ndarray,
    s: float,
    r: float,
    slopes: bool,
) -> tuple[float, float, float, float]:
    """Return z, its variance and its derivatives by column and row at row s, column r.

    NaN beside holes and discontinuities. Exactly on a pixel the value is that of this pixel, and the derivatives, if
    `slopes` are requested, are NaN where its neighbours are not measured.
    """
    nan = np.nan
    rows, columns = z.shape
    if not (0.0 <= s <= rows - 1.0 and 0.0 <= r <= columns - 1.0):  # NaN fails as well
        return nan, nan, nan, nan
    i, j = int(s), int(r)
    on_pixel = s == i and r == j
    if on_pixel and not slopes:
        return z[i, j], variance[i, j], nan, nan
    if not _is_smooth(right, down, i, j):
        return (z[i, j], variance[i, j], nan, nan) if on_pixel else (nan, nan, nan, nan)
    f, g = r - j, s - i
    across, along = cubic(f), cubic(g)
    a, b = _along_row(z, i - 1, j, across), _along_row(z, i, j, across)
    c, d = _along_row(z, i + 1, j, across), _along_row(z, i + 2, j, across)
    value = _dot(along, a, b, c, d)
    by_row = _dot(_cubic_slope(g), a, b, c, d)
    slope = _cubic_slope(f)
    by_column = _dot(
        along,
        _along_row(z, i - 1, j, slope),
        _along_row(z, i, j, slope),
        _along_row(z, i + 1, j, slope),
        _along_row(z, i + 2, j, slope),
    )
    square = _squares(across)
    spread = _dot(
        _squares(along),
        _along_row(variance, i - 1, j, square),
        _along_row(variance, i, j, square),
        _along_row(variance, i + 1, j, square),
        _along_row(variance, i + 2, j, square),
    )
    fine = len(noise_gain) - 1
    gain = noise_gain[int(f * fine + 0.5)] * noise_gain[int(g * fine + 0.5)]
    return value, spread * gain, by_column, by_row


@njit(cache=True, nogil=True, inline="always")
def _ray(ray: np.ndarray, s: float, r: float) -> tuple[float, float, float]:
    """Return the slope of the line of sight at row s, column r, and its derivatives by column and row; bilinear."""
    rows, columns = ray.shape
    if not (0.0 <= s <= rows - 1.0 and 0.0 <= r <= columns - 1.0):
        return np.nan, np.nan, np.nan
    i, j = min(int(s), rows - 2), min(int(r), columns - 2)
    f, g = r - j, s - i
    a, b, c, d = float(ray[i, j]), float(ray[i, j + 1]), float(ray[i + 1, j]), float(ray[i + 1, j + 1])
    by_column = (1.0 - g) * (b - a) + g * (d - c)
    by_row = (1.0 - f) * (c - a) + f * (d - b)
    if s == int(s) and r == int(r):  # the neighbours of that pixel need not be measured
        return float(ray[int(s), int(r)]), by_column, by_row
    return (1.0 - g) * ((1.0 - f) * a + f * b) + g * ((1.0 - f) * c + f * d), by_column, by_row


@njit(cache=True, nogil=True, inline="always")
def _nearest(values: np.ndarray, s: float, r: float) -> float:
    rows, columns = values.shape
    if not (0.0 <= s <= rows - 1.0 and 0.0 <= r <= columns - 1.0):
        return np.nan
    return float(values[int(s + 0.5), int(r + 0.5)])


@njit(cache=True, nogil=True, parallel=True)
def couple_points(
    before: SurfaceArrays,
    after: SurfaceArrays,
    in_plane: InPlane,
    rows: np.ndarray,
    columns: np.ndarray,
    noise_gain: np.ndarray,
    h0: float,
    result: np.ndarray,
) -> None:
    """Fill `result` (field, row, column) in the order of `coupling.FIELDS`.

    `rows` and `columns` are indices in the shapes, `noise_gain` the factor of interpolated noise at fractions of a
    pixel, `h0` the height of the camera [m].
    """
    z, variance, right, down, rays = before
    z_after, variance_after, right_after, down_after, rays_after = after
    d_x, d_y, sigma_x, sigma_y = in_plane
    for i in prange(len(rows)):
        for j in range(len(columns)):
            s, r = rows[i], columns[j]
            height, spread, _, _ = _interpolate(z, variance, right, down, noise_gain, s, r, False)
            ray_x, ray_y = _ray(rays[0], s, r)[0], _ray(rays[1], s, r)[0]
            x, y = ray_x * (height - h0), ray_y * (height - h0)
            result[12, i, j] = math.sqrt(_nearest(variance, s, r))

            s, r = s + d_y[i, j], r + d_x[i, j]
            height_after, spread_after, z_r, z_s = _interpolate(
                z_after, variance_after, right_after, down_after, noise_gain, s, r, True
            )
            ray_x_after, ray_x_r, ray_x_s = _ray(rays_after[0], s, r)
            ray_y_after, ray_y_r, ray_y_s = _ray(rays_after[1], s, r)
            depth = height_after - h0
            # derivatives of x' = ray_x (z' - h0) by column and row of the deformed image
            x_r, x_s = ray_x_r * depth + ray_x_after * z_r, ray_x_s * depth + ray_x_after * z_s
            y_r, y_s = ray_y_r * depth + ray_y_after * z_r, ray_y_s * depth + ray_y_after * z_s
            d_r = sigma_x[i, j] * sigma_x[i, j]
            d_s = sigma_y[i, j] * sigma_y[i, j]

            result[0, i, j] = x
            result[1, i, j] = y
            result[2, i, j] = height
            result[3, i, j] = ray_x_after * depth - x
            result[4, i, j] = ray_y_after * depth - y
            result[5, i, j] = height_after - height
            xz, yz = ray_x * spread, ray_y * spread
            xz_after, yz_after = ray_x_after * spread_after, ray_y_after * spread_after
            result[6, i, j] = math.sqrt(x_r * x_r * d_r + x_s * x_s * d_s + ray_x * xz + ray_x_after * xz_after)
            result[7, i, j] = math.sqrt(y_r * y_r * d_r + y_s * y_s * d_s + ray_y * yz + ray_y_after * yz_after)
            result[8, i, j] = math.sqrt(z_r * z_r * d_r + z_s * z_s * d_s + spread + spread_after)
            result[9, i, j] = x_r * y_r * d_r + x_s * y_s * d_s + ray_y * xz + ray_y_after * xz_after
            result[10, i, j] = x_r * z_r * d_r + x_s * z_s * d_s + xz + xz_after
            result[11, i, j] = y_r * z_r * d_r + y_s * z_s * d_s + yz + yz_after
            result[13, i, j] = math.sqrt(_nearest(variance_after, s, r))
