"""Phase from one fringe image, for events that are too fast for phase stepping, by a windowed Fourier transform.

The image is multiplied by a conjugate wave and averaged by a Gaussian window: once with the plane wave of the strongest
fringes, and once more with the wave of this first phase, so that the window contains the remaining phase only. The
price against phase stepping is resolution: a point is an average over its window, and texture at the frequency of the
fringes counts as phase, unless the image is divided by a white image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import xarray as xr

from fringedic.errors import ErrorCode, ImageError, PhaseError
from fringedic.frames.noise import ROUNDING_NOISE, CameraNoise, saturation_level
from fringedic.patterns.pattern import Orientation
from fringedic.phase.demodulation_kernel import CONFIDENCE
from fringedic.phase.fringe_order import assign_orders, unwrap_spatial
from fringedic.phase.layout import pixels

# test_one_image_gives_the_phase and test_an_image_without_fringes_is_refused fix these limits
_SHORTEST_PERIOD = 4.0  # [px]: the window contains less than two samples per period of shorter fringes
_FEWEST_FRINGES = 4  # shading of the surface has fewer periods in view
_DEGREE = 3  # a polynomial of this degree follows perspective and curvature
_CONTRAST = 6.0  # of the fringes' peak over the median of the spectrum on its ring
_TINY = np.float32(1e-6)  # avoids divisions by zero outside of the measured area


def one_image_phase(
    image: np.ndarray,
    *,
    white: np.ndarray | None = None,
    orientation: Orientation = Orientation.VERTICAL,
    shift_angle: float = 0.0,
    noise: CameraNoise | None = None,
    saturation: float | None = None,
    window: float = 0.5,
    coarse: np.ndarray | xr.DataArray | None = None,
) -> xr.Dataset:
    """Measure the phase from a single image of fine fringes.

    Parameters
    ----------
    image
        Grey levels under fringes, shape (row, column).
    white
        Grey levels of the same surface in the same place under uniform light, same shape. The image is divided by
        them, which removes the texture.
    orientation
        Direction of the fringes; the phase grows to the right, or upwards for horizontal fringes.
    shift_angle
        2 pi k / q of the projected image [rad].
    noise
        Noise of the camera, for pixels of `white` that are too dark to divide by; None for rounding only.
    saturation
        Grey level from which a pixel counts as saturated; by default the largest value of an integer type.
    window
        Standard deviation of the Gaussian window, in periods of the fringes.
    coarse
        Absolute phase at the same pitch [rad], known to within half a fringe, from which the fringe orders are taken.

    Returns
    -------
    Dataset
        As of `absolute_phase`. The phase is relative (attribute ``relative`` = 1, see `unwrap_spatial`) unless
        `coarse` is given. ``sigma`` contains noise and texture together: it is the amplitude found for a wave of the
        same period across the direction of the fringes, where there are no fringes. ``texture`` is the white image, or
        the image divided by its fringes.

    Raises
    ------
    PhaseError
        No fringes are found in the image.
    ImageError
        Image and white image differ in size.

    References
    ----------
    M. Takeda, K. Mutoh, "Fourier transform profilometry for the automatic measurement of 3-D object shapes", Applied
    Optics 22 (1983) 3977-3982.

    Q. Kemao, "Windowed Fourier transform for fringe pattern analysis", Applied Optics 43 (2004) 2695-2702.

    Examples
    --------
    >>> column = np.arange(120.0)
    >>> truth = 2 * np.pi * column / 8 + 2 * np.sin(column / 30)
    >>> image = (120 + 60 * np.cos(truth) * np.ones((90, 1))).round().astype(np.uint8)
    >>> measured = one_image_phase(image)
    >>> turns = (measured.phase.values[45, 20:-20] - truth[20:-20]) / (2 * np.pi)
    >>> bool(abs(turns - np.round(turns[0])).max() < 0.01)  # true up to whole fringes
    True
    """
    if white is not None and white.shape != image.shape:
        raise ImageError(f"the white image is {white.shape}, the fringe image {image.shape}")
    camera = noise if noise is not None else CameraNoise(ROUNDING_NOISE)
    levels = image.astype(np.float32)
    measured = levels < saturation_level(image, saturation)
    levels[~np.isfinite(levels)] = 0.0  # where all merged exposures saturate
    if white is None:
        scene = _Scene(levels, None, levels, measured)
    else:
        light = white.astype(np.float32)
        light[~np.isfinite(light)] = 0.0
        measured &= (light < saturation_level(white, saturation)) & (
            light > CONFIDENCE * np.sqrt(camera.variance(light))
        )
        scene = _Scene(levels, light, levels / np.where(measured, light, np.float32(1)), measured)
    if not scene.measured.any():
        raise PhaseError("no fringes: every pixel is dark or saturates", code=ErrorCode.NO_FRINGES)
    frequency = _carrier(scene.relief, scene.weight, orientation)
    fringes = _windowed_phase(scene, frequency, window)
    valid = scene.measured & (fringes.sigma < 1 / CONFIDENCE) & (fringes.coverage > 0.5)

    residual = np.where(valid, np.angle(fringes.amplitude), np.nan)
    if coarse is not None:
        phase = assign_orders(residual + fringes.wave + shift_angle, coarse)
    else:
        unwrapped = unwrap_spatial(residual)
        phase = unwrapped.copy(data=unwrapped.values + fringes.wave + shift_angle)
    modulation = 2 * np.abs(fringes.amplitude) * (scene.light if scene.light is not None else 1)
    texture = scene.light if scene.light is not None else _without_fringes(scene, fringes)
    valid = valid & np.isfinite(phase.values)
    dimensions = ("row", "column")
    relative = phase.attrs["relative"]
    return xr.Dataset(
        {
            "phase": (
                dimensions,
                phase.values.astype(np.float32),
                {"units": "rad", "long_name": "phase of the fringes", "relative": relative},
            ),
            "sigma": (
                dimensions,
                np.where(valid, fringes.sigma, np.nan).astype(np.float32),
                {"units": "rad", "long_name": "standard deviation of the phase"},
            ),
            "modulation": (dimensions, modulation.astype(np.float32), {"units": "grey level"}),
            "texture": (dimensions, texture.astype(np.float32), {"units": "grey level"}),
            "valid": (dimensions, valid, {"long_name": "where the phase is measured"}),
        },
        coords=pixels(valid.shape),
    )


@dataclass(frozen=True)
class _Scene:
    """Images prepared for the transform, all (row, column): levels are finite, the relief is free of texture."""

    levels: np.ndarray
    light: np.ndarray | None  # the white image
    relief: np.ndarray
    measured: np.ndarray

    @property
    def weight(self) -> np.ndarray:
        return self.measured.astype(np.float32)


@dataclass(frozen=True)
class _Fringes:
    """Fringes around a wave, all (row, column): B/2 exp(i (phi - wave)), sigma of phi [rad], weight in the window."""

    wave: np.ndarray
    amplitude: np.ndarray
    sigma: np.ndarray
    coverage: np.ndarray
    period: float


def _windowed_phase(scene: _Scene, frequency: tuple[float, float], window: float) -> _Fringes:
    """Demodulate with a plane wave, then with the wave of that phase and the final window."""
    weight = scene.weight
    period = 1 / float(np.hypot(*frequency))
    rows, columns = (axis.astype(np.float32) for axis in np.ogrid[: weight.shape[0], : weight.shape[1]])
    wave = (2 * np.pi * (frequency[0] * rows + frequency[1] * columns)).astype(np.float32)
    varying = scene.relief - _smooth(scene.relief * weight, period) / np.maximum(_smooth(weight, period), _TINY)

    first = _demodulate(varying, weight, wave, period)
    wave = wave + _course(first, scene.measured)
    deviation = max(window * period, 0.5)
    amplitude = _demodulate(varying, weight, wave, deviation)
    across = 2 * np.pi * (-frequency[1] * rows + frequency[0] * columns)
    leakage = np.abs(_demodulate(varying, weight, across.astype(np.float32), deviation)) ** 2
    variance = _smooth(leakage * weight, 2 * period) / np.maximum(_smooth(weight, 2 * period), _TINY)
    sigma = np.sqrt(variance / 2) / np.maximum(np.abs(amplitude), np.float32(1e-12))
    return _Fringes(wave, amplitude, sigma, _smooth(weight, deviation), period)


def _smooth(values: np.ndarray, deviation: float) -> np.ndarray:
    """Return the Gaussian average of an image, or of several as channels; zero beyond the border."""
    reach = 2 * math.ceil(3 * deviation) + 1
    return cv2.GaussianBlur(values, (reach, reach), deviation, borderType=cv2.BORDER_CONSTANT)


def _demodulate(varying: np.ndarray, weight: np.ndarray, wave: np.ndarray, deviation: float) -> np.ndarray:
    """Return the windowed mean of the image times the conjugate wave: B/2 exp(i (phi - wave))."""
    known = varying * weight
    parts = np.stack([known * np.cos(wave), -known * np.sin(wave)], axis=-1)
    mean = _smooth(parts, deviation) / np.maximum(_smooth(weight, deviation), _TINY)[..., None]
    return np.asarray(mean[..., 0] + 1j * mean[..., 1])


def _without_fringes(scene: _Scene, fringes: _Fringes) -> np.ndarray:
    """Return the image divided by its fringes of contrast B/A; noise is amplified fivefold at most."""
    weight, period = scene.weight, fringes.period
    mean = _smooth(scene.levels * weight, period) / np.maximum(_smooth(weight, period), _TINY)
    contrast = 2 * np.abs(fringes.amplitude) / np.maximum(mean, _TINY)
    wave = 1 + contrast * np.cos(fringes.wave + np.angle(fringes.amplitude))
    return np.asarray(scene.levels / np.maximum(wave, np.float32(0.2)))


def _carrier(relief: np.ndarray, weight: np.ndarray, orientation: Orientation) -> tuple[float, float]:
    """Return the frequency of the strongest fringes along rows and columns [1/px], in the direction of growth."""
    rows, columns = relief.shape
    taper = np.hanning(rows)[:, None] * np.hanning(columns)
    spectrum = np.abs(np.fft.fft2((relief - np.average(relief, weights=weight)) * weight * taper))
    vertical, horizontal = np.fft.fftfreq(rows)[:, None], np.fft.fftfreq(columns)[None, :]
    along, across = (horizontal, vertical) if orientation == Orientation.VERTICAL else (-vertical, horizontal)
    fewest = _FEWEST_FRINGES / (columns if orientation == Orientation.VERTICAL else rows)
    allowed = (along >= fewest) & (np.abs(across) < along) & (np.hypot(along, across) < 1 / _SHORTEST_PERIOD)
    if not allowed.any():
        raise PhaseError(
            f"no fringes: an image of {columns}x{rows} px is too small for them", code=ErrorCode.NO_FRINGES
        )
    peak = np.unravel_index(np.argmax(np.where(allowed, spectrum, 0)), spectrum.shape)
    ring = np.hypot(along, across)
    alike = allowed & (np.abs(ring - ring[peak]) < 0.3 * ring[peak])
    if not (alike.any() and spectrum[peak] > _CONTRAST * np.median(spectrum[alike])):
        raise PhaseError(
            "no fringes: no period stands out of the image; check that the projector is on and the pitch fine",
            code=ErrorCode.NO_FRINGES,
        )
    return float(vertical[peak[0], 0]), float(horizontal[0, peak[1]])


def _course(amplitude: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return the smooth course of the phase over the image [rad]: a polynomial fitted to its unwrapped values.

    About 120 pixels along the shorter side are enough: the second pass measures what the polynomial leaves.
    """
    strength = np.abs(amplitude)
    strong = measured & (strength > 0.3 * np.median(strength[measured]))
    skip = max(1, min(amplitude.shape) // 120)
    part = np.s_[::skip, ::skip]
    phase = unwrap_spatial(np.where(strong[part], np.angle(amplitude[part]), np.nan)).values
    known = np.isfinite(phase)
    rows, columns = (np.linspace(-1, 1, size) for size in amplitude.shape)
    vertical, horizontal = np.meshgrid(rows[::skip], columns[::skip], indexing="ij")
    exponents = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
    matrix = np.stack([vertical[known] ** i * horizontal[known] ** j for i, j in exponents], axis=1)
    coefficients = np.linalg.lstsq(matrix, phase[known], rcond=None)[0]
    course = np.zeros(amplitude.shape, np.float32)
    for (i, j), value in zip(exponents, coefficients, strict=True):
        course += (value * rows[:, None] ** i * columns[None, :] ** j).astype(np.float32)
    return course
