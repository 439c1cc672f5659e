"""One surface of several sensors: shape, displacement and strain on one map, and how well the sensors agree."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from fringedic.datasets.attributes import parameters_of, recorded_calibration, sensor_of
from fringedic.datasets.quantities import ALL_MAPS
from fringedic.errors import CalibrationError, DatasetError
from fringedic.frames.sensor import JOINED
from fringedic.rig.model import RigModel
from fringedic.sensors.charts import Chart, choose_chart, is_closed
from fringedic.sensors.join_strain import strain_maps
from fringedic.sensors.poses import rotation_errors
from fringedic.sensors.registration import Registration
from fringedic.sensors.windows import window_slopes

SENSOR_ERRORS = "sensor_errors"
"""Attribute of a joined dataset: reasons of failed parts by step and sensor, as JSON."""
_BLEND = 40  # points from the border of a sensor's part over which its weight grows
_SLOPE_HALF = 2  # points, of the slopes that carry a value to a point of the map
_IN_PLANE_HALF = 5
_REGULAR = 1e-6  # of the variance: directions without noise are weighted as if they had so much
_EXACT = 20_000  # points at which common errors are propagated; they are smooth
_MOTION = ("u", "v", "w")
_OF_ONE_SENSOR = ("confirmed_fraction",)
_SOURCES = ("noise_z", "noise_z_deformed", "displacement_sigma_x", "displacement_sigma_y")
_NEEDED = ("x", "y", "z", *_MOTION, *_SOURCES, *(f"sigma_{each}" for each in _MOTION))


@dataclass(frozen=True, eq=False)
class _Grid:
    """The points of the map: coordinates a, b (row, column) of its chart [m]."""

    chart: Chart
    a: np.ndarray
    b: np.ndarray
    spacing: float
    closed: bool


@dataclass(eq=False)
class _Part:
    """What one sensor contributes: its reference surface, and which of its points is next to each point of the map."""

    sensor: str
    dataset: xr.Dataset
    model: RigModel
    turn: np.ndarray
    points: np.ndarray  # (3, row, column) own rig frame
    chart: np.ndarray = field(init=False)  # a, b, height (3, row, column)
    index: np.ndarray = field(init=False)  # of the nearest point, by point of the map; -1 where there is none
    offset: np.ndarray = field(init=False)  # from it to the point of the map (2, row, column)
    height: np.ndarray = field(init=False)
    taper: np.ndarray = field(init=False)

    def place(self, grid: _Grid, common: np.ndarray) -> None:
        """Find the nearest measured point of each point of the map."""
        known = np.isfinite(common).all(axis=0)
        middle = 0.0
        if not grid.chart.is_plane:
            angle = grid.chart.coordinates(common)[0][known] / grid.chart.radius
            middle = grid.chart.radius * math.atan2(float(np.sin(angle).mean()), float(np.cos(angle).mean()))
        self.chart = grid.chart.coordinates(common, middle)
        a = grid.a
        if not grid.chart.is_plane:
            turns = np.round((a - middle) / grid.chart.circumference)
            a = a - turns * grid.chart.circumference
        where = np.flatnonzero(known)
        tree = cKDTree(self.chart[:2].reshape(2, -1)[:, where].T)
        reach = 0.9 * grid.spacing
        distance, nearest = tree.query(np.stack([a.ravel(), grid.b.ravel()], axis=1), distance_upper_bound=reach)
        found = np.isfinite(distance)
        index = np.full(a.size, -1)
        index[found] = where[np.asarray(nearest)[found]]
        self.index = index.reshape(a.shape)
        at = self.chart[:2].reshape(2, -1)[:, self.index]
        self.offset = np.where(self.index >= 0, np.stack([a, grid.b]) - at, np.nan)
        inside = np.pad(self.index >= 0, 1)
        if grid.closed:
            inside[:, 0], inside[:, -1] = inside[:, -2], inside[:, 1]
        depth = distance_transform_edt(inside)[1:-1, 1:-1]
        t = np.clip(depth / _BLEND, 0.0, 1.0)
        self.taper = t * t * (3.0 - 2.0 * t)
        self.height = self.carried(self.chart[2][None])[0]

    def carried(self, fields: np.ndarray) -> np.ndarray:
        """Return fields (field, row, column) of the sensor at the points of the map.

        The nearest value, carried along the slopes around it: unlike an interpolation it has the noise of one point.
        """
        known = np.isfinite(fields).all(axis=0) & np.isfinite(self.chart).all(axis=0)
        slopes = window_slopes(self.chart[0], self.chart[1], fields, known, _SLOPE_HALF).values
        slopes = np.where(np.isfinite(slopes), slopes, 0.0)
        values: np.ndarray = self.nearest(fields) + (self.nearest(slopes) * self.offset).sum(axis=1)
        return values

    def nearest(self, fields: np.ndarray) -> np.ndarray:
        """Return the nearest values of fields (..., row, column) at the points of the map."""
        values = fields.reshape(*fields.shape[:-2], -1)[..., self.index]
        return np.where(self.index >= 0, values, np.nan)

    @property
    def repeated(self) -> np.ndarray:
        """How often the point that is next to a point of the map is used; more than once at a grazing angle."""
        used = np.bincount(self.index[self.index >= 0], minlength=1)
        return np.where(self.index >= 0, used[self.index], 1)

    def sources(self, step: xr.Dataset) -> np.ndarray:
        """Return the independent errors of the displacement at the points of the map, (4, 3, row, column) [m].

        Noise of the height before and after, along the lines of sight, and of the displacement by a column and a row.
        """
        x, y, z, u, v, w = (_map(step, each) for each in ("x", "y", "z", *_MOTION))
        h0 = self.model.camera_distance
        ones = np.ones_like(x)
        before = np.stack([x / (z - h0), y / (z - h0), ones])
        after = np.stack([x + u, y + v, z + w])
        sight = np.stack([after[0] / (after[2] - h0), after[1] / (after[2] - h0), ones])
        row, column = np.meshgrid(step["row"].values.astype(float), step["column"].values.astype(float), indexing="ij")
        by_pixel = window_slopes(column, row, after, np.isfinite(after).all(axis=0), _IN_PLANE_HALF).values
        directions = np.stack([-before, sight, by_pixel[:, 0], by_pixel[:, 1]])
        sigmas = np.stack([_map(step, each) for each in _SOURCES])
        errors: np.ndarray = np.einsum("ij,sj...->si...", self.turn, self.nearest(directions * sigmas[:, None]))
        return errors

    def calibration_variance(self, step: xr.Dataset, noise: np.ndarray) -> np.ndarray:
        """Return the covariance (3, 3, row, column) of the displacement by errors of the calibration [m^2]."""
        stated = self.nearest(np.stack([_map(step, f"sigma_{each}") for each in _MOTION]) ** 2)
        own = np.einsum("ji,jk...,ki->i...", self.turn, noise, self.turn)
        common = np.maximum(stated - own, 0.0)
        covariance: np.ndarray = np.einsum("ik,k...,jk->ij...", self.turn, common, self.turn)
        return covariance


def join_sensors(
    datasets: Mapping[str, xr.Dataset], registration: Registration, *, strain_window: int | None = None
) -> xr.Dataset:
    """Return the surface of several sensors as one dataset.

    The map lies on a plane, or on a cylinder if the surface faces too many directions for one. Where sensors overlap,
    positions along the normal and displacements are means weighted by their covariance and, towards the border of each
    sensor, by a factor that falls to 0, so that the joined maps have no step there. Strain comes from planes over
    windows of the joined map.

    Parameters
    ----------
    datasets
        Of each sensor, from `fringedic.process_bag`, all with the same reference step.
    registration
        Poses of the sensors.
    strain_window
        Width of the window of the strain [points]; by default that of the reference sensor.

    Returns
    -------
    Dataset
        Over (step, row, column), float32, in the rig frame of the reference sensor: ``x``, ``y``, ``z``, ``u``, ``v``,
        ``w``, ``sigma_u``, ``sigma_v``, ``sigma_w``, ``u_t``, ``v_t``, ``w_n``, strain with its standard deviations
        along the rows (t1) and columns (t2) of the map, and ``sigma_shape`` [m]. In the overlap the differences of two
        sensors in units of their standard deviation: ``overlap_shape``, ``overlap_u``, ``overlap_v``, ``overlap_w``;
        ``sensors`` is the number of sensors at each point.

    Raises
    ------
    DatasetError
        A sensor is not registered, was calibrated again since, has another reference step or no displacement; or
        no two sensors overlap.
    """
    _check(datasets, registration)
    parts = [_part(name, datasets[name], registration) for name in registration.poses if name in datasets]
    common = [registration.poses[each.sensor].apply(each.points) for each in parts]
    grid = _grid(parts, common)
    for part, points in zip(parts, common, strict=True):
        part.place(grid, points)
    number = np.sum([np.isfinite(part.height) for part in parts], axis=0)
    if not (number > 1).any():
        raise DatasetError(
            f"the surfaces of the sensors {', '.join(part.sensor for part in parts)} do not overlap: the joined "
            "surface could not be tested; let neighbouring sensors see a common part of the specimen"
        )
    surface = _joined_surface(parts, grid, registration)
    lead = datasets[registration.reference] if registration.reference in datasets else parts[0].dataset
    window = _strain_window(lead) if strain_window is None else strain_window
    steps = sorted({int(each) for part in parts for each in part.dataset["step"].values})
    rows, errors = [], dict[str, dict[str, str]]()
    for step in steps:
        joined, failed = _joined_step(step, parts, grid, surface, registration, window)
        rows.append(joined)
        if failed and "u" in joined:
            errors[str(step)] = failed
    return _as_dataset(rows, lead, grid, registration, errors, window)


def _check(datasets: Mapping[str, xr.Dataset], registration: Registration) -> None:
    if len(datasets) < 2:
        raise DatasetError(f"only the sensor {', '.join(datasets)} was measured: a joined surface needs two")
    try:
        registration.require_poses(datasets)
        registration.require({name: _calibration(name, dataset) for name, dataset in datasets.items()})
    except CalibrationError as error:
        raise DatasetError(str(error)) from None
    references = {name: _references(dataset) for name, dataset in datasets.items()}
    if len(set().union(*references.values())) > 1:
        said = "; ".join(f"'{name}': {', '.join(map(str, sorted(each)))}" for name, each in references.items())
        raise DatasetError(
            f"the displacements count from different reference steps ({said}): process the recording with "
            "one --reference"
        )


def _calibration(name: str, dataset: xr.Dataset) -> str:
    """Return the identifier of the calibration of a dataset that has everything which joining needs."""
    if sensor_of(dataset) != name:
        raise DatasetError(f"the dataset of the sensor '{sensor_of(dataset)}' was given as that of '{name}'")
    missing = [each for each in _NEEDED if each not in dataset]
    model = recorded_calibration(dataset)
    if model is None or missing:
        raise DatasetError(
            f"the dataset of the sensor '{name}' has no "
            f"{missing[0] if missing else 'calibration'}: process its recording again with a calibration"
        )
    return model.identifier


def _references(dataset: xr.Dataset) -> set[int]:
    return {int(each) for each in dataset["reference_step"].values if each >= 0}


def _strain_window(dataset: xr.Dataset) -> int:
    parameters = parameters_of(dataset.isel(step=-1)).get("coupling", {})
    width = int(parameters.get("strain_window_px", 0)) or 33
    return max(3, width // _spacing(dataset))


def _spacing(dataset: xr.Dataset) -> int:
    rows = dataset["row"].values
    return round(rows[1] - rows[0]) if len(rows) > 1 else 1


def _map(step: xr.Dataset, name: str) -> np.ndarray:
    return np.asarray(step[name].values, float)


def _part(name: str, dataset: xr.Dataset, registration: Registration) -> _Part:
    model = recorded_calibration(dataset)
    assert model is not None  # as checked
    for step in dataset["step"].values:
        points = np.stack([_map(dataset.sel(step=step), each) for each in "xyz"])
        if np.isfinite(points).all(axis=0).any():
            return _Part(name, dataset, model, registration.poses[name].matrix, points)
    raise DatasetError(f"the sensor '{name}' has no step with a surface: process its recording again")


def _grid(parts: Sequence[_Part], common: Sequence[np.ndarray]) -> _Grid:
    """Choose chart and points of the map: the spacing is that of the finest sensor."""
    points, normals, spacings = [], [], []
    for part, at in zip(parts, common, strict=True):
        known = np.isfinite(at).all(axis=0)
        row, column = np.indices(known.shape).astype(float)
        slopes = window_slopes(column, row, at, known, _IN_PLANE_HALF).values
        normal = np.cross(slopes[:, 0], -slopes[:, 1], axis=0)
        usable = known & np.isfinite(normal).all(axis=0)
        if not usable.any():
            raise DatasetError(f"the surface of the sensor '{part.sensor}' is too small to be joined")
        length = np.linalg.norm(normal, axis=0)
        points.append(at[:, usable])
        normals.append((normal / length)[:, usable])
        spacings.append(float(np.median(np.sqrt(length[usable]))))
    chart = choose_chart(np.concatenate(points, axis=1), np.concatenate(normals, axis=1))
    spacing = min(spacings)
    at = chart.coordinates(np.concatenate(points, axis=1))
    closed = is_closed(chart, at[0])
    low, high = at[1].min(), at[1].max()
    b = np.arange(high, low - 0.5 * spacing, -spacing)
    if closed:
        count = math.ceil(chart.circumference / spacing)
        a = -0.5 * chart.circumference + np.arange(count) * chart.circumference / count
    else:
        a = np.arange(at[0].min(), at[0].max() + 0.5 * spacing, spacing)
    a, b = np.meshgrid(a, b)
    return _Grid(chart, a, b, spacing, closed)


@dataclass(frozen=True, eq=False)
class _Surface:
    """The joined reference surface."""

    points: np.ndarray
    directions: np.ndarray
    slopes: np.ndarray  # of the position by a and b: (3, 2, row, column)
    normal: np.ndarray
    sigma: np.ndarray
    overlap: np.ndarray


def _joined_surface(parts: Sequence[_Part], grid: _Grid, registration: Registration) -> _Surface:
    """Return the mean of the heights weighted by their variance, and how far sensors differ."""
    directions = grid.chart.directions(grid.a)
    heights = np.stack([part.height for part in parts])
    known = np.isfinite(heights)
    count = known.sum(axis=0)
    rough = np.where(count > 0, np.where(known, heights, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
    towards = _towards(rough, grid, directions)
    variances = []
    for part in parts:
        sight = _line_of_sight(part)
        sigma = part.nearest(_first_known(part.dataset, "noise_z"))
        along = np.einsum("i...,i...->...", towards, np.einsum("ij,j...->i...", part.turn, sight))
        variances.append(np.where(np.isfinite(part.height), (along * sigma) ** 2, np.inf))
    variance = np.stack(variances)
    tapers = np.stack([part.taper for part in parts])
    weights = np.where(known & np.isfinite(variance), tapers / variance, 0.0)
    weights /= np.where(weights.sum(axis=0) > 0, weights.sum(axis=0), np.nan)
    height = np.where(known, weights * heights, 0.0).sum(axis=0)
    height = np.where(np.isfinite(weights).all(axis=0), height, np.nan)
    points = grid.chart.points(grid.a, grid.b, height)
    slopes = window_slopes(grid.a, grid.b, points, np.isfinite(points).all(axis=0), _SLOPE_HALF, grid.closed).values
    normal = np.cross(slopes[:, 0], slopes[:, 1], axis=0)
    normal /= np.linalg.norm(normal, axis=0)
    noise = (weights**2 * np.where(weights > 0, variance, 0.0)).sum(axis=0)
    common = _common(parts, registration, towards, weights)
    overlap = np.full(height.shape, np.nan)
    for first, other in _pairs(len(parts)):
        both = known[first] & known[other] & np.isnan(overlap)
        if both.any():
            share = np.zeros_like(weights)
            share[first], share[other] = np.where(both, 1.0, 0.0), np.where(both, -1.0, 0.0)
            total = variance[first] + variance[other] + _common(parts, registration, towards, share)
            overlap = np.where(both, (heights[first] - heights[other]) / np.sqrt(total), overlap)
    return _Surface(points, directions, slopes, normal, np.sqrt(noise + common), overlap)


def _pairs(count: int) -> Iterator[tuple[int, int]]:
    return ((first, other) for first in range(count) for other in range(first + 1, count))


def _towards(height: np.ndarray, grid: _Grid, directions: np.ndarray) -> np.ndarray:
    """Return the vector whose product with an error is the change of the height at a point of the map."""
    slopes = window_slopes(grid.a, grid.b, height[None], np.isfinite(height), _IN_PLANE_HALF, grid.closed).values[0]
    slopes = np.where(np.isfinite(slopes), slopes, 0.0)
    towards: np.ndarray = directions[2] - slopes[0] * directions[0] - slopes[1] * directions[1]
    return towards


def _line_of_sight(part: _Part) -> np.ndarray:
    x, y, z = part.points
    depth = z - part.model.camera_distance
    return part.nearest(np.stack([x / depth, y / depth, np.ones_like(x)]))


def _first_known(dataset: xr.Dataset, name: str) -> np.ndarray:
    for step in dataset["step"].values:
        values = _map(dataset.sel(step=step), name)
        if np.isfinite(values).any():
            return values
    return np.full((dataset.sizes["row"], dataset.sizes["column"]), np.nan)


def _common(parts: Sequence[_Part], registration: Registration, towards: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Return the variance (..., row, column) of the weighted sum of the parts by errors that points have in common.

    `towards` (..., 3, row, column) are the vectors whose products with the errors count.
    """
    leading, shape = towards.shape[:-3], towards.shape[-2:]
    found = np.zeros((*leading, shape[0] * shape[1]))
    wanted = np.flatnonzero((np.abs(np.nan_to_num(shares)) > 0).any(axis=0).ravel())
    if not wanted.size:
        return found.reshape(*leading, *shape)
    some = wanted[:: max(1, wanted.size // _EXACT)]
    along = towards.reshape(*leading, 3, -1)[..., some]
    total = np.zeros(())
    for part, share in zip(parts, shares, strict=True):
        points = part.nearest(part.points).reshape(3, -1)[:, some]
        weight = np.nan_to_num(share.ravel()[some])
        points = np.where(weight != 0, points, np.nanmean(part.points.reshape(3, -1), axis=1)[:, None])
        errors = registration.position_errors(part.sensor, part.model, points)
        total = total + np.einsum("...in,ikn->...kn", along, errors) * weight
    variance = np.einsum("...kn,kl,...ln->...n", total, registration.common_covariance, total)
    if len(some) < len(wanted):
        place = np.stack(np.unravel_index(wanted, shape), axis=1)
        of_some = np.stack(np.unravel_index(some, shape), axis=1)
        variance = variance[..., cKDTree(of_some).query(place)[1]]
    found[..., wanted] = variance
    return found.reshape(*leading, *shape)


def _joined_step(
    step: int,
    parts: Sequence[_Part],
    grid: _Grid,
    surface: _Surface,
    registration: Registration,
    window: int,
) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the maps of a step, and why sensors did not measure it."""
    measured, failed = [], {}
    for part in parts:
        if step not in part.dataset["step"].values:
            failed[part.sensor] = "the step was not recorded"
            continue
        own = part.dataset.sel(step=step)
        if not np.isfinite(own["w"].values).any():
            failed[part.sensor] = str(own["error"].item()) or "no displacement"
            continue
        measured.append((part, own))
    if not measured:
        return {"step": step, "error": "; ".join(f"{name}: {reason}" for name, reason in failed.items())}, failed
    moved, sources, noises, others = [], [], [], []
    for part, own in measured:
        own_motion = np.stack([_map(own, each) for each in _MOTION])
        moved.append(np.einsum("ij,j...->i...", part.turn, part.carried(own_motion)))
        sources.append(part.sources(own))
        noise = np.einsum("si...,sj...->ij...", sources[-1], sources[-1])
        noises.append(noise)
        turned = registration.pose_covariance(part.sensor)[:3, :3]
        cross = rotation_errors(moved[-1])
        others.append(part.calibration_variance(own, noise) + np.einsum("ia...,ab,jb...->ij...", cross, turned, cross))
    shares = _shares(noises, [part.taper for part, _ in measured])
    known = np.isfinite(surface.points[0])
    motion = np.where(known, _sum(shares, moved), np.nan)
    covariance = sum(
        np.einsum("ij...,jk...,lk...->il...", share, np.nan_to_num(noise + other), share)
        for share, noise, other in zip(shares, noises, others, strict=True)
    )
    sigmas = np.sqrt(np.stack([covariance[axis, axis] for axis in range(3)]))
    gradients = _gradients(motion, surface, grid)
    overlap, apart = _differences([part for part, _ in measured], moved, noises, others, gradients, registration)
    joint = []
    for share, each, (part, _) in zip(shares, sources, measured, strict=True):
        # the noise of a height that is used k times is that of k points in one: its variance in a mean is k times as
        # large; errors of the in-plane displacement are correlated over many more points anyway
        repeated = np.stack([np.sqrt(part.repeated)] * 2 + [np.ones(known.shape)] * 2)
        joint.append(np.einsum("ij...,sj...->si...", share, each * repeated[:, None]))
    lead = measured[0][1]
    strain = strain_maps(
        (grid.a, grid.b),
        surface.points,
        motion,
        joint,
        list(zip(shares, apart, strict=True)),
        window // 2,
        closed=grid.closed,
        filters=_filters(lead),
    )
    maps = dict(zip("xyzuvw", (*surface.points, *motion), strict=True))
    maps |= {f"sigma_{each}": np.where(known, sigma, np.nan) for each, sigma in zip(_MOTION, sigmas, strict=True)}
    maps |= strain
    maps |= dict(zip(("overlap_u", "overlap_v", "overlap_w"), overlap, strict=True))
    maps["overlap_shape"], maps["sigma_shape"] = surface.overlap, surface.sigma
    maps["sensors"] = np.sum([np.isfinite(each[0]) for each in moved], axis=0).astype(float)
    maps["sensors"][~known] = np.nan
    return {"step": step, "error": "", **maps}, failed


def _differences(
    parts: Sequence[_Part],
    moved: Sequence[np.ndarray],
    noises: Sequence[np.ndarray],
    others: Sequence[np.ndarray],
    gradients: np.ndarray,
    registration: Registration,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the differences of u, v, w over their standard deviation, and the common covariance of each sensor.

    Two sensors show at one place of the map different points of the specimen, by the errors of their positions: each
    gets half of the variance.
    """
    overlap = np.full(moved[0].shape, np.nan)
    apart = [each.copy() for each in others]
    for first, other in _pairs(len(parts)):
        both = np.isfinite(moved[first][0]) & np.isfinite(moved[other][0]) & np.isnan(overlap[0])
        share = np.zeros((len(parts), *both.shape))
        share[first], share[other] = np.where(both, 1.0, 0.0), np.where(both, -1.0, 0.0)
        misplaced = _common(parts, registration, gradients, share)
        total = noises[first] + others[first] + noises[other] + others[other]
        variance = np.stack([total[axis, axis] for axis in range(3)]) + misplaced
        for axis in range(3):
            apart[first][axis, axis] += 0.5 * misplaced[axis]
            apart[other][axis, axis] += 0.5 * misplaced[axis]
        overlap = np.where(both, (moved[first] - moved[other]) / np.sqrt(variance), overlap)
    return overlap, apart


def _gradients(motion: np.ndarray, surface: _Surface, grid: _Grid) -> np.ndarray:
    """Return the gradients (component, 3, row, column) of a displacement along the surface."""
    known = np.isfinite(motion).all(axis=0)
    slopes = window_slopes(grid.a, grid.b, motion, known, _IN_PLANE_HALF, grid.closed).values
    along: np.ndarray = np.einsum("kj...,ji...->ki...", np.nan_to_num(slopes), surface.directions[:2])
    return along


def _shares(noises: Sequence[np.ndarray], tapers: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the share (3, 3, row, column) of each sensor in the joined displacement; their sum is 1.

    Inside of an overlap the mean is weighted by the covariances. A view from another direction is better in some
    directions by orders of magnitude, so that such weights jump at the border of its part: towards the borders the
    shares become those of the tapers alone, without a jump.
    """
    whole = [np.isfinite(noise).all(axis=(0, 1)) for noise in noises]
    parts = np.stack([np.where(known, taper, 0.0) for known, taper in zip(whole, tapers, strict=True)])
    total = parts.sum(axis=0)
    parts = parts / np.where(total > 0, total, np.nan)
    inside = np.clip(2.0 * (1.0 - (parts**2).sum(axis=0)), 0.0, 1.0)  # 0 for one sensor, 1 for two equal ones
    inverses = []
    for noise, known, part in zip(noises, whole, parts, strict=True):
        matrix = np.moveaxis(np.where(known, noise, np.eye(3)[:, :, None, None]), (0, 1), (-2, -1))
        scale = np.trace(matrix, axis1=-2, axis2=-1)[..., None, None]
        inverse = np.linalg.inv(matrix / scale + _REGULAR * np.eye(3)) / scale
        inverses.append(np.where((known & (part > 0))[..., None, None], inverse, 0.0))
    summed = np.sum(inverses, axis=0)
    none = ~(np.abs(summed).max(axis=(-2, -1)) > 0)
    summed[none] = np.eye(3)
    total_inverse = np.linalg.inv(summed)
    shares = []
    for inverse, part in zip(inverses, parts, strict=True):
        weighted = np.moveaxis(total_inverse @ inverse, (-2, -1), (0, 1))
        shares.append(inside * weighted + (1.0 - inside) * part * np.eye(3)[:, :, None, None])
    return shares


def _sum(shares: Sequence[np.ndarray], fields: Sequence[np.ndarray]) -> np.ndarray:
    """Return the weighted mean of vectors; where a sensor has none its share is 0."""
    found = np.zeros_like(fields[0])
    for share, values in zip(shares, fields, strict=True):
        found += np.einsum("ij...,j...->i...", share, np.nan_to_num(values))
    return found


def _filters(step: xr.Dataset) -> tuple[float, int, str, int]:
    """Return filter of the height [px], window [px] and method of the displacement, and the distance of points [px]."""
    parameters = parameters_of(step)
    dic, coupling = parameters.get("dic", {}), parameters.get("coupling", {})
    return (
        float(coupling.get("z_filter_px", 2.0)),
        int(dic.get("window", 32)),
        str(dic.get("method", "dense")),
        _spacing(step),
    )


def _as_dataset(
    rows: Sequence[Mapping[str, Any]],
    lead: xr.Dataset,
    grid: _Grid,
    registration: Registration,
    errors: Mapping[str, Mapping[str, str]],
    window: int,
) -> xr.Dataset:
    """Return the joined dataset, with times and signals of the leading sensor."""
    steps = [row["step"] for row in rows]
    names = sorted({name for row in rows for name in row} - {"step", "error"})
    ends = slice(0, 1) if grid.closed else slice(0, 0)  # a closed map ends with the points that it begins with
    shape = (grid.a.shape[0], grid.a.shape[1] + (1 if grid.closed else 0))
    maps = {}
    for name in names:
        quantity = ALL_MAPS[name]
        values = np.full((len(rows), *shape), np.nan, np.float32)
        for index, row in enumerate(rows):
            if name in row:
                values[index] = np.concatenate([row[name], row[name][:, ends]], axis=1)
        maps[name] = (("step", "row", "column"), values, quantity._asdict())
    inherited = lead.drop_vars([name for name, each in lead.variables.items() if {"row", "column"} & set(each.dims)])
    present = [step for step in steps if step in inherited["step"].values]
    found = inherited.sel(step=present)
    if len(present) < len(steps):
        found = _with_steps(found, steps)
    found = found.assign(maps)
    found = found.drop_vars(_OF_ONE_SENSOR, errors="ignore")
    found["error"] = ("step", np.array([row["error"] for row in rows], object), lead["error"].attrs)
    if "valid_fraction" in lead:
        share = [float(np.isfinite(each).mean()) for each in maps["w"][1]]
        found["valid_fraction"] = ("step", np.array(share), lead["valid_fraction"].attrs)
    found = found.assign_coords(
        row=("row", np.arange(shape[0]), {"units": "px", "long_name": "row of the joined map"}),
        column=("column", np.arange(shape[1]), {"units": "px", "long_name": "column of the joined map"}),
    )
    kept = {name: value for name, value in lead.attrs.items() if name != "calibration"}
    chart = grid.chart
    found.attrs = kept | {
        "sensor": JOINED,
        "pixel_size": grid.spacing,
        "image_width": shape[1],
        "image_height": shape[0],
        "strain_window": window,
        SENSOR_ERRORS: json.dumps(errors),
        "joined_sensors": json.dumps(list(registration.poses)),
        "registration": json.dumps(
            {
                "verdict": str(registration.verdict),
                "reference": registration.reference,
                "created": registration.created.isoformat(),
                "edited": registration.edited,
            }
        ),
        "chart": json.dumps(
            {
                "kind": "plane" if chart.is_plane else "cylinder",
                "origin": chart.origin.tolist(),
                "axes": chart.axes.tolist(),
                **({} if chart.is_plane else {"radius": chart.radius, "closed": grid.closed}),
            }
        ),
    }
    return found


def _with_steps(dataset: xr.Dataset, steps: Sequence[int]) -> xr.Dataset:
    """Return a dataset with rows of steps that only other sensors have."""
    whole = {name: each for name, each in dataset.variables.items() if "step" not in each.dims}
    of_steps = {}
    for name, each in dataset.data_vars.items():
        if each.dims == ("step",):
            kind = each.dtype.kind
            empty: Any = {"f": np.nan, "i": -1, "u": 0, "M": np.datetime64("NaT")}.get(kind, "")
            values = np.full(len(steps), empty, each.dtype)
            for index, step in enumerate(steps):
                if step in dataset["step"].values:
                    values[index] = each.sel(step=step).item() if kind != "M" else each.sel(step=step).values
            of_steps[str(name)] = (("step",), values, each.attrs)
    coordinates = {name: each for name, each in whole.items() if name in dataset.coords}
    rest = {name: each for name, each in whole.items() if name not in dataset.coords}
    return xr.Dataset({**rest, **of_steps}, {**coordinates, "step": ("step", np.array(steps), dataset["step"].attrs)})
