"""The interpolation of grey levels: a kernel of six pixels whose error is smallest where textures have their contrast.

The kernel is made of the quintic B-spline b and its derivatives, phi = b + 2 b'' / K^2 + b'''' / K^4. Its spectrum
sinc^6(k / 2) (1 - k^2 / K^2)^2 keeps the B-spline's order of approximation and has a zero at K: a frequency k appears
falsely at k - 2 pi, and with K = 5 rad/px what speckles show around k = 1.3 rad/px does not appear at all. The error of
interpolation is what pulls displacements without noise; it falls by 9 (spots of radius 1.4 px), 40 (1.2) and 5.5 (1.0).

M. Unser, A. Aldroubi, M. Eden, "B-spline signal processing", IEEE Trans. Signal Processing 41 (1993), for splines with
a prefilter; T. Blu, P. Thevenaz, M. Unser, "MOMS: maximal-order interpolation of minimal support", IEEE Trans. Image
Processing 10 (2001), for kernels made of a B-spline and its derivatives.
"""

from __future__ import annotations

from math import comb

import numpy as np

f4 = np.float32

ZERO = 5.0  # K [rad/px]
REACH = 12  # taps of the prefilter on either side
BAND = 2.4  # [rad/px] up to which it is exact to 5e-5


def _pieces() -> np.ndarray:
    """Kernel weights of the six pixels around a point as polynomials (6, power) of s, its distance from their middle.

    The B-spline of degree 5 is the sum of (-1)^k C(6, k) (x + 3 - k)_+^5 / 120.
    """
    out = np.zeros((6, 6))
    for pixel in range(6):
        for k in range(6 - pixel):
            x = np.polynomial.Polynomial([5.5 - pixel - k, 1.0])
            piece = x**5 / 120 + 2 / ZERO**2 * x**3 / 6 + x / ZERO**4
            out[pixel, : piece.coef.size] += (-1) ** k * comb(6, k) * piece.coef
    return out


PIECES = _pieces()
# Of the first three pixels; the others mirror them: even powers are equal, odd ones change their sign.
WEIGHTS = PIECES[:3].astype(f4)


def weights(t: np.ndarray) -> np.ndarray:
    """Weights (..., 6) of the pixels -2 ... 3 of a point at t, 0 <= t <= 1."""
    return ((np.asarray(t, dtype=float) - 0.5)[..., None, None] ** np.arange(6) * PIECES).sum(axis=-1)


def _inverse() -> np.ndarray:
    """Taps of the prefilter, the inverse of the sampled kernel, from the centre on.

    The exact inverse falls by .54 per pixel only. What is cut off is made up for in the least-squares sense where
    textures have their contrast; a symmetric filter moves nothing, and errs in amplitude by 1 % beyond BAND.
    """
    waves = np.cos(np.outer(np.linspace(0, np.pi, 1001), np.arange(REACH + 1)))
    waves[:, 1:] *= 2
    sampled = waves[:, :3] @ weights(np.array(0.0))[2:5]
    importance = np.where(np.linspace(0, np.pi, 1001) < BAND, 1.0, 0.01)
    importance[0] = 1e3  # a uniform grey stays what it is
    taps = np.linalg.lstsq(waves * (sampled * importance)[:, None], importance, rcond=None)[0]
    return np.asarray(taps, dtype=f4)


INVERSE = _inverse()


def noise_kept(positions: int = 64) -> np.ndarray:
    """Variance of white noise of unit variance after interpolation along one axis at k / positions, k = 0...positions.

    Interpolation averages noise between pixels; what it averages away lies at frequencies without texture.
    """
    inverse = np.concatenate([INVERSE[:0:-1], INVERSE]).astype(float)
    return np.array([np.sum(np.convolve(row, inverse) ** 2) for row in weights(np.linspace(0, 1, positions + 1))])
