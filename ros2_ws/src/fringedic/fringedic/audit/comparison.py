"""Comparison of two datasets of one experiment, bit by bit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import xarray as xr

from fringedic.datasets.quantities import MAP_DIMENSIONS

SOFTWARE = ("software", "commit")
"""Attributes that name who computed a dataset; all others belong to the result."""


@dataclass(frozen=True)
class Difference:
    """A variable or attribute that is not the same in two datasets.

    Attributes
    ----------
    name
        Of the variable, or ``attribute`` and its name.
    values, of
        How many values differ, out of how many; all when its size or type differs.
    largest
        Largest difference of the numbers, in `unit`; NaN when one of them is not measured or no number.
    unit
        As in the dataset; empty without one.
    """

    name: str
    values: int
    of: int
    largest: float = float("nan")
    unit: str = ""


def compare_bits(one: xr.Dataset, other: xr.Dataset) -> list[Difference]:
    """Compare all variables and attributes of two datasets, except those of the software, bit by bit.

    Maps are read step by step.

    Parameters
    ----------
    one, other
        From `fringedic.open_experiment`.

    Examples
    --------
    >>> one = xr.Dataset({"force": ("step", np.array([0.0, 100.0]), {"units": "N"})})
    >>> compare_bits(one, one)
    []
    >>> compare_bits(one, one.assign(force=one.force.copy(data=np.array([0.0, 100.5]))))
    [Difference(name='force', values=1, of=2, largest=0.5, unit='N')]
    """
    names = sorted({*map(str, one.variables), *map(str, other.variables)})
    found = [difference for name in names if (difference := _variable(one, other, name)) is not None]
    attributes = sorted({*map(str, one.attrs), *map(str, other.attrs)} - set(SOFTWARE))
    missing = object()
    return found + [
        Difference(f"attribute {name}", 1, 1)
        for name in attributes
        if not _same_value(one.attrs.get(name, missing), other.attrs.get(name, missing))
    ]


def _same_value(one: object, other: object) -> bool:
    return type(one) is type(other) and bool(np.array_equal(np.asarray(one), np.asarray(other)))


def _variable(one: xr.Dataset, other: xr.Dataset, name: str) -> Difference | None:
    if name not in one.variables or name not in other.variables:
        size = int((one if name in one.variables else other)[name].size)
        return Difference(name, size, size)
    first, second = one[name], other[name]
    unit = str(first.attrs.get("units", ""))
    if first.dims != second.dims or first.shape != second.shape or first.dtype != second.dtype:
        return Difference(name, int(first.size), int(first.size), unit=unit)
    values, largest = 0, 0.0
    for a, b in _parts(first, second):
        differs = ~_equal_bits(a, b)
        values += int(differs.sum())
        if differs.any():
            numbers = a.dtype.kind in "iuf"
            apart = np.abs(a[differs].astype(float) - b[differs].astype(float)) if numbers else np.array([np.nan])
            largest = float(np.max([largest, apart.max()]))
    attributes = {key: value for key, value in first.attrs.items() if not _same_value(value, second.attrs.get(key))}
    if values or attributes or first.attrs.keys() != second.attrs.keys():
        return Difference(name, values, int(first.size), largest, unit)
    return None


def _parts(one: xr.DataArray, other: xr.DataArray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the values of two arrays, maps step by step."""
    if one.dims != MAP_DIMENSIONS:
        yield one.values, other.values
        return
    for step in range(one.sizes["step"]):
        yield one[step].values, other[step].values


def _equal_bits(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    if one.dtype.kind not in "fmM":  # of these, what is not measured (NaN, NaT) does not equal itself
        return np.asarray(one == other)
    bits = f"u{one.dtype.itemsize}"
    return np.asarray(np.ascontiguousarray(one).view(bits) == np.ascontiguousarray(other).view(bits))
