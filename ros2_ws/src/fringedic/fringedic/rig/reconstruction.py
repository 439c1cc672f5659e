"""Reconstruction of the surface: the line of sight of every pixel is intersected with its fringe."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numba import njit, prange

from fringedic.errors import ImageError
from fringedic.patterns.pattern import Orientation
from fringedic.rig.geometry import RigGeometry
from fringedic.rig.projector_lens import ProjectorLens, distorted
from fringedic.rig.uncertainty import GRID, HEIGHT_INTERVALS, variance_map

_NEWTON_STEPS = 6  # from the undistorted intersection; two or three are usually enough
_NEWTON_ENDS = 1e-7  # relative size of the last step: convergence is quadratic, the next step would be 1e-14
_distorted = njit(cache=True, nogil=True)(distorted)
_NO_FIELD = np.empty((2, 0, 0), np.float32)
_NO_FIELD.setflags(write=False)  # like the field of a lens, so that Numba compiles one variant


class _Sight(NamedTuple):
    """Lines of sight, camera + t direction, as the kernel needs them.

    ``to_ideal`` is the field (2, row, column) from pixels to ideal pixels, or empty without a distortion. The matrices
    take an ideal (column, row, 1) to a direction in the rig frame and in the projector's axes (across the fringes,
    along them, backward); ``camera_in_projector`` is the camera's pin-hole in these axes.
    """

    rows: np.ndarray
    columns: np.ndarray
    to_ideal: np.ndarray
    ray_matrix: np.ndarray
    ray_in_projector: np.ndarray
    camera_in_projector: np.ndarray
    camera_distance: float


class _Fringes(NamedTuple):
    """Fringes ``distorted(m, n) = scale phi + axis`` in normalised coordinates of the projector; m is across them."""

    scale: float
    axis: float
    curved: bool
    lens: ProjectorLens


class _Variances(NamedTuple):
    """Variances due to the calibration, on the grid of `fringedic.rig.uncertainty.variance_map`, or empty.

    ``row_places`` and ``column_places`` are the pixels in intervals of the grid, ``borders`` the indices of the columns
    at which its cells begin.
    """

    coefficients: np.ndarray
    height: float
    row_places: np.ndarray
    column_places: np.ndarray
    borders: np.ndarray


def pixel_positions(image: np.ndarray | xr.DataArray | xr.Dataset, shape: tuple[int, ...]) -> tuple[np.ndarray, ...]:
    """Return the rows and the columns [px] of an image: its coordinates, or a count from 0 without coordinates."""
    coordinates: Mapping[Any, Any] = image.coords if isinstance(image, xr.DataArray | xr.Dataset) else {}
    return tuple(
        np.asarray(coordinates[name], float) if name in coordinates else np.arange(length, dtype=float)
        for name, length in zip(("row", "column"), shape, strict=True)
    )


def reconstruct_surface(
    geometry: RigGeometry,
    phase: np.ndarray | xr.DataArray,
    pitch: float,
    sigma_phase: np.ndarray | xr.DataArray | None,
    orientation: Orientation,
) -> xr.Dataset:
    """Return the surface of a phase map; see `fringedic.RigModel.reconstruct`.

    Raises
    ------
    ImageError
        The phase is not an image (row, column), or sigma has another shape.
    """
    image = np.asarray(phase)
    if image.ndim != 2:
        raise ImageError(f"phase of shape {image.shape}: an image (row, column) is needed")
    if image.dtype != np.float32:
        image = image.astype(float)
    sigma = np.full(image.shape, np.nan, image.dtype) if sigma_phase is None else np.asarray(sigma_phase, image.dtype)
    if sigma.shape != image.shape:
        raise ImageError(f"sigma of shape {sigma.shape} for a phase of shape {image.shape}")
    image, sigma = _read_only(image), _read_only(sigma)
    row, column = pixel_positions(phase, image.shape)
    lens = geometry.projector_lens(orientation)
    result = np.empty((8, *image.shape), image.dtype)
    # the projector's axes in the order: across the fringes, along them, backward
    axes = geometry.projector_axes.T[[0, 1, 2] if orientation == Orientation.VERTICAL else [1, 0, 2]]
    distortion = geometry.camera_distortion
    unknown = (np.empty((0, 0, 3, HEIGHT_INTERVALS, 4)), 1.0)
    coefficients, height = variance_map(geometry, orientation) if geometry.covariance else unknown
    reconstruct_image(
        image,
        sigma,
        _Sight(
            _read_only(row),
            _read_only(column),
            _NO_FIELD if distortion is None else distortion.field(row, column),
            geometry.ray_matrix,
            axes @ geometry.ray_matrix,
            axes @ (np.array([0.0, 0.0, geometry.camera_distance]) - geometry.projector_position),
            geometry.camera_distance,
        ),
        _Fringes(*geometry.fringe_scale(pitch, orientation), any(lens), lens),
        _Variances(
            coefficients,
            height,
            np.clip(row / (geometry.camera_height - 1), 0, 1) * GRID,
            (np.clip(column / (geometry.camera_width - 1), 0, 1) * GRID).astype(image.dtype),
            np.searchsorted(column, np.linspace(0, geometry.camera_width - 1, GRID + 1)[1:-1]),
        ),
        result,
    )
    names = ("x", "y", "z", "sigma_x", "sigma_y", "sigma_z", "noise_z")
    units = dict.fromkeys(names, "m") | {"dz_dphi": "m/rad"}
    return xr.Dataset(
        {
            name: (("row", "column"), values, {"units": unit})
            for (name, unit), values in zip(units.items(), result, strict=True)
        },
        coords={"row": row, "column": column},
        attrs={
            "camera_distance": geometry.camera_distance,
            "ray_matrix": geometry.ray_matrix.ravel().tolist(),
            "calibration_identifier": geometry.identifier,
        },
    )


def _read_only(array: np.ndarray) -> np.ndarray:
    """Return an array as Numba compiles one variant for: those of messages are read-only, those of a fit are not."""
    view = np.ascontiguousarray(array).view()
    view.setflags(write=False)
    return view


@njit(cache=True, nogil=True, parallel=True)
def reconstruct_image(
    phase: np.ndarray, sigma: np.ndarray, sight: _Sight, fringes: _Fringes, variances: _Variances, result: np.ndarray
) -> None:
    """Intersect the line of sight of every pixel with its fringe.

    ``result`` (8, row, column) receives x, y, z, their three sigmas, the part of sigma_z that is the noise of the
    phase [m], and dz/dphi [m/rad].
    """
    rows, columns, to_ideal = sight.rows, sight.columns, sight.to_ideal
    ray_matrix, ray_in_projector = sight.ray_matrix, sight.ray_in_projector
    camera_distance = sight.camera_distance
    camera_m, camera_n, camera_back = sight.camera_in_projector
    scale, axis, curved = fringes.scale, fringes.axis, fringes.curved
    k1, k2, k3, p, q = fringes.lens  # tuples cannot be used inside the parallel loop
    coefficients, height, borders = variances.coefficients, variances.height, variances.borders
    row_places, column_places = variances.row_places, variances.column_places
    distorted = to_ideal.size > 0
    for i in prange(phase.shape[0]):
        for j in range(phase.shape[1]):
            r, s = columns[j], rows[i]
            if distorted:
                r += to_ideal[0, i, j]
                s += to_ideal[1, i, j]
            dx = ray_matrix[0, 0] * r + ray_matrix[0, 1] * s + ray_matrix[0, 2]
            dy = ray_matrix[1, 0] * r + ray_matrix[1, 1] * s + ray_matrix[1, 2]
            dz = ray_matrix[2, 0] * r + ray_matrix[2, 1] * s + ray_matrix[2, 2]
            g_m = ray_in_projector[0, 0] * r + ray_in_projector[0, 1] * s + ray_in_projector[0, 2]
            g_n = ray_in_projector[1, 0] * r + ray_in_projector[1, 1] * s + ray_in_projector[1, 2]
            g_back = ray_in_projector[2, 0] * r + ray_in_projector[2, 1] * s + ray_in_projector[2, 2]
            target = scale * phase[i, j] + axis
            denominator = g_m + target * g_back
            t = -(camera_m + target * camera_back) / denominator
            slope = -denominator / (camera_back + t * g_back)
            if curved:
                for _ in range(_NEWTON_STEPS):
                    inverse = -1.0 / (camera_back + t * g_back)
                    m = (camera_m + t * g_m) * inverse
                    n = (camera_n + t * g_n) * inverse
                    m_t = (g_m + m * g_back) * inverse
                    n_t = (g_n + n * g_back) * inverse
                    seen, by_m, by_n = _distorted(m, n, k1, k2, k3, p, q)
                    slope = by_m * m_t + by_n * n_t
                    step = (seen - target) / slope
                    t -= step
                    if abs(step) < _NEWTON_ENDS * abs(t):
                        break
            growth = scale / slope
            noise = abs(growth) * sigma[i, j]
            z = camera_distance + t * dz
            result[0, i, j] = t * dx
            result[1, i, j] = t * dy
            result[2, i, j] = z
            result[3, i, j] = abs(dx) * noise
            result[4, i, j] = abs(dy) * noise
            result[5, i, j] = abs(dz) * noise
            result[6, i, j] = abs(dz) * noise
            result[7, i, j] = dz * growth
        if coefficients.size > 0:
            # a parallel loop counts in uint64, which the function would be compiled for beside int64
            _add_variances(result, np.int64(i), row_places[i], borders, column_places, coefficients, height)


@njit(cache=True, nogil=True)
def _add_variances(
    result: np.ndarray,
    i: np.int64,
    place: float,
    borders: np.ndarray,
    where: np.ndarray,
    variances: np.ndarray,
    height: float,
) -> None:
    """Add the variances of the calibration to the sigmas of one row, cell by cell."""
    intervals = variances.shape[3]
    zero, highest = result.dtype.type(0.0), result.dtype.type(intervals)
    middle, per_height = result.dtype.type(intervals / 2), result.dtype.type(intervals / (2.0 * height))
    above = min(int(place), variances.shape[0] - 2)
    share = place - above
    cells = variances.shape[1] - 1
    at = ((1.0 - share) * variances[above] + share * variances[above + 1]).astype(result.dtype)
    to = at[1:] - at[:-1]
    heights = result[2, i]
    for k in range(3):
        sigmas = result[3 + k, i]
        for cell in range(cells):
            first = 0 if cell == 0 else borders[cell - 1]
            end = result.shape[2] if cell == cells - 1 else borders[cell]
            begin = result.dtype.type(cell)  # an integer would promote everything to 64 bits
            left, growth = at[cell, k], to[cell, k]
            for j in range(first, end):
                along = where[j] - begin
                z = middle + heights[j] * per_height
                z = z if z > zero else zero  # and where the height is not known
                z = z if z < highest else highest
                interval = min(np.int64(z), intervals - 1)
                part = z - result.dtype.type(interval)
                a, b = left[interval], growth[interval]
                variance = a[3] + along * b[3]
                for power in range(2, -1, -1):
                    variance = variance * part + (a[power] + along * b[power])
                variance = zero if variance < zero else variance
                sigmas[j] = np.sqrt(sigmas[j] * sigmas[j] + variance)
