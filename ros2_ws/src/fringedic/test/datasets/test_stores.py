"""Writing of a whole dataset as NetCDF: a full disk and a failure leave the previous file as it was."""

import json
import resource
import shutil

import numpy as np
import pytest
import xarray as xr

from fringedic.datasets.checksums import CONTENT
from fringedic.datasets.stores import NetcdfStore, Variable, save_netcdf
from fringedic.errors import DatasetError, ErrorCode

DATASET = xr.Dataset({"phase": (("row", "column"), np.ones((3, 4)))})


@pytest.fixture
def target(tmp_path):
    """Return an existing file, the only one in its folder."""
    file = tmp_path / "phase.nc"
    file.write_text("previous")
    return file


def test_an_existing_file_is_replaced_by_the_dataset(target):
    save_netcdf(DATASET, target)
    with xr.open_dataset(target, engine="h5netcdf") as saved:
        assert "phase" in json.loads(saved.attrs.pop(CONTENT))["variables"]
        xr.testing.assert_identical(saved, DATASET)
    assert list(target.parent.iterdir()) == [target]


def test_a_full_disk_keeps_the_previous_file(target, monkeypatch):
    usage = shutil.disk_usage(target.parent)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=100_000))
    with pytest.raises(DatasetError, match="the disk is full, the dataset needs 10 MB and 0 MB are free") as refused:
        save_netcdf(DATASET, target)
    assert refused.value.code is ErrorCode.DISK_FULL
    assert target.read_text() == "previous"
    assert list(target.parent.iterdir()) == [target]


def test_a_dataset_that_cannot_be_written_keeps_the_previous_file(target):
    with pytest.raises(TypeError):
        save_netcdf(DATASET.assign_attrs(source={"no": "attribute"}), target)
    assert target.read_text() == "previous"
    assert list(target.parent.iterdir()) == [target]


def write_numbers(store):
    for number in range(200):
        axis = f"axis_{number}"
        store.add_variable(Variable(f"v_{number}", (axis,), "f8", {"units": "m"}), {axis: 1000})
        store.put(f"v_{number}", slice(None), np.arange(1000.0))
        if number % 50 == 49:
            store.flush()
    store.finish({})


@pytest.mark.parametrize("limit", [2_000, 60_000, 300_000])
def test_disk_that_refuses_bytes_in_the_middle_of_a_file(tmp_path, limit):
    """HDF5 would end the process when it closes the file; a limit of the process stands for a full disk."""
    store = NetcdfStore(tmp_path / "a.nc")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        with pytest.raises(DatasetError, match=r"a\.nc: cannot be written: .*; make room, or choose another output"):
            write_numbers(store)
    finally:
        store.discard()
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []
