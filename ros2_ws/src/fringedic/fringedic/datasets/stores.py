"""The two formats of a dataset on the disk: NetCDF, one file, and Zarr, a folder of chunks.

Both contain the same variables, one chunk per map and step, and get their name only when they are complete.
"""

from __future__ import annotations

import errno
import io
import os
import shutil
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import h5netcdf
import h5py  # type: ignore[import-untyped]
import numpy as np
import xarray as xr

from fringedic.datasets.checksums import CHECKED, CONTENT, SummedDataset
from fringedic.datasets.quantities import MAP_DIMENSIONS, TEXT
from fringedic.errors import DatasetError, ErrorCode
from fringedic.frames.sensor import SENSOR, file_of
from fringedic.wording.causes import cause_of
from fringedic.wording.optional_packages import optional_import

SUFFIXES = (".nc", ".zarr")
_ROOM_LEFT = 10_000_000  # [byte] beside the maps: attributes, the index of the file
# All metadata have checksums from this version of the format on, readable by HDF5 1.10 of 2016 and later
_FORMAT = ("v110", "v110")
_OF_A_SCALE = ("CLASS", "NAME", "REFERENCE_LIST")  # attributes that HDF5 writes itself


class Variable(NamedTuple):
    """A variable of a store; `dtype` is NumPy's or ``text``."""

    name: str
    dimensions: tuple[str, ...]
    dtype: str
    attributes: Mapping[str, str]


class Store(Protocol):
    """A dataset that is being written."""

    @property
    def name(self) -> str:
        """What messages call it."""

    def room(self) -> float:
        """Return the bytes that still fit; infinity where that is not known."""

    def add_variable(self, variable: Variable, sizes: Mapping[str, int]) -> None:
        """Make a variable; `sizes` is that of each dimension now (step may grow)."""

    def grow(self, steps: int) -> None:
        """Make room for as many steps."""

    def put(self, name: str, index: int | slice, value: Any) -> None:
        """Write one step of a variable, or a whole coordinate."""

    def flush(self) -> None:
        """Hand everything to the operating system."""

    def finish(self, attributes: Mapping[str, str]) -> None:
        """Write the attributes, close, and give the dataset its name."""

    def discard(self) -> None:
        """Close and remove what was written."""


def create_store(target: Path) -> Store:
    """Begin a dataset in the format of its suffix.

    Raises
    ------
    DatasetError
        The suffix is neither ``.nc`` nor ``.zarr``, or the place cannot be written.
    """
    check_suffix(target)
    try:
        with _named_errors(target):
            return NetcdfStore(target) if target.suffix == ".nc" else ZarrStore(target)
    except DatasetError:
        _remove_temporary(target)
        raise


def _cannot_be_written(target: Path, error: OSError) -> DatasetError:
    code = ErrorCode.DISK_FULL if error.errno == errno.ENOSPC else None
    words = f"{target}: cannot be written: {cause_of(error)}; make room, or choose another output"
    return DatasetError(words, code=code)


@contextmanager
def _named_errors(target: Path) -> Iterator[None]:
    """Raise errors of the operating system, which do not always name a file, as DatasetError."""
    try:
        yield
    except OSError as error:
        raise _cannot_be_written(target, error) from error


def check_suffix(target: Path) -> None:
    """Raise DatasetError when the suffix of a name is that of no format."""
    if target.suffix not in SUFFIXES:
        raise DatasetError(f"{target}: a dataset is named .nc (NetCDF) or .zarr (Zarr)")


