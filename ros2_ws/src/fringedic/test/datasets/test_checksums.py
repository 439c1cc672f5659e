"""Datasets prove their content: every change is an error that names the file, and none is silent."""

import random
import shutil

import h5py
import numpy as np
import pytest
import xarray as xr
import zarr

from fringedic.datasets import open_experiment
from fringedic.datasets.checksums import CHECKED, has_checksums, load_checked
from fringedic.datasets.quantities import layout_of_images
from fringedic.datasets.rows import Row
from fringedic.datasets.writer import DatasetWriter
from fringedic.errors import DatasetError, FringedicError
from fringedic.steps.recorded_parameters import RecordedParameters

FLIPS = 25  # the long form is benchmarks/damaged_datasets.py
NAMES = ("displacement_x", "displacement_y")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Return the same small dataset in both formats: two measured steps and a failed one between them."""
    folder, random_numbers = tmp_path_factory.mktemp("written"), np.random.default_rng(1)
    for suffix in (".nc", ".zarr"):
        attributes = {"experiment": "plate", "image_height": 30, "image_width": 40, "source": "bag"}
        with DatasetWriter(folder / f"plate{suffix}", attributes, layout_of_images(scaled=False)) as writer:
            for step in range(3):
                maps = {} if step == 1 else {name: random_numbers.standard_normal((30, 40)) for name in NAMES}
                row = Row(step=step, stamp=None, maps=maps, error="no light" if step == 1 else "")
                writer.add(row, RecordedParameters({}).settings(None))
    return folder


def as_format_2(source, target):
    """Write a Zarr folder again as earlier versions of this library did, and return it."""
    group, copy = zarr.open_group(source, mode="r"), zarr.open_group(target, mode="w", zarr_format=2)
    copy.attrs.update(dict(group.attrs))
    for name, array in group.arrays():
        kind = str if array.metadata.data_type.to_native_dtype().kind in "OT" else array.dtype
        fill = np.nan if array.dtype.kind == "f" else None
        options = {"chunks": array.chunks, "fill_value": fill, "config": {"write_empty_chunks": True}}
        made = copy.create_array(name, shape=array.shape, dtype=kind, **options)
        made[:] = array[:]
        made.attrs.update({"_ARRAY_DIMENSIONS": list(array.metadata.dimension_names), **array.attrs})
    zarr.consolidate_metadata(copy.store)
    return target


@pytest.fixture(params=[".nc", ".zarr", "format 2"])
def file(request, written, tmp_path):
    if request.param == "format 2":
        return as_format_2(written / "plate.zarr", tmp_path / "plate.zarr")
    source, copy = written / f"plate{request.param}", tmp_path / f"plate{request.param}"
    shutil.copytree(source, copy) if source.is_dir() else shutil.copy(source, copy)
    return copy


def content(file):
    """Return everything that a reader gets."""
    with open_experiment(file) as dataset:
        return dataset.load()


def test_parts_of_maps_are_those_of_the_whole(file):
    with open_experiment(file) as dataset:
        assert has_checksums(dataset)
        whole = dataset.displacement_x.values
        assert np.isnan(whole[1]).all()
        assert np.isfinite(whole[[0, 2]]).all()
        for part in ((2,), (-1, 3), (slice(None), 3, 4), (slice(2, 0, -1), slice(1, 9, 3)), (slice(0, 0),)):
            np.testing.assert_array_equal(dataset.displacement_x[part].values, whole[part])


def chunks_and_metadata(folder):
    """Return the files of a Zarr folder that a reader needs, of format 3 or 2."""
    chunks = [path for path in folder.rglob("*") if path.is_file() and path.name[0].isdigit()]
    return [*(path for path in (folder / "zarr.json", folder / ".zmetadata") if path.exists()), *sorted(chunks)]


def test_no_flipped_bit_is_silent(file):
    whole, chosen = content(file), random.Random(2)
    files = [file] if file.is_file() else chunks_and_metadata(file)
    told = 0
    for _ in range(FLIPS):
        changed = chosen.choice(files)
        before = changed.read_bytes()
        data = bytearray(before)
        data[chosen.randrange(len(data))] ^= 1 << chosen.randrange(8)
        changed.write_bytes(data)
        try:
            found = content(file)
            found.attrs[CHECKED] = whole.attrs[CHECKED]  # a damaged name of the attribute leaves none, and says so
            assert found.identical(whole)
        except FringedicError as error:
            told += str(file) in str(error)
        changed.write_bytes(before)
    assert told > FLIPS / 4


def test_a_removed_or_shortened_chunk_is_named(written, tmp_path):
    copy = shutil.copytree(written / "plate.zarr", tmp_path / "plate.zarr")
    chunk = copy / "displacement_x" / "c" / "2" / "0" / "0"
    data = chunk.read_bytes()
    with open_experiment(copy) as dataset:
        chunk.unlink()
        with pytest.raises(DatasetError, match=r"plate\.zarr is damaged: map 'displacement_x' of step 2 .* is missing"):
            load_checked(dataset)
        chunk.write_bytes(data[: len(data) // 2])
        with pytest.raises(DatasetError, match=r"map 'displacement_x' of step 2 .*fringedic process"):
            dataset.displacement_x[2, 3, 4].values  # noqa: B018
        assert np.isfinite(dataset.displacement_x[0].values).all()  # other steps stay readable


def test_changed_texts_attributes_and_values_are_named(written, tmp_path):
    copy = tmp_path / "plate.nc"
    for change, message in (
        (lambda content: content.attrs.__setitem__("experiment", "other"), "its attributes have changed"),
        (lambda content: content["error"].__setitem__(1, "dark"), "'error' has changed"),
        (lambda content: content["row"].__setitem__(1, 7), "'row' has changed"),
        (lambda content: content["displacement_x"].attrs.__setitem__("units", "m"), "attributes of 'displacement_x'"),
        (lambda content: content["displacement_x"].__setitem__((0, 3, 4), 9.0), "map 'displacement_x' of step 0"),
    ):
        shutil.copy(written / "plate.nc", copy)
        with h5py.File(copy, "r+") as opened:
            change(opened)
        with pytest.raises(DatasetError, match=message), open_experiment(copy) as dataset:
            load_checked(dataset)


def test_removed_attributes_are_named(written, tmp_path):
    """Without them a folder would be taken for one of an earlier version, which has no checksums."""
    copy = as_format_2(written / "plate.zarr", tmp_path / "plate.zarr")
    (copy / ".zattrs").unlink()
    with pytest.raises(DatasetError, match=r"plate\.zarr: its attributes \('\.zattrs'\) are missing: restore the file"):
        open_experiment(copy)


@pytest.mark.parametrize("to", ["netcdf", "zarr"])
def test_an_export_has_checksums_of_its_own(written, tmp_path, to):
    with open_experiment(written / "plate.nc") as dataset:
        [exported] = dataset.sel(step=[0, 2]).fringedic.export(tmp_path, [to])
    with open_experiment(exported.path) as dataset:
        assert has_checksums(dataset)
        load_checked(dataset)
        assert dataset.sizes["step"] == 2


def test_a_file_of_an_earlier_version_is_read_and_says_that_it_has_none(written, tmp_path):
    with xr.open_dataset(written / "plate.nc", engine="h5netcdf") as dataset:
        dataset.drop_attrs(deep=False).to_netcdf(tmp_path / "old.nc", engine="h5netcdf")
    with open_experiment(tmp_path / "old.nc") as dataset:
        assert not has_checksums(dataset)
        assert dataset.attrs[CHECKED] == "none"
