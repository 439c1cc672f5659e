"""What every exported file and picture tells about its origin."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr

from fringedic.provenance import git_commit, software
from fringedic.results.quantities import MAP_DIMENSIONS, STEP_NUMBERS

_JSON_ATTRIBUTES = ("calibration", "parameters", "rig", "facts")


def metadata(dataset: xr.Dataset) -> dict[str, Any]:
    """Return the attributes of a dataset, calibration and parameters unpacked, with the software that exports it."""
    found: dict[str, Any] = {}
    for name, value in dataset.attrs.items():
        found[str(name)] = json.loads(value) if name in _JSON_ATTRIBUTES else _plain(value)
    return found | {"exported_by": software(), "exported_by_commit": git_commit()}


def metadata_text(dataset: xr.Dataset) -> str:
    """Return the metadata as one line of ASCII JSON."""
    return json.dumps(metadata(dataset))


def experiment_name(dataset: xr.Dataset) -> str:
    """Return the name of the experiment, for file names."""
    return str(dataset.attrs.get("experiment", "experiment"))


def map_names(dataset: xr.Dataset) -> list[str]:
    """Return the names of the maps over (step, row, column) that hold numbers."""
    return [
        str(name)
        for name, variable in dataset.data_vars.items()
        if variable.dims == MAP_DIMENSIONS and variable.dtype.kind == "f"
    ]


def step_numbers(step: xr.Dataset) -> dict[str, int]:
    """Return which steps one step was measured against, and whether increments were summed, as far as it is told."""
    return {name: int(step[name]) for name in STEP_NUMBERS if name in step}


def seconds(dataset: xr.Dataset) -> np.ndarray:
    """Return the time of each step since the first one [s]; the number of the step where no time is known."""
    if "time" not in dataset:
        return dataset["step"].values.astype(float)
    stamps = dataset["time"].values
    return (stamps - stamps.min()) / np.timedelta64(1, "s")


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
