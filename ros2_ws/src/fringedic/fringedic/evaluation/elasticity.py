"""Mean strains of a region with their uncertainty, and the elastic constants that follow from them.

References
----------
York, D., Evensen, N. M., Lopez Martinez, M., De Basabe Delgado, J. (2004). Unified equations for the slope, intercept,
and standard errors of the best straight line. American Journal of Physics 72, 367-375, doi 10.1119/1.1632486.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr

from fringedic.datasets.quantities import MAP_DIMENSIONS
from fringedic.datasets.signals import knows_sigma, sigma_name
from fringedic.errors import DatasetError
from fringedic.evaluation.force import force_curve
from fringedic.evaluation.mean_uncertainty import spread_beyond_noise, uncertainty_of_mean
from fringedic.evaluation.probes import points_in
from fringedic.evaluation.step_maps import StepValues, maps_by_step, require_maps, values_by_step
from fringedic.frames.region import Region
from fringedic.signals import FORCE
from fringedic.wording.arguments import check_arguments, number, of_type, optional, several, text
from fringedic.wording.arguments import dataset as dataset_of

_STRAINS = ("e_11", "e_22")
_SIGMAS = ("sigma_e_11", "sigma_e_22")
_FEWEST_STEPS = 3  # a straight line with an uncertainty from its residuals needs so many
_CONVERGED = 1e-12  # the slope has converged when its relative change is smaller
_SMALLEST = 1e-12  # noise of a strain, so that results without noise have a weight
_ITERATIONS = 100
# Largest standard deviation of a strain over the region, over its mean: constants of two places then differ by less
# than about a half. The strain of the virtual plate scatters by 0.006, of the skin by 0.4, of the folded leather by 3.
_MOST_SPREAD = 0.2
_LEAST_RATIO = 0.25  # of the mean transverse strain over the axial one, where it is small: Poisson's ratio may be 0
_EXPERIMENT = dataset_of(over=MAP_DIMENSIONS)


@check_arguments(DatasetError, dataset=_EXPERIMENT, region=optional(of_type(Region)), load=text)
def strain_curve(dataset: xr.Dataset, region: Region | None = None, *, load: str = FORCE.name) -> xr.Dataset:
    """Return the mean strain of a region over the steps, with the standard uncertainty of the mean.

    Neighbouring points share their noise, so that the mean of n points is less certain than a standard deviation over
    the root of n; see `fringedic.evaluation.mean_uncertainty`. Systematic errors, such as those of the calibration, are
    not contained.

    Parameters
    ----------
    dataset
        From `open_experiment`, with ``e_11``, ``e_22`` and their standard deviations.
    region
        Part of the reference image; by default all points.
    load
        Name of the signal with the force, as of `force_curve`.

    Returns
    -------
    Dataset
        Over ``step``: ``e_11``, ``e_22``, ``sigma_e_11``, ``sigma_e_22`` [1], ``spread_e_11``, ``spread_e_22`` [1], the
        standard deviation over the region that noise does not explain, 0 where it does (chi-squared test with 0.1 % of
        false alarms), and ``force`` [N] and ``stress`` [Pa] as of `force_curve` and ``reference_step`` where they are
        known. NaN for a step without a result in the region.

    Raises
    ------
    DatasetError
        The dataset has no strain, or no point of it lies in the region.
    ImageError
        The region was drawn in an image of another size.

    Examples
    --------
    >>> generator = np.random.default_rng(1)
    >>> noisy = generator.normal(1e-3, 1e-5, (1, 40, 40))
    >>> maps = {name: (("step", "row", "column"), noisy) for name in ("e_11", "e_22")}
    >>> sigmas = {f"sigma_{name}": (("step", "row", "column"), np.full((1, 40, 40), 1e-5)) for name in maps}
    >>> axes = {"step": [0], "row": np.arange(40), "column": np.arange(40)}
    >>> curve = strain_curve(xr.Dataset(maps | sigmas, axes))
    >>> round(float(curve.e_11[0]), 6), round(float(curve.sigma_e_11[0]), 8)
    (0.001, 2.5e-07)
    """
    names = (*_STRAINS, *_SIGMAS)
    require_maps(dataset, names)
    inside = np.ones((dataset.sizes["row"], dataset.sizes["column"]), bool)
    if region is not None:
        inside = points_in(region, dataset)
    readings = np.array([_readings(step, maps, inside) for step, maps in _steps(dataset, names)])
    meanings = ("mean of {}", "standard uncertainty of the mean of {}", "standard deviation of {} beyond its noise")
    quantities = {
        f"{prefix}{name}": StepValues(readings[:, place, k], "1", meaning.format(name))
        for place, (prefix, meaning) in enumerate(zip(("", "sigma_", "spread_"), meanings, strict=True))
        for k, name in enumerate(_STRAINS)
    }
    curve = values_by_step(dataset, quantities)
    if load in dataset or load != FORCE.name:
        loads = force_curve(dataset, readings[:, 0, 0], load=load)
        curve = curve.assign({name: loads[name] for name in ("force", "stress") if name in loads})
    if knows_sigma(dataset, load):
        curve = curve.assign(force_sigma=dataset[sigma_name(load)].variable)
    if "reference_step" in dataset:
        curve = curve.assign(reference_step=dataset["reference_step"].variable)
    return curve


@dataclass(frozen=True)
class ElasticConstants:
    """Elastic constants of a region in uniaxial stress; NaN where not known.

    Attributes
    ----------
    axial
        Strain along the load: ``e_11`` or ``e_22``, that with the larger range over the steps of one reference.
    steps
        Number of steps in the regression.
    modulus, sigma_modulus
        Slope of the stress over the axial strain with its standard uncertainty [Pa]; NaN without force or section.
    poisson_ratio, sigma_poisson_ratio
        Negative slope of the transverse over the axial strain with its standard uncertainty [1].
    reference_step
        Step that the strain of the regression is relative to; -1 if the dataset does not state it.
    nonuniformity
        Standard deviation of a strain over the region, without noise, over its mean, at the step with the largest axial
        strain; that of the axial or of the transverse strain, the larger one.
    reason
        Why constants are not known; empty if they are.
    """

    axial: str
    steps: int
    modulus: float = math.nan
    sigma_modulus: float = math.nan
    poisson_ratio: float = math.nan
    sigma_poisson_ratio: float = math.nan
    reference_step: int = -1
    nonuniformity: float = math.nan
    reason: str = ""


@check_arguments(
    DatasetError,
    dataset=_EXPERIMENT,
    region=optional(of_type(Region)),
    strain=several(number(), length=2),
    sigma_force=number(0.0),
    load=text,
)
def elastic_constants(
    dataset: xr.Dataset,
    region: Region | None = None,
    *,
    strain: Sequence[float] = (-1.0, 1.0),
    sigma_force: float = 0.0,
    load: str = FORCE.name,
) -> ElasticConstants:
    """Return Young's modulus and Poisson's ratio of a region by regression with the uncertainty of both axes.

    Straight lines with an offset, by York et al. (2004). The offset takes the noise of the common reference and a
    preload. The standard uncertainty contains the noise of strain and force; where the points scatter more than that,
    it is increased to their scatter (Birge ratio). It does not contain the scale errors of calibration, load cell and
    section, which are those of the slope.

    A strain that is not uniform gives no constant of the material: the result depends on the region. The constants are
    NaN, with the reason, where the standard deviation of a strain over the region exceeds its noise significantly
    (0.1 % of false alarms) and a fifth of its mean, at the step with the largest axial strain. A transverse strain
    below a quarter of the axial one counts as a quarter. A modulus needs a uniform axial strain only.

    The strain starts again at 0 where the reference step changes, and the force does not. The regression therefore uses
    the steps of one reference: that of most steps in the range of strain, the first one if several have as many.

    Parameters
    ----------
    dataset
        From `open_experiment`; the stress is the force over the recorded section of the specimen.
    region
        Part of the reference image with a homogeneous strain; by default all points.
    strain
        Smallest and largest axial strain of the regression [1], relative to the reference of each step; by default all
        steps.
    sigma_force
        Standard uncertainty of a force, without its scale error [N], beside that of the signal (``force_sigma``).
    load
        Name of the signal with the force, as of `force_curve`.

    Raises
    ------
    DatasetError
        The dataset has no strain, no point of it lies in the region, or an argument is no such number.
    ImageError
        The region was drawn in an image of another size.

    Examples
    --------
    >>> elastic_constants(open_experiment("plate-7"), strain=(0.0005, 0.002))  # doctest: +SKIP
    ElasticConstants(axial='e_22', steps=8, modulus=3.1e9, ...)
    """
    return constants_of(strain_curve(dataset, region, load=load), strain, sigma_force)


def constants_of(curve: xr.Dataset, strain: Sequence[float], sigma_force: float) -> ElasticConstants:
    """Return the constants of a `strain_curve`; see `elastic_constants`."""
    ranges = [_largest_range(curve, name) for name in _STRAINS]
    axial, transverse = _STRAINS if ranges[0] > ranges[1] else _STRAINS[::-1]
    used = (curve[axial] >= strain[0]) & (curve[axial] <= strain[1]) & np.isfinite(curve[transverse])
    points = curve.isel(step=np.flatnonzero(used.values))
    reference = -1
    if "reference_step" in points and points.sizes["step"]:
        references, counts = np.unique(points["reference_step"].values, return_counts=True)
        reference = int(references[np.argmax(counts)])
        points = points.isel(step=np.flatnonzero(points["reference_step"].values == reference))
    steps = points.sizes["step"]
    if steps < _FEWEST_STEPS:
        reason = f"{steps} steps are in the range of strain, {_FEWEST_STEPS} are needed"
        return ElasticConstants(axial, steps, reference_step=reference, reason=reason)
    last = points.isel(step=int(np.argmax(np.abs(points[axial].values))))
    along, across = (abs(float(last[name])) for name in (axial, transverse))
    scales = {axial: along, transverse: max(across, _LEAST_RATIO * along)}
    spreads = {name: float(last[f"spread_{name}"]) / max(scale, _SMALLEST) for name, scale in scales.items()}
    reasons = [
        f"{name} is not uniform in the region: its standard deviation is {spread:.2g} of its mean, at most "
        f"{_MOST_SPREAD:g} is allowed; choose a region with a uniform strain"
        for name, spread in spreads.items()
        if spread > _MOST_SPREAD
    ]
    x, y = (_Axis(points[name].values, _noise(points, name)) for name in (axial, transverse))
    ratio, sigma_ratio = (math.nan, math.nan) if reasons else _slope(x, y)
    modulus, sigma_modulus = math.nan, math.nan
    if "stress" not in points or not np.isfinite(points["stress"]).all():
        reasons.append("the stress is not known at all steps: it needs a force and section_mm2 of the specimen")
    elif spreads[axial] <= _MOST_SPREAD:
        force, stress = points["force"].values, points["stress"].values
        scale = float(np.ptp(stress) / np.ptp(force)) if np.ptp(force) else math.nan
        if "force_sigma" not in points:
            force_noise = np.full(points.sizes["step"], sigma_force)
        else:
            known = points["force_sigma"].values
            force_noise = np.where(np.isfinite(known), np.hypot(sigma_force, known), sigma_force)
        modulus, sigma_modulus = _slope(x, _Axis(stress, scale * force_noise))
    return ElasticConstants(
        axial,
        steps,
        modulus,
        sigma_modulus,
        -ratio,
        sigma_ratio,
        reference,
        max(spreads.values()),
        "; ".join(reasons),
    )


def _largest_range(curve: xr.Dataset, name: str) -> float:
    """Return the largest range of a strain over the steps of one reference; 0 where none is measured."""
    values = curve[name].values
    references = curve["reference_step"].values if "reference_step" in curve else np.zeros(values.size)
    known = np.isfinite(values)
    parts = (values[known & (references == reference)] for reference in np.unique(references[known]))
    return max((float(np.ptp(part)) for part in parts), default=0.0)


class _Axis(NamedTuple):
    """Values of the points of a regression along one axis, with their standard uncertainties."""

    values: np.ndarray
    sigmas: np.ndarray


def _steps(dataset: xr.Dataset, names: Sequence[str]) -> Iterator[tuple[xr.Dataset, np.ndarray]]:
    """Iterate over the steps and their maps, shape (map, row, column)."""
    for index, maps in enumerate(maps_by_step(dataset, names)):
        yield dataset.isel(step=index) if "step" in dataset.dims else dataset, maps


def _readings(step: xr.Dataset, maps: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return means, their standard uncertainties, and spreads of both strains, shape (3, strain)."""
    found = np.full((3, len(_STRAINS)), np.nan)
    for place, (name, values, sigma) in enumerate(zip(_STRAINS, maps[:2], maps[2:], strict=True)):
        measured = inside & np.isfinite(values) & np.isfinite(sigma)
        if measured.any():
            found[0, place] = values[measured].mean(dtype=float)
            found[1, place] = uncertainty_of_mean(step, name, values, sigma, inside)
            found[2, place] = spread_beyond_noise(step, name, values, sigma, inside, found[1, place])
    return found


