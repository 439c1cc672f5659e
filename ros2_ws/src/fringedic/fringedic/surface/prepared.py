"""A shape made ready for coupling: its height smoothed, and where the surface runs on without a tear."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numba import njit, prange

from fringedic.errors import CalibrationMismatchError, InvalidWindowError, RaysMissingError, ShapeMismatchError
from fringedic.rig import RigModel, pixel_positions

JUMP = 6.0  # standard deviations of a third difference beyond which a surface is torn
_REACH = 3.0  # half-width of the Gaussian filter in standard deviations


class PreparedShape:
    """A shape prepared once for many couplings.

    Parameters
    ----------
    shape
        From `RigModel.reconstruct`, whole image or crop with unit steps of ``row`` and ``column``; used are ``x``,
        ``y``, ``z`` and ``noise_z`` [m], the part of sigma_z that differs from pixel to pixel.
    z_filter
        As in `couple`.
    calibration
        Where the camera's distance comes from; without, from the attribute ``camera_distance`` of the shape.

    Attributes
    ----------
    rows, columns : (row,), (column,)
        Pixel positions.
    rays : (2, row, column)
        Slope of each pixel's line of sight: x = ray_x (z - h0), y = ray_y (z - h0).
    z, variance : (row, column)
        Smoothed height [m] and its variance [m^2].
    right, down : (row, column) bool
        The surface runs on from this pixel to the next one of its row, of its column.
    camera_distance
        h0, height of the camera's pin-hole [m].
    calibration_identifier
        Of the calibration that the shape was made with, empty where it is not told.
    z_filter
        Standard deviation of the Gaussian [px].

    Raises
    ------
    CalibrationMismatchError
        When the shape was made with another calibration than the given one.
    RaysMissingError
        When neither a calibration nor the attributes tell the camera's distance.
    ShapeMismatchError
        When x, y or noise_z differ in size from z.
    InvalidWindowError
        When the filter is negative or no number.
    """

    def __init__(self, shape: xr.Dataset, *, z_filter: float = 0.0, calibration: RigModel | None = None) -> None:
        kernel = gaussian(z_filter)
        self.z_filter = z_filter
        self.camera_distance = _camera_distance(shape, calibration)
        self.calibration_identifier = str(shape.attrs.get("calibration_identifier", ""))
        self.rows, self.columns = pixel_positions(shape, shape["z"].shape)
        z = np.ascontiguousarray(shape["z"], np.float32)
        x, y, sigma = (np.ascontiguousarray(shape[name], np.float32) for name in ("x", "y", "noise_z"))
        for name, each in (("x", x), ("y", y), ("noise_z", sigma)):
            if each.shape != z.shape:
                raise ShapeMismatchError(f"{name} of shape {each.shape} for z of shape {z.shape}")
        self.rays = np.empty((2, *z.shape), np.float32)
        variance = np.empty_like(z)
        _rays(x, y, z, sigma, self.camera_distance, self.rays, variance)
        # neither what the sigmas do not know of (speckle seen through blur) nor the relief of one pixel is a tear
        roughness = max(_roughness(z), _roughness(z.T), self._pixel_size() / JUMP)
        self.right, self.down = np.zeros(z.shape, np.bool_), np.zeros(z.shape, np.bool_)
        _runs_on(z, variance, np.float32(roughness), self.right, self.down)
        if len(kernel) > 1:
            z, variance = _smooth(z, variance, self.right, self.down, kernel.astype(np.float32))
        self.z, self.variance = z, variance

    def _pixel_size(self) -> float:
        """Return the width of a column on the reference plane [m], 0 when no two neighbours are measured."""
        steps = np.diff(self.rays[0, :: max(1, len(self.rows) // 50)], axis=-1)
        steps = steps[np.isfinite(steps)]
        return self.camera_distance * abs(float(np.median(steps))) if len(steps) else 0.0


def _camera_distance(shape: xr.Dataset, calibration: RigModel | None) -> float:
    if calibration is not None:
        identifiers = (str(shape.attrs.get("calibration_identifier", "")), calibration.identifier)
        h0 = calibration.camera_distance
        distances = (float(shape.attrs.get("camera_distance", h0)), h0)
        require_one_calibration("a shape and what is given with it", identifiers, distances)
        return h0
    try:
        return float(shape.attrs["camera_distance"])
    except KeyError:
        raise RaysMissingError(
            "the shape has no attribute camera_distance: give the calibration it was made with"
        ) from None


def require_one_calibration(whose: str, identifiers: tuple[str, str], distances: tuple[float, float]) -> None:
    """Raise CalibrationMismatchError when two calibrations differ, as far as they are told."""
    if (all(identifiers) and identifiers[0] != identifiers[1]) or distances[0] != distances[1]:
        told = " and ".join(
            f"'{name}' (camera at {distance:.6g} m)" for name, distance in zip(identifiers, distances, strict=True)
        )
        raise CalibrationMismatchError(
            f"{whose} are of different calibrations, {told}: reconstruct both phases with the same one"
        )


def gaussian(width: float) -> np.ndarray:
    """Return one half of a Gaussian from its centre on, not normalised; its centre alone for no filter."""
    if not math.isfinite(width) or width < 0:
        raise InvalidWindowError(f"z_filter is {width}: give its standard deviation in pixels, 0 for none")
    if width == 0:
        return np.ones(1)
    return np.exp(-0.5 * (np.arange(math.ceil(_REACH * width) + 1) / width) ** 2)


def _roughness(z: np.ndarray) -> float:
    """Return the robust standard deviation of third differences along rows, 0 when there are none."""
    sample = z[:: max(1, len(z) // 100)]
    difference = np.abs(sample[:, 3:] - sample[:, :-3] - 3 * (sample[:, 2:-1] - sample[:, 1:-2]))
    difference = difference[np.isfinite(difference)]
    return 1.4826 * float(np.median(difference)) if len(difference) else 0.0


@njit(cache=True, nogil=True, parallel=True)
def _rays(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    sigma: np.ndarray,
    camera_distance: float,
    rays: np.ndarray,
    variance: np.ndarray,
) -> None:
    for i in prange(z.shape[0]):
        for j in range(z.shape[1]):
            depth = z[i, j] - camera_distance
            rays[0, i, j] = x[i, j] / depth
            rays[1, i, j] = y[i, j] / depth
            variance[i, j] = sigma[i, j] * sigma[i, j]


@njit(cache=True, nogil=True)
def _small(
    a: np.float32, b: np.float32, c: np.float32, d: np.float32, inner: np.float32, outer: np.float32, floor: np.float32
) -> bool:
    """Tell whether the third difference of four heights is small against its noise."""
    third = d - a - np.float32(3) * (c - b)
    noise = outer + np.float32(9) * inner
    # a noise that is not known, NaN, is not larger either
    noise = noise if noise > floor else floor
    return bool(third * third <= np.float32(JUMP * JUMP) * noise)


@njit(cache=True, nogil=True, parallel=True)
def _runs_on(z: np.ndarray, variance: np.ndarray, roughness: np.float32, right: np.ndarray, down: np.ndarray) -> None:
    """Tell for each pixel whether the surface runs on to the next one, judged by four pixels; starts from False."""
    rows, columns = z.shape
    floor = roughness * roughness
    for i in prange(rows):
        for j in range(1, columns - 2):
            right[i, j] = _small(
                z[i, j - 1],
                z[i, j],
                z[i, j + 1],
                z[i, j + 2],
                variance[i, j] + variance[i, j + 1],
                variance[i, j - 1] + variance[i, j + 2],
                floor,
            )
        if 1 <= i < rows - 2:
            for j in range(columns):
                down[i, j] = _small(
                    z[i - 1, j],
                    z[i, j],
                    z[i + 1, j],
                    z[i + 2, j],
                    variance[i, j] + variance[i + 1, j],
                    variance[i - 1, j] + variance[i + 2, j],
                    floor,
                )


def _smooth(
    z: np.ndarray, variance: np.ndarray, right: np.ndarray, down: np.ndarray, kernel: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return z and its variance, smoothed along rows and then along columns."""
    sample = variance[::8, ::8][np.isfinite(z[::8, ::8])]
    typical = np.float32(np.median(sample)) if len(sample) else np.float32(np.nan)
    # close to 1, or the squares of the weights leave the range of float32
    weight = typical / variance if typical > 0 else np.ones_like(z)
    z_rows, weight_rows, spread_rows = np.empty_like(z), np.empty_like(z), np.empty_like(z)
    _filter(z, weight, weight, right, kernel, True, z_rows, weight_rows, spread_rows)
    smooth, total, spread = np.empty_like(z), np.empty_like(z), np.empty_like(z)
    _filter(z_rows, weight_rows, spread_rows, down, kernel, False, smooth, total, spread)
    return smooth, typical * spread / (total * total)


