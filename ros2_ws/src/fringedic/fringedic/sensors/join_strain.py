"""Strain of a joined surface from one neighbourhood on it, whichever sensors its points come from.

Least-squares planes over windows of the map give the tangent vectors A_i of the surface before and the slopes of the
displacement, and with them the Green-Lagrange strain, as for one sensor. The errors are those of each sensor at each
point, weighted by its share in the mean, with the correlation of neighbouring errors of one sensor.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fringedic.sensors.windows import window_slopes
from fringedic.surface.noise_correlation import displacement_gains, height_gains


def strain_maps(
    coordinates: tuple[np.ndarray, np.ndarray],
    points: np.ndarray,
    motion: np.ndarray,
    sources: Sequence[np.ndarray],
    shares: Sequence[tuple[np.ndarray, np.ndarray]],
    half: int,
    *,
    closed: bool,
    filters: tuple[float, int, str, int],
) -> dict[str, np.ndarray]:
    """Return local displacement, strain and its standard deviations at the points of a map.

    Parameters
    ----------
    coordinates
        a and b (row, column) of the map [m].
    points, motion
        Positions before and displacement (3, row, column) [m]; NaN where not measured.
    sources
        Of each sensor: its independent errors in the joined displacement (4, 3, row, column) [m].
    shares
        Of each sensor: its share (3, 3, row, column) in the joined displacement, and the covariance of the errors that
        its points have in common [m^2]: where the share changes, they change, too.
    half
        Half width of the window [points].
    closed
        Whether the last column is followed by the first one.
    filters
        Filter of the height [px], window [px] and method of the displacement, distance of points [px].

    Returns
    -------
    dict
        ``u_t``, ``v_t``, ``w_n`` [m], ``e_11``, ``e_22``, ``e_12`` and ``sigma_e_11``, ``sigma_e_22``, ``sigma_e_12``;
        the first tangent is along a, the second one across it.
    """
    half = max(1, half)
    known = np.isfinite(points).all(axis=0) & np.isfinite(motion).all(axis=0)
    fitted = window_slopes(*coordinates, np.concatenate([points, motion]), known, half, closed)
    before, change = fitted.values[:3], fitted.values[3:]  # (3, 2, row, column)
    after = before + change
    metric = np.einsum("ki...,kj...->ij...", before, before)
    strain = 0.5 * (np.einsum("ki...,kj...->ij...", after, after) - metric)
    # t1 = p A1, t2 = q A1 + r A2
    p = 1.0 / np.sqrt(metric[0, 0])
    r = 1.0 / np.sqrt(metric[1, 1] - metric[0, 1] ** 2 / metric[0, 0])
    q = -r * metric[0, 1] / metric[0, 0]
    basis = np.stack([np.stack([p, np.zeros_like(p)]), np.stack([q, r])])
    first, second, mixed = _in_basis(basis, strain[0, 0], strain[1, 1], strain[0, 1])
    tangents = np.einsum("ij...,kj...->ik...", basis, before)
    normal = np.cross(tangents[0], tangents[1], axis=0)
    variance = np.zeros((3, *known.shape))
    for errors in sources:
        for index, gains in enumerate(_gains(filters, half)):
            along = np.einsum("ki...,k...->i...", before if index == 0 else after, np.nan_to_num(errors[index]))
            products = np.stack([along[0] ** 2, along[1] ** 2, along[0] * along[1]])
            slopes = window_slopes(*coordinates, products[:0], known, half, closed, products).variances
            slopes *= np.array([gains[0], gains[1], np.sqrt(gains[0] * gains[1])])[:, None, None]
            of_11, of_22, of_12 = (_in_basis(basis, *each) for each in _in_basis(basis, *slopes))
            variance[0] += of_11[0]
            variance[1] += of_22[1]
            variance[2] += 0.25 * (of_11[1] + 2.0 * of_12[2] + of_22[0])
    variance += _of_changing_shares(shares, coordinates, after, basis, known, half, closed)
    sigmas = np.sqrt(variance)
    return {
        "u_t": np.einsum("k...,k...->...", tangents[0], motion),
        "v_t": np.einsum("k...,k...->...", tangents[1], motion),
        "w_n": np.einsum("k...,k...->...", normal, motion),
        "e_11": first,
        "e_22": second,
        "e_12": mixed,
        **{name: np.where(np.isfinite(first), each, np.nan) for name, each in zip(_SIGMAS, sigmas, strict=True)},
    }


def _of_changing_shares(
    shares: Sequence[tuple[np.ndarray, np.ndarray]],
    coordinates: tuple[np.ndarray, np.ndarray],
    after: np.ndarray,
    basis: np.ndarray,
    known: np.ndarray,
    half: int,
    closed: bool,
) -> np.ndarray:
    """Return the variances of e_11, e_22, e_12 that the common errors cause where the shares of sensors change."""
    total = np.zeros((3, *known.shape))
    for share, covariance in shares:
        fields = np.nan_to_num(share.reshape(9, *known.shape))
        if np.ptp(fields[:, known], axis=1).max(initial=0.0) == 0.0:
            continue
        change = window_slopes(*coordinates, fields, known, half, closed).values.reshape(3, 3, 2, *known.shape)
        along = np.einsum("ki...,klj...->ijl...", after, change)
        mixed = 0.5 * (along[0, 1] + along[1, 0])
        by_error = np.stack(_in_basis(basis, along[0, 0], along[1, 1], mixed))  # (strain, error, row, column)
        total += np.nan_to_num(np.einsum("si...,ij...,sj...->s...", by_error, np.nan_to_num(covariance), by_error))
    return total


_SIGMAS = ("sigma_e_11", "sigma_e_22", "sigma_e_12")


def _gains(filters: tuple[float, int, str, int], half: int) -> list[np.ndarray]:
    """Return the gains of the variance of slopes by a and by b, for each source of errors."""
    z_filter, window, method, spacing = filters
    size, steps = (half, half), (spacing, spacing)
    in_plane = displacement_gains(window, method, size, steps)
    return [height_gains(z_filter, False, size, steps), height_gains(z_filter, True, size, steps), in_plane, in_plane]


def _in_basis(
    basis: np.ndarray, xx: np.ndarray, yy: np.ndarray, xy: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return 11, 22 and 12 of a symmetric tensor with covariant components in the basis t1 = p A1, t2 = q A1 + r A2."""
    p, q, r = basis[0, 0], basis[1, 0], basis[1, 1]
    return p * p * xx, q * q * xx + 2.0 * q * r * xy + r * r * yy, p * (q * xx + r * xy)
