"""Figures of one experiment for the catalogue."""

from __future__ import annotations

import numpy as np
import xarray as xr

from fringedic.campaign.key_figures import key_figures
from fringedic.evaluation.elasticity import constants_of, strain_curve

MAP = ("step", "row", "column")


def loaded_plate() -> xr.Dataset:
    """Return five steps, of which the last one is relative to a loaded one."""
    strain = np.array([0.0, 1e-3, 2e-3, 0.0, 3e-3])
    maps = {"e_22": (MAP, strain[:, None, None] * np.ones((1, 20, 20))), "e_11": (MAP, np.zeros((5, 20, 20)))}
    maps |= {f"sigma_{name}": (MAP, np.full((5, 20, 20), 1e-5)) for name in maps}
    values = {"force": [0.0, 100.0, 200.0, 300.0, 600.0], "valid_fraction": np.ones(5), "error": [""] * 5}
    values |= {"confirmed_fraction": np.ones(5), "reference_step": [0, 0, 0, 3, 3]}
    axes = {"step": range(5), "row": np.arange(20), "column": np.arange(20)}
    return xr.Dataset(maps | {name: ("step", each) for name, each in values.items()}, axes, {"experiment": "plate"})


def test_strains_of_the_catalogue_are_relative_to_one_reference() -> None:
    """The step that the later strains count from is loaded: their largest is not that of the experiment."""
    dataset = loaded_plate()
    constants = constants_of(strain_curve(dataset), (-1, 1), 0.0)
    figures = key_figures(dataset, constants)
    assert (figures["reference_step"], figures["reference_steps"]) == (0, "0, 3")
    assert (figures["largest_strain"], figures["largest_strain_step"]) == (2e-3, 2)
    against_one = dataset.assign(reference_step=("step", [0] * 5))
    figures = key_figures(against_one, constants_of(strain_curve(against_one), (-1, 1), 0.0))
    assert (figures["reference_step"], figures["reference_steps"], figures["largest_strain_step"]) == (0, "0", 4)


def test_conditions_are_mean_and_range_of_the_other_signals() -> None:
    temperature = ("step", [295.0, np.nan, 296.0, 297.0, 298.0], {"quantity": "temperature", "units": "K"})
    load = ("step", [0.0, -110.0, -220.0, -330.0, -660.0], {"quantity": "force", "units": "N"})
    dataset = loaded_plate().assign(temperature_grip=temperature, force_machine=load)
    constants = constants_of(strain_curve(dataset, load="force_machine"), (-1, 1), 0.0)
    figures = key_figures(dataset, constants, load="force_machine")
    assert (figures["mean_temperature_grip"], figures["range_temperature_grip"]) == (296.5, 3.0)
    assert figures["largest_force"] == -660.0
    assert "mean_force_machine" not in figures