def dataset_path(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    sensor: str = SENSOR,
    kind: str = "",
) -> Path:
    """Return where the dataset of a sensor in a recording goes: `output`, or NetCDF beside the recording with its name.

    A ``kind`` at the end of this name keeps a dataset that has other steps apart from that of the recorded ones.

    Raises
    ------
    DatasetError
        It exists and is not to be overwritten, its suffix is that of no format, or `output` is in a missing folder.
    """
    source = Path(path) if Path(path).name else Path(path).absolute()
    if not source.name:
        raise DatasetError(f"{path}: is no recording and no dataset")
    beside = source.with_suffix(".nc") if source.is_file() else source.with_name(f"{source.name}.nc")
    beside = file_of(beside, sensor)
    beside = file_of(beside, kind) if kind else beside
    target = beside if output is None else Path(output)
    check_suffix(target)
    if target.exists() and not overwrite:
        raise DatasetError(f"{target} exists already; choose another output or ask to overwrite it")
    if output is not None and not target.absolute().parent.is_dir():
        raise DatasetError(f"{target}: the folder {target.parent} does not exist; make it, or choose another output")
    return target


def free_bytes(target: Path) -> float:
    """Return the bytes that still fit beside a file or folder."""
    return shutil.disk_usage(target.absolute().parent).free


def require_room(place: str, content: str, size: int, free: float) -> None:
    """Refuse to write what the disk has no room for: HDF5 ends the process when it cannot write.

    Parameters
    ----------
    place, content
        Where and what is to be written, for the message.
    size, free
        Size of its maps, and free space [byte].

    Raises
    ------
    DatasetError
        The free space is too small, with the code DISK_FULL.
    """
    needed = size + _ROOM_LEFT
    if free < needed:
        raise DatasetError(
            f"{place}: the disk is full, {content} needs {1e-6 * needed:.0f} MB and {1e-6 * free:.0f} MB are free: "
            "make room, or choose another output",
            code=ErrorCode.DISK_FULL,
        )


def save_netcdf(dataset: xr.Dataset, target: Path, encoding: Mapping[str, Mapping[str, Any]] | None = None) -> None:
    """Write a dataset as NetCDF; an existing file is replaced when the new one is complete.

    Parameters
    ----------
    dataset
        In memory or on the disk.
    target
        The file.
    encoding
        Of its variables, as of `xarray.Dataset.to_netcdf`.

    Raises
    ------
    DatasetError
        The file cannot be written; the disk is full, with the code DISK_FULL.
    """
    require_room(str(target.absolute().parent), "the dataset", dataset.nbytes, free_bytes(target))
    summed = SummedDataset(_of_a_file(dataset), encoding or {})
    with _named_errors(target):
        output = _Output(_temporary(target), "w+")
    try:
        summed.content.to_netcdf(output, engine="h5netcdf")
        output.require_written(target)
        with h5py.File(output, "r+") as file:
            file.attrs[CONTENT] = summed.text
        output.require_written(target)
        _temporary(target).replace(target)
    finally:
        output.close()
        _remove_temporary(target)


def save_zarr(dataset: xr.Dataset, target: Path, encoding: Mapping[str, Mapping[str, Any]] | None = None) -> None:
    """Write a dataset as Zarr of format 3; each chunk has a checksum (crc32c).

    Parameters
    ----------
    dataset, target, encoding
        As of `save_netcdf`; an existing folder is replaced.

    Raises
    ------
    FringedicError
        The package ``zarr`` is not installed.
    DatasetError
        The folder cannot be written; the disk is full, with the code DISK_FULL.
    """
    with optional_import("zarr"):
        import zarr
    plain = _of_a_file(dataset)
    # texts of variable length are registered with Zarr; those of NumPy's fixed length are not
    texts = {name: each.astype(object) for name, each in plain.variables.items() if each.dtype.kind == "U"}
    summed = SummedDataset(plain.assign(texts), encoding or {})
    checked = {name: {**each.encoding, "compressors": _codecs()} for name, each in summed.content.variables.items()}
    with _named_errors(target), _text_and_consolidation():
        summed.content.to_zarr(
            target, mode="w", zarr_format=3, consolidated=False, encoding=checked, write_empty_chunks=True
        )
        group = zarr.open_group(target, mode="r+", zarr_format=3)
        group.attrs[CONTENT] = summed.text
        consolidate(group.store)


def _of_a_file(dataset: xr.Dataset) -> xr.Dataset:
    """Return a dataset without what opening added to its attributes."""
    kept = {name: value for name, value in dataset.attrs.items() if name != CHECKED}
    return dataset.drop_attrs(deep=False).assign_attrs(kept)


