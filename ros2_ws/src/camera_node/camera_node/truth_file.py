"""Ground truth behind the frames of a virtual rig."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path

import h5netcdf
import numpy as np
import xarray as xr

from fringedic.virtual_rig import VirtualRig


class TruthFile:
    """Ground truth of one experiment, as NetCDF with the dimension `step`, which grows step by step.

    Shape and displacement are those of `VirtualRig.truth`, relative to the first step that is added.

    Parameters
    ----------
    path
        The file; an existing one is replaced when the first step is added.
    rig
        The twin.
    """

    def __init__(self, path: Path, rig: VirtualRig) -> None:
        self._path = path
        self._rig = rig
        self._reference_position: float | None = None

    def add(self, step: int, position: float) -> None:
        """Write the truth of a step at a crosshead position [m]; omitted steps stay NaN and invalid."""
        first = self._reference_position is None
        if self._reference_position is None:
            self._reference_position = position
        truth = self._rig.truth(position, self._reference_position)
        if first:
            self._create(truth)
        with h5netcdf.File(self._path, "a") as file:
            file.resize_dimension("step", max(step + 1, file.dimensions["step"].size))
            for name in _of_step(truth):
                file.variables[name][step] = truth[name].values
            file.variables["position"][step] = position

    def _create(self, truth: xr.Dataset) -> None:
        """Write the variables of the reference, and those of the steps without any step.

        The first file that xarray writes imports Dask: more than a second of the thread that exposes.
        """
        of_step = _of_step(truth)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with h5netcdf.File(self._path, "w") as file:
            file.dimensions = {"step": None, **truth.sizes}
            file.attrs["reference_position_m"] = truth.attrs["reference_position_m"]
            for name, variable in truth.variables.items():
                if name in of_step:
                    self._create_variable(file, name, ("step", *variable.dims), variable.dtype)
                else:
                    self._create_variable(file, name, variable.dims, variable.dtype)[...] = variable.values
            position = file.create_variable("position", ("step",), "f8", fillvalue=np.nan)
            position.attrs.update(units="m", long_name="crosshead position")

    def _create_variable(
        self, file: h5netcdf.File, name: Hashable, dimensions: tuple[Hashable, ...], dtype: np.dtype
    ) -> h5netcdf.Variable:
        chunks = (1, *self._rig.shape) if "step" in dimensions else None
        if dtype.kind == "b":
            return file.create_variable(str(name), dimensions, "i1", chunks=chunks)
        if dtype.kind == "f":
            return file.create_variable(str(name), dimensions, "f4", fillvalue=np.float32(np.nan), chunks=chunks)
        return file.create_variable(str(name), dimensions, dtype)


def _of_step(truth: xr.Dataset) -> list[str]:
    """Return the variables that change from step to step; the others describe the reference surface."""
    return [str(name) for name in truth.data_vars if name not in ("x", "y", "z", "lit")]
