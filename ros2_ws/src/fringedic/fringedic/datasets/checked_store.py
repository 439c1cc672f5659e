"""Writing of the checksums of a dataset beside its content, into any store."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from fringedic.datasets.checksums import CONTENT, sum_of, sum_of_description, text_of
from fringedic.datasets.quantities import MAP_DIMENSIONS, TEXT
from fringedic.datasets.stores import Store, Variable


class ChecksummedStore:
    """A store that writes the checksums of its content as an attribute.

    Parameters
    ----------
    store
        Where everything is written.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._variables: dict[str, Variable] = {}
        self._values: dict[str, dict[int, Any]] = {}  # of each step: its checksum of a map, otherwise its value
        self._whole: dict[str, str] = {}
        self._empty: dict[str, str] = {}
        self._steps = 0

    @property
    def name(self) -> str:
        """What messages call it."""
        return self._store.name

    def room(self) -> float:
        """Return the bytes that still fit."""
        return self._store.room()

    def add_variable(self, variable: Variable, sizes: Mapping[str, int]) -> None:
        """Make a variable; `sizes` is that of each dimension now (step may grow)."""
        self._variables[variable.name] = variable
        self._values[variable.name] = {}
        if variable.dimensions == MAP_DIMENSIONS:
            self._empty[variable.name] = sum_of(np.full((sizes["row"], sizes["column"]), np.nan, variable.dtype))
        self._store.add_variable(variable, sizes)

    def grow(self, steps: int) -> None:
        """Make room for as many steps."""
        self._steps = steps
        self._store.grow(steps)

    def put(self, name: str, index: int | slice, value: Any) -> None:
        """Write one step of a variable, or a whole coordinate."""
        variable = self._variables[name]
        if isinstance(value, np.ndarray) and not value.ndim:
            value = value.item()  # one value of another dataset
        elif isinstance(value, np.ndarray) and variable.dtype != TEXT:
            value = np.ascontiguousarray(value, variable.dtype)  # a library may convert NaN to another bit pattern
        if isinstance(index, slice):
            self._whole[name] = sum_of(np.asarray(value))
        else:
            self._values[name][index] = sum_of(value) if variable.dimensions == MAP_DIMENSIONS else value
        self._store.put(name, index, value)

    def flush(self) -> None:
        """Hand everything to the operating system."""
        self._store.flush()

    def finish(self, attributes: Mapping[str, Any]) -> None:
        """Write the attributes and the checksums, close, and give the dataset its name."""
        variables = {name: {"about": about, "values": self._values_of(name)} for name, about in self._descriptions()}
        self._store.finish({**attributes, CONTENT: text_of(attributes, variables)})

    def discard(self) -> None:
        """Close and remove what was written."""
        self._store.discard()

    def _descriptions(self) -> Iterator[tuple[str, str]]:
        for name, (_, dimensions, dtype, attributes) in self._variables.items():
            yield name, sum_of_description(dimensions, dtype if dtype == TEXT else np.dtype(dtype).str, attributes)

    def _values_of(self, name: str) -> str:
        _, dimensions, dtype, _ = self._variables[name]
        by_step = self._values[name]
        if dimensions == MAP_DIMENSIONS:
            return "".join(by_step.get(index, self._empty[name]) for index in range(self._steps))
        if dimensions[0] != MAP_DIMENSIONS[0]:
            return self._whole[name]
        values = [by_step[index] for index in range(self._steps)]
        return sum_of(np.array(values, object if dtype == TEXT else dtype))
