"""Checksums of the content of a dataset: written with it, and checked whenever it is read.

The checksums of HDF5 and Zarr cover chunks of numbers, but no texts, attributes, names, dimensions and missing chunks,
and that of HDF5 takes as long as writing. A dataset contains an attribute with a checksum of everything that a reader
gets: of the attributes, of each variable, and of each step of a map. It is a GMAC (NIST SP 800-38D) of 32 bits with a
public key, which processors compute several times faster than CRC-32. It proves that nothing was damaged, not who wrote
the dataset.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes
from xarray import conventions
from xarray.backends import BackendArray
from xarray.core import indexing

from fringedic.datasets.quantities import MAP_DIMENSIONS, TEXT
from fringedic.errors import DatasetError
from fringedic.wording.causes import cause_of

CONTENT = "content_gmac"
"""Attribute of a file that contains the checksums."""
CHECKED = "checksums"
"""Attribute of an opened dataset that states whether its file contains checksums."""
_CHECKED, _NONE = "GMAC of every variable and step, checked when it is read", "none"
_FILL = "_FillValue"  # libraries write it; values that equal it are covered with the values
_DIGITS = 8  # of a checksum
_GMAC = Cipher(algorithms.AES(bytes(16)), modes.GCM(bytes(12)))
_PIECE = 1 << 30  # [byte] OpenSSL takes less than 2 GB at a time
AGAIN = "restore the file from a copy, or make it again from its recording with 'fringedic process'"


def has_checksums(dataset: xr.Dataset) -> bool:
    """Return whether the file of an opened dataset contains checksums; those of earlier versions contain none."""
    return dataset.attrs.get(CHECKED) == _CHECKED


def open_checked(source: Any, place: str, *, netcdf: bool, **options: Any) -> xr.Dataset:
    """Open a dataset after a check of everything but its maps, which are checked when they are read.

    Parameters
    ----------
    source
        What xarray reads: a path, an open file or a store of Zarr.
    place
        The file, for messages.
    netcdf
        Whether it is NetCDF, otherwise Zarr.
    options
        Further ones of `xarray.open_dataset`.

    Raises
    ------
    DatasetError
        It cannot be read, or the content is not what was written; also from every later access to a damaged map.
    """
    raw = None
    try:
        # without a cache: a loop over the maps of an experiment would fill the memory
        engine = "h5netcdf" if netcdf else "zarr"
        raw = xr.open_dataset(source, engine=engine, cache=False, decode_cf=False, **options)
        if CONTENT not in raw.attrs and isinstance(source, str | os.PathLike) and _had_checksums(Path(source)):
            raise DatasetError(f"{place}: its attributes ('.zattrs') are missing: {AGAIN}")
        return _checked(raw, place)
    except Exception as error:  # of HDF5 and Zarr each part of a damaged file has its own
        if raw is not None:
            raw.close()
        if isinstance(error, DatasetError):
            raise
        kind = "NetCDF" if netcdf else "Zarr"
        raise DatasetError(f"{place}: cannot be read as {kind}: {cause_of(error)}; {AGAIN}") from error


def _had_checksums(folder: Path) -> bool:
    """Return whether the consolidated metadata of a Zarr folder (format 2), a copy of the others, have checksums."""
    copy = folder / ".zmetadata"
    return copy.is_file() and CONTENT in copy.read_text("utf-8")


def load_checked(dataset: xr.Dataset) -> None:
    """Read every map of an opened dataset, step by step, so that all its checksums are compared.

    Raises
    ------
    DatasetError
        A map is damaged.
    """
    for variable in dataset.variables.values():
        if variable.dims == MAP_DIMENSIONS:
            for index in range(variable.shape[0]):
                variable[index].values  # noqa: B018


def _checked(raw: xr.Dataset, place: str) -> xr.Dataset:
    text = raw.attrs.pop(CONTENT, None)
    if text is None:
        return _decoded(raw, _NONE, place)
    try:
        sums = json.loads(text)
        known: dict[str, dict[str, str]] = sums["variables"]
        named = [(name, each["about"], each["values"]) for name, each in known.items()]
    except (ValueError, TypeError, KeyError) as error:
        raise DatasetError(f"{place}: the attribute '{CONTENT}' is damaged: {AGAIN}") from error
    _require(_sum_of_attributes(raw.attrs) == sums.get("attributes"), place, "its attributes have")
    _require(raw.variables.keys() == known.keys(), place, "the list of its variables has")
    maps = {}
    for name, about, values in named:
        variable = raw.variables[name]
        _require(_sum_of_description(variable) == about, place, f"dimensions, type or attributes of '{name}' have")
        if variable.dims == MAP_DIMENSIONS:
            _require(len(values) == _DIGITS * variable.shape[0], place, f"the number of steps of '{name}' has")
            lazy = indexing.LazilyIndexedArray(_CheckedMap(variable, values, name, place))
            maps[name] = xr.Variable(variable.dims, lazy, variable.attrs, variable.encoding)
        else:
            _require(sum_of(variable.values) == values, place, f"'{name}' has")
    return _decoded(raw.assign(maps), _CHECKED, place, raw)


def _decoded(raw: xr.Dataset, state: str, place: str, source: xr.Dataset | None = None) -> xr.Dataset:
    dataset = xr.decode_cf(raw)
    dataset.attrs[CHECKED] = state
    dataset.encoding.setdefault("source", place)
    dataset.set_close((source or raw).close)
    return dataset


def _require(equal: bool, place: str, what: str) -> None:
    if not equal:
        raise DatasetError(f"{place} is damaged: {what} changed since it was written; {AGAIN}")


class _CheckedMap(BackendArray):
    """A map over (step, row, column) that reads whole steps and compares each with its checksum."""

    def __init__(self, variable: xr.Variable, sums: str, name: str, place: str) -> None:
        self._variable, self._sums, self._name, self._place = variable, sums, name, place
        self.shape, self.dtype = variable.shape, variable.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._read)

    def _read(self, key: tuple[int | slice, ...]) -> np.ndarray:
        steps, *rest = key
        if isinstance(steps, int | np.integer):
            return np.asarray(self._step(int(steps))[tuple(rest)])
        return _stacked([self._step(each)[tuple(rest)] for each in range(*steps.indices(self.shape[0]))], self, key)

    def _step(self, index: int) -> np.ndarray:
        index %= self.shape[0]
        where = f"map '{self._name}' of step {index} (counted from 0)"
        try:
            values: np.ndarray = self._variable[index].values
        except Exception as error:  # HDF5 and each codec of Zarr have their own errors for a damaged or shortened chunk
            raise DatasetError(
                f"{self._place} is damaged: {where} cannot be read: {cause_of(error)}; {AGAIN}"
            ) from error
        begin = _DIGITS * index
        _require(sum_of(values) == self._sums[begin : begin + _DIGITS], self._place, f"{where} is missing or has")
        return values


def _stacked(steps: list[np.ndarray], array: _CheckedMap, key: tuple[int | slice, ...]) -> np.ndarray:
    if steps:
        return np.stack(steps)
    return np.empty(array.shape, array.dtype)[:0][(slice(0), *key[1:])]


class SummedDataset:
    """A dataset with the checksums of what a library writes of it, so that the file need not be read again.

    Parameters
    ----------
    dataset
        In memory or on the disk; its maps are read when they are written.
    encoding
        Of its variables, as of `xarray.Dataset.to_netcdf`.

    Attributes
    ----------
    content
        The dataset that the library has to write, without another encoding.
    """

    def __init__(self, dataset: xr.Dataset, encoding: Mapping[str, Mapping[str, Any]]) -> None:
        variables, attributes = conventions.encode_dataset_coordinates(dataset)
        for name, options in encoding.items():
            variables[name].encoding = dict(options)
        encoded, self._attributes = conventions.cf_encoder(variables, attributes)
        self._abouts = {str(name): _sum_of_description(variable) for name, variable in encoded.items()}
        self._values: dict[str, str] = {}
        self.content = xr.Dataset({name: self._summed(str(name), each) for name, each in encoded.items()}).assign_attrs(
            self._attributes
        )

    @property
    def text(self) -> str:
        """Text of the attribute `CONTENT`, once the dataset is written."""
        variables = {name: {"about": about, "values": self._values[name]} for name, about in self._abouts.items()}
        return text_of(self._attributes, variables)

    def _summed(self, name: str, variable: xr.Variable) -> xr.Variable:
        if variable.dims != MAP_DIMENSIONS:
            self._values[name] = sum_of(variable.values)
            return variable
        lazy = indexing.LazilyIndexedArray(_SummedMap(variable, name, self._values))
        return xr.Variable(variable.dims, lazy, variable.attrs, variable.encoding)


class _SummedMap(BackendArray):
    """A map over (step, row, column) that enters its checksums when it is read."""

    def __init__(self, variable: xr.Variable, name: str, sums: dict[str, str]) -> None:
        self._variable, self._name, self._sums = variable, name, sums
        self.shape, self.dtype = variable.shape, variable.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._read)

    def _read(self, key: tuple[int | slice, ...]) -> np.ndarray:
        values = self._variable.values
        self._sums[self._name] = "".join(map(sum_of, values))
        return np.asarray(values[key])


def text_of(attributes: Mapping[Any, Any], variables: Mapping[str, Mapping[str, str]]) -> str:
    """Return the text of the attribute `CONTENT` from the attributes and the checksums of the variables."""
    return json.dumps({"attributes": _sum_of_attributes(attributes), "variables": variables}, sort_keys=True)


def _sum_of_description(variable: xr.Variable) -> str:
    attributes = dict(variable.attrs)
    truth = attributes.get("dtype") == "bool"  # as Zarr contains it; HDF5 has a type of its own
    if truth:
        del attributes["dtype"]
    text = variable.dtype.kind in "OSTU"
    dtype = TEXT if text else np.dtype(bool).str if truth else variable.dtype.str
    return sum_of_description(tuple(map(str, variable.dims)), dtype, attributes)


def sum_of_description(dimensions: tuple[str, ...], dtype: str, attributes: Mapping[Any, Any]) -> str:
    """Return the checksum of what a variable is without its values."""
    about = json.dumps([*dimensions, dtype, _sum_of_attributes(attributes)])
    return _tag(about.encode())


def _sum_of_attributes(attributes: Mapping[Any, Any]) -> str:
    content = {str(name): _plain(value) for name, value in attributes.items() if name not in (_FILL, CONTENT)}
    return _tag(json.dumps(content, sort_keys=True).encode())


def _plain(value: Any) -> Any:
    """Return a value as every format returns it: HDF5 has arrays with NumPy's types, and no lists of one element."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, bytes):
        value = value.decode(errors="replace")
    if isinstance(value, list | tuple):
        if value and all(isinstance(each, int | float) for each in value):
            value = np.array(value).tolist()  # of one type, as in an array
        value = [_plain(each) for each in value]
        return value[0] if len(value) == 1 else value
    return value


def sum_of(values: Any) -> str:
    """Return the checksum of numbers or texts of any shape."""
    array = np.asarray(values)
    if array.dtype.kind in "OSTU":
        return _tag(json.dumps(array.astype(object).tolist(), default=str).encode())
    plain = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    return _tag(plain.reshape(-1).view(np.uint8).data)


def _tag(data: bytes | memoryview) -> str:
    sums = _GMAC.encryptor()
    for begin in range(0, len(data), _PIECE):
        sums.authenticate_additional_data(data[begin : begin + _PIECE])
    sums.finalize()
    return sums.tag.hex()[:_DIGITS]
