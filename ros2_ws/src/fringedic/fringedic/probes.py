"""Probes on results: virtual extensometers, profiles, statistics of regions, rigid motion, force against strain.

All take the dataset of `open_experiment`, or one of `couple` for a single step, and read only the maps that they need,
step by step. Places are pixel positions (row, column) in the reference image.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.path import Path as Outline
from numpy.typing import ArrayLike
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from fringedic.errors import ProbeError

Place = tuple[float, float]
_POSITION, _MOTION, _SIGMAS = ("x", "y", "z"), ("u", "v", "w"), ("sigma_u", "sigma_v", "sigma_w")


@dataclass(frozen=True)
class Region:
    """Part of the reference image.

    Attributes
    ----------
    corners
        (row, column) [px] of a polygon, at least three.
    """

    corners: tuple[Place, ...]

    @classmethod
    def rectangle(cls, first: Place, last: Place) -> Region:
        """Region between two opposite corners, both included."""
        (top, left), (bottom, right) = first, last
        return cls(((top, left), (top, right), (bottom, right), (bottom, left)))

    def mask(self, dataset: xr.Dataset) -> np.ndarray:
        """Return which points of a dataset lie inside or on the edge, shape (row, column).

        Raises
        ------
        ProbeError
            When there are fewer than three corners, or no point inside.
        """
        if len(self.corners) < 3:
            raise ProbeError(f"a region has {len(self.corners)} corners: it needs at least three")
        row, column = np.meshgrid(dataset.row.values, dataset.column.values, indexing="ij")
        corners = np.array([*self.corners, self.corners[0]], float)
        outline = Outline(corners, closed=True)
        points = np.stack([row.ravel(), column.ravel()], axis=-1).astype(float)
        # points on the edge are on one of its sides, depending on how the corners go round
        inside = outline.contains_points(points, radius=1e-6) | outline.contains_points(points, radius=-1e-6)
        if not inside.any():
            raise ProbeError(f"no point of the result lies in the region {self.corners} px (row, column)")
        return np.asarray(inside.reshape(row.shape))


def extensometer(dataset: xr.Dataset, first: Place, second: Place, *, pad: float = 1.0) -> xr.Dataset:
    """Follow the distance between two points of the surface, as an extensometer does.

    Parameters
    ----------
    dataset
        From `open_experiment` or `couple`.
    first, second
        (row, column) of the points [px of the reference image].
    pad
        Side [px] of the squares over which positions and displacements are averaged.

    Returns
    -------
    Dataset
        Over ``step``: ``length`` and ``elongation`` [m], ``strain`` (elongation over the length in the reference [1]),
        and ``sigma_elongation`` [m], ``sigma_strain`` [1] where the dataset tells sigmas: those of two points, since
        errors agree over the pads; NaN where nothing of a pad is measured.

    Raises
    ------
    ProbeError
        When a pad holds no point of the result, both are the same, or pad is not above 0.
    """
    if not pad > 0:
        raise ProbeError(f"pad is {pad} px: the side of a pad has to be above 0")
    pads = [_pad(dataset, place, pad) for place in (first, second)]
    if all(np.array_equal(*each) for each in zip(*pads, strict=True)):
        raise ProbeError(f"both pads, at {first} and {second} px, hold the same points: move them apart")
    rows = []
    sigmas = all(name in dataset for name in _SIGMAS)
    names = (*_POSITION, *_MOTION, *(_SIGMAS if sigmas else ()))
    for values in _steps(dataset, names):
        ends = [_mean(values[:, rows_of[:, None], columns_of]) for rows_of, columns_of in pads]
        before = ends[1][:3] - ends[0][:3]
        after = before + ends[1][3:6] - ends[0][3:6]
        length, start = float(np.linalg.norm(after)), float(np.linalg.norm(before))
        spread = np.nan
        if sigmas:
            along = after / length
            spread = float(np.sqrt(sum(np.sum((along * end[6:]) ** 2) for end in ends)))
        rows.append((length, length - start, (length - start) / start, spread, spread / start))
    fields = {
        "length": ("m", "distance of the two points"),
        "elongation": ("m", "change of the distance"),
        "strain": ("1", "elongation over the length in the reference"),
        "sigma_elongation": ("m", "standard deviation of the elongation"),
        "sigma_strain": ("1", "standard deviation of the strain"),
    }
    if not sigmas:
        fields = {name: each for name, each in fields.items() if not name.startswith("sigma")}
    return _over_steps(dataset, dict(zip(fields, np.array(rows).T, strict=False)), fields)


def profile(
    dataset: xr.Dataset, names: Sequence[str], start: Place, end: Place, *, points: int | None = None
) -> xr.Dataset:
    """Return maps along a straight line of the reference image.

    Parameters
    ----------
    dataset, names
        The dataset and the maps to read.
    start, end
        (row, column) [px].
    points
        Number of points, by default one per pixel of length. Values between points are bilinear, NaN beside holes.

    Returns
    -------
    Dataset
        The maps over (step, position); the coordinate ``position`` is the distance from the start [px], ``row`` and
        ``column`` tell the places.

    Raises
    ------
    ProbeError
        When a map is missing or the line leaves the result.
    """
    missing = [name for name in names if name not in dataset]
    if missing:
        raise ProbeError(f"the dataset has no map {', '.join(missing)}")
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    number = points or round(length) + 1
    row, column = (np.linspace(a, b, number) for a, b in zip(start, end, strict=True))
    where = [
        np.interp(each, dataset[name].values, np.arange(dataset.sizes[name]), left=np.nan, right=np.nan)
        for name, each in (("row", row), ("column", column))
    ]
    if not np.isfinite(where).all():
        raise ProbeError(f"the line from {start} to {end} px (row, column) leaves the result")
    found = [
        [map_coordinates(each, where, order=1, mode="nearest") for each in values] for values in _steps(dataset, names)
    ]
    arrays = dict(zip(names, np.moveaxis(np.array(found, np.float32), 1, 0), strict=True))
    dimensions = ("step", "position") if "step" in dataset.dims else ("position",)
    return xr.Dataset(
        {
            name: (dimensions, values if "step" in dataset.dims else values[0], dict(dataset[name].attrs))
            for name, values in arrays.items()
        },
        coords={
            "position": ("position", np.linspace(0.0, length, number), {"units": "px"}),
            "row": ("position", row),
            "column": ("position", column),
            **({"step": dataset.step} if "step" in dataset.dims else {}),
        },
    )


def region_statistics(dataset: xr.Dataset, names: Sequence[str], region: Region) -> xr.Dataset:
    """Return mean, standard deviation, smallest, median and largest value of maps in a region.

    Returns
    -------
    Dataset
        Over (step, statistic) with the statistics ``mean``, ``standard_deviation``, ``minimum``, ``median``,
        ``maximum``; ``measured_fraction`` over (step, map) tells how much of the region each rests on. NaN where
        nothing is measured.

    Raises
    ------
    ProbeError
        When a map is missing, or the region holds no point of the result.
    """
    missing = [name for name in names if name not in dataset]
    if missing:
        raise ProbeError(f"the dataset has no map {', '.join(missing)}")
    inside = region.mask(dataset)
    found, measured = [], []
    for values in _steps(dataset, names):
        chosen = [each[inside] for each in values]
        chosen = [each[np.isfinite(each)].astype(float) for each in chosen]
        found.append([_statistics(each) for each in chosen])
        measured.append([each.size / np.count_nonzero(inside) for each in chosen])
    stepwise = "step" in dataset.dims
    table = np.moveaxis(np.array(found), 1, 0)
    dimensions = ("step", "statistic") if stepwise else ("statistic",)
    fields = {
        name: (dimensions, values if stepwise else values[0], dict(dataset[name].attrs))
        for name, values in zip(names, table, strict=True)
    }
    fraction = np.array(measured) if stepwise else np.array(measured[0])
    fields["measured_fraction"] = (("step", "map") if stepwise else ("map",), fraction, {"units": "1"})
    coordinates = {"statistic": list(_STATISTICS), "map": list(names)}
    return xr.Dataset(fields, {**coordinates, "step": dataset.step} if stepwise else coordinates)


def remove_rigid_motion(dataset: xr.Dataset, region: Region | None = None) -> xr.Dataset:
    """Take out of each step's displacement the rigid motion that fits it best.

    Rotation and translation with the least squared distances bring the deformed points of the region back; what remains
    is the deformation, and in `region` it is smallest. Strain does not change.

    Parameters
    ----------
    dataset
        From `open_experiment` or `couple`; it is not changed.
    region
        Where the motion is taken from; everything measured by default.

    Returns
    -------
    Dataset
        ``x``, ``y``, ``z`` and the remaining ``u``, ``v``, ``w`` [m], with ``rotation`` (rotation vector [rad]) and
        ``translation`` [m] over (step, axis): a reference point X went to rotation X + translation plus what remains.

    Raises
    ------
    ProbeError
        When fewer than three points are measured.
    """
    inside = None if region is None else region.mask(dataset)
    remaining, rotations, translations = [], [], []
    for values in _steps(dataset, (*_POSITION, *_MOTION)):
        before = values[:3].astype(float)
        moved = before + values[3:]
        known = np.isfinite(moved).all(axis=0)
        chosen = known if inside is None else known & inside
        if np.count_nonzero(chosen) < 3:
            raise ProbeError("fewer than three points are measured: they do not tell a rigid motion")
        centre, goal = before[:, chosen].mean(axis=1), moved[:, chosen].mean(axis=1)
        covariance = (moved[:, chosen] - goal[:, None]) @ (before[:, chosen] - centre[:, None]).T
        left, _, right = np.linalg.svd(covariance)
        turn = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
        shift = goal - turn @ centre
        # in the frame of the reference, so that it can be compared with it
        back = np.tensordot(turn.T, moved - shift[:, None, None], 1)
        remaining.append((back - before).astype(np.float32))
        rotations.append(Rotation.from_matrix(turn).as_rotvec())
        translations.append(shift)
    stepwise = "step" in dataset.dims
    maps = np.moveaxis(np.array(remaining), 1, 0)
    dimensions = tuple(dataset["u"].dims)
    fields: dict[str, object] = {name: dataset[name] for name in _POSITION}
    for name, each in zip(_MOTION, maps, strict=True):
        fields[name] = (dimensions, each if stepwise else each[0], dict(dataset[name].attrs))
    axes = ("step", "axis") if stepwise else ("axis",)
    for name, unit, table in (("rotation", "rad", rotations), ("translation", "m", translations)):
        fields[name] = (axes, np.array(table) if stepwise else table[0], {"units": unit})
    return xr.Dataset(fields, {**dataset[["u"]].coords, "axis": list("xyz")}, dataset.attrs)


def force_curve(
    dataset: xr.Dataset,
    strain: ArrayLike,
    *,
    section: float | None = None,
    tare: float = 0.0,
    sign: int = 1,
) -> xr.Dataset:
    """Return force, and stress when the section is known, against a strain or an elongation.

    Parameters
    ----------
    dataset
        From `open_experiment`, with the ``force`` of each step: the mean of the load frame's readings over the step's
        exposures, tared and signed as the specimen's facts say.
    strain
        One value per step, such as the ``strain`` of `extensometer` or the mean of a region.
    section
        Area that carries the force [m^2]; by default that of the recorded facts of the specimen.
    tare, sign
        Further corrections: sign (force - tare), with the tare [N].

    Returns
    -------
    Dataset
        Over ``step``: ``strain``, ``force`` [N] and, with a section, ``stress`` [Pa] = force over the section in the
        reference.

    Raises
    ------
    ProbeError
        When the dataset has no force, the number of values is not that of the steps, or section or sign have no
        meaning.
    """
    if "force" not in dataset:
        raise ProbeError("the dataset has no force: no load frame was recorded")
    values = np.asarray(strain, float)
    if values.shape != (dataset.sizes["step"],):
        raise ProbeError(f"strain has the shape {values.shape}, the dataset has {dataset.sizes['step']} steps")
    if sign not in (1, -1):
        raise ProbeError(f"sign is {sign}: it has to be 1 or -1")
    if section is not None and not section > 0:
        raise ProbeError(f"section is {section} m2: it has to be above 0")
    if section is None:
        section = _recorded_section(dataset)
    force = sign * (dataset["force"].values.astype(float) - tare)
    arrays = {"strain": values, "force": force}
    if section is not None:
        arrays["stress"] = force / section
    words = {"strain": ("1", "strain"), "force": ("N", "force"), "stress": ("Pa", "force over the reference section")}
    return _over_steps(dataset, arrays, {name: words[name] for name in arrays})


def _recorded_section(dataset: xr.Dataset) -> float | None:
    facts = json.loads(dataset.attrs.get("facts", "{}"))
    square_millimetres = facts.get("specimen", {}).get("section_mm2")
    return None if square_millimetres is None else 1e-6 * float(square_millimetres)


_STATISTICS = ("mean", "standard_deviation", "minimum", "median", "maximum")


def _statistics(values: np.ndarray) -> tuple[float, ...]:
    if not values.size:
        return (np.nan,) * len(_STATISTICS)
    return (
        float(values.mean()),
        float(values.std(ddof=1)) if values.size > 1 else np.nan,
        float(values.min()),
        float(np.median(values)),
        float(values.max()),
    )


def _pad(dataset: xr.Dataset, place: Place, pad: float) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the rows and columns of a square around a place."""
    indices = []
    for name, centre in zip(("row", "column"), place, strict=True):
        positions = dataset[name].values
        near = np.flatnonzero(np.abs(positions - centre) <= pad / 2)
        if not near.size:
            nearest = int(np.argmin(np.abs(positions - centre)))
            spacing = abs(float(positions[1] - positions[0])) if len(positions) > 1 else 1.0
            if abs(positions[nearest] - centre) > spacing / 2:
                raise ProbeError(f"the point {place} px (row, column) lies outside the result")
            near = np.array([nearest])
        indices.append(near)
    return indices[0], indices[1]


