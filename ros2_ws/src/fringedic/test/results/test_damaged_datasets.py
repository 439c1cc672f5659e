"""Datasets that another program or a failure has changed are refused in one sentence."""

import numpy as np
import pytest
import xarray as xr

from fringedic.errors import DatasetError
from fringedic.results import open_experiment
from fringedic.results.attributes import recorded_metadata


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
    ],
)
def test_a_damaged_dataset_is_refused(tmp_path, content, message):
    content.to_netcdf(tmp_path / "plate.nc", engine="h5netcdf")
    with pytest.raises(DatasetError, match=rf"plate\.nc: {message}.*process its recording again"):
        open_experiment(tmp_path / "plate.nc")


def test_metadata_of_another_kind_are_named():
    with pytest.raises(DatasetError, match="attribute 'facts' of the dataset: specimen: "):
        recorded_metadata(dataset([0], facts='{"specimen": 5}'))
