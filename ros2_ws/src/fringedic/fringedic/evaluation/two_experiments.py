"""Comparison of two experiments: differences of the same points over their uncertainty, and what else differs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fringedic.datasets.attributes import plain
from fringedic.datasets.quantities import MAP_DIMENSIONS, sigma_of
from fringedic.errors import DatasetError
from fringedic.wording.arguments import check_arguments, whole
from fringedic.wording.arguments import dataset as dataset_of

COMPARED = ("displacement_x", "displacement_y", "u", "v", "w", "e_11", "e_22", "e_12")
"""Maps that are compared where both experiments have them."""
STATISTICS = {
    "points": "points that both experiments measured",
    "mean_one": "mean of the first experiment over these points",
    "mean_other": "mean of the second experiment over these points",
    "rms_difference": "root mean square of the second minus the first",
    "rms_sigma": "root mean square of the standard uncertainty of the difference",
    "normalized_rms": "root mean square of the difference over its standard uncertainty",
    "within_2_sigma": "share of points whose difference is within two standard uncertainties",
}
_ATTRIBUTES = (
    *("experiment", "source", "software", "commit", "parameters", "calibration", "rig", "facts"),
    *("pixel_size", "image_width", "image_height"),  # of images without a rig
)
_EXPERIMENT = dataset_of(over=MAP_DIMENSIONS)


class Difference(NamedTuple):
    """An attribute that differs between two experiments: its path, and its value in each; None where it is missing."""

    name: str
    one: Any
    other: Any


@check_arguments(DatasetError, one=_EXPERIMENT, other=_EXPERIMENT)
def compare_experiments(one: xr.Dataset, other: xr.Dataset) -> xr.Dataset:
    """Compare two experiments point by point: two specimens, or one recording processed with two settings.

    Points correspond by their pixel in the reference image, steps by their number. The standard uncertainty of a
    difference is that of two independent measurements. Two evaluations of one recording share its noise: their
    differences are smaller, ``normalized_rms`` is then below 1.

    Parameters
    ----------
    one, other
        From `open_experiment`.

    Returns
    -------
    Dataset
        `STATISTICS` over (step, quantity) in the unit of each quantity, ``force_one``, ``force_other`` [N], and
        ``references_differ``: whether the displacements of a step are relative to different reference steps.

    Raises
    ------
    DatasetError
        The experiments have no step, no point or no map in common.

    Examples
    --------
    >>> step = {"step": [0], "row": [0], "column": [0, 1]}
    >>> maps = {name: (("step", "row", "column"), [[[0.0, 1.0]]]) for name in ("w", "sigma_w")}
    >>> one = xr.Dataset(maps, step)
    >>> found = compare_experiments(one, one.assign(w=one.w + 1)).sel(quantity="w", step=0)
    >>> int(found.points), float(found.rms_difference), round(float(found.rms_sigma), 3)
    (2, 1.0, 1.0)
    """
    names = common_maps(one, other)
    steps = [int(step) for step in one["step"].values if step in other["step"].values]
    if not steps:
        raise DatasetError("the two experiments have no step in common: compare experiments of the same programme")
    statistics = [[_statistics(maps, name) for name in names] for maps in _each_step(one, other, steps, names)]
    values = np.array(statistics, float)
    found = xr.Dataset(
        {
            name: (("step", "quantity"), values[..., place], {"long_name": meaning})
            for place, (name, meaning) in enumerate(STATISTICS.items())
        },
        {"step": steps, "quantity": names},
    )
    found["references_differ"] = ("step", references_differ([one, other], steps))
    for name, dataset in (("force_one", one), ("force_other", other)):
        if "force" in dataset:
            found[name] = dataset["force"].sel(step=steps)
    return found


@check_arguments(DatasetError, step=whole())
def difference_maps(one: xr.Dataset, other: xr.Dataset, step: int) -> xr.Dataset:
    """Return the maps of one step at the points that both experiments have.

    Parameters
    ----------
    one, other
        From `open_experiment`.
    step
        Its number.

    Returns
    -------
    Dataset
        For each quantity NAME over (row, column): ``NAME`` of the first experiment, ``other_NAME``,
        ``difference_NAME`` (second minus first), ``sigma_difference_NAME`` and ``normalized_NAME``.

    Raises
    ------
    DatasetError
        The experiments have no point or no map in common.
    """
    return next(_each_step(one, other, [step], common_maps(one, other)))


def differing_attributes(one: xr.Dataset, other: xr.Dataset) -> list[Difference]:
    """Return the settings, parts of calibration and rig, software, scale, image size and reference steps that differ.

    Examples
    --------
    >>> settings = ({"parameters": json.dumps([{"parameters": {"dic": {"window": size}}}])} for size in (24, 32))
    >>> differing_attributes(*(xr.Dataset(attrs=each) for each in settings))
    [Difference(name='parameters.dic.window', one=24, other=32)]
    """
    first, second = _flat_attributes(one), _flat_attributes(other)
    names = [*first, *(name for name in second if name not in first)]
    differences = [
        Difference(name, first.get(name), second.get(name)) for name in names if first.get(name) != second.get(name)
    ]
    if all("reference_step" in each for each in (one, other)):
        steps = np.intersect1d(one["step"], other["step"])
        steps = steps[references_differ([one, other], steps)]
        if steps.size:
            values = [np.unique(each["reference_step"].sel(step=steps)).astype(int).tolist() for each in (one, other)]
            differences.append(Difference("reference_step", *(each[0] if len(each) == 1 else each for each in values)))
    return differences


def references_differ(experiments: Sequence[xr.Dataset], steps: Sequence[int] | np.ndarray) -> np.ndarray:
    """Return at which steps the reference steps of experiments differ, as far as they are recorded: booleans (step,).

    Examples
    --------
    >>> recorded = ([0, 0, 0], [-1, 0, 2])
    >>> group = [xr.Dataset({"reference_step": ("step", each)}, {"step": range(3)}) for each in recorded]
    >>> references_differ(group, [0, 1, 2]).tolist()
    [False, False, True]
    """
    recorded = [each["reference_step"].sel(step=steps).values for each in experiments if "reference_step" in each]
    if not recorded:
        return np.zeros(len(steps), bool)
    values = np.array(recorded, float)
    known = values >= 0
    highest, lowest = np.where(known, values, -np.inf).max(axis=0), np.where(known, values, np.inf).min(axis=0)
    return np.asarray(highest > lowest)


def common_maps(one: xr.Dataset, other: xr.Dataset) -> list[str]:
    """Return the names of the `COMPARED` maps that both experiments have with their standard deviation.

    Raises
    ------
    DatasetError
        There is none, or they have no point in common.
    """
    names = [
        name
        for name in COMPARED
        if all(
            (each in dataset and set(dataset[each].dims) == set(MAP_DIMENSIONS) and dataset[each].dtype.kind == "f")
            for dataset in (one, other)
            for each in (name, str(sigma_of(name)))
        )
    ]
    if not names:
        raise DatasetError(f"the two experiments have none of the maps {', '.join(COMPARED)} in common")
    if not all(np.intersect1d(one[axis], other[axis]).size for axis in ("row", "column")):
        raise DatasetError("the two experiments have no point in common: their images or spacings differ")
    return names


def _each_step(one: xr.Dataset, other: xr.Dataset, steps: list[int], names: list[str]) -> Iterator[xr.Dataset]:
    """Yield the maps of `difference_maps` step by step."""
    wanted = [*names, *(str(sigma_of(name)) for name in names)]
    for step in steps:
        first, second = xr.align(
            *(each[wanted].sel(step=step).transpose(*MAP_DIMENSIONS[1:]).load() for each in (one, other)), join="inner"
        )
        maps = first[names].copy()
        for name in names:
            sigma = (first[sigma_of(name)] ** 2 + second[sigma_of(name)] ** 2) ** 0.5
            difference = second[name] - first[name]
            maps[f"other_{name}"] = second[name]
            maps[f"difference_{name}"] = difference.assign_attrs(first[name].attrs)
            maps[f"sigma_difference_{name}"] = sigma.assign_attrs(first[name].attrs)
            normalized = difference / sigma.where(sigma > 0)
            maps[f"normalized_{name}"] = normalized.assign_attrs(units="sigma")
        yield maps


def _statistics(maps: xr.Dataset, name: str) -> list[float]:
    """Return `STATISTICS` of one quantity."""
    one, other, difference, sigma, normalized = (
        maps[f"{prefix}{name}"].values.astype(float)
        for prefix in ("", "other_", "difference_", "sigma_difference_", "normalized_")
    )
    both = np.isfinite(difference)
    if not both.any():
        return [0.0, *[np.nan] * (len(STATISTICS) - 1)]
    known = normalized[np.isfinite(normalized)]
    return [
        float(both.sum()),
        float(one[both].mean()),
        float(other[both].mean()),
        float(np.sqrt(np.mean(difference[both] ** 2))),
        float(np.sqrt(np.nanmean(sigma[both] ** 2))),
        float(np.sqrt(np.mean(known**2))) if known.size else np.nan,
        float(np.mean(np.abs(known) <= 2)) if known.size else np.nan,
    ]


def _flat_attributes(dataset: xr.Dataset) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name in _ATTRIBUTES:
        if name not in dataset.attrs:
            continue
        value = plain(dataset.attrs[name])
        if name == "parameters":
            value = json.loads(value)[-1]["parameters"]
        elif name in ("calibration", "rig", "facts"):
            value = json.loads(value)
        flat |= dict(_flattened(name, value))
    return flat


def _flattened(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _flattened(f"{name}.{key}", inner)
    else:
        yield name, value
