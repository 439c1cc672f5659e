"""Writing of datasets, step by step."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterable, Mapping
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np

from fringedic.datasets.checked_store import ChecksummedStore
from fringedic.datasets.quantities import MAP_DIMENSIONS, NANOSECONDS, RECORDING, STEP_NUMBERS, TEXT, Layout
from fringedic.datasets.rows import Row
from fringedic.datasets.signals import drift_name, series_name, sigma_name, time_name
from fringedic.datasets.stores import Store, Variable, create_store, require_room
from fringedic.errors import DatasetError
from fringedic.provenance import git_commit, software
from fringedic.signals import Signal, SignalValue
from fringedic.steps.recorded_parameters import StepSettings


class DatasetWriter:
    """Appends steps to a dataset, which gets its name when it is complete.

    Parameters
    ----------
    target
        The dataset: a path, which becomes NetCDF or Zarr by its suffix, or a store.
    attributes
        Of the dataset, beside software, commit, settings and conventions.
    layout
        Its variables.

    Attributes
    ----------
    attributes
        Those of the dataset, which are written when it is complete.
    """

    def __init__(self, target: Path | Store, attributes: Mapping[str, Any], layout: Layout = RECORDING) -> None:
        self._target = target
        self._layout = layout
        self._store: Store
        self._settings: list[dict[str, Any]] = []
        self.attributes: dict[str, Any] = {
            **attributes,
            "software": software(),
            "commit": git_commit(),
            "conventions": "SI units; z towards the camera, x right and y up in the image; NaN is not measured",
        }
        self._grid: tuple[int, int, int] | None = None
        self._count = 0
        self._signals: dict[str, str] = {}  # name of a signal -> name of its variable
        self._last_error = ""

    def __enter__(self) -> DatasetWriter:
        self._store = ChecksummedStore(create_store(self._target) if isinstance(self._target, Path) else self._target)
        try:
            self._make_variables()
        except BaseException:  # without a `with` block nobody discards it
            self._store.discard()
            raise
        return self

    def _make_variables(self) -> None:
        self._variable("step", ("step",), "i8", "1", "load step")
        if self._layout.timed:
            self._variable("time", ("step",), "i8", NANOSECONDS, "last exposure, or middle of a moving stack")
        for name, meaning in STEP_NUMBERS.items():
            self._variable(name, ("step",), "i8", "1", meaning)
        for name, meaning in self._layout.texts.items():
            self._variable(name, ("step",), TEXT, "", meaning)
        for name, quantity in self._layout.scalars.items():
            self._variable(name, ("step",), "f8", *quantity)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if kind is None and self._grid is not None:
            try:
                self._store.finish(self.attributes)
            except BaseException:
                self._store.discard()
                raise
            return
        self._store.discard()
        if kind is None:
            raise DatasetError(f"{self._store.name}: no step could be measured: {self._last_error or 'no frames'}")

    def add_signals(self, signals: Iterable[Signal]) -> None:
        """Make the variables of signals: their series over a time axis of their own, and their value at each step."""
        for signal in signals:
            channel, name = signal.channel, self._free_name(signal.channel.name)
            self._signals[channel.name] = name
            about = {"quantity": channel.quantity, "positive": channel.positive, "source": channel.source}
            during = f"{channel.name} during the exposures"
            self._variable(name, ("step",), "f8", channel.unit, during, more=about)
            self._variable(sigma_name(name), ("step",), "f8", channel.unit, f"standard uncertainty of {name}")
            change = f"change of {name} from the begin to the end of the exposures"
            self._variable(drift_name(name), ("step",), "f8", channel.unit, change)
            if signal.stamps.size:
                self._write_series(name, signal, about)

    def _free_name(self, name: str) -> str:
        """Return the name of a signal whose variables are not those of something else."""
        plain = re.sub(r"\W", "_", name)
        own = {*MAP_DIMENSIONS, *STEP_NUMBERS, "time", *self._layout.texts, *self._layout.scalars, *self._layout.maps}
        taken = own.union(*map(_variables_of, self._signals.values()))
        names = chain((plain, f"signal_{plain}"), (f"{plain}_{number}" for number in count(2)))
        return next(each for each in names if not taken & _variables_of(each))

    def _write_series(self, name: str, signal: Signal, about: Mapping[str, str]) -> None:
        axis, series = time_name(name), series_name(name)
        sizes, unit = {axis: signal.stamps.size}, signal.channel.unit
        self._variable(axis, (axis,), "i8", NANOSECONDS, f"time of the samples of {name}", sizes)
        self._variable(series, (axis,), "f8", unit, signal.channel.name, sizes, about)
        self._variable(sigma_name(series), (axis,), "f8", unit, f"standard uncertainty of {series}", sizes)
        columns = {axis: signal.stamps, series: signal.values, sigma_name(series): signal.sigmas}
        for column, values in columns.items():
            self._store.put(column, slice(None), values)

    def add(self, row: Row, settings: StepSettings) -> None:
        """Append one step."""
        self._describe(row.step, settings)
        self._last_error = row.error or self._last_error
        size = sum(values.nbytes for values in row.maps.values())
        require_room(self._store.name, f"step {row.step}", size, self._store.room())
        index = self._count
        self._count += 1
        self._store.grow(self._count)
        self.enter_values(index, row)
        if row.maps:
            self._write_maps(index, row, settings.spacing)
        self._store.flush()

    def enter_values(self, index: int, row: Row) -> None:
        """Write the values of a step without its maps; those of a step that was added before are replaced."""
        values: dict[str, Any] = {
            "step": row.step,
            **({"time": row.stamp} if self._layout.timed else {}),
            "reference_step": row.reference_step,
            "correlated_step": row.correlated_step,
            "increments_summed": None if row.correlated_step is None else row.correlated_step != row.reference_step,
        }
        values |= {name: -1 if values[name] is None else int(values[name]) for name in STEP_NUMBERS}
        values |= {name: getattr(row, name) for name in (*self._layout.texts, *self._layout.scalars)}
        for signal, name in self._signals.items():
            value = row.signals.get(signal, SignalValue())
            values |= {name: value.mean, sigma_name(name): value.sigma, drift_name(name): value.drift}
        for name, value in values.items():
            self._store.put(name, index, value)

    def _write_maps(self, index: int, row: Row, spacing: int) -> None:
        points = row.maps["displacement_x"] if "displacement_x" in row.maps else _sampled(row.maps["phase"], spacing)
        grid = (*points.shape, spacing)
        if self._grid is None:
            self._create_grid(grid)
        elif grid != self._grid:
            raise DatasetError(
                f"{self._store.name}: step {row.step} has {grid[1]}x{grid[0]} points at a spacing of {grid[2]} px, the "
                f"steps before have {self._grid[1]}x{self._grid[0]} at {self._grid[2]} px; process them separately"
            )
        for name, values in row.maps.items():
            if name in self._layout.maps:
                sampled = values if values.shape == grid[:2] else _sampled(values, spacing)
                self._store.put(name, index, sampled)

    def _create_grid(self, grid: tuple[int, int, int]) -> None:
        rows, columns, spacing = self._grid = grid
        sizes = {"row": rows, "column": columns}
        for name, number in sizes.items():
            self._variable(name, (name,), "i8", "px", f"{name} in the reference image", sizes)
            self._store.put(name, slice(None), spacing * np.arange(number))
        for name, quantity in self._layout.maps.items():
            self._variable(name, MAP_DIMENSIONS, "f4", *quantity, sizes)

    def _variable(
        self,
        name: str,
        dimensions: tuple[str, ...],
        dtype: str,
        units: str,
        long_name: str,
        sizes: Mapping[str, int] | None = None,
        more: Mapping[str, str] | None = None,
    ) -> None:
        attributes = {"long_name": long_name} | ({"units": units} if units else {}) | dict(more or {})
        variable = Variable(name, dimensions, dtype, attributes)
        self._store.add_variable(variable, {"step": self._count, **(sizes or {})})

    def _describe(self, step: int, settings: StepSettings) -> None:
        """Enter parameters and calibration into the attributes, with the first step for which they apply."""
        now = {node: parameters.model_dump() for node, parameters in settings.parameters.items()}
        if not self._settings or self._settings[-1]["parameters"] != now:
            self._settings.append({"from_step": step, "parameters": now})
            self.attributes["parameters"] = _to_json(self._settings)
        if settings.calibration is not None:
            self.attributes["calibration"] = _to_json(dataclasses.asdict(settings.calibration))
        if settings.rig:
            self.attributes["rig"] = _to_json(settings.rig)
        if settings.metadata:
            self.attributes["facts"] = _to_json(settings.metadata.model_dump())


def _to_json(value: Any) -> str:
    return json.dumps(value, default=lambda array: array.tolist())


def _sampled(image: np.ndarray, spacing: int) -> np.ndarray:
    return image[::spacing, ::spacing]


def _variables_of(signal: str) -> set[str]:
    series = series_name(signal)
    return {signal, sigma_name(signal), drift_name(signal), time_name(signal), series, sigma_name(series)}
