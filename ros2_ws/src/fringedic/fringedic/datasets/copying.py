"""A dataset in memory, written into any store."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from fringedic.datasets.checked_store import ChecksummedStore
from fringedic.datasets.checksums import CHECKED, CONTENT
from fringedic.datasets.quantities import MAP_DIMENSIONS, NANOSECONDS, TEXT
from fringedic.datasets.stores import Store, Variable

_IN_MILLIMETRES = ("x_mm", "y_mm")  # made when a dataset is opened
_WHEN_OPENED = {CHECKED, CONTENT}  # attributes
_STEP = MAP_DIMENSIONS[0]


def copy_into(store: Store, dataset: xr.Dataset) -> None:
    """Write a dataset with its checksums.

    Parameters
    ----------
    store
        Takes maps over (step, row, column), values over (step) and whole coordinates.
    dataset
        As of `fringedic.open_experiment`.
    """
    target = ChecksummedStore(store)
    kept = dataset.drop_vars(_IN_MILLIMETRES, errors="ignore")
    sizes = {str(name): size for name, size in kept.sizes.items()}
    steps = sizes[_STEP]
    for name, each in kept.variables.items():
        values = _plain(each.values)
        attributes = {str(key): str(value) for key, value in each.attrs.items()}
        if each.dtype.kind == "M":
            attributes["units"] = NANOSECONDS
        kind = TEXT if values.dtype.kind == "O" else f"{values.dtype.kind}{values.dtype.itemsize}"
        dimensions = tuple(map(str, each.dims))
        target.add_variable(Variable(str(name), dimensions, kind, attributes), {**sizes, _STEP: 0})
    target.grow(steps)
    for name, each in kept.variables.items():
        values = _plain(each.values)
        if each.dims[0] != _STEP:
            target.put(str(name), slice(None), values)
            continue
        for index in range(steps):
            target.put(str(name), index, values[index] if values.ndim > 1 else values[index : index + 1].tolist()[0])
    target.finish(
        {str(name): _plain_attribute(value) for name, value in kept.attrs.items() if name not in _WHEN_OPENED}
    )


def _plain(values: np.ndarray) -> np.ndarray:
    """Return times as nanoseconds, and texts as objects."""
    if values.dtype.kind == "M":
        return values.astype("datetime64[ns]").astype(np.int64)
    return values.astype(object) if values.dtype.kind in "UO" else values


def _plain_attribute(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
