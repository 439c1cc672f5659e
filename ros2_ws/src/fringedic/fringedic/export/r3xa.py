"""Metadata of an experiment in the R3XA schema, version 2024.7.1.

Only known values are written; a text that the schema requires is empty if nobody entered it. Without the times of the
steps the document lacks ``date`` and ``time_reference``, which the schema requires.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fringedic.datasets.attributes import experiment_name, first_time, image_size, origin_of, seconds
from fringedic.steps.recorded_parameters import present_parameters

VERSION = "2024.7.1"


def write_r3xa(dataset: xr.Dataset, file: Path) -> list[str]:
    """Write the metadata as JSON."""
    file.write_text(json.dumps(r3xa_document(dataset), indent=1, ensure_ascii=False), encoding="utf-8")
    if "time" in dataset:
        return []
    return ["the times of the steps are not known; enter date and time_reference, which the schema of R3XA requires"]


def r3xa_document(dataset: xr.Dataset) -> dict[str, Any]:
    """Return specimen, camera, analysis and results of an experiment as R3XA lays them out."""
    known = origin_of(dataset)
    entered = known.get("facts", {})
    specimen, hardware = entered.get("specimen", {}), entered.get("hardware", {})
    name = experiment_name(dataset)
    date = {"date": str(np.datetime_as_string(first_time(dataset), unit="D"))} if "time" in dataset else {}
    section = specimen.get("section_mm2")
    setting: dict[str, Any] = {
        "id": "specimen",
        "kind": "settings/specimen",
        "title": specimen.get("name") or name,
        "description": specimen.get("material", ""),
        "sizes": [] if section is None else [_quantity(section, "mm2", "section")],
    }
    spatial = "w" in dataset
    times: dict[str, Any] = {"timestamps": []}
    if "time" in dataset:
        begin = float(first_time(dataset).astype("datetime64[ns]").astype(np.int64)) * 1e-9
        times = {"time_reference": begin, "timestamps": seconds(dataset).tolist()}
    return {
        "title": name,
        "description": specimen.get("notes") or f"Experiment {name}, measured by {known.get('software', 'fringedic')}",
        "version": VERSION,
        "authors": specimen.get("operator", ""),
        **date,
        "settings": [setting | ({"patterning_technique": specimen["pattern"]} if specimen.get("pattern") else {})],
        "data_sources": [
            _camera(dataset, known, hardware),
            {
                "id": "analysis",
                "kind": "data_sources/generic",
                "title": "shape and 3D displacement" if spatial else "in-plane displacement",
                "description": json.dumps(known.get("parameters", [])),
                "output_components": 3 if spatial else 2,
                "output_dimension": "surface",
                "output_units": [{"kind": "unit", "unit": "m" if "u" in dataset else "px"}],
                "manufacturer": "",
                "model": f"{known.get('software', '')}, commit {known.get('commit', '')}",
            },
        ],
        "data_sets": [
            {
                "id": "results",
                "kind": "data_sets/list",
                "title": "maps of every step",
                "description": "one labelled dataset; each step is one index of its dimension 'step'",
                "file_type": "application/x-netcdf",
                "data_sources": ["camera", "analysis"],
                **times,
                "data": [f"step {int(number)}" for number in dataset["step"].values],
            }
        ],
    }


def _quantity(value: float, unit: str, title: str = "") -> dict[str, Any]:
    entry: dict[str, Any] = {"kind": "unit", "unit": unit, "value": float(value)}
    return entry | ({"title": title} if title else {})


def _camera(dataset: xr.Dataset, known: dict[str, Any], hardware: dict[str, Any]) -> dict[str, Any]:
    source: dict[str, Any] = {
        "id": "camera",
        "kind": "data_sources/camera",
        "title": "camera",
        "description": "frames of fringes and white light" if "w" in dataset else "images",
        "output_components": 1,
        "output_dimension": "surface",
        "output_units": [{"kind": "unit", "unit": "grey level"}],
        "manufacturer": "",
        "model": hardware.get("camera", ""),
        "image_size": [],
    }
    calibration = known.get("calibration")
    view, size = calibration or known, image_size(dataset)
    scale = view.get("pixel_size")
    if size is not None:
        width, height = size
        source["image_size"] = [_quantity(width, "px", "width"), _quantity(height, "px", "height")]
        if scale is not None:
            source["field_of_view"] = [
                _quantity(1e3 * width * scale / view.get("pixel_aspect", 1.0), "mm", "width"),
                _quantity(1e3 * height * scale, "mm", "height"),
            ]
    if scale is not None:
        source["image_scale"] = _quantity(1e-3 / scale, "px/mm")
    if calibration is not None:
        source["standoff_distance"] = _quantity(1e3 * calibration["camera_distance"], "mm")
    exposure_ms = present_parameters("camera", known.get("rig", {}).get("camera", {})).get("exposure_ms")
    if exposure_ms is not None:
        source["exposure"] = _quantity(exposure_ms, "ms")
    if hardware.get("focal_length_mm") is not None:
        source["focal_length"] = _quantity(hardware["focal_length_mm"], "mm")
    entered = {"lens": "lens", "aperture": "aperture", "filters": "filter"}
    return source | {theirs: hardware[ours] for ours, theirs in entered.items() if hardware.get(ours)}
