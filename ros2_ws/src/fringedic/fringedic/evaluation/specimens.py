"""Comparison of the specimens of a group: mean and spread of the same points beside the measurement uncertainty."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import reduce

import numpy as np
import xarray as xr

from fringedic.datasets.quantities import MAP_DIMENSIONS, sigma_of
from fringedic.errors import DatasetError
from fringedic.evaluation.two_experiments import common_maps, references_differ
from fringedic.wording.arguments import check_arguments, several, whole
from fringedic.wording.arguments import dataset as dataset_of

STATISTICS = {
    "points": "points that are measured of all specimens",
    "mean": "mean of all specimens over these points",
    "spread_of_means": "standard deviation between the means of the specimens",
    "spread": "root mean square over the points of the standard deviation between the specimens",
    "uncertainty": "root mean square of the standard uncertainty of one specimen at one point",
    "spread_over_uncertainty": "ratio of both: about 1 if the measurement explains the spread",
}
_EXPERIMENTS = several(dataset_of(over=MAP_DIMENSIONS), least=2)


@check_arguments(DatasetError, experiments=_EXPERIMENTS)
def compare_specimens(experiments: Sequence[xr.Dataset]) -> xr.Dataset:
    """Compare the specimens of a group point by point.

    Points correspond by their pixel in the reference image, steps by their number. One map of one step of all specimens
    is in memory at a time.

    Parameters
    ----------
    experiments
        From `open_experiment`, two or more.

    Returns
    -------
    Dataset
        `STATISTICS` over (step, quantity) in the unit of each quantity, and ``references_differ``: whether the
        displacements of a step are relative to different reference steps.

    Raises
    ------
    DatasetError
        The experiments have no step, no point or no map in common.

    Examples
    --------
    >>> axes = {"step": [0], "row": [0], "column": [0, 1]}
    >>> group = [
    ...     xr.Dataset({"w": (tuple(axes)[:3], [[[w, w]]]), "sigma_w": (tuple(axes)[:3], [[[0.1, 0.1]]])}, axes)
    ...     for w in (1.0, 2.0, 3.0)
    ... ]
    >>> found = compare_specimens(group).sel(quantity="w", step=0)
    >>> float(found["mean"]), float(found.spread), round(float(found.spread_over_uncertainty), 6)
    (2.0, 1.0, 10.0)
    """
    names = _names(experiments)
    steps = reduce(np.intersect1d, [each["step"].values for each in experiments])
    if not steps.size:
        raise DatasetError("the experiments have no step in common: compare experiments of the same programme")
    values = np.array([[_statistics(maps, name) for name in names] for maps in _each_step(experiments, steps, names)])
    return xr.Dataset(
        {
            name: (("step", "quantity"), values[..., place], {"long_name": meaning})
            for place, (name, meaning) in enumerate(STATISTICS.items())
        }
        | {"references_differ": ("step", references_differ(experiments, steps))},
        {"step": steps, "quantity": names},
    )


@check_arguments(DatasetError, experiments=_EXPERIMENTS, step=whole())
def specimen_maps(experiments: Sequence[xr.Dataset], step: int) -> xr.Dataset:
    """Return the maps of one step over the specimens of a group, at the points that are measured of all.

    Parameters
    ----------
    experiments
        From `open_experiment`, two or more.
    step
        Its number.

    Returns
    -------
    Dataset
        For each quantity NAME over (row, column): ``NAME``, the mean of the specimens, ``spread_NAME``, the standard
        deviation between them, ``uncertainty_NAME``, the root mean square of their standard uncertainties, and
        ``ratio_NAME``, spread over uncertainty; over ``specimen``: ``means_NAME``, their means over these points.

    Raises
    ------
    DatasetError
        The experiments have no point or no map in common, or one has no such step.
    """
    if not all(step in each["step"].values for each in experiments):
        raise DatasetError(f"not all of the experiments have a step {step}: compare one that all have")
    return next(_each_step(experiments, np.array([step]), _names(experiments)))


def _names(experiments: Sequence[xr.Dataset]) -> list[str]:
    """Return the maps that all experiments have."""
    first, *others = experiments
    found = [common_maps(first, each) for each in others]
    return [name for name in found[0] if all(name in names for names in found)]


def _each_step(experiments: Sequence[xr.Dataset], steps: np.ndarray, names: list[str]) -> Iterator[xr.Dataset]:
    """Yield `specimen_maps` step by step."""
    places = {axis: reduce(np.intersect1d, [each[axis].values for each in experiments]) for axis in MAP_DIMENSIONS[1:]}
    if not all(values.size for values in places.values()):
        raise DatasetError("the experiments have no point in common: their images or spacings differ")
    for step in steps:
        yield _step_maps([each.sel({"step": step, **places}) for each in experiments], names)


def _step_maps(steps: Sequence[xr.Dataset], names: list[str]) -> xr.Dataset:
    """Return `specimen_maps` of one step of each experiment."""
    maps = steps[0][[]].copy()
    for name in names:
        values, sigmas = (
            [each[part].transpose(*MAP_DIMENSIONS[1:]).load() for each in steps] for part in (name, str(sigma_of(name)))
        )
        mean, spread, uncertainty = _moments([each.values for each in values], [each.values for each in sigmas])
        measured = np.isfinite(mean)
        template = values[0]
        maps[name] = template.copy(data=mean)
        maps[f"spread_{name}"] = template.copy(data=spread)
        maps[f"uncertainty_{name}"] = template.copy(data=uncertainty)
        ratio = np.divide(spread, uncertainty, out=np.full_like(spread, np.nan), where=uncertainty > 0)
        maps[f"ratio_{name}"] = template.copy(data=ratio).assign_attrs(units="sigma")
        means = [each.values[measured].mean() if measured.any() else np.nan for each in values]
        maps[f"means_{name}"] = ("specimen", np.array(means, float))
    return maps


def _moments(values: Sequence[np.ndarray], sigmas: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mean, standard deviation and root mean square of the uncertainty; NaN where one is not measured."""
    stacked = np.stack(values).astype(float)
    uncertainty = np.sqrt(np.mean(np.stack(sigmas).astype(float) ** 2, axis=0))
    return stacked.mean(axis=0), stacked.std(axis=0, ddof=1), uncertainty


def _statistics(maps: xr.Dataset, name: str) -> list[float]:
    """Return `STATISTICS` of one quantity."""
    mean, spread, uncertainty = (maps[f"{prefix}{name}"].values for prefix in ("", "spread_", "uncertainty_"))
    measured = np.isfinite(mean)
    if not measured.any():
        return [0.0, *[np.nan] * (len(STATISTICS) - 1)]
    between, one = (float(np.sqrt(np.nanmean(values[measured] ** 2))) for values in (spread, uncertainty))
    return [
        float(measured.sum()),
        float(mean[measured].mean()),
        float(maps[f"means_{name}"].values.std(ddof=1)),
        between,
        one,
        between / one if one > 0 else np.nan,
    ]
