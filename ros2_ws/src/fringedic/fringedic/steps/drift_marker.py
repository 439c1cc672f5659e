"""A rigid, textured marker on the frame, beside the specimen: its apparent motion is drift of the rig.

A projector that warms up, a camera that creeps in its clamp or a frame that bends moves everything in view, and nothing
on the specimen distinguishes this from the specimen's own motion. A marker that is fixed to the frame does: its
displacement against the reference step should be zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

COMPONENTS = ("u", "v", "w")
_MAPS = (*COMPONENTS, *(f"sigma_{name}" for name in COMPONENTS))
_LEAST_PART = 0.2  # of the marker that has to be measured


@dataclass(frozen=True)
class MarkerMotion:
    """Apparent motion of the drift marker since the reference step.

    Attributes
    ----------
    u, v, w
        Median displacement of its points [m]; NaN where too little of it is measured.
    sigma_u, sigma_v, sigma_w
        Median standard deviation of the displacement of one point [m].
    measured
        Part of its points that is measured, 0 to 1.
    reference_step
        The step that the displacement is measured against.
    """

    u: float
    v: float
    w: float
    sigma_u: float
    sigma_v: float
    sigma_w: float
    measured: float
    reference_step: int

    @property
    def moved(self) -> bool:
        """Whether it moved by more than the noise of one point, and is visible in the maps of the specimen."""
        return any(abs(getattr(self, name)) > getattr(self, f"sigma_{name}") for name in COMPONENTS)

    @property
    def lost(self) -> bool:
        """Whether too little of it is measured."""
        return self.measured < _LEAST_PART


def measure_drift(displacement: xr.Dataset, region: Sequence[int], reference_step: int = 0) -> MarkerMotion:
    """Measure the apparent motion of the drift marker.

    Parameters
    ----------
    displacement
        ``u``, ``v``, ``w``, ``sigma_u``, ``sigma_v``, ``sigma_w`` [m] over (row, column), NaN where not measured; its
        coordinates are pixels of the reference image.
    region
        First column, first row, width and height of the marker [px of the reference image].
    reference_step
        Step that the displacement is measured against.
    """
    column, row, width, height = region
    inside = {
        "row": np.flatnonzero((displacement.row.values >= row) & (displacement.row.values < row + height)),
        "column": np.flatnonzero(
            (displacement.column.values >= column) & (displacement.column.values < column + width)
        ),
    }
    maps = {name: displacement[name].isel(inside).values for name in _MAPS}
    known = np.isfinite(maps["u"]) & np.isfinite(maps["w"])
    measured = float(known.mean()) if known.size else 0.0
    values = dict.fromkeys(_MAPS, float("nan"))
    if measured >= _LEAST_PART:
        values = {name: float(np.median(each[known])) for name, each in maps.items()}
    return MarkerMotion(**values, measured=measured, reference_step=reference_step)


def drift_of_steps(dataset: xr.Dataset, region: Sequence[int]) -> dict[int, MarkerMotion]:
    """Return the apparent motion of the drift marker in every step of an experiment that has a 3D displacement.

    Parameters
    ----------
    dataset
        From `fringedic.open_experiment`.
    region
        As of `measure_drift`.
    """
    if any(name not in dataset for name in _MAPS):
        return {}
    found = {}
    for index, step in enumerate(dataset.step.values):
        one = dataset[list(_MAPS)].isel(step=index)
        if np.isfinite(one.u.values).any():
            reference = int(dataset["reference_step"].values[index]) if "reference_step" in dataset else 0
            found[int(step)] = measure_drift(one, region, reference)
    return found
