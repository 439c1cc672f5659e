"""Figures of one experiment for the catalogue of a campaign."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from fringedic.datasets.attributes import recorded_metadata
from fringedic.datasets.confirmation import confirmed_share
from fringedic.datasets.signals import signal_names
from fringedic.evaluation.elasticity import ElasticConstants
from fringedic.evaluation.noise_floor import noise_floors, static_steps
from fringedic.signals import FORCE, POSITION

_STRAINS = ("e_11", "e_22")
_ELASTIC = ("modulus", "sigma_modulus", "poisson_ratio", "sigma_poisson_ratio", "nonuniformity")
_NOISE = ("u", "v", "w", *_STRAINS)


def key_figures(dataset: xr.Dataset, constants: ElasticConstants, *, load: str = FORCE.name) -> dict[str, Any]:
    """Return the figures of an experiment in SI units; None for those that are not known.

    Parameters
    ----------
    dataset
        From `fringedic.open_experiment`.
    constants
        Its elastic constants.
    load
        Name of the signal with the force.

    Returns
    -------
    dict
        ``experiment``, ``specimen``, ``material``; numbers of ``steps`` and ``failed_steps``; ``reference_step``, which
        all strains of this list are relative to (that of the elastic constants, else the first one), and
        ``reference_steps``, all of the experiment; ``confirmed_fraction`` and the mean ``valid_fraction``;
        ``largest_force`` by its magnitude [N]; ``largest_strain``, the largest magnitude of e_11 and e_22 at any point,
        with ``sigma_largest_strain`` there and ``largest_strain_step``;
        ``axial_strain``, the name of the strain along the load; ``modulus`` [Pa] and ``poisson_ratio`` with
        ``sigma_modulus`` and ``sigma_poisson_ratio``, ``nonuniformity`` and ``elastic_reason``, why they are not known,
        as of `ElasticConstants`; ``noise_u``, ... [m] and ``noise_e_11``, ...: standard deviation over the points of
        the steps at rest;
        ``mean_temperature_grip``, ``range_temperature_grip``, ...: mean and largest minus smallest value over the steps
        of each signal besides force and position, in its unit.
    """
    specimen = recorded_metadata(dataset).specimen
    floors = {floor.name: floor.spatial for floor in noise_floors(dataset, static_steps(dataset))}
    largest, sigma, step = np.nan, np.nan, None
    references = dataset["reference_step"].values
    known_references = [int(each) for each in np.unique(references) if each >= 0]
    reference = constants.reference_step if constants.reference_step >= 0 else next(iter(known_references), -1)
    for index in np.flatnonzero(references == reference):
        for name in _STRAINS:
            values = dataset[name].isel(step=index).values
            if not np.isfinite(values).any():
                continue
            place = np.unravel_index(np.nanargmax(np.abs(values)), values.shape)
            if not abs(values[place]) <= abs(largest):
                largest, step = float(values[place]), int(dataset["step"][index])
                sigma = float(dataset[f"sigma_{name}"].isel(step=index).values[place])
    forces = dataset[load].values
    known = forces[np.isfinite(forces)]
    values = dataset["valid_fraction"].values
    finite = values[np.isfinite(values)]
    figures: dict[str, Any] = {
        "experiment": dataset.attrs["experiment"],
        "specimen": specimen.name,
        "material": specimen.material,
        "steps": dataset.sizes["step"],
        "reference_step": None if reference < 0 else reference,
        "reference_steps": ", ".join(map(str, known_references)),
        "failed_steps": int(np.count_nonzero(dataset["error"].values != "")),
        "confirmed_fraction": confirmed_share(dataset),
        "valid_fraction": float(finite.mean()) if finite.size else np.nan,
        "largest_force": float(known[np.argmax(np.abs(known))]) if known.size else np.nan,
        "largest_strain": largest,
        "sigma_largest_strain": sigma,
        "largest_strain_step": step,
        "axial_strain": constants.axial,
        "elastic_reason": constants.reason,
        **{name: getattr(constants, name) for name in _ELASTIC},
        **{f"noise_{name}": floors.get(name, np.nan) for name in _NOISE},
        **_conditions(dataset, {FORCE.name, POSITION.name, load}),
    }
    return {name: None if isinstance(value, float) and np.isnan(value) else value for name, value in figures.items()}


def _conditions(dataset: xr.Dataset, loads: set[str]) -> dict[str, float]:
    """Return mean and range over the steps of the signals that are no loads, such as a temperature."""
    found = {}
    for name in signal_names(dataset):
        values = dataset[name].values
        known = values[np.isfinite(values)]
        if name not in loads:
            found[f"mean_{name}"] = float(known.mean()) if known.size else np.nan
            found[f"range_{name}"] = float(np.ptp(known)) if known.size else np.nan
    return found
