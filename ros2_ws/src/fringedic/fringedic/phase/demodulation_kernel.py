"""Compiled kernel of phase stepping: demodulates and unwraps a stack row by row."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

CONFIDENCE = 5.0
"""Standard deviations between a measurement and the case in which it means nothing.

A normal error exceeds five of them once in 1.7 million: less than one pixel of an image. `test_demodulation` and
`test_fringe_order` count wrong orders against the target of 1e-5.
"""


class Shifts(NamedTuple):
    """The fringe frames of a stack by pitch, coarse to fine.

    Attributes
    ----------
    pitch_of
        Number of the pitch of each frame, shape (frame,).
    sine, cosine
        Of 2 pi k / q, float32, shape (frame,).
    frames
        Number of frames of each pitch, float32, shape (pitch,).
    ratio
        Next coarser pitch over this pitch, float32, shape (pitch,); 1 for the coarsest.
    factor
        By which the grey levels of each frame are multiplied, float32, shape (frame,).
    """

    pitch_of: np.ndarray
    sine: np.ndarray
    cosine: np.ndarray
    frames: np.ndarray
    ratio: np.ndarray
    factor: np.ndarray


class NoiseModel(NamedTuple):
    """Noise of a grey level.

    Attributes
    ----------
    read_variance
        Without light [grey level^2].
    shot
        Growth of the variance with the level [grey level].
    of_pixels
        Variance of each pixel, float32, shape (row, column), instead of both; shape (0, 0) for none.
    """

    read_variance: np.float32
    shot: np.float32
    of_pixels: np.ndarray


class Limits(NamedTuple):
    """Limits of a valid pixel [grey level]."""

    minimum_modulation: np.float32
    saturation: np.float32


class Maps(NamedTuple):
    """Results, shape (row, column): float32, and booleans for ``valid``."""

    phase: np.ndarray
    sigma: np.ndarray
    modulation: np.ndarray
    texture: np.ndarray
    valid: np.ndarray


@njit(cache=True, nogil=True)
def find_angle(sine: np.float32, cosine: np.float32) -> np.float32:
    """Return the arctangent of eq. 11 [rad], -pi to pi, to 2e-7.

    A polynomial in the square of the smaller over the larger argument (Chebyshev fit of arctan(x)/x), without branches:
    the compiler vectorises it, which the arctangent of the C library does not allow.
    """
    larger = max(abs(sine), abs(cosine))
    smaller = min(abs(sine), abs(cosine))
    ratio = smaller / max(larger, np.float32(1e-30))
    square = ratio * ratio
    value = np.float32(-0.0017437012)
    value = value * square + np.float32(0.010680719)
    value = value * square + np.float32(-0.030717509)
    value = value * square + np.float32(0.057463557)
    value = value * square + np.float32(-0.08372064)
    value = value * square + np.float32(0.109401986)
    value = value * square + np.float32(-0.14261574)
    value = value * square + np.float32(0.1999823)
    value = value * square + np.float32(-0.33333284)
    value = (value * square + np.float32(1)) * ratio
    value = np.float32(np.pi / 2) - value if abs(sine) > abs(cosine) else value
    value = np.float32(np.pi) - value if cosine < 0 else value
    return -value if sine < 0 else value


@njit(cache=True, nogil=True)
def _half_period(levels: np.ndarray, flipped: int) -> int:
    """Return the number of the half period that the bits of a Gray code encode, one of them inverted."""
    number = 0
    bit = 0
    for index in range(len(levels)):
        bit ^= int((levels[index] > 0) != (index == flipped))
        number = 2 * number + bit
    return number


@njit(cache=True, nogil=True)
def _order(half_period: int, bits: int, wrapped: np.float32) -> int:
    """Return the fringe order of a half period; correct also where that is one too low or too high at its edge."""
    quarter = np.float32(0.5 * np.pi)
    middle = 1 << (bits - 2)
    if wrapped > quarter:
        return ((half_period + 1) >> 1) - 1 - middle
    if wrapped < -quarter:
        return ((half_period + 1) >> 1) - middle
    return (half_period >> 1) - middle


@njit(cache=True, nogil=True)
def _sums(frames: np.ndarray, row: np.int64, shifts: Shifts) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the sine and cosine sums of each pitch, the mean and the brightest level of one row."""
    images, _, columns = frames.shape
    pitches = len(shifts.frames)
    sine_sum = np.zeros((pitches, columns), np.float32)
    cosine_sum = np.zeros((pitches, columns), np.float32)
    mean = np.zeros(columns, np.float32)
    brightest = np.zeros(columns, np.float32)
    for k in range(images):
        sines, cosines = sine_sum[shifts.pitch_of[k]], cosine_sum[shifts.pitch_of[k]]
        factor = shifts.factor[k]
        sine, cosine = factor * shifts.sine[k], factor * shifts.cosine[k]
        for column in range(columns):
            level = np.float32(frames[k, row, column])
            sines[column] += sine * level
            cosines[column] += cosine * level
            mean[column] += factor * level
            brightest[column] = max(brightest[column], level)
    per_image = np.float32(1) / np.float32(images)
    for column in range(columns):
        mean[column] *= per_image
    return sine_sum, cosine_sum, mean, brightest


