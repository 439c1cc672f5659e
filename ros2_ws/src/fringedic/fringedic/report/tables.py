"""Cells of the tables of a report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from fringedic.metadata import NOISE_QUANTITIES
from fringedic.results.noise_floor import NoiseFloor
from fringedic.results.quantities import number_text
from fringedic.results.truth import compare_with_truth

MILLI, MICRO = 1e-3, 1e-6


def noise_floor_row(floor: NoiseFloor) -> list[str]:
    """Return quantity, spatial and temporal noise, bias, stated noise and number of points."""
    quantity = NOISE_QUANTITIES[floor.name]
    values = (floor.spatial, floor.temporal, floor.bias, floor.predicted)
    cells = [number_text(value / quantity.factor) for value in values]
    return [f"{floor.name} [{quantity.unit}]", *cells, str(floor.points)]


def step_rows(dataset: xr.Dataset) -> list[list[str]]:
    """Return a row per step: number, time, load, references, measured points, displacement and error."""
    begin = dataset["time"].values.min()
    rows = []
    for index, step in enumerate(dataset["step"].values):
        one = dataset.isel(step=index)
        seconds = (one["time"].values - begin) / np.timedelta64(1, "s")
        rows.append(
            [
                str(int(step)),
                f"{seconds:.1f}",
                number_text(float(one["force"])),
                number_text(float(one["position"]) / MILLI),
                _step_number(one, "reference_step"),
                _step_number(one, "correlated_step"),
                number_text(100 * float(one["valid_fraction"])),
                number_text(float(one["rms_displacement"]) / MICRO),
                str(one["error"].values),
            ]
        )
    return rows


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


def gauge_rows(gauges: Mapping[str, xr.Dataset]) -> list[list[str]]:
    """Return a row per virtual extensometer: length, elongation, strain and its sigma at the last measured step."""
    return [[name, *_gauge_cells(gauge)] for name, gauge in gauges.items()]


def _gauge_cells(gauge: xr.Dataset) -> list[str]:
    measured = np.flatnonzero(np.isfinite(gauge["strain"].values))
    if not measured.size:
        return ["-"] * 4
    last = gauge.isel(step=int(measured[-1]))
    elongation, strain = float(last["elongation"]), float(last["strain"])
    sigma = float(last.get("sigma_strain", np.nan))
    rest = float(last["length"]) - elongation
    return [number_text(each) for each in (rest / MILLI, elongation / MICRO, strain / MICRO, sigma / MICRO)]
