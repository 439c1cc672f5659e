"""Strain of a curved surface from planes: what the slopes of planes miss, by second derivatives.

A slope of a least-squares plane is the mean of the slope over the window, with weights whose second moment M is 3/5 of
that of the window along the slope and that of the window across it. A product of two mean slopes lacks their
covariance in the window. With the second derivatives P_ik of the position before and p_ik after, covariant for the
surface before (P_ik is the second fundamental form times the normal), the scalar products of the tangent vectors lack

    A_i . A_j:  M^kl P_ik . P_jl          a_i . a_j:  M^kl p_ik . p_jl

to second order in window over radius of curvature. The mean metric G of the surface before then is that of the plane
plus the first line, and the strain is related to lengths on the surface by the symmetric root of G. A rigid motion
turns all p_ik alike and gives no strain.

The mean is a tensor in the tangent plane of the window's plane. It is turned to the tangent plane of the point itself,
whose slopes follow from those of the plane, the distance of the point from the centre of the window's points and the
second derivatives; the third ones are those of a surface with a constant second fundamental form, such as a cylinder.

References: M. P. do Carmo (1976), Differential Geometry of Curves and Surfaces, Prentice-Hall, for both fundamental
forms and parallel transport.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringedic.surface.coarse_grid import coarse_half, fill_from_nearest, window_means
from fringedic.surface.planes import Planes

_ALONG = 0.6  # second moment of the weights of a slope over that of the window, along the slope
_MIXED = 0.8  # mean of that along and across
_FLATTEST = 1e-3  # determinant of the moments of points over the square of their sum; below, they are on one line


def second_derivatives(planes: Planes, step: int) -> np.ndarray:
    """Return second derivatives of the fitted fields by x and y at every `step` points.

    They are the slopes of the slopes over the same window. Together that is a window of twice the width, so that their
    noise adds little to that of the strain.

    Parameters
    ----------
    planes
        Of z, u, v, w.
    step
        Distance of the points that the result is computed at, in points.

    Returns
    -------
    ndarray
        float64 (15, row, column): xx, xy, yy of z, u, v, w, then those of z from the slopes of the unit normal, which
        is a linear function of x and y on spheres and cylinders even where they are steep. Where too few slopes are
        known, the nearest values; zero without any.
    """
    slopes = planes.slopes[:, :, ::step, ::step].astype(float)
    count, _, rows, columns = slopes.shape
    root = np.sqrt(1 + (slopes[0] ** 2).sum(axis=0))
    fields = np.concatenate([slopes.reshape(-1, rows, columns), slopes[0] / root])
    count += 1  # the normal
    x, y = planes.centres[:, ::step, ::step].astype(float)
    known = np.isfinite(fields).all(axis=0)
    if not known.any():
        return np.zeros((15, rows, columns))
    x, y = x - x[known].mean(), y - y[known].mean()
    half = coarse_half(planes.half, step)
    means = window_means(np.concatenate([[x, y, x * x, x * y, y * y], fields, x * fields, y * fields]), known, half)
    (x, y, xx, xy, yy), means = means[:5], means[5:]
    xx, xy, yy = xx - x * x, xy - x * y, yy - y * y
    f, xf, yf = means.reshape(3, 2 * count, rows, columns)
    xf, yf = xf - x * f, yf - y * f
    determinant = xx * yy - xy * xy
    determinant[determinant <= _FLATTEST * (xx + yy) ** 2] = np.nan
    by_x = ((yy * xf - xy * yf) / determinant).reshape(count, 2, rows, columns)
    by_y = ((xx * yf - xy * xf) / determinant).reshape(count, 2, rows, columns)
    for by in (by_x, by_y):  # from the slopes of the normal to those of the slope
        by[-1] = root * (by[-1] + (slopes[0] * by[-1]).sum(axis=0) * slopes[0])
    found = np.stack([by_x[:, 0], 0.5 * (by_x[:, 1] + by_y[:, 0]), by_y[:, 1]], axis=1)
    return fill_from_nearest(found.reshape(15, rows, columns))


@njit(cache=True, nogil=True, error_model="numpy")
def window_moments(white: np.ndarray, number: float, row: int, column: int) -> tuple[float, float, float]:
    """Return the second central moments xx, xy, yy of the points in the window of a plane [m^2]."""
    w_xx, w_yy, w_xy = float(white[0, row, column]), float(white[1, row, column]), float(white[2, row, column])
    scale = number * (w_xx * w_yy - w_xy * w_xy)
    return w_yy / scale, -w_xy / scale, w_xx / scale


@njit(cache=True, nogil=True, error_model="numpy")
def _contract(moments: tuple[float, float, float], a_x: float, a_y: float, b_x: float, b_y: float) -> float:
    """Return M^kl a_k b_l."""
    return moments[0] * a_x * b_x + moments[1] * (a_x * b_y + a_y * b_x) + moments[2] * a_y * b_y


@njit(cache=True, nogil=True, error_model="numpy")
def add_covariances(
    slopes: np.ndarray, second: np.ndarray, moments: tuple[float, float, float], missed: np.ndarray
) -> None:
    """Compute what the products of mean slopes lack at a point.

    Parameters
    ----------
    slopes : (4, 2)
        Of z, u, v, w by x and y.
    second : (15,)
        From `second_derivatives`; those of u, v, w become covariant.
    moments
        From `window_moments`.
    missed : (6,)
        Becomes xx, yy, xy of the strain, and xx, yy, xy of the metric before.
    """
    z_x, z_y = slopes[0, 0], slopes[0, 1]
    area = 1.0 + z_x * z_x + z_y * z_y
    root = math.sqrt(area)
    for field in range(1, 4):
        along = (z_x * slopes[field, 0] + z_y * slopes[field, 1]) / area
        for k in range(3):
            second[3 * field + k] -= along * second[k]
    for pair in range(3):  # xx, yy, xy
        first, other = (1 if pair == 1 else 0), (0 if pair == 0 else 1)
        weights = (
            moments[0] * (_ALONG if pair == 0 else 1.0 if pair == 1 else _MIXED),
            moments[1] * _MIXED,
            moments[2] * (_ALONG if pair == 1 else 1.0 if pair == 0 else _MIXED),
        )
        # along the normal, before and by the displacement
        n_1, n_2 = second[first] / root, second[first + 1] / root
        m_1, m_2 = second[other] / root, second[other + 1] / root
        w_1 = (second[9 + first] - z_x * second[3 + first] - z_y * second[6 + first]) / root
        w_2 = (second[10 + first] - z_x * second[4 + first] - z_y * second[7 + first]) / root
        v_1 = (second[9 + other] - z_x * second[3 + other] - z_y * second[6 + other]) / root
        v_2 = (second[10 + other] - z_x * second[4 + other] - z_y * second[7 + other]) / root
        change = _contract(weights, n_1, n_2, v_1, v_2) + _contract(weights, w_1, w_2, m_1, m_2)
        for field in range(3, 12, 3):
            change += _contract(
                weights,
                second[field + first],
                second[field + first + 1],
                second[field + other],
                second[field + other + 1],
            )
        missed[pair] = 0.5 * change
        missed[3 + pair] = _contract(weights, n_1, n_2, m_1, m_2)


@njit(cache=True, nogil=True, error_model="numpy")
def point_slopes(
    z_x: float,
    z_y: float,
    second: np.ndarray,
    moments: tuple[float, float, float],
    offset_x: float,
    offset_y: float,
) -> tuple[float, float]:
    """Return the slopes of the surface at a point, from those of the plane of its window.

    `offset_x` and `offset_y` lead from the point to the centre of the window's points.
    """
    z_xx, z_xy, z_yy = second[12], second[13], second[14]
    area = 1.0 + z_x * z_x + z_y * z_y
    s_x, s_y = z_x * z_xx + z_y * z_xy, z_x * z_xy + z_y * z_yy
    z_xxx, z_yyy = 3.0 * z_xx * s_x / area, 3.0 * z_yy * s_y / area
    z_xxy, z_xyy = (2.0 * z_xy * s_x + z_xx * s_y) / area, (2.0 * z_xy * s_y + z_yy * s_x) / area
    # the plane has the mean slope around its centre, and the centre lies at the offset
    xx, xy, yy = offset_x * offset_x, offset_x * offset_y, offset_y * offset_y
    m_xx, m_xy, m_yy = moments
    mean_x = (_ALONG * m_xx - xx) * z_xxx + 2.0 * (_MIXED * m_xy - xy) * z_xxy + (m_yy - yy) * z_xyy
    mean_y = (m_xx - xx) * z_xxy + 2.0 * (_MIXED * m_xy - xy) * z_xyy + (_ALONG * m_yy - yy) * z_yyy
    return (
        z_x - z_xx * offset_x - z_xy * offset_y - 0.5 * mean_x,
        z_y - z_xy * offset_x - z_yy * offset_y - 0.5 * mean_y,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def turn_of_basis(from_x: float, from_y: float, to_x: float, to_y: float) -> float:
    """Return the angle by which t1 of a tangent plane, transported to another one, is turned against t1 there [rad].

    Tangent planes are given by their slopes. t1 turns by -z_y dz_x / (|n| (1 + z_x^2)) with the length of the normal
    (-z_x, -z_y, 1); the slopes halfway make it correct to second order in the change.
    """
    z_x, z_y = 0.5 * (from_x + to_x), 0.5 * (from_y + to_y)
    squared = 1.0 + z_x * z_x
    return -z_y * (to_x - from_x) / (math.sqrt(squared + z_y * z_y) * squared)


@njit(cache=True, nogil=True, error_model="numpy")
def inverse_root(xx: float, yy: float, xy: float) -> tuple[float, float, float]:
    """Return xx, yy, xy of (1 + C)^(-1/2) for a small symmetric C, to second order: 1 - C/2 + 3 C^2/8."""
    mixed = 0.375 * xy * (xx + yy)
    return (
        1.0 - 0.5 * xx + 0.375 * (xx * xx + xy * xy),
        1.0 - 0.5 * yy + 0.375 * (yy * yy + xy * xy),
        mixed - 0.5 * xy,
    )
