"""Reading of NetCDF files that opens at once, however many maps there are.

The common readers ask every variable for the length of the growing dimension, again for every other variable: a second
for forty maps. Here each variable is looked at once.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py  # type: ignore[import-untyped]
import numpy as np
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

# what the format needs for itself
_INTERNAL = {
    "CLASS",
    "DIMENSION_LIST",
    "NAME",
    "REFERENCE_LIST",
    "_NCProperties",
    "_Netcdf4Coordinates",
    "_Netcdf4Dimid",
    "_nc3_strict",
}
_NO_VARIABLE = b"This is a netCDF dimension but not a netCDF variable"


class _Stored(BackendArray):
    """A variable on the disk; what is indexed is read."""

    def __init__(self, stored: Any) -> None:
        self._stored = stored
        self._text = h5py.check_string_dtype(stored.dtype) is not None
        self.shape = stored.shape
        self.dtype = np.dtype(object) if self._text else stored.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER_1VECTOR, self._read)

    def _read(self, key: tuple[Any, ...]) -> np.ndarray:
        """Read what xarray has made a key of that HDF5 understands."""
        return np.asarray((self._stored.asstr() if self._text else self._stored)[key])


def open_netcdf(file: Path) -> xr.Dataset:
    """Open a NetCDF-4 file as a dataset whose variables are read when they are used, each time anew.

    Raises
    ------
    OSError
        It cannot be read, or is no such file.
    """
    stored = h5py.File(file, "r")
    variables = {}
    for name, node in stored.items():
        if isinstance(node, h5py.Dataset) and not node.attrs.get("NAME", b"").startswith(_NO_VARIABLE):
            data = indexing.LazilyIndexedArray(_Stored(node))
            variables[name] = xr.Variable(_dimensions(name, node), data, _attributes(node))
    dataset = xr.decode_cf(xr.Dataset(variables, attrs=_attributes(stored)))
    dataset.set_close(stored.close)
    return dataset


def _dimensions(name: str, node: Any) -> tuple[str, ...]:
    """Names of the dimensions that a variable hangs on; a dimension's own variable hangs on itself."""
    if node.attrs.get("CLASS") == b"DIMENSION_SCALE":
        return (name,)
    return tuple(axis[0].name.rsplit("/", 1)[-1] for axis in node.dims)


def _attributes(node: Any) -> dict[str, Any]:
    """Attributes of a variable or file; that NaN stands for NaN needs no mention."""
    found = {key: _plain(value) for key, value in node.attrs.items() if key not in _INTERNAL}
    if isinstance(found.get("_FillValue"), np.floating) and np.isnan(found["_FillValue"]):
        del found["_FillValue"]
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.decode()
    return value[0] if isinstance(value, np.ndarray) and value.shape == (1,) else value