@njit(cache=True, nogil=True)
def _join(whole: np.ndarray, runs_before: np.ndarray, runs_after: np.ndarray) -> None:
    """Keep the pixels whose surface runs on to the next pair of neighbours as well."""
    for j in range(len(whole)):
        whole[j] = whole[j] & runs_before[j] & runs_after[j]


@njit(cache=True, nogil=True)
def _add_rise(
    distance: np.float32, whole: np.ndarray, before: np.ndarray, after: np.ndarray, rise: np.ndarray, length: np.ndarray
) -> None:
    """Add a pair of heights to the sums whose ratio is the slope."""
    zero, twice = np.float32(0), np.float32(2) * distance * distance
    for j in range(len(whole)):
        rise[j] += distance * (after[j] - before[j]) if whole[j] else zero
        length[j] += twice if whole[j] else zero


@njit(cache=True, nogil=True)
def _add_mean(
    share: np.float32,
    whole: np.ndarray,
    z_before: np.ndarray,
    z_after: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    total: np.ndarray,
    mean: np.ndarray,
) -> None:
    """Add a pair of neighbours to the sums of weights and of weighted heights."""
    zero = np.float32(0)
    for j in range(len(whole)):
        total[j] += share * (before[j] + after[j]) if whole[j] else zero
        mean[j] += share * (before[j] * z_before[j] + after[j] * z_after[j]) if whole[j] else zero


