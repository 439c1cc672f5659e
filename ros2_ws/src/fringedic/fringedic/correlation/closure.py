"""Closure of a displacement: what an independent criterion finds between the reference and the image moved back.

The deformed image g is moved back by the measured displacement d: b(p) = g(p + d(p)). Where d is right, b differs from
the reference f by noise alone. A remaining displacement c makes their local cross-correlation unsymmetric,

    A_i = sum w(p) [f(p) b(p + e_i) - f(p + e_i) b(p)],  A = K c,
    K_ij = -sum w(p) [f(p) f_j(p + e_i) - f(p + e_i) f_j(p)],  f_j = df/dx_j,

with the unit vector e_i along axis i. A vanishes for b = f whatever the texture is. No residual is minimised and
nothing is iterated. The Gaussian window w covers a quarter of the area of the window of the measurement: with this
area the closure has about two thirds of the noise of the displacement, and shows what its window averages.
"""

from __future__ import annotations

import cv2
import numpy as np
import xarray as xr
from scipy.ndimage import binary_dilation, distance_transform_edt, map_coordinates

from fringedic.correlation.transfer import noise_transfer, window_deviation
from fringedic.errors import CorrelationError
from fringedic.wording.arguments import array, check_arguments, of_type

f4 = np.float32

REFUTED = 5.0  # standard deviations; normal errors exceed them at one point in a million
_DOUBTFUL = 3.0  # standard deviations, of points beside one that is refuted
# Variance of the residual, as a multiple of the usual one and as a part of the local contrast, where a window contains
# something else than the surface, and the multiple for a point beside; test_points_beside_an_occluder_are_refuted
_FOREIGN, _FOREIGN_PART, _UNUSUAL = 4.0, 0.02, 2.0
_AREA = 0.25  # the closure is evaluated in a window of this part of that of the measurement
_FLAT = 2.0  # the local mean and contrast are those of a window so many times as wide as w
_LEAST = 0.5  # at least this part of a window has to be covered
_NOISE_RANGE = 2.0  # a variance beyond this multiple of the usual one is a fault, not noise
_MEDIAN = 0.6745  # of the absolute values of a normal distribution
_LARGEST_SCALE = 1.25  # 1.15 on leather; a larger one is a fault
_ROUNDING = f4(1e-6)  # smallest variance of the residual, of a contrast of 1: that of rounding; equal images have none
_TINY = f4(1e-12)