@contextmanager
def _text_and_consolidation() -> Iterator[None]:
    """Ignore warnings that Zarr 3 does not specify texts of variable length and consolidated metadata yet.

    Readers that ignore consolidated metadata need none; texts are an extension that is registered with Zarr.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def consolidate(store: Any) -> None:
    """Copy the metadata of all arrays of a Zarr group to the group, so that one file opens it."""
    import zarr

    with _text_and_consolidation():
        zarr.consolidate_metadata(store)


def _codecs() -> list[Any]:
    """Return how the chunks of Zarr arrays are packed: with a checksum around the compressed bytes."""
    from zarr.codecs import Crc32cCodec, ZstdCodec

    return [ZstdCodec(level=0), Crc32cCodec()]


def create_array(group: Any, variable: Variable, shape: tuple[int, ...], chunks: tuple[int, ...]) -> Any:
    """Make the array of a variable in a Zarr group of format 3, and return it.

    Parameters
    ----------
    group
        Of Zarr, opened for writing.
    variable
        Name, dimensions, type and attributes.
    shape, chunks
        Sizes of the array and of its chunks.
    """
    with _text_and_consolidation():
        return group.create_array(
            variable.name,
            shape=shape,
            dtype=str if variable.dtype == TEXT else variable.dtype,
            chunks=chunks,
            fill_value=np.nan if variable.dtype in ("f4", "f8") else None,
            compressors=_codecs(),
            config={"write_empty_chunks": True},  # a removed chunk is no empty one
            dimension_names=variable.dimensions,
            attributes=dict(variable.attributes),
        )


def _temporary(target: Path) -> Path:
    return target.with_name(f".{target.name}.writing")


def _remove_temporary(target: Path) -> None:
    if _temporary(target).is_dir():
        shutil.rmtree(_temporary(target), ignore_errors=True)
        return
    with suppress(OSError):  # the disk became read-only: the first error is reported
        _temporary(target).unlink(missing_ok=True)


class _Output(io.FileIO):
    """A file that keeps the first error of writing: HDF5 would end the process (SIGSEGV) when it closes the file."""

    error: OSError | None = None

    def write(self, data: Any) -> int:
        """Write all bytes, and return their number also when the disk refuses them."""
        rest = memoryview(data).cast("B")
        size = len(rest)
        try:
            while rest and self.error is None:
                rest = rest[super().write(rest) :]
        except OSError as error:
            self.error = error
        return size

    def truncate(self, size: int | None = None) -> int:
        """Set the size of the file."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.error = self.error or error
            return size or 0

    def require_written(self, target: Path) -> None:
        """Raise DatasetError if the disk has refused a part."""
        if self.error is not None:
            raise _cannot_be_written(target, self.error) from self.error


class NetcdfStore:
    """A NetCDF-4 file."""

    def __init__(self, target: Path) -> None:
        self._target = target
        self._output = _Output(_temporary(target), "w+")
        self._file: Any = h5netcdf.File(self._output, "w", libver=_FORMAT)
        self._file.dimensions = {"step": None}

    @property
    def name(self) -> str:
        """What messages call it."""
        return str(self._target)

    def room(self) -> float:
        """Return the bytes that still fit."""
        return free_bytes(self._target)

    def add_variable(self, variable: Variable, sizes: Mapping[str, int]) -> None:
        """Make a variable; `sizes` is that of each dimension now (step may grow)."""
        for dimension in variable.dimensions:
            if dimension not in self._file.dimensions:
                self._file.dimensions[dimension] = sizes[dimension]
        options: dict[str, Any] = {}
        if variable.dimensions == MAP_DIMENSIONS:
            options = {"chunks": (1, sizes["row"], sizes["column"]), "fillvalue": np.float32(np.nan)}
        kind = h5py.string_dtype() if variable.dtype == TEXT else variable.dtype
        made = self._file.create_variable(variable.name, variable.dimensions, kind, **options)
        for key, value in variable.attributes.items():
            made.attrs[key] = value

    def grow(self, steps: int) -> None:
        """Make room for as many steps."""
        self._file.resize_dimension("step", steps)

    def put(self, name: str, index: int | slice, value: Any) -> None:
        """Write one step of a variable, or a whole coordinate."""
        self._file[name][index] = value

    def flush(self) -> None:
        """Hand everything to the operating system."""
        self._file.flush()
        self._output.require_written(self._target)

    def finish(self, attributes: Mapping[str, str]) -> None:
        """Write the attributes, close, and give the dataset its name."""
        for name, value in attributes.items():
            self._file.attrs[name] = value
        self._file.close()
        self._output.require_written(self._target)
        with h5py.File(self._output, "r+", libver=_FORMAT) as content:
            _end_growth(content, "step")
        self._output.require_written(self._target)
        self._output.close()
        _temporary(self._target).replace(self._target)

    def discard(self) -> None:
        """Close and remove what was written."""
        self._file.close()
        self._output.close()
        _remove_temporary(self._target)


