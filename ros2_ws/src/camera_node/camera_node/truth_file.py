"""Ground truth behind the frames of a virtual rig."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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
        """Write the variables of the reference, without any step."""
        empty = truth[_of_step(truth)].expand_dims(step=0)
        file = xr.merge([truth.drop_vars(_of_step(truth)), empty], combine_attrs="drop")
        file["position"] = ("step", np.empty(0), {"units": "m", "long_name": "crosshead position"})
        file.attrs = {"reference_position_m": truth.attrs["reference_position_m"]}
        encoding: dict[str, dict[str, Any]] = {}
        for name, variable in file.data_vars.items():
            if variable.ndim > 1:
                flag = variable.dtype == bool
                encoding[str(name)] = {"dtype": "i1"} if flag else {"dtype": "f4", "_FillValue": np.float32(np.nan)}
                if "step" in variable.dims:
                    encoding[str(name)]["chunksizes"] = (1, *self._rig.shape)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        file.to_netcdf(self._path, engine="h5netcdf", encoding=encoding, unlimited_dims=["step"])


def _of_step(truth: xr.Dataset) -> list[str]:
    """Return the variables that change from step to step; the others describe the reference surface."""
    return [str(name) for name in truth.data_vars if name not in ("x", "y", "z", "lit")]
