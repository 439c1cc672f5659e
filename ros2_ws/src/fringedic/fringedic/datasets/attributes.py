"""Origin of a dataset, which every exported file and picture contains."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr
from pydantic import ValidationError

from fringedic.camera.distortion import DistortionMap
from fringedic.datasets.quantities import (
    ATTACHMENTS,
    LATER_REFERENCES,
    MAP_DIMENSIONS,
    METADATA_ATTRIBUTE,
    MISSING_PARTS,
    MISSING_SETTINGS,
    STEP_NUMBERS,
    TIME_ZERO,
)
from fringedic.errors import DatasetError
from fringedic.frames.sensor import JOINED, SENSOR, sensor_name
from fringedic.metadata import Metadata
from fringedic.provenance import git_commit, software
from fringedic.rig.model import RigModel
from fringedic.wording.arguments import check_value
from fringedic.wording.path_names import path_name

JSON_ATTRIBUTES = {
    "calibration": dict,
    "parameters": list,
    "rig": dict,
    METADATA_ATTRIBUTE: dict,
    ATTACHMENTS: dict,
    MISSING_PARTS: list,
    MISSING_SETTINGS: list,
    LATER_REFERENCES: list,
}
"""The attributes that contain JSON, and the kind of its content."""


def origin_of(dataset: xr.Dataset) -> dict[str, Any]:
    """Return the attributes of a dataset, calibration and parameters unpacked, with the software that exports it."""
    found: dict[str, Any] = {}
    for name, value in dataset.attrs.items():
        found[str(name)] = json.loads(value) if name in JSON_ATTRIBUTES else plain(value)
    return found | {"exported_by": software(), "exported_by_commit": git_commit()}


def recorded_calibration(dataset: xr.Dataset) -> RigModel | None:
    """Return the calibration that a dataset was measured with; None if it has none."""
    recorded = json.loads(dataset.attrs.get("calibration", "{}"))
    if not recorded:
        return None
    distortion = recorded.get("camera_distortion")
    if distortion is not None:
        arrays = {name: np.array(distortion[name]) for name in ("columns", "rows")}
        recorded["camera_distortion"] = DistortionMap(**{**distortion, **arrays})
    return RigModel(**recorded)


def recorded_metadata(dataset: xr.Dataset) -> Metadata:
    """Return specimen, hardware, calibration and noise floor as recorded; empty if they were not.

    Raises
    ------
    DatasetError
        The attribute contains something else.
    """
    try:
        return Metadata.model_validate(json.loads(dataset.attrs.get(METADATA_ATTRIBUTE, "{}")))
    except ValidationError as error:
        [problem, *_] = error.errors()
        place = ".".join(map(str, problem["loc"]))
        raise DatasetError(f"attribute '{METADATA_ATTRIBUTE}' of the dataset: {place}: {problem['msg']}") from error


def parameters_of(step: xr.Dataset) -> dict[str, dict[str, Any]]:
    """Return the parameters of the processing that applied at a step, by node; empty if they are not recorded.

    Parameters
    ----------
    step
        One step of a dataset, or a dataset without steps.

    Examples
    --------
    >>> recorded = [{"from_step": 0, "parameters": {"dic": {"window": 32}}}]
    >>> recorded += [{"from_step": 3, "parameters": {"dic": {"window": 48}}}]
    >>> parameters_of(xr.Dataset(coords={"step": 2}, attrs={"parameters": json.dumps(recorded)}))
    {'dic': {'window': 32}}
    """
    recorded = json.loads(step.attrs.get("parameters", "[]"))
    if "step" in step.coords:
        number = int(step["step"])
        recorded = [each for each in recorded if each["from_step"] <= number] or recorded[:1]
    return dict(recorded[-1]["parameters"]) if recorded else {}


def image_size(dataset: xr.Dataset) -> tuple[int, int] | None:
    """Return width and height of the camera's images [px], None if they are not known.

    Examples
    --------
    >>> image_size(xr.Dataset(attrs={"image_width": 320, "image_height": 240}))
    (320, 240)
    """
    source, names = json.loads(dataset.attrs.get("calibration", "{}")), ("camera_width", "camera_height")
    if not source:
        source, names = dataset.attrs, ("image_width", "image_height")
    return (int(source[names[0]]), int(source[names[1]])) if names[0] in source else None


def origin_text(dataset: xr.Dataset) -> str:
    """Return `origin_of` as one line of ASCII JSON."""
    return json.dumps(origin_of(dataset))


def experiment_name(dataset: xr.Dataset) -> str:
    """Return the name of the experiment."""
    return str(dataset.attrs.get("experiment", "experiment"))


def file_stem(dataset: xr.Dataset) -> str:
    """Return the name of the experiment, and of a sensor that has one, as the beginning of file names.

    Examples
    --------
    >>> file_stem(xr.Dataset(attrs={"experiment": "../plate 7", "sensor": "left"}))
    'plate-7.left'
    """
    stem, sensor = path_name(experiment_name(dataset), "experiment"), sensor_of(dataset)
    return stem if sensor == SENSOR else f"{stem}.{sensor}"


def sensor_of(dataset: xr.Dataset) -> str:
    """Return the name of the sensor whose frames were measured, or ``joined``; it becomes a part of names of files.

    Raises
    ------
    DatasetError
        It is no name of a sensor.
    """
    name = dataset.attrs.get("sensor", SENSOR)
    return JOINED if name == JOINED else str(check_value(DatasetError, "sensor of the dataset", name, sensor_name))


def map_names(dataset: xr.Dataset) -> list[str]:
    """Return the names of the maps over (step, row, column) that contain numbers."""
    return [
        str(name)
        for name, variable in dataset.data_vars.items()
        if variable.dims == MAP_DIMENSIONS and variable.dtype.kind == "f"
    ]


def step_numbers(step: xr.Dataset) -> dict[str, int]:
    """Return the steps that one step was measured against, and whether increments were summed, if recorded."""
    return {name: int(step[name]) for name in STEP_NUMBERS if name in step}


def first_time(dataset: xr.Dataset) -> np.datetime64:
    """Return the time of the first step; of a selection of steps, that of the dataset that they were selected from.

    Raises
    ------
    DatasetError
        The variable ``time`` contains no times.
    """
    times = dataset["time"].values
    if times.dtype.kind != "M":
        raise DatasetError(
            f"'time' of the dataset contains {times.dtype} instead of times; process its recording again"
        )
    recorded = dataset.attrs.get(TIME_ZERO)
    return np.datetime64(recorded if recorded is not None else times.min())


def seconds(dataset: xr.Dataset) -> np.ndarray:
    """Return the time of each step since `first_time` [s]; the dataset needs the variable ``time``."""
    return np.asarray((dataset["time"].values - first_time(dataset)) / np.timedelta64(1, "s"))


def plain(value: Any) -> Any:
    """Return the value of an attribute without NumPy's types."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
