"""Compiled kernels of phase stepping on a moving surface: alignment of a frame, fit of a pitch, fringe orders.

Loops are parallel over rows and nothing is summed across rows, so results do not depend on the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from fringedic.frames.interpolation_kernels import GROUP, interpolate_block
from fringedic.phase.demodulation_kernel import CONFIDENCE, find_angle

f4 = np.float32

CELL = 8
"""Side [px] of the cells whose pixels share the drift about which the model is linear."""


class CellTables(NamedTuple):
    """What the fit of a pitch needs in each cell, float32; the first two axes are cell row and cell column.

    Attributes
    ----------
    filters : (..., parameter, frame)
        Least-squares estimates are these times the grey levels: mean, cosine, sine, and for a free drift the rates of
        cosine and sine.
    covariance : (..., parameter, parameter)
        Of the estimates, for grey levels of variance 1 before their alignment.
    higher : (..., parameter, 4)
        Estimates of the terms t^2/2 cos, t^2/2 sin, t^3/6 cos and t^3/6 sin, which the linear model omits.
    """

    filters: np.ndarray
    covariance: np.ndarray
    higher: np.ndarray


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def align_frame(
    frame: np.ndarray,
    coefficients: np.ndarray,
    weights: np.ndarray,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    time: float,
    saturation: float,
    out: np.ndarray,
) -> None:
    """Interpolate a frame where the material points are at its time; NaN outside of it and where it saturates.

    Parameters
    ----------
    frame, coefficients
        Grey levels (row, column), and their spline coefficients with a border.
    weights
        `fringedic.frames.interpolation.WEIGHTS`.
    velocity, acceleration
        Of the material points, (2, row, column) float32: to the right and down, in pixels per unit of `time` and per
        its square. An acceleration of shape (2, 0, 0) is none.
    time
        Of the frame, 0 where the points are at the pixels.
    saturation
        Grey level from which a pixel counts as saturated.
    out
        Float32, shape (row, column).
    """
    rows, columns = frame.shape
    whole = -(-columns // GROUP) * GROUP
    t, half_square = f4(time), f4(0.5 * time * time)
    accelerated = acceleration.shape[1] > 0
    limit = f4(saturation)
    for r in prange(rows):
        along_x, along_y, grey = np.empty(whole, f4), np.empty(whole, f4), np.empty(whole, f4)
        keys = np.empty(whole, np.int32)
        row = np.int64(r)
        for c in range(columns):
            dx, dy = t * velocity[0, row, c], t * velocity[1, row, c]
            if accelerated:
                dx += half_square * acceleration[0, row, c]
                dy += half_square * acceleration[1, row, c]
            known = dx == dx and dy == dy
            x = min(max(f4(c) + (dx if known else f4(-2 * columns - 8)), f4(-4)), f4(columns + 3))
            y = min(max(f4(row) + (dy if known else f4(0)), f4(-4)), f4(rows + 3))
            fx, fy = np.floor(x), np.floor(y)
            along_x[c], along_y[c] = x - fx - f4(0.5), y - fy - f4(0.5)
            keys[c] = ((np.int32(fy) - np.int32(row) + np.int32(16384)) << 15) + (
                np.int32(fx) - np.int32(c) + np.int32(16384)
            )
        for c in range(columns, whole):
            along_x[c], along_y[c], keys[c] = along_x[columns - 1], along_y[columns - 1], keys[columns - 1]
        interpolate_block(coefficients, weights, row, 0, along_x, along_y, keys, grey)  # type: ignore[arg-type]
        for c in range(columns):
            value = grey[c]
            if value == value:
                i = min(max(row + (keys[c] >> 15) - 16384, 0), rows - 2)
                j = min(max(c + (keys[c] & 32767) - 16384, 0), columns - 2)
                brightest = max(max(frame[i, j], frame[i, j + 1]), max(frame[i + 1, j], frame[i + 1, j + 1]))
                value = f4(np.nan) if brightest >= limit else value
            out[row, c] = value


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _apply(filters: np.ndarray, frames: np.ndarray, row: np.int64, first: int, out: np.ndarray) -> None:
    """Multiply the grey levels of the pixels of a cell in one row by the filters, out (parameter, pixel)."""
    size = out.shape[1]
    for p in range(filters.shape[0]):
        for c in range(size):
            out[p, c] = f4(0)
        for k in range(frames.shape[0]):
            weight = filters[p, k]
            for c in range(size):
                out[p, c] += weight * frames[k, row, first + c]


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _hold_modulation(estimate: np.ndarray, covariance: np.ndarray, factor: np.ndarray) -> None:
    """Change the five estimates of each pixel so that the modulation has no rate, by their covariance."""
    cosine, sine = estimate[1], estimate[2]
    a, b, c = covariance[3, 3], covariance[3, 4], covariance[4, 4]
    for k in range(factor.size):
        across = cosine[k] * estimate[3, k] + sine[k] * estimate[4, k]
        variance = cosine[k] * cosine[k] * a + f4(2) * cosine[k] * sine[k] * b + sine[k] * sine[k] * c
        factor[k] = across / max(variance, f4(1e-30))
    for p in (0, 3, 4):  # cosine and sine are changed last: the others need them
        one, other = covariance[p, 3], covariance[p, 4]
        changed = estimate[p]
        for k in range(factor.size):
            changed[k] -= factor[k] * (one * cosine[k] + other * sine[k])
    a, b = covariance[1, 3], covariance[1, 4]
    c, d = covariance[2, 3], covariance[2, 4]
    for k in range(factor.size):
        old_cosine, old_sine = cosine[k], sine[k]
        cosine[k] = old_cosine - factor[k] * (a * old_cosine + b * old_sine)
        sine[k] = old_sine - factor[k] * (c * old_cosine + d * old_sine)


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _add_higher(sums: np.ndarray, estimate: np.ndarray, higher: np.ndarray, work: np.ndarray) -> None:
    """Set the estimates to the sums with the terms that the linear model omits, for the drift of the estimates."""
    cosine, sine = work[0], work[1]
    second, third = work[2], work[3]
    for k in range(cosine.size):
        cosine[k], sine[k] = estimate[1, k], estimate[2, k]
        square = max(cosine[k] * cosine[k] + sine[k] * sine[k], f4(1e-12))
        drift = (cosine[k] * estimate[4, k] - sine[k] * estimate[3, k]) / square
        second[k], third[k] = drift * drift, drift * drift * drift
    for p in range(5):
        a, b, c, d = higher[p, 0], higher[p, 1], higher[p, 2], higher[p, 3]
        source, target = sums[p], estimate[p]
        for k in range(cosine.size):
            target[k] = source[k] + second[k] * (cosine[k] * a + sine[k] * b) + third[k] * (cosine[k] * d - sine[k] * c)


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _propagate(estimate: np.ndarray, covariance: np.ndarray, out: np.ndarray) -> None:
    """Return mean, modulation, phase, drift and the variances of `fit_drifting` of each pixel, out (8, pixel)."""
    q11, q12, q22 = covariance[1, 1], covariance[1, 2], covariance[2, 2]
    q13, q14, q23, q24 = covariance[1, 3], covariance[1, 4], covariance[2, 3], covariance[2, 4]
    q33, q34, q44 = covariance[3, 3], covariance[3, 4], covariance[4, 4]
    q03, q04 = covariance[0, 3], covariance[0, 4]
    two = f4(2)
    for k in range(out.shape[1]):
        cosine, sine = estimate[1, k], estimate[2, k]
        square = max(cosine * cosine + sine * sine, f4(1e-12))
        modulation = np.sqrt(square)
        e0, e1 = cosine / modulation, sine / modulation
        along = max(e0 * e0 * q33 + two * e0 * e1 * q34 + e1 * e1 * q44, f4(1e-30))
        across = e1 * e1 * q33 - two * e0 * e1 * q34 + e0 * e0 * q44
        mixed = e0 * e1 * (q44 - q33) + (e0 * e0 - e1 * e1) * q34
        phase = e1 * e1 * q11 - two * e0 * e1 * q12 + e0 * e0 * q22
        to_along = e0 * (e0 * q23 - e1 * q13) + e1 * (e0 * q24 - e1 * q14)
        to_across = e0 * (e0 * q24 - e1 * q14) - e1 * (e0 * q23 - e1 * q13)
        out[0, k] = estimate[0, k]
        out[1, k] = modulation
        out[2, k] = find_angle(sine, cosine)
        out[3, k] = (cosine * estimate[4, k] - sine * estimate[3, k]) / square
        out[4, k] = phase - to_along * to_along / along
        out[5, k] = across - mixed * mixed / along
        out[6, k] = to_across - to_along * mixed / along
        mean = e0 * q04 - e1 * q03 - (e0 * q03 + e1 * q04) * mixed / along
        out[7, k] = mean * modulation / max(out[5, k], f4(1e-30))


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def fit_drifting(frames: np.ndarray, tables: CellTables, out: np.ndarray) -> None:
    """Fit mean, modulation, phase and its drift to the aligned frames of one pitch.

    The modulation is constant. About the drift of the cell the model is linear; terms up to the third power of the
    rest of the drift are corrected.

    Parameters
    ----------
    frames
        Aligned grey levels, float32, C-contiguous, shape (frame, row, column).
    tables
        Of this pitch, with five parameters.
    out
        Float32, shape (8, row, column): mean, modulation, phase at time 0, drift beyond that of the cell, for grey
        levels of variance 1 the variances of phase and drift and their covariance times the modulation squared, and the
        change of the mean for a change of the drift.
    """
    _, rows, columns = frames.shape
    for block in prange(-(-rows // CELL)):
        i = np.int64(block)
        top = i * CELL
        high = min(CELL, rows - top)
        sums, estimate = np.zeros((5, CELL * CELL), f4), np.zeros((5, CELL * CELL), f4)
        work, fitted = np.zeros((4, CELL * CELL), f4), np.zeros((8, CELL * CELL), f4)
        for j in range(-(-columns // CELL)):
            first = j * CELL
            size = min(CELL, columns - first)
            covariance, higher = tables.covariance[i, j], tables.higher[i, j]
            for r in range(high):
                _apply(tables.filters[i, j], frames, top + r, first, sums[:, r * CELL : r * CELL + size])
            estimate[:] = sums
            _hold_modulation(estimate, covariance, work[0])
            for _ in range(2):
                _add_higher(sums, estimate, higher, work)
                _hold_modulation(estimate, covariance, work[0])
            _propagate(estimate, covariance, fitted)
            for p in range(8):
                for r in range(high):
                    for c in range(size):
                        out[p, top + r, first + c] = fitted[p, r * CELL + c]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def fit_known_drift(frames: np.ndarray, tables: CellTables, out: np.ndarray) -> None:
    """Fit mean, modulation and phase to the aligned frames of one pitch whose drift is that of the cell.

    Parameters
    ----------
    frames
        See `fit_drifting`.
    tables
        Of this pitch, with three parameters.
    out
        Float32, shape (4, row, column): mean, modulation, phase at the middle of these frames, and its variance for
        grey levels of variance 1, times the modulation squared.
    """
    _, rows, columns = frames.shape
    for r in prange(rows):
        row = np.int64(r)
        i = row // CELL
        sums = np.empty((3, CELL), f4)
        for j in range(-(-columns // CELL)):
            first = j * CELL
            size = min(CELL, columns - first)
            covariance = tables.covariance[i, j]
            _apply(tables.filters[i, j], frames, row, first, sums[:, :size])
            for c in range(size):
                cosine, sine = sums[1, c], sums[2, c]
                modulation = max(np.sqrt(cosine * cosine + sine * sine), f4(1e-6))
                e0, e1 = cosine / modulation, sine / modulation
                out[0, row, first + c] = sums[0, c]
                out[1, row, first + c] = modulation
                out[2, row, first + c] = find_angle(sine, cosine)
                out[3, row, first + c] = (
                    e1 * e1 * covariance[1, 1] - f4(2) * e0 * e1 * covariance[1, 2] + e0 * e0 * covariance[2, 2]
                )


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def find_orders(
    phases: np.ndarray, variances: np.ndarray, ratio: np.ndarray, good: np.ndarray, out: np.ndarray
) -> None:
    """Unwrap the phases of all pitches at one time, coarse to fine, and mark uncertain orders in `good`.

    Parameters
    ----------
    phases, variances
        Phase of each pitch [rad] and its variance, float32, shape (pitch, row, column). The coarsest one is absolute.
    ratio
        Next coarser pitch over this pitch, shape (pitch,).
    good
        Boolean, shape (row, column).
    out
        Phase at the finest pitch [rad], float32, shape (row, column).
    """
    pitches, rows, columns = phases.shape
    turn = f4(2 * np.pi)
    for r in prange(rows):
        for c in range(columns):
            angle = phases[0, r, c]
            for pitch in range(1, pitches):
                finer = f4(ratio[pitch])
                coarse, wrapped = angle * finer, phases[pitch, r, c]
                angle = wrapped + turn * np.floor((coarse - wrapped) / turn + f4(0.5))
                doubt = f4(CONFIDENCE) * np.sqrt(finer * finer * variances[pitch - 1, r, c] + variances[pitch, r, c])
                good[r, c] &= abs(coarse - angle) + doubt < f4(0.5) * turn
            out[r, c] = angle
