"""The noise floor: noise and bias of a quantity over steps (or images) at rest. The one definition of all rooms.

Every step at rest is measured against the same reference, which is at rest too.

References
----------
Jones, E. M. C., Iadicola, M. A. (eds.) (2018). A Good Practices Guide for Digital Image Correlation. International
Digital Image Correlation Society, doi 10.32720/idics/gpg.ed1; edition 2: doi 10.58720/idics/gpg.ed2.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from fringedic.errors import DatasetError

POSITION_TOLERANCE = 1e-6  # [m], crosshead positions that count as the same: the resolution of common machines
SIGMAS = {
    "displacement_x": "displacement_sigma_x",
    "displacement_y": "displacement_sigma_y",
    **{name: f"sigma_{name}" for name in ("u", "v", "w", "e_11", "e_22", "e_12", "e_xx", "e_yy", "e_xy")},
}
"""Maps of a dataset that have a noise floor, and the maps of their stated standard deviations."""


@dataclass(frozen=True)
class NoiseFloor:
    """Noise and bias of one quantity at rest, in the unit of its maps.

    Attributes
    ----------
    name
        The quantity.
    spatial
        Standard deviation over the points, averaged over the steps; it contains the noise of step and reference.
    temporal
        Standard deviation over the steps at each point, root mean square over the points; it does not contain the noise
        of the reference. NaN for a single step.
    bias
        Mean over points and steps: systematic error, and drift since the reference.
    predicted
        Root mean square of the stated standard deviations; NaN if there are none.
    points
        Number of points.
    limit
        Root mean square of the Cramer-Rao bound; NaN where it is not known.
    """

    name: str
    spatial: float
    temporal: float
    bias: float
    predicted: float
    points: int
    limit: float = math.nan


def noise_floor(name: str, maps: np.ndarray, sigmas: np.ndarray | None = None) -> NoiseFloor | None:
    """Return the noise floor of a quantity over the points that are measured in all steps.

    Parameters
    ----------
    name
        The quantity.
    maps
        Its maps at rest against a common reference, shape (step, row, column), in any unit; NaN where not measured.
    sigmas
        Stated standard deviations, same shape and unit.

    Returns
    -------
    NoiseFloor or None
        None if fewer than two points are measured in all steps.

    Examples
    --------
    >>> import numpy as np
    >>> noise = np.random.default_rng(1).normal(0.02, 0.1, (5, 100, 100))
    >>> floor = noise_floor("displacement_x", noise)
    >>> round(floor.spatial, 2), round(floor.temporal, 2), round(floor.bias, 2), floor.points
    (0.1, 0.1, 0.02, 10000)
    """
    maps = np.asarray(maps, np.float64)
    common = np.isfinite(maps).all(axis=0)
    if common.sum() < 2:
        return None
    values = maps[:, common]
    return NoiseFloor(
        name=name,
        spatial=float(values.std(axis=1, ddof=1).mean()),
        temporal=float(np.sqrt(values.var(axis=0, ddof=1).mean())) if len(values) > 1 else np.nan,
        bias=float(values.mean()),
        predicted=np.nan if sigmas is None else _rms(sigmas[:, common]),
        points=int(common.sum()),
    )


def noise_floors(dataset: xr.Dataset, steps: Sequence[int]) -> list[NoiseFloor]:
    """Return the noise floors of displacement and strain over steps at rest.

    Parameters
    ----------
    dataset
        From `fringedic.open_experiment`.
    steps
        Numbers of the steps at rest, without their reference: of `static_steps` or `check_static_steps`.
    """
    if not len(steps):
        return []
    static = dataset.sel(step=list(steps))
    floors = (
        noise_floor(name, static[name].values, static[sigma].values if sigma in static else None)
        for name, sigma in SIGMAS.items()
        if name in static
    )
    return [floor for floor in floors if floor is not None]


def single_step_noise_floors(dataset: xr.Dataset, steps: Sequence[int]) -> list[NoiseFloor]:
    """Return the noise floors of phase and height of single steps, with the reference among them.

    Only their temporal part and their prediction are known: over the points the surface is not flat.

    Parameters
    ----------
    dataset
        From `fringedic.open_experiment`.
    steps
        Numbers of all steps at rest.
    """
    static = dataset.sel(step=list(steps))
    floors = (
        noise_floor(name, static[name].values, static[sigma].values if sigma in static else None)
        for name, sigma in (("phase", "phase_sigma"), ("shape_z", "shape_sigma_z"))
        if name in static
    )
    return [replace(floor, spatial=np.nan, bias=np.nan) for floor in floors if floor is not None]


def static_steps(dataset: xr.Dataset) -> list[int]:
    """Return the steps that repeat the last step's reference at rest: next to it, at the same crosshead position.

    The list is empty without positions of a load frame. A later return to the position does not count, because the
    specimen may have changed. A step that was compared with itself, because the step before it failed, does not count
    either.
    """
    if "position" not in dataset:
        return []
    numbers, positions = dataset["step"].values, dataset["position"].values
    moved = dataset["rms_displacement"].values
    references = [int(number) for number in dataset["reference_step"].values if number >= 0]
    if not references or references[-1] not in numbers:
        return []
    place = int(np.flatnonzero(numbers == references[-1])[0])
    found = []
    for direction in (-1, 1):
        index = place + direction
        while 0 <= index < len(numbers) and abs(positions[index] - positions[place]) <= POSITION_TOLERANCE:
            if dataset["reference_step"].values[index] == references[-1] and moved[index] > 0:
                found.append(int(numbers[index]))
            index += direction
    return sorted(found)


def check_static_steps(dataset: xr.Dataset, steps: Sequence[int]) -> list[int]:
    """Return the steps that a person names as at rest in their order, without their reference, whose displacement is 0.

    Parameters
    ----------
    dataset
        From `fringedic.open_experiment`.
    steps
        Numbers of the steps.

    Raises
    ------
    DatasetError
        The dataset lacks one of the steps, it was not measured, or they have several references.
    """
    named = sorted(set(steps))
    absent = [step for step in named if step not in dataset["step"].values]
    if absent:
        raise DatasetError(
            f"the dataset has no step {_listed(absent)} to take the noise from: name steps of the dataset"
        )
    static = dataset[["reference_step", "error"]].sel(step=named)
    references = static["reference_step"].values
    unmeasured = static["step"].values[(references < 0) | (static["error"].values != "")]
    if unmeasured.size:
        raise DatasetError(
            f"the dataset has no displacement of step {_listed(unmeasured)} to take the noise from: name steps that "
            "were measured"
        )
    if len(set(references)) > 1:
        raise DatasetError(
            f"steps {_listed(named)} are relative to steps {_listed(references)}: name steps at rest of one reference"
        )
    return [step for step, reference in zip(named, references, strict=True) if step != reference]


def _listed(steps: Iterable[int]) -> str:
    return ", ".join(str(int(step)) for step in steps)


def _rms(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)].astype(np.float64)
    return float(np.sqrt(np.mean(finite**2))) if finite.size else np.nan
