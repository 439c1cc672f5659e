"""Phase stepping: from n q frames of each pitch to the absolute phase at the finest one (eq. 11).

A frame is ``I_k = A + B cos(phi - 2 pi k / q)``, k = 1..n q, so that eq. 11 returns +phi. What is valid, and how
noisy, follows from the noise of a grey level: phi has the standard deviation ``sqrt(2/N) sigma_I / B`` over N = n q
frames.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr
from numba import njit, prange

from fringedic.errors import InvalidSequenceError, ShapeMismatchError
from fringedic.phase.layout import check_frames, layout_of, pixels, shift_angles
from fringedic.phase.noise import ROUNDING_NOISE, CameraNoise, estimate_noise, saturation_level
from fringedic.sequence import Orientation, PatternKind, Projection

CONFIDENCE = 5.0  # standard deviations between a measurement and the case in which it means nothing


def demodulate(
    frames: np.ndarray,
    shifts: int,
    *,
    noise: CameraNoise | float | None = None,
    saturation: float | None = None,
) -> xr.Dataset:
    """Measure the wrapped phase of one pitch from its n q frames (eq. 11).

    Parameters
    ----------
    frames
        Grey levels, shape (n q, row, column), frame k - 1 taken at the shift 2 pi k / q.
    shifts
        q, at least 3.
    noise, saturation
        See `absolute_phase`.

    Returns
    -------
    Dataset
        ``phase`` [rad] in (-pi, pi], ``modulation`` B and ``texture`` A [grey level], ``sigma`` of the phase [rad] and
        ``valid``. Phase and sigma are NaN where not valid; modulation and texture are given everywhere.

    Raises
    ------
    InvalidSequenceError
        When q < 3 or the frames are not n cycles of q.
    """
    if shifts < 3 or len(frames) == 0 or len(frames) % shifts:
        raise InvalidSequenceError(f"{len(frames)} frames are not whole cycles of {shifts} shifts, of at least 3")
    projections = [
        Projection(PatternKind.FRINGES, Orientation.VERTICAL, 1.0, k, shifts) for k in range(1, len(frames) + 1)
    ]
    return _measure(frames, projections, noise, saturation, 0.0)


def absolute_phase(
    frames: np.ndarray,
    projections: Sequence[Projection],
    *,
    noise: CameraNoise | float | np.ndarray | None = None,
    saturation: float | None = None,
    minimum_modulation: float = 0.0,
) -> xr.Dataset:
    """Measure the absolute phase at the finest pitch from all frames of a step.

    Every pitch is demodulated (eq. 11). The fringe order comes from the phase of the next coarser pitch, or, where the
    frames begin with a Gray code, from its bits. A pixel is valid where no frame saturates, where every pitch is
    modulated by more than 5 sqrt(2/N) sigma_I, and where every fringe order is more than 5 standard deviations away
    from its neighbour.

    With one pitch and no code the phase is the wrapped one: absolute only when one fringe covers the whole view; see
    `unwrap_spatial` otherwise.

    Parameters
    ----------
    frames
        Grey levels, uint8, uint16 or float32, shape (frame, row, column).
    projections
        What each frame showed: fringes of one orientation, pitches coarse to fine, whole cycles of q >= 3 shifts; or
        the bits of a Gray code and then fringes of its pitch.
    noise
        Noise of the camera, or its standard deviation [grey level]: one, or one for each pixel, shape (row, column).
        When None it is estimated from what the frames leave unexplained, which takes more than 3 frames of some pitch;
        with 3 frames of each there is nothing left to estimate from: sigma is NaN and the validity assumes the noise
        of rounding.
    saturation
        Grey level from which a pixel counts as saturated; by default the largest value of an integer type.
    minimum_modulation
        Modulation that the surface itself, and no stray light, has at least [grey level].

    Returns
    -------
    Dataset
        ``phase`` [rad at the finest pitch], zero on the projector axis; ``sigma`` [rad], its standard deviation;
        ``modulation`` [grey level] of the finest pitch; ``texture`` [grey level], the mean of all fringe frames;
        ``valid``. Phase and sigma are NaN where not valid; modulation and texture are given everywhere.

    Raises
    ------
    InvalidSequenceError
        When the projections are not what is said above.
    ShapeMismatchError
        When there is not one frame for each projection, or the noise of each pixel has another shape.
    """
    return _measure(frames, projections, noise, saturation, minimum_modulation)


def _measure(
    frames: np.ndarray,
    projections: Sequence[Projection],
    noise: CameraNoise | float | np.ndarray | None,
    saturation: float | None,
    minimum_modulation: float,
) -> xr.Dataset:
    layout = layout_of(projections)
    check_frames(frames, projections)
    known = noise if noise is not None else estimate_noise(frames, projections, saturation=saturation)
    camera, variance_of_pixels = CameraNoise(ROUNDING_NOISE), np.empty((0, 0), np.float32)
    if isinstance(known, CameraNoise):
        camera = known
    elif isinstance(known, np.ndarray):
        if known.shape != frames.shape[1:]:
            raise ShapeMismatchError(f"noise of {known.shape} pixels for frames of {frames.shape[1:]}")
        variance_of_pixels = np.ascontiguousarray(known, np.float32) ** 2
    elif known is not None:
        camera = CameraNoise(known)
    frames = np.ascontiguousarray(frames)
    angles = shift_angles(projections[layout.code :])
    pitches = layout.pitches
    phase, sigma, modulation, texture = (np.empty(frames.shape[1:], np.float32) for _ in range(4))
    valid = np.empty(frames.shape[1:], np.bool_)
    _absolute_phase(
        frames[layout.code :],
        frames[: layout.code],
        np.repeat(np.arange(len(pitches)), layout.counts),
        np.sin(angles).astype(np.float32),
        np.cos(angles).astype(np.float32),
        np.array(layout.counts, np.float32),
        np.array([coarse / fine for coarse, fine in zip(pitches[:1] + pitches, pitches, strict=False)], np.float32),
        np.float32(camera.read**2),
        np.float32(camera.shot),
        variance_of_pixels,
        np.float32(minimum_modulation),
        np.float32(saturation_level(frames, saturation)),
        phase,
        sigma,
        modulation,
        texture,
        valid,
    )
    if known is None:
        sigma.fill(np.nan)
    image = ("row", "column")
    return xr.Dataset(
        {
            "phase": (image, phase, {"units": "rad", "long_name": "phase of the fringes"}),
            "sigma": (image, sigma, {"units": "rad", "long_name": "standard deviation of the phase"}),
            "modulation": (image, modulation, {"units": "grey level", "long_name": "modulation of the finest fringes"}),
            "texture": (image, texture, {"units": "grey level", "long_name": "mean of the fringe frames"}),
            "valid": (image, valid, {"long_name": "where the phase is measured"}),
        },
        coords=pixels(frames.shape[1:]),
    )


@njit(cache=True, nogil=True)
def _half_period(levels: np.ndarray, flipped: int) -> int:
    """Number of the half period that the bits of a Gray code tell, one of them taken the other way round."""
    number = 0
    bit = 0
    for index in range(len(levels)):
        bit ^= int((levels[index] > 0) != (index == flipped))
        number = 2 * number + bit
    return number


@njit(cache=True, nogil=True)
def _order(half_period: int, bits: int, wrapped: np.float32) -> int:
    """Fringe order from the number of the half period, right also when that is one too low or high at its edge."""
    quarter = np.float32(0.5 * np.pi)
    middle = 1 << (bits - 2)
    if wrapped > quarter:
        return ((half_period + 1) >> 1) - 1 - middle
    if wrapped < -quarter:
        return ((half_period + 1) >> 1) - middle
    return (half_period >> 1) - middle


@njit(cache=True, nogil=True, parallel=True)
def _absolute_phase(
    frames: np.ndarray,
    code: np.ndarray,
    period_of: np.ndarray,
    sine: np.ndarray,
    cosine: np.ndarray,
    count: np.ndarray,
    ratio: np.ndarray,
    read_variance: np.float32,
    shot: np.float32,
    variance_of_pixels: np.ndarray,
    minimum_modulation: np.float32,
    saturation: np.float32,
    phase: np.ndarray,
    sigma: np.ndarray,
    modulation: np.ndarray,
    texture: np.ndarray,
    valid: np.ndarray,
) -> None:
    """Demodulate and unwrap a stack row by row, so that the sums of one row stay in the processor's cache.

    A bit of the code is certain when its grey level is more than 5 standard deviations away from the mean of the
    fringes. At the edge of a half period one bit is not; the order stands when it is the same for both readings.
    """
    images, rows, columns = frames.shape
    periods = len(count)
    bits = code.shape[0]
    turn = np.float32(2 * np.pi)
    confidence = np.float32(CONFIDENCE)
    for row in prange(rows):
        sine_sum = np.zeros((periods, columns), np.float32)
        cosine_sum = np.zeros((periods, columns), np.float32)
        total = np.zeros(columns, np.float32)
        brightest = np.zeros(columns, np.float32)
        levels = np.zeros(bits, np.float32)
        for k in range(images):
            period = period_of[k]
            for column in range(columns):
                level = np.float32(frames[k, row, column])
                sine_sum[period, column] += sine[k] * level
                cosine_sum[period, column] += cosine[k] * level
                total[column] += level
                brightest[column] = max(brightest[column], level)
        for bit in range(bits):
            for column in range(columns):
                brightest[column] = max(brightest[column], np.float32(code[bit, row, column]))
        for column in range(columns):
            mean = total[column] / np.float32(images)
            variance = read_variance + shot * mean
            if variance_of_pixels.shape[0] > 0:
                variance = variance_of_pixels[row, column]
            noise = np.float32(math.sqrt(variance))
            measured = brightest[column] < saturation
            angle = np.float32(0)
            deviation = np.float32(0)
            amplitude = np.float32(0)
            for period in range(periods):
                s, c = sine_sum[period, column], cosine_sum[period, column]
                amplitude = np.float32(2) / count[period] * math.sqrt(s * s + c * c)
                limit = confidence * math.sqrt(np.float32(2) / count[period]) * noise
                measured &= amplitude > max(limit, minimum_modulation)
                if not measured:
                    continue
                wrapped = np.float32(math.atan2(s, c))
                coarse = angle * ratio[period]
                coarse_deviation = deviation * ratio[period]
                deviation = np.float32(math.sqrt(np.float32(2) / count[period]) * noise / amplitude)
                if period == 0:
                    angle = wrapped
                    continue
                order = math.floor((coarse - wrapped) / turn + np.float32(0.5))
                angle = wrapped + turn * np.float32(order)
                doubt = confidence * math.sqrt(coarse_deviation * coarse_deviation + deviation * deviation)
                measured &= abs(coarse - angle) + doubt < np.float32(0.5) * turn
            if measured and bits > 0:
                certain = confidence * noise * math.sqrt(np.float32(1) + np.float32(1) / np.float32(images))
                uncertain = -1
                for bit in range(bits):
                    levels[bit] = np.float32(code[bit, row, column]) - mean
                    if abs(levels[bit]) < certain:
                        measured &= uncertain < 0
                        uncertain = bit
                fringe = _order(_half_period(levels, -1), bits, angle)
                if uncertain >= 0:
                    measured &= fringe == _order(_half_period(levels, uncertain), bits, angle)
                angle += turn * np.float32(fringe)
            phase[row, column] = angle if measured else np.float32(np.nan)
            sigma[row, column] = deviation if measured else np.float32(np.nan)
            modulation[row, column] = amplitude
            texture[row, column] = mean
            valid[row, column] = measured
