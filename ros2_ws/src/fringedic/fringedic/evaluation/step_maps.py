"""Maps of a dataset step by step, and values per step: the parts that all probes share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from fringedic.errors import DatasetError

_STRAINS = (("e_11", "e_22", "e_12"), ("e_xx", "e_yy", "e_xy"))


class StepValues(NamedTuple):
    """One quantity per step: its values, its unit and its meaning."""

    values: np.ndarray
    units: str
    long_name: str


def require_maps(dataset: xr.Dataset, names: Iterable[str]) -> None:
    """Raise DatasetError when a dataset lacks one of these maps of numbers."""
    missing = [name for name in names if name not in dataset or not {"row", "column"} <= set(dataset[name].dims)]
    if missing:
        present = [str(name) for name, each in dataset.data_vars.items() if {"row", "column"} <= set(each.dims)]
        raise DatasetError(f"the dataset has no map {', '.join(missing)}; it has {', '.join(present) or 'none'}")
    other = [name for name in names if dataset[name].dtype.kind not in "iuf"]
    if other:
        raise DatasetError(f"{', '.join(other)}: contains no numbers")


def step_of(dataset: xr.Dataset, number: int) -> xr.Dataset:
    """Return one step, by its number or counted from the last one; a dataset without steps is one step.

    Raises
    ------
    DatasetError
        There is no such step.
    """
    if "step" not in dataset.dims:
        return dataset
    present = dataset["step"].values.tolist()
    if number < 0 and -number <= len(present):
        return dataset.isel(step=number)
    if number not in present:
        raise DatasetError(
            f"the dataset has no step {number}; it has {', '.join(map(str, present))}, and -1 is the last one"
        )
    return dataset.sel(step=number)


def maps_by_step(dataset: xr.Dataset, names: Sequence[str]) -> Iterator[np.ndarray]:
    """Iterate over the maps of each step, shape (map, row, column); a dataset without steps is one step."""
    chosen = dataset[list(names)].transpose(..., "row", "column")
    if "step" not in dataset.dims:
        yield np.stack([chosen[name].values for name in names])
        return
    for index in range(dataset.sizes["step"]):
        one = chosen.isel(step=index)
        yield np.stack([one[name].values for name in names])


def values_by_step(dataset: xr.Dataset, quantities: Mapping[str, StepValues]) -> xr.Dataset:
    """Return quantities over the steps of a dataset, as numbers where it has no steps."""
    stepwise = "step" in dataset.dims
    return xr.Dataset(
        {
            name: (
                ("step",) if stepwise else (),
                values if stepwise else values[0],
                {"units": units, "long_name": long_name},
            )
            for name, (values, units, long_name) in quantities.items()
        },
        {"step": dataset.step} if stepwise else {},
    )


def with_stresses(step: xr.Dataset, modulus: float, poisson_ratio: float) -> xr.Dataset:
    """Return a step with the stress of an isotropic elastic sheet in plane stress, if it has a strain.

    Parameters
    ----------
    step
        With the strain ``e_11``, ``e_22``, ``e_12`` in the tangent plane, or ``e_xx``, ``e_yy``, ``e_xy`` of images.
    modulus
        Young's modulus [Pa].
    poisson_ratio
        Poisson's ratio [1].

    Returns
    -------
    Dataset
        With the principal stresses ``s_1`` >= ``s_2`` and the equivalent stress ``s_von_mises`` [Pa].

    Examples
    --------
    Uniaxial tension with 1000 µstrain:

    >>> strain = {"e_11": -0.3e-3, "e_22": 1e-3, "e_12": 0.0}
    >>> step = xr.Dataset({name: (("row", "column"), [[value]]) for name, value in strain.items()})
    >>> found = with_stresses(step, 70e9, 0.3)
    >>> [round(float(found[name][0, 0]) / 1e6, 6) for name in ("s_1", "s_2", "s_von_mises")]
    [70.0, 0.0, 70.0]
    """
    names = next((names for names in _STRAINS if all(name in step for name in names)), None)
    if names is None:
        return step
    e_11, e_22, e_12 = (step[name] for name in names)
    stiffness = modulus / (1 - poisson_ratio**2)
    centre = 0.5 * stiffness * (1 + poisson_ratio) * (e_11 + e_22)
    radius = modulus / (1 + poisson_ratio) * np.hypot(0.5 * (e_11 - e_22), e_12)
    units = {"units": "Pa"}
    return step.assign(
        s_1=(centre + radius).assign_attrs(units),
        s_2=(centre - radius).assign_attrs(units),
        s_von_mises=((centre**2 + 3 * radius**2) ** 0.5).assign_attrs(units),
    )


def with_principal_strains(step: xr.Dataset) -> xr.Dataset:
    """Return a step with the principal strains ``e_1`` >= ``e_2`` of its strain in the tangent plane, if it has one."""
    if "e_1" in step or not all(name in step for name in ("e_11", "e_22", "e_12")):
        return step
    centre = 0.5 * (step["e_11"] + step["e_22"])
    radius = np.hypot(0.5 * (step["e_11"] - step["e_22"]), step["e_12"])
    units = {"units": "1"}
    return step.assign(e_1=(centre + radius).assign_attrs(units), e_2=(centre - radius).assign_attrs(units))
