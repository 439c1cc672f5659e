"""Phase from one fringe image, for events that are too fast for phase stepping: a windowed Fourier transform.

The image is multiplied by a conjugate wave and averaged by a Gaussian window, once with the plane wave of the strongest
fringes and once more with the wave that this first phase tells, so that the window only sees what is left. The price
against phase stepping is resolution: a point stands for its window, and texture of the fringes' own frequency passes
for phase, unless a white image takes it out.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import xarray as xr

from fringedic.errors import NoFringesError, ShapeMismatchError
from fringedic.phase.layout import pixels
from fringedic.phase.noise import ROUNDING_NOISE, CameraNoise, saturation_level
from fringedic.phase.order import assign_orders, unwrap_spatial
from fringedic.phase.steps import CONFIDENCE
from fringedic.sequence import Orientation

_SHORTEST_PERIOD = 4.0  # camera pixels; below, the window does not separate fringes from noise
_FEWEST_FRINGES = 4  # in view; below, brightness differences of the surface pass for fringes
_DEGREE = 3  # of the polynomial that describes the fringes' course over the image: perspective and curvature
_CONTRAST = 6.0  # how far the fringes' peak has to stand above the median of the spectrum


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
        The same surface in the same place under uniform light, same shape: takes its texture out.
    orientation
        Direction of the fringes; the phase grows to the right, or upwards for horizontal ones.
    shift_angle
        2 pi k / q of the image shown [rad].
    noise
        Noise of the camera, for pixels too dark to be divided by; rounding only when None.
    saturation
        Grey level from which a pixel counts as saturated; by default the largest value of an integer type.
    window
        Standard deviation of the Gaussian window, in periods of the fringes.
    coarse
        Absolute phase at the same pitch [rad], known to within half a fringe: tells the fringe orders.

    Returns
    -------
    Dataset
        As `absolute_phase` returns. The phase is relative (attribute ``relative`` = 1, see `unwrap_spatial`) unless
        `coarse` is given. ``sigma`` holds noise and texture together: what a wave of the same period across the
        fringes' direction finds, where there are none. ``texture`` is the white image, or what is left of the image
        without its fringes.

    Raises
    ------
    NoFringesError
        When no fringes stand out of the image.
    ShapeMismatchError
        When image and white image differ in size.
    """
    if white is not None and white.shape != image.shape:
        raise ShapeMismatchError(f"the white image is {white.shape}, the fringe image {image.shape}")
    camera = noise if noise is not None else CameraNoise(ROUNDING_NOISE)
    levels = image.astype(np.float32)
    measured = levels < saturation_level(image, saturation)
    levels[~np.isfinite(levels)] = 0.0  # merged exposures that all saturate
    relief: np.ndarray = levels
    if white is not None:
        light = white.astype(np.float32)
        light[~np.isfinite(light)] = 0.0
        measured &= (light < saturation_level(white, saturation)) & (
            light > CONFIDENCE * np.sqrt(camera.variance(light))
        )
        relief = levels / np.where(measured, light, np.float32(1))
    weight = measured.astype(np.float32)
    if not measured.any():
        raise NoFringesError("no fringes: every pixel is dark or saturates")
    frequency = _carrier(relief, weight, orientation)
    period = 1 / float(np.hypot(*frequency))
    rows, columns = (axis.astype(np.float32) for axis in np.ogrid[: image.shape[0], : image.shape[1]])
    wave = (2 * np.pi * (frequency[0] * rows + frequency[1] * columns)).astype(np.float32)
    varying = relief - _smooth(relief * weight, period) / np.maximum(_smooth(weight, period), np.float32(1e-6))

    first = _demodulated(varying, weight, wave, period)
    wave = wave + _course(first, measured)
    deviation = max(window * period, 0.5)
    amplitude = _demodulated(varying, weight, wave, deviation)
    across = 2 * np.pi * (-frequency[1] * rows + frequency[0] * columns)
    leakage = np.abs(_demodulated(varying, weight, across.astype(np.float32), deviation)) ** 2
    variance = _smooth(leakage * weight, 2 * period) / np.maximum(_smooth(weight, 2 * period), np.float32(1e-6))
    strength = np.abs(amplitude)
    sigma = np.sqrt(variance / 2) / np.maximum(strength, np.float32(1e-12))
    valid = measured & (sigma < 1 / CONFIDENCE) & (_smooth(weight, deviation) > 0.5)

    modulation = 2 * strength * (light if white is not None else 1)
    texture = light if white is not None else _without_fringes(levels, weight, amplitude, wave, period)
    residual = np.where(valid, np.angle(amplitude), np.nan)
    if coarse is None:
        residual_unwrapped = unwrap_spatial(residual)
        phase = xr.DataArray(
            residual_unwrapped.values + wave + shift_angle,
            dims=residual_unwrapped.dims,
            coords=residual_unwrapped.coords,
            attrs={"relative": 1},
        )
    else:
        phase = assign_orders(residual + wave + shift_angle, coarse)
    valid &= np.isfinite(phase.values)
    dimensions = ("row", "column")
    return xr.Dataset(
        {
            "phase": (
                dimensions,
                phase.values.astype(np.float32),
                {"units": "rad", "long_name": "phase of the fringes", "relative": phase.attrs["relative"]},
            ),
            "sigma": (
                dimensions,
                np.where(valid, sigma, np.nan).astype(np.float32),
                {"units": "rad", "long_name": "standard deviation of the phase"},
            ),
            "modulation": (dimensions, modulation.astype(np.float32), {"units": "grey level"}),
            "texture": (dimensions, texture.astype(np.float32), {"units": "grey level"}),
            "valid": (dimensions, valid, {"long_name": "where the phase is measured"}),
        },
        coords=pixels(image.shape),
    )


