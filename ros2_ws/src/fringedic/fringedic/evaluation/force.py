"""Force and stress of the steps of an experiment."""

from __future__ import annotations

import json

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from fringedic.datasets.signals import knows_sigma, sigma_name, signal_names
from fringedic.errors import DatasetError
from fringedic.evaluation.step_maps import StepValues, values_by_step
from fringedic.signals import FORCE
from fringedic.wording.arguments import array, check_arguments, number, optional, text
from fringedic.wording.arguments import dataset as dataset_of


@check_arguments(
    DatasetError,
    dataset=dataset_of(over=("step",)),
    strain=array(1),
    section=optional(number()),
    tare=number(),
    sign=number(),
    load=text,
)
def force_curve(
    dataset: xr.Dataset,
    strain: ArrayLike,
    *,
    section: float | None = None,
    tare: float = 0.0,
    sign: int = 1,
    load: str = FORCE.name,
) -> xr.Dataset:
    """Return force, and stress if the section is known, against a strain or an elongation.

    Parameters
    ----------
    dataset
        From `open_experiment`, with the ``force`` of each step [N]: the mean of the load frame's readings over the
        exposures of the step, with the tare and sign of the specimen's metadata.
    strain
        One value per step, shape (step,), such as ``strain`` of `extensometer` or the mean of a region.
    section
        Area that carries the force [m^2]; by default that of the recorded metadata of the specimen.
    tare, sign
        Further corrections: sign (force - tare), with the tare [N] and the sign 1 or -1.
    load
        Name of the signal with the force [N], such as that of a second load cell.

    Returns
    -------
    Dataset
        Over ``step``: ``strain``, ``force`` [N] and, with a section, ``stress`` [Pa], the force over the section in the
        reference; where that of the sensor is known, with the standard uncertainties ``force_sigma``, ``stress_sigma``,
        which do not contain the section.

    Raises
    ------
    DatasetError
        The dataset has no such force, the number of values is not that of the steps, or section or sign is invalid.

    Examples
    --------
    >>> import xarray as xr
    >>> dataset = xr.Dataset({"force": ("step", [5.0, 25.0])}, {"step": [0, 1]})
    >>> force_curve(dataset, [0.0, 0.01], section=10e-6, tare=5.0).stress.values.round().tolist()
    [0.0, 2000000.0]
    """
    if load not in dataset or dataset[load].attrs.get("units", FORCE.unit) != FORCE.unit:
        forces = [name for name in signal_names(dataset) if dataset[name].attrs["units"] == FORCE.unit]
        raise DatasetError(
            f"the dataset has no force [N] '{load}', only {', '.join(forces) or 'none'}; record a load frame, or name "
            "another signal"
        )
    values = np.asarray(strain, float)
    if values.shape != (dataset.sizes["step"],):
        raise DatasetError(f"strain has the shape {values.shape}, the dataset has {dataset.sizes['step']} steps")
    if sign not in (1, -1):
        raise DatasetError(f"sign is {sign}: it has to be 1 or -1")
    if section is not None and not section > 0:
        raise DatasetError(f"section is {section} m2: it has to be above 0")
    section = _recorded_section(dataset) if section is None else section
    force = sign * (dataset[load].values.astype(float) - tare)
    curve = {"strain": StepValues(values, "1", "strain"), "force": StepValues(force, "N", "force")}
    sigma = dataset[sigma_name(load)].values.astype(float) if knows_sigma(dataset, load) else None
    if sigma is not None:
        curve["force_sigma"] = StepValues(sigma, "N", "standard uncertainty of force")
    if section is not None:
        curve["stress"] = StepValues(force / section, "Pa", "force over the reference section")
    if section is not None and sigma is not None:
        curve["stress_sigma"] = StepValues(sigma / section, "Pa", "standard uncertainty of stress")
    return values_by_step(dataset, curve)


def _recorded_section(dataset: xr.Dataset) -> float | None:
    recorded = json.loads(dataset.attrs.get("facts", "{}"))
    square_millimetres = recorded.get("specimen", {}).get("section_mm2")
    return None if square_millimetres is None else 1e-6 * float(square_millimetres)
