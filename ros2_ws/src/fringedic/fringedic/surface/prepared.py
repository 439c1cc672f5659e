"""Preparation of a shape for coupling: smoothed height, and where the surface continues without a discontinuity."""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np
import xarray as xr
from numba import njit, prange

from fringedic.errors import CalibrationError, ImageError, SurfaceError
from fringedic.rig.model import RigModel
from fringedic.rig.reconstruction import pixel_positions
from fringedic.surface.coupling_kernels import SurfaceArrays
from fringedic.surface.height_offset import Curvature, set_offsets
from fringedic.wording.arguments import check_arguments, dataset, number, of_type, optional

# Standard deviations of a third difference of z beyond which a surface is discontinuous: 2e-9 of normal noise, so that
# no pixel of an image is lost by chance; test_nothing_leaks_over_a_step_of_the_surface.
JUMP = 6.0
_REACH = 3.0  # half-width of the Gaussian filter in standard deviations: 0.3 % of its weight is cut off

WIDEST_FILTER = 1000.0  # [px], standard deviation


class PreparedShape:
    """A shape that is prepared once for many couplings.

    Parameters
    ----------
    shape
        From `RigModel.reconstruct`, whole image or crop with unit steps of ``row`` and ``column``, containing ``x``,
        ``y``, ``z`` and ``noise_z`` [m], the part of sigma_z that is independent from pixel to pixel.
    z_filter
        As in `couple` [px].
    calibration
        Gives the distance of the camera; without it, the attribute ``camera_distance`` of the shape.

    Attributes
    ----------
    rows, columns : (row,), (column,)
        Pixel positions.
    rays : (2, row, column) float32
        Slopes of each pixel's line of sight: x = ray_x (z - h0), y = ray_y (z - h0).
    z, variance : (row, column) float32
        Smoothed height [m] and its variance [m^2].
    right, down : (row, column) bool
        The surface continues from this pixel to the next one of its row, of its column.
    camera_distance
        h0, height of the camera's pin-hole [m].
    calibration_identifier
        Of the calibration that the shape was made with, empty where unknown.
    z_filter
        Standard deviation of the Gaussian [px].

    Raises
    ------
    CalibrationError
        The shape was made with another calibration than the given one.
    SurfaceError
        Neither a calibration nor the attributes contain the distance of the camera, or the filter is negative or no
        number.
    ImageError
        x, y or noise_z differ in size from z.

    Examples
    --------
    >>> import numpy as np, xarray as xr
    >>> column, row = np.meshgrid(np.arange(40.0), np.arange(30.0))
    >>> noise = 1e-6 * np.random.default_rng(1).normal(size=row.shape)
    >>> fields = {"x": 1e-4 * column, "y": -1e-4 * row, "z": noise, "noise_z": 1e-6 + 0 * row}
    >>> shape = xr.Dataset({name: (("row", "column"), values) for name, values in fields.items()})
    >>> prepared = PreparedShape(shape.assign_attrs(camera_distance=0.5), z_filter=2.0)
    >>> round(1e6 * float(np.median(prepared.variance) ** 0.5), 2)  # standard deviation of z [µm], 1 before the filter
    0.15
    """

    @check_arguments(
        SurfaceError,
        shape=dataset("x", "y", "z", "noise_z"),
        z_filter=number(high=WIDEST_FILTER),
        calibration=optional(of_type(RigModel)),
    )
    def __init__(self, shape: xr.Dataset, *, z_filter: float = 0.0, calibration: RigModel | None = None) -> None:
        kernel = sample_gaussian(z_filter)
        self.z_filter = z_filter
        self.camera_distance = _camera_distance(shape, calibration)
        self.calibration_identifier = str(shape.attrs.get("calibration_identifier", ""))
        self.rows, self.columns = pixel_positions(shape, shape["z"].shape)
        z = np.ascontiguousarray(shape["z"], np.float32)
        x, y, sigma = (np.ascontiguousarray(shape[name], np.float32) for name in ("x", "y", "noise_z"))
        for name, each in (("x", x), ("y", y), ("noise_z", sigma)):
            if each.shape != z.shape:
                raise ImageError(f"{name} of shape {each.shape} for z of shape {z.shape}")
        self.rays = np.empty((2, *z.shape), np.float32)
        variance = np.empty_like(z)
        _compute_rays(x, y, z, sigma, self.camera_distance, self.rays, variance)
        # neither errors outside the sigmas (speckle seen through blur) nor the relief of one pixel is a discontinuity
        steps = np.diff(self.rays[0, :: max(1, len(self.rows) // 50)], axis=-1)
        steps = steps[np.isfinite(steps)]
        pixel_size = self.camera_distance * abs(float(np.median(steps))) if len(steps) else 0.0
        roughness = max(_measure_roughness(z), _measure_roughness(z.T), pixel_size / JUMP)
        self.right, self.down = np.zeros(z.shape, np.bool_), np.zeros(z.shape, np.bool_)
        _find_continuations(z, variance, np.float32(roughness), self.right, self.down)
        if len(kernel) > 1:
            kernel = kernel.astype(np.float32)
            sample = variance[::8, ::8][np.isfinite(z[::8, ::8])]
            typical = np.float32(np.median(sample)) if len(sample) else np.float32(np.nan)
            # close to 1, or the squares of the weights leave the range of float32
            weight = typical / variance if typical > 0 else np.ones_like(z)
            along_rows, smooth = (_Weighted(*(np.empty_like(z) for _ in range(4))) for _ in range(2))
            own = np.empty_like(z)  # not read in the first pass: single heights have no moment
            _filter(_Weighted(z, weight, weight, own), self.right, kernel, True, along_rows, along_rows.moment)
            _filter(along_rows, self.down, kernel, False, smooth, own)
            z, variance = smooth.z, np.asarray(typical * smooth.spread / (smooth.weight * smooth.weight))
            self._moments = smooth.moment, own  # of the weights along rows and along columns [px^2]
        self.z, self.variance = z, variance

    @property
    def arrays(self) -> SurfaceArrays:
        """Arrays for the kernels."""
        return SurfaceArrays(self.z, self.variance, self.right, self.down, self.rays)

    @cached_property
    def _curvature(self) -> Curvature:
        return Curvature.of(self.z, self.z_filter)

    def offsets(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return how far the filter has moved curved surfaces at points: smoothed height minus that of the surface.

        Parameters
        ----------
        rows, columns : (row,), (column,)
            Places of the points from the first pixel [px].

        Returns
        -------
        ndarray
            (row, column) float32 [m], 0 without a filter.
        """
        offsets = np.zeros((len(rows), len(columns)), np.float32)
        if self.z_filter > 0:
            set_offsets(self._curvature, *self._moments, rows, columns, offsets)
        return offsets


def _camera_distance(shape: xr.Dataset, calibration: RigModel | None) -> float:
    if calibration is not None:
        identifiers = (str(shape.attrs.get("calibration_identifier", "")), calibration.identifier)
        h0 = calibration.camera_distance
        distances = (float(shape.attrs.get("camera_distance", h0)), h0)
        require_one_calibration("a shape and the calibration given with it", identifiers, distances)
        return h0
    try:
        return float(shape.attrs["camera_distance"])
    except KeyError:
        raise SurfaceError(
            "the shape has no attribute camera_distance: give the calibration it was made with"
        ) from None


def require_one_calibration(whose: str, identifiers: tuple[str, str], distances: tuple[float, float]) -> None:
    """Require that two calibrations are the same, as far as they are known.

    Raises
    ------
    CalibrationError
        Their identifiers, where both are known, or the distances of the camera [m] differ.
    """
    if (all(identifiers) and identifiers[0] != identifiers[1]) or distances[0] != distances[1]:
        named = " and ".join(
            f"'{name}' (camera at {distance:.6g} m)" for name, distance in zip(identifiers, distances, strict=True)
        )
        raise CalibrationError(
            f"{whose} are of different calibrations, {named}: reconstruct both phases with the same one"
        )


def sample_gaussian(width: float) -> np.ndarray:
    """Return one half of a Gaussian from its centre on, not normalised; its centre alone for no filter.

    Raises
    ------
    SurfaceError
        The standard deviation `width` [px] is negative or no number.
    """
    if not math.isfinite(width) or width < 0:
        raise SurfaceError(f"z_filter is {width}: give its standard deviation in pixels, 0 for none")
    if width == 0:
        return np.ones(1)
    return np.exp(-0.5 * (np.arange(math.ceil(_REACH * width) + 1) / width) ** 2)


def _measure_roughness(z: np.ndarray) -> float:
    """Return the robust standard deviation of third differences along rows, 0 when there are none."""
    sample = z[:: max(1, len(z) // 100)]
    difference = np.abs(sample[:, 3:] - sample[:, :-3] - 3 * (sample[:, 2:-1] - sample[:, 1:-2]))
    difference = difference[np.isfinite(difference)]
    return 1.4826 * float(np.median(difference)) if len(difference) else 0.0


@njit(cache=True, nogil=True, parallel=True)
def _compute_rays(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    sigma: np.ndarray,
    camera_distance: float,
    rays: np.ndarray,
    variance: np.ndarray,
) -> None:
    """Compute the slopes of the lines of sight (2, row, column) and the variance of z."""
    for i in prange(z.shape[0]):
        for j in range(z.shape[1]):
            depth = z[i, j] - camera_distance
            rays[0, i, j] = x[i, j] / depth
            rays[1, i, j] = y[i, j] / depth
            variance[i, j] = sigma[i, j] * sigma[i, j]


@njit(cache=True, nogil=True)
def _is_small(
    a: np.float32, b: np.float32, c: np.float32, d: np.float32, inner: np.float32, outer: np.float32, floor: np.float32
) -> bool:
    """Tell whether the third difference of four heights is small against its noise."""
    third = d - a - np.float32(3) * (c - b)
    noise = outer + np.float32(9) * inner
    # noise that is not known, NaN, is not above the floor
    noise = noise if noise > floor else floor
    return bool(third * third <= np.float32(JUMP * JUMP) * noise)


@njit(cache=True, nogil=True, parallel=True)
def _find_continuations(
    z: np.ndarray, variance: np.ndarray, roughness: np.float32, right: np.ndarray, down: np.ndarray
) -> None:
    """Set for each pixel whether the surface continues to the next one, from four pixels; the arrays start as False."""
    rows, columns = z.shape
    floor = roughness * roughness
    for i in prange(rows):
        for j in range(1, columns - 2):
            right[i, j] = _is_small(
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
                down[i, j] = _is_small(
                    z[i - 1, j],
                    z[i, j],
                    z[i + 1, j],
                    z[i + 2, j],
                    variance[i, j] + variance[i + 1, j],
                    variance[i - 1, j] + variance[i + 2, j],
                    floor,
                )


class _Weighted(NamedTuple):
    """Heights with their weights, (row, column) float32.

    `weight` are inverse variances of z, or sums of them; `spread` are the variances of z times the squares of these
    sums. `moment` are the second moments of the weights along rows [px^2], which single heights do not have.
    """

    z: np.ndarray
    weight: np.ndarray
    spread: np.ndarray
    moment: np.ndarray


@njit(cache=True, nogil=True)
def _join(whole: np.ndarray, runs_before: np.ndarray, runs_after: np.ndarray) -> None:
    """Keep the pixels whose surface continues to the next pair of neighbours."""
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
def _add_both(factor: np.float32, whole: np.ndarray, before: np.ndarray, after: np.ndarray, sums: np.ndarray) -> None:
    """Add a pair of neighbours to a sum: of squared weights times variances, or of weights times squared distances."""
    for j in range(len(whole)):
        sums[j] += factor * (before[j] + after[j]) if whole[j] else np.float32(0)


@njit(cache=True, nogil=True)
def _add_moments(
    share: np.float32,
    whole: np.ndarray,
    of_before: np.ndarray,
    of_after: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    sums: np.ndarray,
) -> None:
    """Add a pair of neighbours to the sum of weighted moments of another direction."""
    for j in range(len(whole)):
        sums[j] += share * (before[j] * of_before[j] + after[j] * of_after[j]) if whole[j] else np.float32(0)


@njit(cache=True, nogil=True, parallel=True)
def _filter(
    source: _Weighted,
    runs_on: np.ndarray,
    kernel: np.ndarray,
    along_rows: bool,
    result: _Weighted,
    own_moment: np.ndarray,
) -> None:
    """Compute the weighted mean over the neighbours on both sides of each pixel, as far as the surface continues.

    The weight of a neighbour is that of its noise: dark speckles have many times the variance of their surroundings.
    The weighted mean of the heights belongs to the weighted mean of their places; the unweighted slope of the same
    neighbours corrects it to the place of the pixel. `own_moment` becomes the second moment along this direction.
    """
    z, weight, spread, moment = source
    smooth, total, spreads, moments = result  # Numba loses what is written to fields of a named tuple inside prange
    rows, columns = z.shape
    for i in prange(rows):
        sum_w, sum_wz, sum_s = (
            np.empty(columns, np.float32),
            np.empty(columns, np.float32),
            np.empty(columns, np.float32),
        )
        sum_wk, rise = np.zeros(columns, np.float32), np.zeros(columns, np.float32)
        sum_wkk, sum_wm = np.zeros(columns, np.float32), np.zeros(columns, np.float32)
        length, whole = np.zeros(columns, np.float32), np.ones(columns, np.bool_)
        for j in range(columns):
            sum_w[j] = kernel[0] * weight[i, j]
            sum_wz[j] = kernel[0] * weight[i, j] * z[i, j]
            sum_s[j] = kernel[0] * kernel[0] * spread[i, j]
            sum_wm[j] = np.float32(0) if along_rows else kernel[0] * weight[i, j] * moment[i, j]
        for k in range(1, len(kernel)):
            share, distance = kernel[k], np.float32(k)
            if along_rows and 2 * k < columns:
                inner, first, last = slice(k, columns - k), slice(0, columns - 2 * k), slice(2 * k, columns)
                joined, before, after = whole[inner], weight[i, first], weight[i, last]
                _join(joined, runs_on[i, first], runs_on[i, 2 * k - 1 : columns - 1])
                _add_rise(distance, joined, z[i, first], z[i, last], rise[inner], length[inner])
                _add_mean(share, joined, z[i, first], z[i, last], before, after, sum_w[inner], sum_wz[inner])
                _add_places(share * distance, joined, before, after, sum_wk[inner])
                _add_both(share * distance * distance, joined, before, after, sum_wkk[inner])
                _add_both(share * share, joined, spread[i, first], spread[i, last], sum_s[inner])
            elif not along_rows and i - k >= 0 and i + k < rows:
                _join(whole, runs_on[i - k], runs_on[i + k - 1])
                _add_rise(distance, whole, z[i - k], z[i + k], rise, length)
                _add_mean(share, whole, z[i - k], z[i + k], weight[i - k], weight[i + k], sum_w, sum_wz)
                _add_places(share * distance, whole, weight[i - k], weight[i + k], sum_wk)
                _add_both(share * distance * distance, whole, weight[i - k], weight[i + k], sum_wkk)
                _add_moments(share, whole, moment[i - k], moment[i + k], weight[i - k], weight[i + k], sum_wm)
                _add_both(share * share, whole, spread[i - k], spread[i + k], sum_s)
        for j in range(columns):
            slope = rise[j] / max(length[j], np.float32(1))
            smooth[i, j] = (sum_wz[j] - slope * sum_wk[j]) / sum_w[j]
            total[i, j] = sum_w[j]
            spreads[i, j] = sum_s[j]
            if not along_rows:
                moments[i, j] = sum_wm[j] / sum_w[j]
            own_moment[i, j] = sum_wkk[j] / sum_w[j]
