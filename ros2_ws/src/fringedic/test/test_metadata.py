"""Metadata of the specimen: gauge points in the present order and in that of earlier versions."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from fringedic.configuration.rig_file import load_programme, load_rig_file
from fringedic.datasets.attributes import recorded_metadata
from fringedic.datasets.opening import open_experiment
from fringedic.errors import ConfigurationError
from fringedic.metadata import Metadata

RIG = "camera: {source: virtual}\nprojector: {source: virtual}\nvirtual_rig: {preset: plate, size: tiny}\n"
OLD = "{extensometers_px: [[480, 200, 470, 1000]]}"
NEW = "{gauges_px: [{first: [200, 480], second: [1000, 470]}]}"


def write(folder: Path, text: str) -> Path:
    file = folder / "RIG.yaml"
    file.write_text(text)
    return file


def test_gauges_are_column_and_row(tmp_path: Path) -> None:
    (gauge,) = load_rig_file(write(tmp_path, f"{RIG}specimen: {NEW}\n")).specimen.gauges_px
    assert gauge.first == [200, 480]
    assert gauge.second == [1000, 470]
    with pytest.raises(ConfigurationError, match=r"gauges_px\.0\.first: List should have at least 2 items"):
        load_rig_file(write(tmp_path, f"{RIG}specimen: {{gauges_px: [{{first: [1], second: [1, 2]}}]}}\n"))


def test_a_rig_file_with_the_old_order_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError) as refused:
        load_rig_file(write(tmp_path, f"{RIG}specimen: {OLD}\n"))
    sentence = str(refused.value)
    assert "specimen: extensometers_px with the order [row, column, row, column]" in sentence
    assert "gauges_px with the order [column, row]" in sentence
    assert "it is {" not in sentence


def test_a_programme_with_the_old_order_is_refused(tmp_path: Path) -> None:
    programme = f"experiment: plate\nramp: {{to_mm: 1.0, steps: 5}}\nspecimen: {OLD}\n"
    with pytest.raises(ConfigurationError, match="extensometers_px with the order"):
        load_programme(write(tmp_path, programme))


def test_recordings_of_earlier_versions_are_translated() -> None:
    assert Metadata.from_text(f"specimen: {OLD}") == Metadata.from_text(f"specimen: {NEW}")


def test_datasets_of_earlier_versions_are_translated(tmp_path: Path) -> None:
    attributes = {"facts": json.dumps({"specimen": {"name": "sheet", "extensometers_px": [[480, 200, 470, 1000]]}})}
    of_steps = {"time": ("step", np.zeros(1, "datetime64[ns]")), "error": ("step", [""])}
    maps = {"w": (("step", "row", "column"), [[[0.0]]])}
    dataset = xr.Dataset({**maps, **of_steps}, coords={"step": [0]}, attrs=attributes)
    dataset.to_netcdf(tmp_path / "old.nc", engine="h5netcdf")
    with open_experiment(tmp_path / "old.nc") as again:
        (gauge,) = recorded_metadata(again).specimen.gauges_px
    assert gauge.first == [200, 480]
    assert gauge.second == [1000, 470]
