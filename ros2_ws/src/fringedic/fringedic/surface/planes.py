"""Least-squares planes in a moving window: slopes of fields over (x, y), and their variance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numba import njit, prange
from scipy.ndimage import find_objects, label, maximum_filter

from fringedic.errors import SurfaceError
from fringedic.rig.reconstruction import pixel_positions
from fringedic.surface.masked_fit import fit_masked
from fringedic.surface.plane_sums import MINIMUM_COVERAGE, PlaneArrays, Samples, add_point, count_quantities, solve

WIDEST_WINDOW = 10_001  # [px]; wider than every image
_BLOCK = 64  # rows that share running sums; fixed, so that results do not depend on the number of threads


@dataclass(frozen=True)
class Planes:
    """Planes fitted around every point, NaN where the point or more than half of the window is not measured.

    Attributes
    ----------
    fields : (2 + field, row, column)
        x, y and the fitted fields.
    slopes : (field, 2, row, column)
        Derivatives of the fields by x and y.
    white : (3, row, column)
        Variances of the slopes by x and y and their covariance for errors of variance 1 that are independent from
        point to point [1/m^2].
    means : (number, row, column)
        Means over the window of the squares of the averaged fields, where they are known.
    centres : (2, row, column)
        Mean x and y of the points in the window.
    number : (row, column)
        Number of the points in the window.
    half : (rows, columns)
        Half-width of the window in points.
    spacing : (rows, columns)
        Distance of the points [px].
    """

    fields: np.ndarray
    slopes: np.ndarray
    white: np.ndarray
    means: np.ndarray
    centres: np.ndarray
    number: np.ndarray
    half: tuple[int, int]
    spacing: tuple[float, float]

    @property
    def width_px(self) -> tuple[float, float]:
        """Distance between the first and the last point of a window along rows and columns [px]."""
        return 2 * self.half[0] * self.spacing[0], 2 * self.half[1] * self.spacing[1]


def fit_planes(
    cloud: xr.Dataset,
    names: tuple[str, ...],
    window: int,
    averaged: tuple[str, ...] = (),
    discontinuous: np.ndarray | None = None,
) -> Planes:
    """Fit planes over ``x`` and ``y`` of a cloud to its fields `names`; average the squares of the fields `averaged`.

    Parameters
    ----------
    cloud
        From `couple`.
    names, averaged
        Of fields of the cloud.
    window
        Width of the window [px of the reference image].
    discontinuous
        Points beside a discontinuity, bool (row, column): they count as not measured, and a window contains only the
        points that measured ones connect with its centre (masked fit).

    Raises
    ------
    SurfaceError
        The window contains fewer than 3 x 3 points.
    """
    rows, columns = pixel_positions(cloud, cloud["x"].shape)
    half, spacing = zip(*(_half_width(window, positions) for positions in (rows, columns)), strict=True)
    arrays = [cloud.variables[name].values for name in ("x", "y", *names)]
    kind = np.result_type(np.float32, *arrays)
    fields = np.stack([np.asarray(each, kind) for each in arrays])
    known = np.isfinite(fields[0])
    for each in fields[1:]:
        known &= np.isfinite(each)
    if discontinuous is not None:
        known &= ~discontinuous
    squared = np.empty((len(averaged), *fields.shape[1:]), kind)
    for target, name in zip(squared, averaged, strict=True):
        np.square(np.asarray(cloud.variables[name].values, kind), out=target)
    middle = np.array([_average_sample(each[::8, ::8]) for each in fields])
    samples = Samples(fields, squared, middle, known)
    planes = PlaneArrays(
        np.empty((len(names), 2, *fields.shape[1:]), kind),
        np.empty((3, *fields.shape[1:]), kind),
        np.empty((len(averaged), *fields.shape[1:]), kind),
        np.empty((2, *fields.shape[1:]), kind),
        np.empty(fields.shape[1:], kind),
    )
    _fit(samples, half, planes)
    if discontinuous is not None and discontinuous.any():
        # Lines shorter than half a window cannot divide it.
        patches, _ = label(discontinuous, np.ones((3, 3)))
        long = np.zeros(discontinuous.shape, np.bool_)
        for number, place in enumerate(find_objects(patches), start=1):
            if any(part.stop - part.start > each for part, each in zip(place, half, strict=True)):
                long[place] |= patches[place] == number
        fit_masked(
            samples, maximum_filter(long, size=[2 * each + 1 for each in half], mode="constant") & known, half, planes
        )
    planes.centres[0] += kind.type(middle[0])
    planes.centres[1] += kind.type(middle[1])
    return Planes(fields, *planes, half, spacing)


def _average_sample(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean(dtype=float)) if known.size else 0.0


def spacing_of(positions: np.ndarray) -> float:
    """Return the distance of neighbouring positions [px], 1 for a single one."""
    return float(positions[1] - positions[0]) if len(positions) > 1 else 1.0


def _half_width(window: int, positions: np.ndarray) -> tuple[int, float]:
    spacing = spacing_of(positions)
    half = round((window - 1) / 2 / spacing)
    if half < 1:
        raise SurfaceError(
            f"a window of {window} px holds fewer than 3 points at a spacing of {spacing:g} px: widen it"
        )
    return half, spacing


@njit(cache=True, nogil=True, parallel=True)
def _fit(samples: Samples, half: tuple[int, int], planes: PlaneArrays) -> None:
    """Fit planes in whole windows, by running sums."""
    for block in prange((len(samples.known) + _BLOCK - 1) // _BLOCK):
        _fit_block(samples, half, block * _BLOCK, planes)


@njit(cache=True, nogil=True)
def _fit_block(samples: Samples, half: tuple[int, int], first: int, planes: PlaneArrays) -> None:
    """Fit the planes of a block of rows; the sums over the rows of a window move down with it."""
    rows, columns = samples.known.shape
    half_rows = half[0]
    sums = np.zeros((columns, count_quantities(samples)))
    for row in range(max(first - half_rows, 0), min(first + half_rows, rows)):
        _add_row(samples, row, 1.0, sums)
    for row in range(first, min(first + _BLOCK, rows)):
        if row + half_rows < rows:
            _add_row(samples, row + half_rows, 1.0, sums)
        if row > first and row - half_rows - 1 >= 0:
            _add_row(samples, row - half_rows - 1, -1.0, sums)
        _solve_row(sums, samples.known[row], half, row, planes)


@njit(cache=True, nogil=True)
def _solve_row(sums: np.ndarray, known: np.ndarray, half: tuple[int, int], row: int, planes: PlaneArrays) -> None:
    """Compute the planes of a row from the sums (column, quantity) over the rows of its windows."""
    columns, quantities = sums.shape
    half_columns = half[1]
    enough = MINIMUM_COVERAGE * (2 * half[0] + 1) * (2 * half_columns + 1)
    total = np.zeros(quantities)
    for column in range(min(half_columns, columns)):
        for k in range(quantities):
            total[k] += sums[column, k]
    for column in range(columns):
        if column + half_columns < columns:
            for k in range(quantities):
                total[k] += sums[column + half_columns, k]
        if column - half_columns - 1 >= 0:
            for k in range(quantities):
                total[k] -= sums[column - half_columns - 1, k]
        solve(total, enough if known[column] else np.inf, row, column, planes)


@njit(cache=True, nogil=True)
def _add_row(samples: Samples, row: int, sign: float, sums: np.ndarray) -> None:
    """Add a row to the sums (column, quantity), or subtract it."""
    for column in range(samples.known.shape[1]):
        if samples.known[row, column]:
            add_point(samples, row, column, sign, sums, column)