@check_arguments(CorrelationError, reference=array(2), deformed=array(2), field=of_type(xr.Dataset))
def displacement_closure(reference: np.ndarray, deformed: np.ndarray, field: xr.Dataset) -> xr.Dataset:
    """Return the closure of a displacement, from the reference to the deformed image and back.

    Parameters
    ----------
    reference, deformed
        Textures (row, column) [grey level]; NaN is not measured.
    field
        Of `measure_displacement`.

    Returns
    -------
    Dataset
        ``closure_x`` (right) and ``closure_y`` (down), float32 at the points of `field`: what is left of the
        displacement [standard deviations of the closure]; NaN where it cannot be checked. ``residual``, float32: local
        variance of what the displacement leaves of the difference, in units of that of the texture; its attribute
        ``usual`` is the median over all pixels.

    Raises
    ------
    CorrelationError
        The textures differ in shape, or the field does not contain its window and its spacing.

    Examples
    --------
    >>> from fringedic import measure_displacement
    >>> generator = np.random.default_rng(1)
    >>> texture = cv2.GaussianBlur(generator.normal(0, 100, (96, 96)), (0, 0), 1.5)
    >>> images = [texture + generator.normal(0, 0.5, texture.shape) for _ in "ab"]
    >>> field = measure_displacement(*images, window=32)
    >>> closure = displacement_closure(*images, field)
    >>> bool(0.5 < abs(closure.closure_x).mean() < 1.2)
    True
    >>> wrong = field.assign(displacement_x=field.displacement_x + 0.2 * (field.column < 30))
    >>> bool(abs(displacement_closure(*images, wrong).closure_x[:, :20]).min() > 3)
    True
    """
    if reference.shape != deformed.shape or not {"window_px", "spacing_px", "method"} <= field.attrs.keys():
        raise CorrelationError(
            f"textures of {reference.shape} and {deformed.shape} px and a displacement with the attributes "
            f"{sorted(field.attrs)} give no closure: give equal shapes and the result of measure_displacement"
        )
    window, spacing = int(field.attrs["window_px"]), int(field.attrs["spacing_px"])
    deviation = window_deviation(window) * np.sqrt(_AREA)
    moved, known = _move_back(deformed, field, spacing, np.isfinite(reference))
    if not known.any():
        empty = field.displacement_x.copy(data=np.full(field.displacement_x.shape, np.nan, f4))
        residual = empty.copy().assign_attrs(usual=float("nan"))
        return xr.Dataset({"closure_x": empty, "closure_y": empty, "residual": residual})
    fixed, moved = (_flatten(image, known, _FLAT * deviation) for image in (reference, moved))
    # The measured displacement contains the part T of the noise, see `transfer`, so that 1 - T remains in the closure.
    method = str(field.attrs["method"])
    frequency = np.linspace(0, 0.5, 4001)
    rings = frequency * np.exp(-((2 * np.pi * deviation * frequency) ** 2))  # square of the transfer of w
    remaining = float(np.sum(rings * (1 - noise_transfer(frequency, window, method)) ** 2) / np.sum(rings))
    weight = known.astype(f4)
    covered = _smooth(weight, deviation)
    gradients = [(np.gradient(fixed, axis=axis) * weight).astype(f4) for axis in (1, 0)]
    found = [_smooth(_antisymmetric(fixed, moved, axis), deviation) for axis in (1, 0)]
    (kxx, kxy), (kyx, kyy) = (
        [-_smooth(_antisymmetric(fixed, each, axis), deviation) for each in gradients] for axis in (1, 0)
    )
    noise = _smooth((moved - fixed) ** 2, deviation) / np.maximum(covered, _TINY)
    usual = np.median(noise[known])
    residual = np.where(known, noise, f4(np.nan))[::spacing, ::spacing]
    noise = np.maximum(np.minimum(noise, f4(_NOISE_RANGE) * usual), _ROUNDING)
    # A_i is the sum of w (f(p - e_i) - f(p + e_i)) n(p); the square of the window is one of deviation s / sqrt(2).
    square = f4(1 / (4 * np.pi * deviation**2))
    # beside a border the displacement has a one-sided window; there its noise has less in common with that of A
    one_sided = np.clip(2 * (1 - _smooth(weight, deviation / np.sqrt(_AREA))), 0, 1)
    noise *= f4(remaining) + f4(1 - remaining) * one_sided
    spread = [square * _smooth(4 * each**2, deviation / np.sqrt(2)) for each in gradients]
    determinant = kxx * kyy - kxy * kyx
    scores = []
    with np.errstate(divide="ignore", invalid="ignore"):
        for a, b in ((kyy, -kxy), (-kyx, kxx)):
            sigma = np.sqrt(noise * (a**2 * spread[0] + b**2 * spread[1]))
            scores.append(np.sign(determinant) * (a * found[0] + b * found[1]) / sigma)
    closure = np.where(known & (covered > _LEAST), np.stack(scores), f4(np.nan)).astype(f4)[:, ::spacing, ::spacing]
    closure = np.where(np.isfinite(field.displacement_x.values), closure, f4(np.nan))
    # Where the texture is faint or has one direction, the displacement takes less of the noise with it than that.
    known = np.abs(closure[np.isfinite(closure)])
    closure /= f4(float(np.clip(np.median(known) / _MEDIAN, 1, _LARGEST_SCALE)) if known.size else 1.0)
    units = {"units": "standard deviations"}
    dimensions = ("row", "column")
    maps = {f"closure_{axis}": (dimensions, part, units) for axis, part in zip("xy", closure, strict=True)}
    measure = {"residual": (dimensions, residual, {"units": "1", "usual": float(usual)})}
    return xr.Dataset(maps | measure, field.coords)


