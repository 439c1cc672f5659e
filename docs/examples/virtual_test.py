"""A test on the virtual rig, measured by the step functions of the nodes, with the truth beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from fringedic.frames.collector import Stack
from fringedic.frames.records import FrameRecord
from fringedic.patterns.sequences import fringe_sequence
from fringedic.rig.model import RigModel
from fringedic.steps.displacement_tracker import DisplacementTracker
from fringedic.steps.parameters import DicParameters, PhaseParameters
from fringedic.steps.phase import phase_step
from fringedic.surface import PreparedShape, couple
from fringedic.virtual_rig import VirtualRig

PITCH = 10.0


@dataclass
class Measured:
    """One step: texture, displacement in the image, 3D displacement and the truth at the same points."""

    texture: np.ndarray
    displacement: xr.Dataset
    cloud: xr.Dataset
    truth: xr.Dataset

    def error(self, name: str) -> np.ndarray:
        """Measured minus true displacement [m] where both images see the surface."""
        seen = (self.truth.valid & self.truth.lit).values
        return np.where(seen, self.cloud[name].values - self.truth[name].values, np.nan)


def run(twin: VirtualRig, positions: Sequence[float], *, spacing: int = 4, z_filter: float = 2.0) -> list[Measured]:
    """Measure the steps at crosshead positions [m] against the first one."""
    rig = RigModel(**twin.optics())
    sequence = fringe_sequence(rig.projector_width, rig.projector_height, [800, 80, PITCH], [4, 4, 8])
    tracker = DisplacementTracker(DicParameters(spacing=spacing))
    reference: PreparedShape | None = None
    grid = slice(None, None, spacing)
    steps = []
    for step, position in enumerate(positions):
        frames = np.array([twin.expose(image, position, 100 * step + k) for k, image in enumerate(sequence)])
        records = [
            FrameRecord("example", step, k, len(frames), pattern, k, 0.01, 0)
            for k, pattern in enumerate(sequence.patterns)
        ]
        phase = phase_step(Stack("example", step, records, frames, step), PhaseParameters())
        displacement = tracker.step("example", step, step, phase.texture).field
        shape = PreparedShape(rig.reconstruct(phase.phase, PITCH, phase.sigma), z_filter=z_filter)
        reference = reference or shape
        cloud = couple(reference, shape, displacement, z_filter=z_filter)
        truth = twin.truth(position).isel(row=grid, column=grid)
        steps.append(Measured(phase.texture, displacement, cloud, truth))
    return steps


def rms(values: np.ndarray) -> float:
    """Root mean square of what is measured."""
    return float(np.sqrt(np.nanmean(np.square(values, dtype=float))))
