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
# Where the images disagree: share of the pixels beyond 3 standard deviations of the residual, of which normal noise has
# 0.3 %. Windows that reach there, up to 3/4 of their width away, contain something else.
# test_points_beside_a_seam_are_right_or_refuted
_OUTLIER, _DISAGREEING = 3.0, 0.1
_BEYOND = 0.4  # of the window's width beyond measured points, where their displacement is extended
_PLANE_POINTS = 10_000  # of a field are enough for its plane
_END = 3.0  # [px] from the ends of the deformed image
_BESIDE, _REACH = 0.2, 0.75  # of the window's width: points so close are refuted, up to there a stricter test holds
_STRICT, _STRICT_RESIDUAL = 2.0, 1.5  # standard deviations of the closure; multiple of the usual variance
_AREA = 0.25  # the closure is evaluated in a window of this part of that of the measurement
_FLAT = 2.0  # the local mean and contrast are those of a window so many times as wide as w
_LEAST = 0.5  # at least this part of a window has to be covered
_NOISE_RANGE = 2.0  # a variance beyond this multiple of the usual one is a fault, not noise
_MEDIAN = 0.6745  # of the absolute values of a normal distribution
_NINE_TENTHS = 1.645  # the same of the quantile; compression leaves more differences of this size than noise
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
        ``usual`` is the median over all pixels. ``border_distance``, float32: distance [px] to the nearest area in
        which the images disagree after the displacement, which is extended a little beyond the measured points;
        infinity where there is none.

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
    back, known, seen = _move_back(deformed, field, spacing, np.isfinite(reference))
    if not known.any():
        empty = field.displacement_x.copy(data=np.full(field.displacement_x.shape, np.nan, f4))
        residual = empty.copy().assign_attrs(usual=float("nan"))
        return xr.Dataset({"closure_x": empty, "closure_y": empty, "residual": residual, "border_distance": empty})
    fixed, moved = (_flatten(image, known, _FLAT * deviation) for image in (reference, back))
    distance = _measure_border_distance((reference, back), known, seen, deviation)[::spacing, ::spacing]
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
    measure = {
        "residual": (dimensions, residual, {"units": "1", "usual": float(usual)}),
        "border_distance": (dimensions, distance, {"units": "px"}),
    }
    return xr.Dataset(maps | measure, field.coords)


def refuted_points(closure: xr.Dataset, field: xr.Dataset) -> np.ndarray:
    """Return the measured points that the closure refutes, as beside an object that moves in front of the surface.

    The closure of such a point is beyond 5 standard deviations, and the window contains something else than the
    surface: its residual is 4 times the usual variance and 2 % of the local one at least. Noise and strain that the
    window smooths fulfil one of these conditions only. Points within a window of a refuted one are refuted from 3
    standard deviations and twice the usual variance on (hysteresis threshold, Canny 1986), or if too little of their
    window is seen for a closure.

    Beside an area in which the images disagree (another motion, an occluder, a gap), windows contain some of it, which
    displaces the result by more than its uncertainty and may pass these tests. Points within a fifth of the window's
    width of such an area are refuted, and up to three quarters of it those with a closure beyond 2 standard deviations
    or a residual of more than 1.5 times the usual variance.

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
    >>> closure["border_distance"] = closure.residual + np.inf
    >>> field = xr.Dataset({"valid": (("row", "column"), [[True] * 4])}, attrs={"window_px": 16, "spacing_px": 4})
    >>> refuted_points(closure, field).astype(int)
    array([[0, 1, 1, 0]])
    """
    largest = np.maximum(np.abs(closure.closure_x.values), np.abs(closure.closure_y.values))
    residual, usual, measured = closure.residual.values, float(closure.residual.attrs["usual"]), field.valid.values
    window, spacing = int(field.attrs["window_px"]), int(field.attrs["spacing_px"])
    refuted = measured & (largest > REFUTED) & (residual > max(_FOREIGN * usual, _FOREIGN_PART))
    if refuted.any():
        doubtful = measured & ((largest > _DOUBTFUL) & (residual > _UNUSUAL * usual) | np.isnan(largest))
        refuted = binary_dilation(refuted, np.ones((3, 3), np.bool_), -(-window // spacing), mask=doubtful)
    distance = closure.border_distance.values
    passed = (largest <= _STRICT) & (residual <= _STRICT_RESIDUAL * usual)
    beside = (distance <= _BESIDE * window) | (distance <= _REACH * window) & ~passed
    return np.asarray(refuted | measured & beside)


def _move_back(
    deformed: np.ndarray, field: xr.Dataset, spacing: int, wanted: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the deformed image at the displaced pixels of the reference, where it is measured, and where it is seen.

    Pixels that are not measured are seen beside measured ones, up to `_BEYOND` of a window away.
    """
    measured = np.isfinite(field.displacement_x.values)
    known = np.isfinite(deformed)
    if not measured.any() or not known.any():
        nowhere = np.zeros(deformed.shape, np.bool_)
        return np.zeros(deformed.shape, f4), nowhere, nowhere
    pixels = np.indices(deformed.shape, dtype=f4)
    points = pixels / f4(spacing)
    names = ("displacement_y", "displacement_x")
    nearest = tuple(distance_transform_edt(~measured, return_distances=False, return_indices=True))
    away = [_extend(field[name].values, nearest, points) for name in names]
    places = pixels + np.stack(away)
    filled = np.where(known, deformed, np.mean(deformed[known]))
    moved = map_coordinates(filled, places, order=5, mode="constant", output=f4)
    seen = map_coordinates(known.astype(f4), places, order=1, mode="constant") > 1 - 1e-3
    inside = map_coordinates(measured.astype(f4), points, order=1, mode="nearest") > 0.5
    beyond = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    near = np.asarray(beyond <= _BEYOND * int(field.attrs["window_px"]))
    height, width = deformed.shape  # the spline is not known as well next to the ends of the image
    y, x = places
    near &= (x > _END) & (x < width - 1 - _END) & (y > _END) & (y < height - 1 - _END)
    return moved, seen & inside & wanted, seen & near & wanted


def _extend(values: np.ndarray, nearest: tuple[np.ndarray, ...], points: np.ndarray) -> np.ndarray:
    """Return a field at points (row, column), counted in those of the field; beyond measured ones along its plane.

    `nearest` are the indices of the measured points that are nearest to each.
    """
    at = np.nonzero(np.isfinite(values))
    few = slice(None, None, max(1, at[0].size // _PLANE_POINTS))
    rows, columns = (each[few] for each in at)
    basis = np.stack([np.ones(rows.size), rows, columns], axis=1)
    plane = np.linalg.lstsq(basis, values[rows, columns], rcond=None)[0].astype(f4)
    row, column = np.indices(values.shape, f4)
    rest = (values - (plane[0] + plane[1] * row + plane[2] * column))[nearest]
    along = plane[0] + plane[1] * points[0] + plane[2] * points[1]
    return np.asarray(along + map_coordinates(rest, points, order=1, mode="nearest"))


def _measure_border_distance(
    images: tuple[np.ndarray, np.ndarray], measured: np.ndarray, seen: np.ndarray, deviation: float
) -> np.ndarray:
    """Return the distance [px] of each pixel to the nearest area in which two images disagree; infinity without one."""
    fixed, moved = (_remove_shading(image, seen, measured, _FLAT * deviation) for image in images)
    apart = np.abs(moved - fixed)
    usual = float(np.quantile(apart[measured], 0.9)) / _NINE_TENTHS
    # of images without noise, what the interpolation leaves is no difference
    outliers = (seen & (apart > max(_OUTLIER * usual, np.sqrt(_FOREIGN_PART)))).astype(f4)
    disagree = _smooth(outliers, deviation) > f4(_DISAGREEING) * _smooth(seen.astype(f4), deviation)
    disagree &= seen
    if not disagree.any():
        return np.full(seen.shape, np.inf, f4)
    return np.asarray(cv2.distanceTransform((~disagree).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5))


def _remove_shading(image: np.ndarray, known: np.ndarray, measured: np.ndarray, deviation: float) -> np.ndarray:
    """Return an image as `_flatten` does, where its contrast is at least the usual one of the measured pixels.

    Bare surfaces keep a low contrast: their noise is no difference.
    """
    weight = np.maximum(_smooth(known.astype(f4), deviation), _TINY)
    values = np.where(known, image, 0).astype(f4)
    values = np.where(known, values - _smooth(values, deviation) / weight, 0).astype(f4)
    contrast = np.sqrt(_smooth(values**2, deviation) / weight)
    return np.asarray(values / np.maximum(contrast, max(float(np.median(contrast[measured])), float(_TINY))))


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
