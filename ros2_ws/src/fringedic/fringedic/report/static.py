"""Noise floors from the static images of an experiment: steps at rest, measured against a reference step at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from fringedic.errors import DatasetError

POSITION_TOLERANCE = 1e-6  # [m], crosshead positions that count as the same
QUANTITIES = (
    "displacement_x",
    "displacement_y",
    "u",
    "v",
    "w",
    "e_11",
    "e_22",
    "e_12",
)
SIGMAS = {
    "displacement_x": "displacement_sigma_x",
    "displacement_y": "displacement_sigma_y",
    **{name: f"sigma_{name}" for name in ("u", "v", "w", "e_11", "e_22", "e_12")},
}


@dataclass(frozen=True)
class NoiseFloor:
    """Noise of one quantity over the points that all static steps have, in the unit of the dataset.

    Attributes
    ----------
    name
        Map of the dataset.
    spatial
        Standard deviation over the points, averaged over the steps; it holds the noise of step and reference.
    temporal
        Standard deviation over the steps at each point, root mean square over the points; the noise of the reference is
        not in it. NaN for a single step.
    bias
        Mean over points and steps: systematic error, and any drift since the reference.
    predicted
        Root mean square of the stated standard deviations.
    points
        Number of points.
    """

    name: str
    spatial: float
    temporal: float
    bias: float
    predicted: float
    points: int


def static_steps(dataset: xr.Dataset) -> list[int]:
    """Return the steps that repeat the last step's reference at rest: beside it, at the same crosshead position.

    Empty where no load frame tells positions. A later return to the position does not count: the specimen may have
    changed. Nor does a step that was compared with itself, because the one before it failed.
    """
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


def noise_floors(dataset: xr.Dataset, steps: Sequence[int]) -> list[NoiseFloor]:
    """Return the noise of displacement and strain over static steps.

    Parameters
    ----------
    dataset
        From `fringedic.open_experiment`.
    steps
        Numbers of the static steps, without their reference.

    Raises
    ------
    DatasetError
        The dataset lacks one of the steps.
    """
    absent = [step for step in steps if step not in dataset["step"].values]
    if absent:
        raise DatasetError(f"the dataset has no step {', '.join(map(str, absent))} to take the noise from")
    floors = []
    for name in QUANTITIES if len(steps) else ():
        if name not in dataset:
            continue
        maps = dataset[name].sel(step=list(steps)).values.astype(np.float64)
        common = np.isfinite(maps).all(axis=0)
        if common.sum() < 2:
            continue
        values = maps[:, common]
        predicted = np.nan
        if SIGMAS[name] in dataset:
            predicted = _rms(dataset[SIGMAS[name]].sel(step=list(steps)).values[:, common])
        floors.append(
            NoiseFloor(
                name=name,
                spatial=float(values.std(axis=1, ddof=1).mean()),
                temporal=float(np.sqrt(values.var(axis=0, ddof=1).mean())) if len(steps) > 1 else float("nan"),
                bias=float(values.mean()),
                predicted=predicted,
                points=int(common.sum()),
            )
        )
    return floors


def _rms(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)].astype(np.float64)
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")
