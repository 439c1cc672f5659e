"""Writing of a whole dataset as NetCDF: a full disk and a failure leave the previous file as it was."""

import json
import resource
import shutil

import numpy as np
import pytest
import xarray as xr

from fringedic.datasets.checksums import CONTENT, has_checksums, load_checked, open_checked
from fringedic.datasets.quantities import MAP_DIMENSIONS
from fringedic.datasets.rows import Row
from fringedic.datasets.stores import NetcdfStore, Variable, save_netcdf, save_zarr
from fringedic.datasets.writer import DatasetWriter
from fringedic.errors import DatasetError, ErrorCode
from fringedic.steps.parameters import DicParameters
from fringedic.steps.recorded_parameters import StepSettings

UNWRITABLE = r"a\.(nc|zarr): cannot be written: .*; make room, or choose another output"
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


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
def test_the_checksums_of_a_written_dataset_are_those_of_its_file(tmp_path, suffix):
    """They are taken before a library converts texts, times, truth values and attributes to its format."""
    random_numbers = np.random.default_rng(1)
    dataset = xr.Dataset(
        {
            "w": (
                MAP_DIMENSIONS,
                random_numbers.standard_normal((2, 3, 4), np.float32),
                {"units": "m", "limits": (0.1, 2)},
            ),
            "count": (MAP_DIMENSIONS, random_numbers.integers(0, 9, (2, 3, 4))),
            "error": ("step", ["", "dark; 20 µm"]),
            "held": ("step", [True, False]),
            "force": ("step", [1.5, np.nan], {"source": ""}),
            "time": ("step", np.array([1, 2], "M8[ns]")),
            "scale": ((), 0.25),
        },
        {"step": [1, 2], "x_mm": ("column", np.arange(4.0))},
        {"names": ["a", "b"], "one": ["a"], "number": np.float64(0.1), "rows": np.arange(3), "empty": ""},
    )
    target = tmp_path / f"a{suffix}"
    encoding = {"time": {"units": "nanoseconds since 1970-01-01", "dtype": "int64"}}
    (save_netcdf if suffix == ".nc" else save_zarr)(dataset, target, encoding)
    with open_checked(target, str(target), netcdf=suffix == ".nc") as opened:
        assert has_checksums(opened)
        load_checked(opened)
        np.testing.assert_array_equal(opened["w"], dataset["w"])
        np.testing.assert_array_equal(opened["time"], dataset["time"])
        assert list(opened["error"].values) == ["", "dark; 20 µm"]


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


@pytest.fixture
def limited():
    """Return a function that limits the size of every file that this process writes, which stands for a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("limit", [2_000, 60_000, 300_000])
def test_disk_that_refuses_bytes_in_the_middle_of_a_file(tmp_path, limit, limited):
    """HDF5 would end the process when it closes the file."""
    store = NetcdfStore(tmp_path / "a.nc")
    limited(limit)
    with pytest.raises(DatasetError, match=UNWRITABLE):
        write_numbers(store)
    store.discard()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("name", "save"), [("a.nc", save_netcdf), ("a.zarr", save_zarr)])
def test_disk_that_refuses_bytes_of_a_whole_dataset(tmp_path, name, save, limited):
    limited(20_000)
    with pytest.raises(DatasetError, match=UNWRITABLE):
        save(
            xr.Dataset({"w": (MAP_DIMENSIONS, np.random.default_rng(1).standard_normal((1, 90, 90)))}), tmp_path / name
        )
    assert list(tmp_path.glob(".*")) == []


@pytest.mark.parametrize("name", ["a.nc", "a.zarr"])
@pytest.mark.parametrize("when", ["first", "last"])
def test_nothing_is_left_of_a_dataset_whose_first_or_last_bytes_are_refused(tmp_path, name, when, limited):
    dataset = DatasetWriter(tmp_path / name, {})  # before the limit: git, which it calls, writes files

    def write():
        with dataset as writer:
            settings = StepSettings({"dic": DicParameters()}, None, {}, None)
            writer.add(Row(0, 0, maps={"displacement_x": np.zeros((8, 8), np.float32)}), settings)
            limited(100)

    if when == "first":
        limited(100)
    with pytest.raises(DatasetError, match=UNWRITABLE):
        write()
    assert list(tmp_path.iterdir()) == []