@njit(cache=True, nogil=True)
def _add_places(factor: np.float32, whole: np.ndarray, before: np.ndarray, after: np.ndarray, sums: np.ndarray) -> None:
    """Add a pair of neighbours to the sum of weighted distances."""
    for j in range(len(whole)):
        sums[j] += factor * (after[j] - before[j]) if whole[j] else np.float32(0)


@njit(cache=True, nogil=True)
def _add_spread(factor: np.float32, whole: np.ndarray, before: np.ndarray, after: np.ndarray, sums: np.ndarray) -> None:
    """Add a pair of neighbours to the sum of squared weights times variances."""
    for j in range(len(whole)):
        sums[j] += factor * (before[j] + after[j]) if whole[j] else np.float32(0)


@njit(cache=True, nogil=True, parallel=True)
def _filter(
    z: np.ndarray,
    weight: np.ndarray,
    spread: np.ndarray,
    runs_on: np.ndarray,
    kernel: np.ndarray,
    along_rows: bool,
    smooth: np.ndarray,
    total: np.ndarray,
    spreads: np.ndarray,
) -> None:
    """Weighted mean over the neighbours on both sides of each pixel, as far as both sides run on.

    A neighbour weighs as much as its noise allows: dark speckles have many times the variance of their surroundings.
    The weighted mean of the heights stands at the weighted mean of their places; the slope of the same neighbours,
    without weights, brings it back to the pixel.

    `weight` are inverse variances of z, or sums of them; `spread` are the variances of z times the squares of these
    sums. `smooth`, `total` and `spreads` are the same after filtering.
    """
    rows, columns = z.shape
    for i in prange(rows):
        sum_w, sum_wz, sum_s = (
            np.empty(columns, np.float32),
            np.empty(columns, np.float32),
            np.empty(columns, np.float32),
        )
        sum_wk, rise = np.zeros(columns, np.float32), np.zeros(columns, np.float32)
        length, whole = np.zeros(columns, np.float32), np.ones(columns, np.bool_)
        for j in range(columns):
            sum_w[j] = kernel[0] * weight[i, j]
            sum_wz[j] = kernel[0] * weight[i, j] * z[i, j]
            sum_s[j] = kernel[0] * kernel[0] * spread[i, j]
        for k in range(1, len(kernel)):
            share, distance = kernel[k], np.float32(k)
            if along_rows and 2 * k < columns:
                inner, first, last = slice(k, columns - k), slice(0, columns - 2 * k), slice(2 * k, columns)
                joined, before, after = whole[inner], weight[i, first], weight[i, last]
                _join(joined, runs_on[i, first], runs_on[i, 2 * k - 1 : columns - 1])
                _add_rise(distance, joined, z[i, first], z[i, last], rise[inner], length[inner])
                _add_mean(share, joined, z[i, first], z[i, last], before, after, sum_w[inner], sum_wz[inner])
                _add_places(share * distance, joined, before, after, sum_wk[inner])
                _add_spread(share * share, joined, spread[i, first], spread[i, last], sum_s[inner])
            elif not along_rows and i - k >= 0 and i + k < rows:
                _join(whole, runs_on[i - k], runs_on[i + k - 1])
                _add_rise(distance, whole, z[i - k], z[i + k], rise, length)
                _add_mean(share, whole, z[i - k], z[i + k], weight[i - k], weight[i + k], sum_w, sum_wz)
                _add_places(share * distance, whole, weight[i - k], weight[i + k], sum_wk)
                _add_spread(share * share, whole, spread[i - k], spread[i + k], sum_s)
        for j in range(columns):
            slope = rise[j] / max(length[j], np.float32(1))
            smooth[i, j] = (sum_wz[j] - slope * sum_wk[j]) / sum_w[j]
            total[i, j] = sum_w[j]
            spreads[i, j] = sum_s[j]