def _mean(values: np.ndarray) -> np.ndarray:
    """Mean of each map over the points of a pad that are measured in all of them."""
    flat = values.reshape(len(values), -1).astype(float)
    known = np.isfinite(flat[:6]).all(axis=0)
    return flat[:, known].mean(axis=1) if known.any() else np.full(len(values), np.nan)


def _steps(dataset: xr.Dataset, names: Iterable[str]) -> Iterator[np.ndarray]:
    """Maps of one step after the other, (map, row, column)."""
    chosen = dataset[list(names)]
    if "step" not in dataset.dims:
        yield np.stack([chosen[name].values for name in names])
        return
    for index in range(dataset.sizes["step"]):
        one = chosen.isel(step=index)
        yield np.stack([one[name].values for name in names])


def _over_steps(dataset: xr.Dataset, arrays: dict[str, np.ndarray], words: dict[str, tuple[str, str]]) -> xr.Dataset:
    stepwise = "step" in dataset.dims
    return xr.Dataset(
        {
            name: (("step",), values, {"units": words[name][0], "long_name": words[name][1]})
            if stepwise
            else ((), values[0], {"units": words[name][0], "long_name": words[name][1]})
            for name, values in arrays.items()
            if name in words
        },
        {"step": dataset.step} if stepwise else {},
    )