@njit(cache=True, nogil=True)
def _deviation(mean: np.ndarray, row: np.int64, model: NoiseModel) -> np.ndarray:
    """Return the standard deviation of a grey level at each pixel of one row."""
    columns = len(mean)
    noise = np.empty(columns, np.float32)
    if model.of_pixels.shape[0] > 0:
        for column in range(columns):
            noise[column] = np.sqrt(model.of_pixels[row, column])
    else:
        for column in range(columns):
            noise[column] = np.sqrt(model.read_variance + model.shot * mean[column])
    return noise


@njit(cache=True, nogil=True)
def _unwrap(
    sine_sum: np.ndarray,
    cosine_sum: np.ndarray,
    noise: np.ndarray,
    shifts: Shifts,
    minimum_modulation: np.float32,
    good: np.ndarray,
    modulation: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the phase at the finest pitch of one row and its standard deviation; mark what is invalid in `good`."""
    pitches, columns = sine_sum.shape
    turn = np.float32(2 * np.pi)
    per_turn = np.float32(0.5 / np.pi)
    half = np.float32(0.5)
    confidence = np.float32(CONFIDENCE)
    angle = np.zeros(columns, np.float32)
    deviation = np.zeros(columns, np.float32)
    for pitch in range(pitches):
        scale = np.float32(2) / shifts.frames[pitch]
        spread = np.float32(np.sqrt(scale))
        finer = shifts.ratio[pitch]
        sines, cosines = sine_sum[pitch], cosine_sum[pitch]
        first = pitch == 0
        for column in range(columns):
            s, c = sines[column], cosines[column]
            amplitude = scale * np.sqrt(s * s + c * c)
            wrapped = find_angle(s, c)
            scatter = spread * noise[column]
            coarse = wrapped if first else angle[column] * finer
            before = np.float32(0) if first else deviation[column] * finer
            now = scatter / max(amplitude, np.float32(1e-12))
            turned = wrapped + turn * np.floor((coarse - wrapped) * per_turn + half)
            doubt = np.float32(0) if first else confidence * np.sqrt(before * before + now * now)
            good[column] &= amplitude > max(confidence * scatter, minimum_modulation)
            good[column] &= abs(coarse - turned) + doubt < half * turn
            angle[column] = turned
            deviation[column] = now
            modulation[column] = amplitude
    return angle, deviation


@njit(cache=True, nogil=True)
def _add_code_orders(
    code: np.ndarray,
    row: np.int64,
    mean: np.ndarray,
    noise: np.ndarray,
    frames: int,
    angle: np.ndarray,
    good: np.ndarray,
) -> None:
    """Add the orders of a Gray code to the phase of one row.

    A bit is certain when its grey level is more than 5 standard deviations away from the mean of the fringes. At the
    edge of a half period one bit is not; the order is valid when it is the same for both readings of that bit.
    """
    bits = code.shape[0]
    turn = np.float32(2 * np.pi)
    confidence = np.float32(CONFIDENCE)
    per_image = np.float32(1) / np.float32(frames)
    levels = np.empty(bits, np.float32)
    for column in range(len(mean)):
        certain = confidence * noise[column] * np.sqrt(np.float32(1) + per_image)
        uncertain = -1
        for bit in range(bits):
            levels[bit] = np.float32(code[bit, row, column]) - mean[column]
            if abs(levels[bit]) < certain:
                good[column] &= uncertain < 0
                uncertain = bit
        fringe = _order(_half_period(levels, -1), bits, angle[column])
        if uncertain >= 0:
            good[column] &= fringe == _order(_half_period(levels, uncertain), bits, angle[column])
        angle[column] += turn * np.float32(fringe)


@njit(cache=True, nogil=True)
def _measure_row(
    frames: np.ndarray,
    code: np.ndarray,
    row: np.int64,
    shifts: Shifts,
    model: NoiseModel,
    limits: Limits,
    maps: Maps,
) -> None:
    bits, columns = code.shape[0], frames.shape[2]
    sine_sum, cosine_sum, mean, brightest = _sums(frames, row, shifts)
    good = np.empty(columns, np.bool_)
    for bit in range(bits):
        for column in range(columns):
            brightest[column] = max(brightest[column], np.float32(code[bit, row, column]))
    for column in range(columns):
        good[column] = brightest[column] < limits.saturation
    noise = _deviation(mean, row, model)
    angle, deviation = _unwrap(
        sine_sum, cosine_sum, noise, shifts, limits.minimum_modulation, good, maps.modulation[row]
    )
    if bits > 0:
        _add_code_orders(code, row, mean, noise, frames.shape[0], angle, good)
    for column in range(columns):
        maps.phase[row, column] = angle[column] if good[column] else np.float32(np.nan)
        maps.sigma[row, column] = deviation[column] if good[column] else np.float32(np.nan)
        maps.texture[row, column] = mean[column]
        maps.valid[row, column] = good[column]


@njit(cache=True, nogil=True, parallel=True)
def measure_stack(
    frames: np.ndarray, code: np.ndarray, shifts: Shifts, model: NoiseModel, limits: Limits, maps: Maps
) -> None:
    """Demodulate and unwrap a stack row by row, so that the sums of one row stay in the processor's cache.

    Parameters
    ----------
    frames, code
        Fringe frames, and the frames of a Gray code, coarsest bit first; C-contiguous, shape (frame, row, column).
    shifts
        The fringe frames by pitch.
    model
        Noise of a grey level.
    limits
        Limits of a valid pixel.
    maps
        Get the results.
    """
    for row in prange(frames.shape[1]):
        # a parallel loop counts in uint64, which the function would be compiled for beside int64
        _measure_row(frames, code, np.int64(row), shifts, model, limits, maps)


@njit(cache=True, nogil=True, parallel=True)
def add_gain_variance(
    phase: np.ndarray,
    modulation: np.ndarray,
    texture: np.ndarray,
    angles: np.ndarray,
    covariance: np.ndarray,
    sigma: np.ndarray,
) -> None:
    """Add the standard deviation by uncertain gains of the frames of one pitch to that of the phase, in place.

    By eq. 11 a relative change g of frame k at the angle a changes the phase by
    ``2 g / N (A/B sin(a - phi) + sin(2 (a - phi)) / 2)``.

    Parameters
    ----------
    phase, modulation, texture
        phi [rad], B and A [grey level], float32, shape (row, column).
    angles, covariance
        2 pi k / q of each frame [rad] and covariance of the gains, float64, shape (frame,) and (frame, frame).
    sigma
        Standard deviation of the phase [rad], float32, shape (row, column).
    """
    count = len(angles)
    # with four functions of the phase the variance is a quadratic form of 4 x 4
    course = np.empty((4, count))
    course[0], course[1] = np.sin(angles), np.cos(angles)
    course[2], course[3] = 0.5 * np.sin(2 * angles), 0.5 * np.cos(2 * angles)
    form = (course @ covariance @ course.T) * (2.0 / count) ** 2
    for row in prange(phase.shape[0]):
        part = np.empty(4)
        for column in range(phase.shape[1]):
            sine, cosine = np.sin(phase[row, column]), np.cos(phase[row, column])
            ratio = texture[row, column] / max(modulation[row, column], np.float32(1e-12))
            part[0], part[1] = ratio * cosine, -ratio * sine
            part[2], part[3] = cosine * cosine - sine * sine, -2 * sine * cosine
            total = sigma[row, column] ** 2
            for one in range(4):
                for other in range(4):
                    total += part[one] * form[one, other] * part[other]
            sigma[row, column] = np.sqrt(total)
