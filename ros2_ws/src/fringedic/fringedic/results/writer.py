"""Writing of datasets, step by step."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5netcdf
import h5py  # type: ignore[import-untyped]
import numpy as np

from fringedic import __version__
from fringedic.errors import DatasetError
from fringedic.results.quantities import MAPS, SCALARS
from fringedic.results.rows import Row, Settings


class DatasetWriter:
    """Appends steps to a NetCDF file, which gets its name when it is whole."""

    def __init__(self, target: Path, attributes: Mapping[str, str]) -> None:
        self._target = target
        self._temporary = target.with_name(f".{target.name}.writing")
        self._file: Any = None
        self._settings: list[dict[str, Any]] = []
        self._attributes = {
            **attributes,
            "software": f"fringedic {__version__}",
            "conventions": "SI units; z towards the camera, x right and y up in the image; NaN is not measured",
        }
        self._grid: tuple[int, int, int] | None = None
        self._count = 0
        self._last_error = ""

    def __enter__(self) -> DatasetWriter:
        try:
            self._file = h5netcdf.File(self._temporary, "w")
        except OSError as error:
            raise DatasetError(f"{self._target}: cannot be written: {error}") from error
        self._file.dimensions = {"step": None}
        self._variable("step", ("step",), "i8", "1", "load step")
        self._variable("time", ("step",), "i8", "nanoseconds since 1970-01-01", "stamp of the last exposure")
        self._variable("reference_step", ("step",), "i8", "1", "step that the displacement is measured against")
        self._variable("error", ("step",), h5py.string_dtype(), "", "why the step failed, empty when it did not")
        for name, quantity in SCALARS.items():
            self._variable(name, ("step",), "f8", *quantity)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        whole = kind is None and self._grid is not None
        if whole:
            for name, value in self._attributes.items():
                self._file.attrs[name] = value
        self._file.close()
        if whole:
            self._temporary.replace(self._target)
            return
        self._temporary.unlink()
        if kind is None:
            raise DatasetError(f"{self._target}: no step could be measured: {self._last_error or 'no frames'}")

    def add(self, row: Row, settings: Settings) -> None:
        """Append one step."""
        self._describe(row.step, settings)
        self._last_error = row.error or self._last_error
        index = self._count
        self._count += 1
        self._file.resize_dimension("step", self._count)
        values: dict[str, Any] = {
            "step": row.step,
            "time": row.stamp,
            "reference_step": -1 if row.reference_step is None else row.reference_step,
            "error": row.error,
        }
        values |= {name: getattr(row, name) for name in SCALARS}
        for name, value in values.items():
            self._file[name][index] = value
        if row.maps:
            self._write_maps(index, row, settings.spacing)
        self._file.flush()

    def _write_maps(self, index: int, row: Row, spacing: int) -> None:
        points = row.maps["displacement_x"] if "displacement_x" in row.maps else _sampled(row.maps["phase"], spacing)
        grid = (*points.shape, spacing)
        if self._grid is None:
            self._create_grid(grid)
        elif grid != self._grid:
            raise DatasetError(
                f"{self._target}: step {row.step} has {grid[1]}x{grid[0]} points at a spacing of {grid[2]} px, the "
                f"steps before have {self._grid[1]}x{self._grid[0]} at {self._grid[2]} px; process them separately"
            )
        for name, values in row.maps.items():
            if name in self._file.variables:
                sampled = values if values.shape == grid[:2] else _sampled(values, spacing)
                self._file[name][index] = sampled

    def _create_grid(self, grid: tuple[int, int, int]) -> None:
        rows, columns, spacing = self._grid = grid
        self._file.dimensions["row"] = rows
        self._file.dimensions["column"] = columns
        for name, number in (("row", rows), ("column", columns)):
            variable = self._variable(name, (name,), "i8", "px", f"{name} in the reference image")
            variable[:] = spacing * np.arange(number)
        for name, quantity in MAPS.items():
            self._variable(
                name,
                ("step", "row", "column"),
                "f4",
                *quantity,
                chunks=(1, rows, columns),
                fillvalue=np.float32(np.nan),
            )

    def _variable(
        self, name: str, dimensions: tuple[str, ...], dtype: Any, units: str, long_name: str, **options: Any
    ) -> Any:
        variable = self._file.create_variable(name, dimensions, dtype, **options)
        if units:
            variable.attrs["units"] = units
        variable.attrs["long_name"] = long_name
        return variable

    def _describe(self, step: int, settings: Settings) -> None:
        """Note parameters and calibration in the attributes, with the step from which on they hold."""
        now = {node: parameters.model_dump() for node, parameters in settings.parameters.items()}
        if not self._settings or self._settings[-1]["parameters"] != now:
            self._settings.append({"from_step": step, "parameters": now})
            self._attributes["parameters"] = json.dumps(self._settings)
        if settings.calibration is not None:
            self._attributes["calibration"] = json.dumps(dataclasses.asdict(settings.calibration))


def _sampled(image: np.ndarray, spacing: int) -> np.ndarray:
    return image[::spacing, ::spacing]