def _smooth(values: np.ndarray, deviation: float) -> np.ndarray:
    """Gaussian average of an image, or of several as channels; nothing beyond the border."""
    reach = 2 * math.ceil(3 * deviation) + 1
    return cv2.GaussianBlur(values, (reach, reach), deviation, borderType=cv2.BORDER_CONSTANT)


def _demodulated(varying: np.ndarray, weight: np.ndarray, wave: np.ndarray, deviation: float) -> np.ndarray:
    """Return the windowed mean of the image times the conjugate wave: B/2 exp(i (phi - wave))."""
    known = varying * weight
    parts = np.stack([known * np.cos(wave), -known * np.sin(wave)], axis=-1)
    mean = _smooth(parts, deviation) / np.maximum(_smooth(weight, deviation), np.float32(1e-6))[..., None]
    return np.asarray(mean[..., 0] + 1j * mean[..., 1])


def _without_fringes(
    levels: np.ndarray, weight: np.ndarray, amplitude: np.ndarray, wave: np.ndarray, period: float
) -> np.ndarray:
    """Return the image divided by its fringes of contrast B/A; in their dark lines the noise grows fivefold at most."""
    mean = _smooth(levels * weight, period) / np.maximum(_smooth(weight, period), np.float32(1e-6))
    contrast = 2 * np.abs(amplitude) / np.maximum(mean, np.float32(1e-6))
    fringes = 1 + contrast * np.cos(wave + np.angle(amplitude))
    return np.asarray(levels / np.maximum(fringes, np.float32(0.2)))


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
        raise NoFringesError(f"no fringes: an image of {columns}x{rows} px is too small for them")
    peak = np.unravel_index(np.argmax(np.where(allowed, spectrum, 0)), spectrum.shape)
    ring = np.hypot(along, across)
    alike = allowed & (np.abs(ring - ring[peak]) < 0.3 * ring[peak])
    if not (alike.any() and spectrum[peak] > _CONTRAST * np.median(spectrum[alike])):
        raise NoFringesError("no fringes: no period stands out of the image; is the projector on, and the pitch fine?")
    return float(vertical[peak[0], 0]), float(horizontal[0, peak[1]])


def _course(amplitude: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return the smooth course of the phase over the image [rad]: a polynomial through its unwrapped values.

    Fitted to every eighth pixel or so; what it misses stays for the second pass.
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