def _end_growth(content: h5py.File, dimension: str) -> None:
    """Give a growing dimension its final length.

    Readers ask every variable for the length of a growing dimension, again for every other variable: opening a file
    with forty maps then takes seconds instead of tenths.
    """
    growing = content[dimension]
    variables = [
        variable
        for name, variable in content.items()
        if name != dimension and variable.ndim and len(variable.dims[0]) and variable.dims[0][0] == growing
    ]
    attributes = {name: value for name, value in growing.attrs.items() if name not in _OF_A_SCALE}
    values = growing[...]
    for variable in variables:
        variable.dims[0].detach_scale(growing)
    del content[dimension]
    fixed = content.create_dataset(dimension, data=values)
    fixed.attrs.update(attributes)
    fixed.make_scale(dimension)
    for variable in variables:
        variable.dims[0].attach_scale(fixed)


class ZarrStore:
    """A Zarr folder of format 3."""

    def __init__(self, target: Path) -> None:
        with optional_import("zarr"):
            import zarr
        self._target = target
        self._group = zarr.open_group(_temporary(target), mode="w", zarr_format=3)
        self._growing: list[Any] = []

    @property
    def name(self) -> str:
        """What messages call it."""
        return str(self._target)

    def room(self) -> float:
        """Return the bytes that still fit."""
        return free_bytes(self._target)

    def add_variable(self, variable: Variable, sizes: Mapping[str, int]) -> None:
        """Make a variable; `sizes` is that of each dimension now (step may grow)."""
        shape = tuple(sizes[dimension] for dimension in variable.dimensions)
        # one map per chunk; values per step share a chunk
        chunks = (1, *shape[1:]) if variable.dimensions == MAP_DIMENSIONS else tuple(max(size, 1024) for size in shape)
        with _named_errors(self._target):
            array = create_array(self._group, variable, shape, chunks)
        if variable.dimensions[0] == "step":
            self._growing.append(array)

    def grow(self, steps: int) -> None:
        """Make room for as many steps."""
        with _named_errors(self._target):
            for array in self._growing:
                array.resize((steps, *array.shape[1:]))

    def put(self, name: str, index: int | slice, value: Any) -> None:
        """Write one step of a variable, or a whole coordinate."""
        with _named_errors(self._target):
            array: Any = self._group[name]
            array[index] = value

    def flush(self) -> None:
        """Every chunk is a file that is closed already."""

    def finish(self, attributes: Mapping[str, str]) -> None:
        """Write the attributes, close, and give the dataset its name."""
        with _named_errors(self._target):
            self._group.attrs.update(dict(attributes))
            consolidate(self._group.store)
            old = self._target.with_name(f".{self._target.name}.old")
            if self._target.exists():
                self._target.replace(old)
            _temporary(self._target).replace(self._target)
            shutil.rmtree(old, ignore_errors=True)

    def discard(self) -> None:
        """Close and remove what was written."""
        _remove_temporary(self._target)