def refuted_points(closure: xr.Dataset, field: xr.Dataset) -> np.ndarray:
    """Return the measured points that the closure refutes, as beside an object that moves in front of the surface.

    The closure of such a point is beyond 5 standard deviations, and the window contains something else than the
    surface: its residual is 4 times the usual variance and 2 % of the local one at least. Noise and strain that the
    window smooths fulfil one of these conditions only. Points within a window of a refuted one are refuted from 3
    standard deviations and twice the usual variance on (hysteresis threshold, Canny 1986), or if too little of their
    window is seen for a closure.

    Parameters
    ----------
    closure
        Of `displacement_closure`.
    field
        That it belongs to.

    Returns
    -------
    ndarray
        bool (row, column).

    References
    ----------
    J. Canny (1986), A computational approach to edge detection, IEEE Transactions on Pattern Analysis and Machine
    Intelligence 8, 679-698.

    Examples
    --------
    >>> values = {"closure_x": [0.5, 3.5, 6.0, 6.0], "closure_y": [0.1] * 4, "residual": [0.01, 0.1, 0.2, 0.01]}
    >>> closure = xr.Dataset({name: (("row", "column"), [each]) for name, each in values.items()})
    >>> closure.residual.attrs["usual"] = 0.01
    >>> field = xr.Dataset({"valid": (("row", "column"), [[True] * 4])}, attrs={"window_px": 16, "spacing_px": 4})
    >>> refuted_points(closure, field).astype(int)
    array([[0, 1, 1, 0]])
    """
    largest = np.maximum(np.abs(closure.closure_x.values), np.abs(closure.closure_y.values))
    residual, usual, measured = closure.residual.values, float(closure.residual.attrs["usual"]), field.valid.values
    refuted = measured & (largest > REFUTED) & (residual > max(_FOREIGN * usual, _FOREIGN_PART))
    if not refuted.any():
        return np.asarray(refuted)
    doubtful = measured & ((largest > _DOUBTFUL) & (residual > _UNUSUAL * usual) | np.isnan(largest))
    reach = -(-int(field.attrs["window_px"]) // int(field.attrs["spacing_px"]))
    return np.asarray(binary_dilation(refuted, np.ones((3, 3), np.bool_), reach, mask=doubtful))


def _move_back(
    deformed: np.ndarray, field: xr.Dataset, spacing: int, wanted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the deformed image at the displaced pixels of the reference, and where it is known and wanted."""
    measured = np.isfinite(field.displacement_x.values)
    known = np.isfinite(deformed)
    if not measured.any() or not known.any():
        return np.zeros(deformed.shape, f4), np.zeros(deformed.shape, np.bool_)
    nearest = tuple(distance_transform_edt(~measured, return_distances=False, return_indices=True))
    pixels = np.indices(deformed.shape, dtype=f4)
    points = pixels / f4(spacing)
    names = ("displacement_y", "displacement_x")
    away = [map_coordinates(field[name].values[nearest], points, order=1, mode="nearest") for name in names]
    places = pixels + np.stack(away)
    filled = np.where(known, deformed, np.mean(deformed[known]))
    moved = map_coordinates(filled, places, order=5, mode="constant", output=f4)
    seen = map_coordinates(known.astype(f4), places, order=1, mode="constant") > 1 - 1e-3
    inside = map_coordinates(measured.astype(f4), points, order=1, mode="nearest") > 0.5
    return moved, seen & inside & wanted


def _flatten(image: np.ndarray, known: np.ndarray, deviation: float) -> np.ndarray:
    """Return an image without its local mean, in units of its local standard deviation; zero where not known."""
    covered = np.maximum(_smooth(known.astype(f4), deviation), _TINY)
    values = np.where(known, image, 0).astype(f4)
    values = np.where(known, values - _smooth(values, deviation) / covered, 0).astype(f4)
    return np.asarray(values / np.sqrt(np.maximum(_smooth(values**2, deviation) / covered, _TINY)))


def _smooth(values: np.ndarray, deviation: float) -> np.ndarray:
    """Return the sums over a Gaussian window of weight 1; the image is zero outside of its edges."""
    return np.asarray(cv2.GaussianBlur(values, (0, 0), deviation, borderType=cv2.BORDER_CONSTANT))


def _antisymmetric(first: np.ndarray, second: np.ndarray, axis: int) -> np.ndarray:
    """Return first(p) second(p + e) - first(p + e) second(p), the mean of the pairs on both sides of a pixel."""
    one, other = np.moveaxis(first, axis, 0), np.moveaxis(second, axis, 0)
    half = f4(0.5) * (one[:-1] * other[1:] - one[1:] * other[:-1])
    result = np.zeros_like(first)
    along = np.moveaxis(result, axis, 0)
    along[:-1] += half
    along[1:] += half
    return result
