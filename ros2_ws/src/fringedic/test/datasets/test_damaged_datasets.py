"""Datasets that another program or a failure has changed are refused in one sentence."""

import numpy as np
import pytest
import xarray as xr

from fringedic.datasets import open_experiment
from fringedic.datasets.attributes import recorded_metadata
from fringedic.errors import DatasetError


def dataset(steps, **attributes):
    """Return an experiment of one map with these numbers of steps."""
    maps = {"u": (("step", "row", "column"), np.zeros((len(steps), 2, 3)))}
    return xr.Dataset(
        maps | {"error": ("step", np.array([""] * len(steps), dtype=object))},
        coords={"step": np.array(steps, dtype=int), "row": [0, 4], "column": [0, 4, 8]},
        attrs=attributes,
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (dataset([]), "contains no step"),
        (dataset([0, 1, 1]), "contains a step number twice"),
        (dataset([0], facts="{"), "the attribute 'facts' is damaged"),
        (dataset([0], facts="[1]"), "the attribute 'facts' is damaged"),
        (dataset([0], facts=5), "the attribute 'facts' is damaged"),
        (dataset([0], parameters="{"), "the attribute 'parameters' is damaged"),
        (dataset([0], rig="none"), "the attribute 'rig' is damaged"),
        (dataset([0], calibration="null"), "the attribute 'calibration' is damaged"),
        (dataset([0], time_zero="noon"), "the attribute 'time_zero' is damaged"),
        (dataset([0], time_zero=5), "the attribute 'time_zero' is damaged"),
        (dataset([0]).assign_coords(step=["first"]), r"'step' contains .* over \(step\) instead of whole numbers"),
        (dataset([0]).assign_coords(step=[0.5]), "'step' contains float64 .* instead of whole numbers"),
        (dataset([0]).assign(time=("step", [1.5])), r"'time' contains float64 over \(step\) instead of times"),
        (dataset([0]).assign(error=("step", [0.0])), "'error' contains float64 .* instead of text"),
        (dataset([0]).assign(error=(("step", "row"), [["", ""]])), r"'error' contains .* over \(step, row\) instead"),
        (dataset([0]).assign(force=("step", ["much"])), "'force' contains .* instead of numbers"),
        (dataset([0]).assign(sigma_w=(("row", "column"), np.zeros((2, 3)))), r"'sigma_w' .* instead of numbers over"),
        (dataset([0]).assign(w=(dataset([0]).u.dims, np.zeros((1, 2, 3)), {"units": "days since 2026-01-01"})), "'w'"),
        (dataset([0]).assign(w=(dataset([0]).u.dims, np.zeros((1, 2, 3)), {"units": 5})), "the attribute 'units' of"),
        (dataset([0]).assign_coords(row=["top", "bottom"]), "'row' contains .* instead of numbers"),
        (dataset([0]).assign_coords(column=[0, np.nan, 8]), "'column' contains a position that is no finite number"),
    ],
)
def test_a_damaged_dataset_is_refused(tmp_path, content, message):
    content.to_netcdf(tmp_path / "plate.nc", engine="h5netcdf")
    with pytest.raises(DatasetError, match=rf"plate\.nc: {message}.*process its recording again"):
        open_experiment(tmp_path / "plate.nc")


def test_metadata_of_another_kind_are_named():
    with pytest.raises(DatasetError, match="attribute 'facts' of the dataset: specimen: "):
        recorded_metadata(dataset([0], facts='{"specimen": 5}'))
