"""Phase stepping: from n q frames of each pitch to the absolute phase at the finest one (eq. 11).

A frame is ``I_k = A + B cos(phi - 2 pi k / q)``, k = 1..n q, so that eq. 11 returns +phi. What is valid, and how
noisy, follows from the noise of a grey level: phi has the standard deviation ``sqrt(2/N) sigma_I / B`` over N = n q
frames.
"""

from __future__ import annotations

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
def _angle(sine: np.float32, cosine: np.float32) -> np.float32:
    """Return the arctangent of eq. 11 [rad], -pi to pi, to 2e-7.

    A polynomial in the square of the smaller over the larger argument (Chebyshev fit of arctan(x)/x); without branches,
    so that the processor takes several pixels at once, which the library's arctangent does not allow.
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
    per_turn = np.float32(0.5 / np.pi)
    half = np.float32(0.5)
    confidence = np.float32(CONFIDENCE)
    for row in prange(rows):
        sine_sum = np.zeros((periods, columns), np.float32)
        cosine_sum = np.zeros((periods, columns), np.float32)
        mean = np.zeros(columns, np.float32)
        brightest = np.zeros(columns, np.float32)
        for k in range(images):
            sines, cosines = sine_sum[period_of[k]], cosine_sum[period_of[k]]
            for column in range(columns):
                level = np.float32(frames[k, row, column])
                sines[column] += sine[k] * level
                cosines[column] += cosine[k] * level
                mean[column] += level
                brightest[column] = max(brightest[column], level)
        for bit in range(bits):
            for column in range(columns):
                brightest[column] = max(brightest[column], np.float32(code[bit, row, column]))
        noise = np.empty(columns, np.float32)
        angle = np.zeros(columns, np.float32)
        deviation = np.zeros(columns, np.float32)
        good = np.empty(columns, np.bool_)
        per_image = np.float32(1) / np.float32(images)
        for column in range(columns):
            mean[column] *= per_image
            noise[column] = np.sqrt(read_variance + shot * mean[column])
            good[column] = brightest[column] < saturation
        if variance_of_pixels.shape[0] > 0:
            for column in range(columns):
                noise[column] = np.sqrt(variance_of_pixels[row, column])
        for period in range(periods):
            scale = np.float32(2) / count[period]
            spread = np.float32(np.sqrt(scale))
            finer = ratio[period]
            sines, cosines = sine_sum[period], cosine_sum[period]
            first = period == 0
            for column in range(columns):
                s, c = sines[column], cosines[column]
                amplitude = scale * np.sqrt(s * s + c * c)
                wrapped = _angle(s, c)
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
                modulation[row, column] = amplitude
        if bits > 0:
            levels = np.empty(bits, np.float32)
            for column in range(columns):
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
        for column in range(columns):
            phase[row, column] = angle[column] if good[column] else np.float32(np.nan)
            sigma[row, column] = deviation[column] if good[column] else np.float32(np.nan)
            texture[row, column] = mean[column]
            valid[row, column] = good[column]
