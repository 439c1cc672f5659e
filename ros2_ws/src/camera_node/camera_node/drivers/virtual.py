"""The camera of a virtual rig, and the truth behind what it sees."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import xarray as xr

from camera_node.drivers.driver import Frame, LocalDriver, PlacedPlane, Scene
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration, pattern_weights


class VirtualDriver(LocalDriver):
    """Camera of the digital twin. Frames are numbered from 0 on; the number and the rig's seed decide the noise."""

    needs_scene = True

    def __init__(self, configuration: VirtualRigConfiguration) -> None:
        self.rig = VirtualRig(configuration)
        self._plane: tuple[PlacedPlane, VirtualRig] | None = None
        self._frames = 0
        # the first call compiles, or loads what was compiled: before the first frame is asked for
        self.rig.expose(self._dark(), 0.0, 0)

    def expose(self, scene: Scene) -> Frame:
        """Render what the camera sees of a scene."""
        white = self.rig.configuration.sensor.exposure_ms
        image = self._rig_with(scene.plane).expose_parts(
            self._parts(scene),
            scene.position,
            self._frames,
            exposure_factor=1.0 if white is None else 1e3 * scene.exposure_time / white,
        )
        self._frames += 1
        return Frame(image, scene.stamp_ns, scene.exposure_time)

    def close(self) -> None:
        """Nothing is kept open."""

    def _parts(self, scene: Scene) -> list[tuple[np.ndarray, float]]:
        """What the projector's light during the exposure is made of."""
        if not scene.patterns:
            return [(self._dark(), 1.0)]
        projector = self.rig.configuration.projector
        if projector.is_immediate:
            return [(scene.patterns[-1].image, 1.0)]
        shown = [pattern.shown_ns for pattern in scene.patterns]
        start = scene.stamp_ns - round(0.5e9 * scene.exposure_time)
        weights = pattern_weights(projector, self.rig.configuration.seed, shown, start, scene.exposure_time)
        return [(pattern.image, float(weight)) for pattern, weight in zip(scene.patterns, weights, strict=True)]

    def _rig_with(self, plane: PlacedPlane | None) -> VirtualRig:
        """The rig in front of the specimen, or of the reference plane; the latest place of that is kept."""
        if plane is None:
            return self.rig
        if self._plane is None or self._plane[0] != plane:
            specimen = {
                "kind": "reference_plane",
                "surface": plane.surface,
                "angle_degree": math.degrees(plane.angle),
                "height_mm": 1e3 * plane.height,
            }
            self._plane = plane, self.rig.with_specimen(specimen)
        return self._plane[1]

    def _dark(self) -> np.ndarray:
        return np.zeros(self.rig.projector_shape, np.uint8)


class TruthFile:
    """Ground truth of one experiment, as NetCDF with the dimension `step`, which grows step by step.

    Shape and displacement are those of `VirtualRig.truth`, against the position of the first step that is added.

    Parameters
    ----------
    path
        The file; an older one is replaced when the first step is added.
    rig
        The twin.
    """

    def __init__(self, path: Path, rig: VirtualRig) -> None:
        self._path = path
        self._rig = rig
        self._reference_position: float | None = None

    def add(self, step: int, position: float) -> None:
        """Write the truth of a step at a crosshead position [m]; steps left out stay NaN, and invalid."""
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
        """Write what belongs to the reference, and no step yet."""
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
    """Variables that change from step to step; the others are of the reference surface."""
    return [str(name) for name in truth.data_vars if name not in ("x", "y", "z", "lit")]
