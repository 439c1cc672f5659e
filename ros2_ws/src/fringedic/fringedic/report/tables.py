"""Cells of the tables of a report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from fringedic.datasets.attributes import seconds
from fringedic.datasets.quantities import PeopleUnit, largest_of, people_unit
from fringedic.datasets.signals import drift_name, has_drift, knows_sigma, sigma_name, signal_names
from fringedic.evaluation.noise_floor import NoiseFloor
from fringedic.evaluation.probes import region_statistics
from fringedic.evaluation.truth import compare_with_truth
from fringedic.frames.region import Region
from fringedic.metadata import NOISE_QUANTITIES
from fringedic.wording.numbers import number_text

MILLI, MICRO = 1e-3, 1e-6
REGION_MAPS = ("u", "v", "w", "displacement_x", "displacement_y", "e_11", "e_22", "e_12", "e_xx", "e_yy", "e_xy")
REGION_STATISTICS = ("mean", "standard_uncertainty", "standard_deviation", "minimum", "maximum")
_MOST_COLUMNS = 9  # beside that of the step
_ROUNDING = 1e-9  # of a signal: a drift below it is the rounding of its samples, which are constant
_STEP_VALUES = (  # after the signals; factor 0: in the unit of people
    ("valid_fraction", "measured [%]", 0.01),
    ("confirmed_fraction", "confirmed [%]", 0.01),
    ("rms_displacement", "RMS displacement", 0.0),
)


def noise_floor_row(floor: NoiseFloor) -> list[str]:
    """Return quantity, spatial and temporal noise, bias, stated noise and number of points."""
    quantity = NOISE_QUANTITIES[floor.name]
    values = (floor.spatial, floor.temporal, floor.bias, floor.predicted)
    cells = [number_text(value / quantity.factor) for value in values]
    return [f"{floor.name} [{quantity.unit}]", *cells, str(floor.points)]


class Column(NamedTuple):
    """A column of the table of steps: its heading, its cells, and whether they are numbers."""

    heading: str
    cells: list[str]
    is_number: bool = True


def step_columns(dataset: xr.Dataset) -> list[Column]:
    """Return the columns of the table of steps: number, image or time, load, references, displacement and error."""
    columns = [Column("step", [str(int(step)) for step in dataset["step"].values])]
    if "image" in dataset:
        columns.append(Column("image", [str(name) for name in dataset["image"].values], False))
    if "time" in dataset:
        columns.append(Column("time [s]", [f"{value:.1f}" for value in seconds(dataset)]))
    signals = [(name, name, 0.0) for name in signal_names(dataset)]
    signals += [
        (sigma_name(name), f"sigma of {name}", 0.0) for name in signal_names(dataset) if knows_sigma(dataset, name)
    ]
    drifts = {drift_name(name): name for name in signal_names(dataset) if has_drift(dataset, name)}
    signals += [(name, f"drift of {signal}", 0.0) for name, signal in drifts.items()]
    for name, heading, factor in (*signals, *_STEP_VALUES):
        if name in dataset:
            unit, in_dataset = people_unit(dataset[name]), dataset[name].values.astype(float)
            factor, heading = (factor, heading) if factor else (unit.factor, f"{heading} [{unit.text}]")
            if name in drifts:
                largest = largest_of([dataset[drifts[name]].values.astype(float)])
                in_dataset = np.where(np.abs(in_dataset) < _ROUNDING * largest, 0.0, in_dataset)
            columns.append(Column(heading, [number_text(value / factor) for value in in_dataset]))
    for name, heading in (("reference_step", "reference step"), ("correlated_step", "compared with")):
        columns.append(
            Column(heading, [_step_number(dataset.isel(step=index), name) for index in range(dataset.sizes["step"])])
        )
    return [*columns, Column("error", [str(error) for error in dataset["error"].values], False)]


def step_tables(dataset: xr.Dataset) -> list[list[Column]]:
    """Return `step_columns` as tables that fit the width of a page; each begins with the number of the step."""
    first, *others = step_columns(dataset)
    return [[first, *others[start : start + _MOST_COLUMNS]] for start in range(0, len(others), _MOST_COLUMNS)]


def _step_number(step: xr.Dataset, name: str) -> str:
    value = int(step[name]) if name in step else -1
    return str(value) if value >= 0 else "-"


def truth_rows(dataset: xr.Dataset, file: Path) -> list[list[str]]:
    """Return a row per step with the errors against the ground truth of a virtual rig; none without a truth.

    Raises
    ------
    DatasetError
        The truth lacks steps or pixels of the dataset, or is damaged.
    """
    if not file.exists():
        return []
    errors = compare_with_truth(dataset, file)
    names = [f"error_{name}" for name in "uvwz"]
    return [
        [str(int(step)), *(number_text(float(errors[name].sel(step=step))) for name in names)]
        for step in errors["step"].values
    ]


def gauge_rows(gauges: Mapping[str, xr.Dataset], unit: PeopleUnit) -> list[list[str]]:
    """Return a row per virtual extensometer: length, elongation, strain and its sigma at the last measured step.

    Parameters
    ----------
    gauges
        From `fringedic.extensometer`, by name.
    unit
        Of the strain.
    """
    return [[name, *_gauge_cells(gauge, unit)] for name, gauge in gauges.items()]


def _gauge_cells(gauge: xr.Dataset, unit: PeopleUnit) -> list[str]:
    measured = np.flatnonzero(np.isfinite(gauge["strain"].values))
    if not measured.size:
        return ["-"] * 4
    last = gauge.isel(step=int(measured[-1]))
    elongation, strain = float(last["elongation"]), float(last["strain"])
    sigma = float(last.get("sigma_strain", np.nan))
    rest = float(last["length"]) - elongation
    lengths = (f"{number_text(rest)} px", f"{number_text(elongation)} px")
    if gauge["length"].attrs["units"] == "m":
        lengths = (f"{number_text(rest / MILLI)} mm", f"{number_text(elongation / MICRO)} µm")
    return [*lengths, number_text(strain / unit.factor), number_text(sigma / unit.factor)]


def region_rows(dataset: xr.Dataset, regions: Mapping[str, Region]) -> list[list[str]]:
    """Return a row per region and quantity of the last step: mean with its standard uncertainty, deviation, range."""
    present = [name for name in REGION_MAPS if name in dataset]
    rows = []
    for title, region in regions.items():
        table = region_statistics(dataset, present, region)
        for name in present:
            values = [float(table[name].sel(statistic=each)) for each in REGION_STATISTICS]
            unit = people_unit(dataset[name], largest_of([np.array(values)]))
            rows.append([title, f"{name} [{unit.text}]", *(number_text(value / unit.factor) for value in values)])
    return rows
