"""A ground truth that cannot be read is named, and costs the report nothing but its comparison."""

import h5py
import numpy as np
import pytest
import xarray as xr

from fringedic.errors import DatasetError
from fringedic.evaluation import compare_with_truth, open_truth, truth_errors

ROWS, COLUMNS, STEPS = 40, 50, 3


def maps(names):
    rng = np.random.default_rng(1)
    values = {name: (("step", "row", "column"), rng.normal(0, 1e-4, (STEPS, ROWS, COLUMNS))) for name in names}
    return xr.Dataset(values, {"row": np.arange(ROWS), "column": np.arange(COLUMNS)})


@pytest.fixture
def dataset():
    return maps(("u", "v", "w", "shape_z")).assign_coords(step=np.arange(STEPS))


@pytest.fixture
def file(tmp_path):
    truth = maps(("u", "v", "w", "z_deformed"))
    truth["valid"] = ("step", "row", "column"), np.ones((STEPS, ROWS, COLUMNS), bool)
    encoding = {name: {"zlib": True, "complevel": 1} for name in truth.data_vars}
    truth.to_netcdf(tmp_path / "truth.nc", engine="h5netcdf", encoding=encoding)
    return tmp_path / "truth.nc"


def test_whole_truth_is_compared(dataset, file):
    assert compare_with_truth(dataset, file)["measured_fraction"].values.tolist() == [1, 1, 1]


def test_heights_of_the_exact_calibration_are_compared(dataset, file):
    """Heights that are 3 µm too large, with one pixel without phase."""
    with open_truth(file) as truth:
        dataset["phase"] = ("step", "row", "column"), truth.z_deformed.values + 3e-6
    dataset["phase"][1, 0, 0] = np.nan
    found = compare_with_truth(dataset, file, reconstruct=lambda phase: xr.Dataset({"z": phase}))
    assert found["error_z_exact"].values == pytest.approx([3, 3, 3], rel=1e-6)
    assert found["error_z_exact"].attrs["units"] == "µm"


@pytest.mark.parametrize("part", [0, 0.01, 0.3, 0.7, 0.99])
def test_truncated_truth_is_named(dataset, file, part):
    data = file.read_bytes()
    file.write_bytes(data[: int(part * len(data))])
    with pytest.raises(DatasetError, match=r"truth\.nc: is no ground truth or is damaged") as caught:
        compare_with_truth(dataset, file)
    assert len(str(caught.value)) <= 500
    assert "\n" not in str(caught.value)


def test_damaged_map_is_named(dataset, file):
    """The file opens, and a compressed map cannot be read."""
    with h5py.File(file) as content:
        chunk = content["u"].id.get_chunk_info(0)
    data = bytearray(file.read_bytes())
    data[chunk.byte_offset : chunk.byte_offset + chunk.size] = bytes(chunk.size)
    file.write_bytes(data)
    with open_truth(file) as truth, pytest.raises(DatasetError, match=r"truth\.nc: is no ground truth or is damaged"):
        truth_errors(dataset, truth, 0)


@pytest.mark.parametrize("name", ["u", "valid", "z_deformed"])
def test_dataset_of_another_kind_is_named(dataset, tmp_path, name):
    maps(("u", "v", "w", "z_deformed", "valid")).drop_vars(name).to_netcdf(tmp_path / "truth.nc", engine="h5netcdf")
    with pytest.raises(DatasetError, match="is no ground truth or is damaged"):
        compare_with_truth(dataset, tmp_path)
