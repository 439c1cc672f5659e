"""Probes on results: virtual extensometers, profiles along lines, statistics of regions.

Every probe accepts the dataset of `open_experiment`, or one of `couple` for a single step, and reads the maps it needs
step by step. Positions are (column, row) = (x, y) in pixels of the reference image.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.ndimage import map_coordinates

from fringedic.datasets.attributes import image_size
from fringedic.datasets.quantities import sigma_of
from fringedic.errors import DatasetError
from fringedic.evaluation.mean_uncertainty import uncertainty_of_mean
from fringedic.evaluation.motion import motion_of
from fringedic.evaluation.noise_floor import SIGMAS
from fringedic.evaluation.step_maps import StepValues, maps_by_step, require_maps, values_by_step
from fringedic.frames.region import Point, Region
from fringedic.surface.planes import spacing_of
from fringedic.wording.arguments import check_arguments, number, of_type, optional, several, text, whole
from fringedic.wording.arguments import dataset as dataset_of

MOST_POINTS = 1_000_000  # of a profile
_STATISTICS = ("mean", "standard_deviation", "minimum", "median", "maximum", "standard_uncertainty")


@check_arguments(
    DatasetError,
    dataset=dataset_of(),
    first=several(number(), length=2),
    second=several(number(), length=2),
    subset=number(),
)
def extensometer(dataset: xr.Dataset, first: Point, second: Point, *, subset: float = 1.0) -> xr.Dataset:
    """Follow the distance in space between two points of the surface, as an extensometer does.

    Parameters
    ----------
    dataset
        From `open_experiment` or `couple`; of images alone also from `fringedic.measure_displacement`.
    first, second
        (column, row) of the gauge points [px of the reference image].
    subset
        Side of the square over which positions and displacements are averaged at each gauge point [px].

    Returns
    -------
    Dataset
        Over ``step``: ``length`` and ``elongation`` [m; px for images without a scale], ``strain`` (elongation over the
        length in the reference [1], positive in tension), and ``sigma_elongation``, ``sigma_strain`` [1] if the dataset
        contains standard deviations: those of two points, because errors are correlated within a gauge subset. NaN
        where nothing of a gauge subset is measured.

    Raises
    ------
    DatasetError
        The dataset has no displacement, a gauge subset contains no point of the result, both contain the same points,
        or `subset` is not above 0.

    Examples
    --------
    A plane seen at 0.1 mm per pixel, which is stretched by 1 % along x:

    >>> import numpy as np
    >>> import xarray as xr
    >>> columns, rows = np.arange(0, 100, 10), np.arange(0, 50, 10)
    >>> column, row = np.meshgrid(columns, rows)
    >>> maps = {"x": 1e-4 * column, "y": -1e-4 * row, "z": 0 * row, "u": 1e-6 * column, "v": 0 * row, "w": 0 * row}
    >>> fields = {name: (("row", "column"), values) for name, values in maps.items()}
    >>> dataset = xr.Dataset(fields, {"row": rows, "column": columns})
    >>> gauge = extensometer(dataset, (20, 30), (80, 30))
    >>> round(float(gauge.strain), 6), round(float(gauge.length), 6)
    (0.01, 0.00606)
    """
    motion = motion_of(dataset)
    if not subset > 0:
        raise DatasetError(f"subset is {subset} px: the side of a gauge subset has to be above 0")
    ends = [_gauge_subset(dataset, point, subset) for point in (first, second)]
    if all(np.array_equal(*each) for each in zip(*ends, strict=True)):
        raise DatasetError(f"both gauge subsets, at {first} and {second} px, contain the same points: move them apart")
    readings = [
        _gauge_reading(*(_mean(maps[:, rows[:, None], columns]) for columns, rows in ends)) for maps in motion.by_step()
    ]
    length, elongation, strain, sigma_elongation, sigma_strain = np.array(readings).T
    quantities = {
        "length": StepValues(length, motion.unit, "distance of the two points"),
        "elongation": StepValues(elongation, motion.unit, "change of the distance"),
        "strain": StepValues(strain, "1", "elongation over the length in the reference"),
    }
    if motion.sigmas:
        unit = motion.unit
        quantities["sigma_elongation"] = StepValues(sigma_elongation, unit, "standard deviation of the elongation")
        quantities["sigma_strain"] = StepValues(sigma_strain, "1", "standard deviation of the strain")
    return values_by_step(dataset, quantities)


class _Indices(NamedTuple):
    """Indices of the columns and rows of a rectangle of points."""

    columns: np.ndarray
    rows: np.ndarray


def _gauge_subset(dataset: xr.Dataset, point: Point, side: float) -> _Indices:
    """Return the points of a square around a position; at least the nearest one."""
    indices = []
    for name, centre in zip(("column", "row"), point, strict=True):
        positions = dataset[name].values
        near = np.flatnonzero(np.abs(positions - centre) <= side / 2)
        if not near.size:
            nearest = int(np.argmin(np.abs(positions - centre)))
            spacing = abs(spacing_of(positions))
            if abs(positions[nearest] - centre) > spacing / 2:
                raise DatasetError(f"the point {point} px (column, row) lies outside the result")
            near = np.array([nearest])
        indices.append(near)
    return _Indices(*indices)


def _mean(maps: np.ndarray) -> np.ndarray:
    """Return the mean of each map over the points of a gauge subset whose position and displacement are measured."""
    flat = maps.reshape(len(maps), -1).astype(float)
    measured = np.isfinite(flat[:6]).all(axis=0)
    return flat[:, measured].mean(axis=1) if measured.any() else np.full(len(maps), np.nan)


def _gauge_reading(first: np.ndarray, second: np.ndarray) -> tuple[float, float, float, float, float]:
    """Return length, elongation, strain and the sigmas of the last two; NaN without sigmas of (u, v, w)."""
    before = second[:3] - first[:3]
    if not before.any():  # the same place twice
        return (np.nan,) * 5
    after = before + second[3:6] - first[3:6]
    length, start = float(np.linalg.norm(after)), float(np.linalg.norm(before))
    sigma = np.nan
    if len(first) > 6:
        along = after / length
        sigma = float(np.sqrt(sum(np.sum((along * end[6:]) ** 2) for end in (first, second))))
    return length, length - start, (length - start) / start, sigma, sigma / start


@check_arguments(
    DatasetError,
    dataset=dataset_of(),
    names=several(text, least=1),
    start=several(number(), length=2),
    end=several(number(), length=2),
    points=optional(whole(2, MOST_POINTS)),
)
def profile(
    dataset: xr.Dataset, names: Sequence[str], start: Point, end: Point, *, points: int | None = None
) -> xr.Dataset:
    """Return maps along a straight line of the reference image.

    Parameters
    ----------
    dataset
        From `open_experiment` or `couple`.
    names
        The maps to read.
    start, end
        (column, row) [px].
    points
        Number of points; by default one per pixel of length.

    Returns
    -------
    Dataset
        The maps and their standard deviations over (step, position), float32. ``position`` is the distance from the
        start [px], ``row`` and ``column`` are the pixel positions. Values are interpolated bilinearly, NaN beside
        points without a value.

    Raises
    ------
    DatasetError
        A map is missing, or the line has no length or leaves the result.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> w = np.tile([0.0, 1.0, 2.0], (2, 1))
    >>> dataset = xr.Dataset({"w": (("row", "column"), w)}, {"row": [0, 10], "column": [0, 10, 20]})
    >>> profile(dataset, ["w"], (0, 5), (20, 5), points=5).w.values.tolist()
    [0.0, 0.5, 1.0, 1.5, 2.0]
    """
    require_maps(dataset, names)
    sigmas = (_sigma_of(name) for name in names)
    names = list(dict.fromkeys([*names, *(sigma for sigma in sigmas if sigma is not None and sigma in dataset)]))
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    if not length > 0:
        raise DatasetError(f"the line from {start} to {end} px (column, row) has no length; give two different points")
    number = points or round(length) + 1
    column, row = (np.linspace(a, b, number) for a, b in zip(start, end, strict=True))
    where = [
        np.interp(each, dataset[name].values, np.arange(dataset.sizes[name]), left=np.nan, right=np.nan)
        for name, each in (("row", row), ("column", column))
    ]
    if not np.isfinite(where).all():
        raise DatasetError(f"the line from {start} to {end} px (column, row) leaves the result")
    lines = np.array(
        [
            [map_coordinates(each, where, order=1, mode="nearest") for each in maps]
            for maps in maps_by_step(dataset, names)
        ],
        np.float32,
    )
    stepwise = "step" in dataset.dims
    return xr.Dataset(
        {
            name: (
                ("step", "position") if stepwise else ("position",),
                lines[:, place] if stepwise else lines[0, place],
                dict(dataset[name].attrs),
            )
            for place, name in enumerate(names)
        },
        coords={
            "position": ("position", np.linspace(0.0, length, number), {"units": "px"}),
            "row": ("position", row),
            "column": ("position", column),
            **({"step": dataset.step} if stepwise else {}),
        },
    )


@check_arguments(DatasetError, dataset=dataset_of(), names=several(text, least=1), region=of_type(Region))
def region_statistics(dataset: xr.Dataset, names: Sequence[str], region: Region) -> xr.Dataset:
    """Return mean, standard deviation, minimum, median and maximum of maps in a region, and the mean's uncertainty.

    The standard uncertainty of the mean contains the correlation of neighbouring errors, over the window of the
    displacement and, of strains, over the virtual strain gauge; see `fringedic.evaluation.mean_uncertainty`. It is NaN
    for maps without standard deviations.

    Parameters
    ----------
    dataset
        From `open_experiment` or `couple`.
    names
        The maps to read.
    region
        Part of the reference image, such as ``Region.rectangle((column, row), (column, row))``.

    Returns
    -------
    Dataset
        The maps over (step, statistic) with the statistics ``mean``, ``standard_deviation``, ``minimum``, ``median``,
        ``maximum``, ``standard_uncertainty``; ``measured_fraction`` over (step, map) is the share of the region's
        points with a value. NaN where nothing is measured.

    Raises
    ------
    DatasetError
        A map is missing, or no point of the result lies in the region.
    ImageError
        The region was drawn in an image of another size.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> w = np.array([[0.0, 1.0, 2.0], [3.0, np.nan, 5.0]])
    >>> dataset = xr.Dataset({"w": (("row", "column"), w)}, {"row": [0, 10], "column": [0, 10, 20]})
    >>> table = region_statistics(dataset, ["w"], Region.rectangle((0, 0), (10, 10)))
    >>> float(table.w.sel(statistic="maximum")), float(table.measured_fraction.sel(map="w"))
    (3.0, 0.75)
    """
    require_maps(dataset, names)
    inside = points_in(region, dataset)
    sigmas = [sigma if sigma in dataset else None for sigma in map(_sigma_of, names)]
    read = [*names, *(sigma for sigma in sigmas if sigma is not None)]
    statistics, measured = [], []
    for index, maps in enumerate(maps_by_step(dataset, read)):
        step = dataset.isel(step=index) if "step" in dataset.dims else dataset
        present = dict(zip(read, maps, strict=True))
        rows, fractions = [], []
        for name, sigma in zip(names, sigmas, strict=True):
            values = present[name][inside]
            values = values[np.isfinite(values)].astype(float)
            uncertainty = np.nan
            if sigma is not None:
                uncertainty = uncertainty_of_mean(step, name, present[name], present[sigma], inside)
            rows.append((*_summarise(values), uncertainty))
            fractions.append(values.size / np.count_nonzero(inside))
        statistics.append(rows)
        measured.append(fractions)
    stepwise = "step" in dataset.dims
    table, fraction = np.array(statistics), np.array(measured)
    over: tuple[str, ...] = ("step",) if stepwise else ()
    fields: dict[str, object] = {
        name: (
            (*over, "statistic"),
            table[:, place] if stepwise else table[0, place],
            dict(dataset[name].attrs),
        )
        for place, name in enumerate(names)
    }
    fields["measured_fraction"] = ((*over, "map"), fraction if stepwise else fraction[0], {"units": "1"})
    coordinates = {"statistic": list(_STATISTICS), "map": list(names)}
    return xr.Dataset(fields, {**coordinates, "step": dataset.step} if stepwise else coordinates)


def surface_means(step: xr.Dataset, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return mean and standard uncertainty of maps of a step over all points; NaN where nothing is measured."""
    if not names:
        return {}
    ends = [(float(step["column"][end]), float(step["row"][end])) for end in (0, -1)]
    table = region_statistics(step, names, Region.rectangle(*ends))
    return {
        name: (float(table[name].sel(statistic="mean")), float(table[name].sel(statistic="standard_uncertainty")))
        for name in names
    }


def _sigma_of(name: str) -> str | None:
    """Return the map with the standard deviations of a map, also of one of images; None when there is none."""
    return SIGMAS.get(name) or sigma_of(name)


def _summarise(values: np.ndarray) -> tuple[float, float, float, float, float]:
    """Return mean, standard deviation, minimum, median and maximum; NaN where they are not defined."""
    if not values.size:
        return (np.nan,) * 5
    deviation = float(values.std(ddof=1)) if values.size > 1 else np.nan
    return float(values.mean()), deviation, float(values.min()), float(np.median(values)), float(values.max())


def points_in(region: Region, dataset: xr.Dataset) -> np.ndarray:
    """Return which points of a dataset lie in a region of the reference image: booleans (row, column).

    Raises
    ------
    DatasetError
        No point lies in the region.
    ImageError
        The region was drawn in an image of another size.
    """
    size = image_size(dataset)
    if size is not None:
        region.require_size(*size)
    inside = region.mask_at(dataset["column"].values, dataset["row"].values)
    if not inside.any():
        corners = "; ".join(str(polygon.points) for polygon in region.polygons)
        raise DatasetError(f"no point of the result lies in the region {corners} px (column, row)")
    return inside