def _noise(curve: xr.Dataset, name: str) -> np.ndarray:
    """Return the noise of each step alone.

    The stated uncertainty is that of the difference of a step and the common reference. The noise of the reference is
    the same in all steps and is in the offset of the line; the reference itself, whose strain is 0 by definition, has
    the noise of the others.
    """
    sigma = curve[f"sigma_{name}"].values / math.sqrt(2)
    itself = curve[name].values == 0
    if not itself.all():
        sigma[itself] = np.sqrt(np.mean(sigma[~itself] ** 2))
    return np.asarray(np.maximum(sigma, _SMALLEST))


def _slope(x: _Axis, y: _Axis) -> tuple[float, float]:
    """Return the slope of a straight line with its standard uncertainty (York et al. 2004, without correlations)."""
    slope = np.polyfit(x.values, y.values, 1)[0]
    for _ in range(_ITERATIONS):
        weight = 1 / (y.sigmas**2 + (slope * x.sigmas) ** 2)
        u, v = (axis.values - np.average(axis.values, weights=weight) for axis in (x, y))
        adjusted = weight * (u * y.sigmas**2 + slope * v * x.sigmas**2)
        before, slope = slope, np.sum(weight * adjusted * v) / np.sum(weight * adjusted * u)
        if abs(slope - before) <= _CONVERGED * abs(slope):
            break
    spread = adjusted - np.average(adjusted, weights=weight)
    sigma = 1 / math.sqrt(np.sum(weight * spread**2))
    scatter = math.sqrt(np.sum(weight * (v - slope * u) ** 2) / (len(u) - 2))
    return float(slope), sigma * max(1.0, scatter)
