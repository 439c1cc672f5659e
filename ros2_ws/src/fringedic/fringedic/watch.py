"""A part of the image that stands still during a test, a marker on the frame: what moves there is the rig.

A projector that warms up, a camera that creeps in its clamp or a frame that bends move everything that is seen, and
nothing on the specimen tells it from the specimen's own motion. A rigid, textured marker beside it, fixed to the frame,
does: its displacement against the reference step should be zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

_NAMES = {"u": "to the right", "v": "upwards", "w": "towards the camera"}
_MAPS = (*_NAMES, *(f"sigma_{name}" for name in _NAMES))
_LEAST_PART = 0.2  # of the region that has to be measured


@dataclass(frozen=True)
class WatchedMotion:
    """How far the watched region seems to have moved since the reference step.

    Attributes
    ----------
    u, v, w
        Median displacement of its points [m]; NaN where too little of it is measured.
    sigma_u, sigma_v, sigma_w
        Median standard deviation of the displacement of one point [m].
    measured
        Part of its points that is measured, 0 to 1.
    reference_step
        The step it is measured against.
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
        """Whether it moved by more than the noise of one point: not to be overlooked in the maps of the specimen."""
        return any(abs(getattr(self, name)) > getattr(self, f"sigma_{name}") for name in _NAMES)

    @property
    def lost(self) -> bool:
        """Whether too little of it is measured to say anything."""
        return self.measured < _LEAST_PART

    @property
    def words(self) -> str:
        """What is to be said of it; empty when it stood still."""
        if self.lost:
            return (
                f"only {100 * self.measured:.0f} % of the watched region is measured: whether the rig drifts is not "
                "known; give it a texture, light, and a margin of one window"
            )
        if not self.moved:
            return ""
        motion = ", ".join(f"{name} {1e6 * getattr(self, name):+.2g} µm" for name in _NAMES)
        noise = ", ".join(f"{1e6 * getattr(self, f'sigma_{name}'):.2g}" for name in _NAMES)
        return (
            f"the watched region, which should stand still, has moved since step {self.reference_step} by {motion} "
            f"(noise of one point: {noise} µm): the rig drifts, the projector is warming up, or the frame gives way"
        )


def watched_motion(
    displacement: Mapping[str, np.ndarray],
    region: Sequence[int],
    *,
    spacing: int = 1,
    origin: tuple[int, int] = (0, 0),
    reference_step: int = 0,
) -> WatchedMotion:
    """Measure the motion of a region that should stand still.

    Parameters
    ----------
    displacement
        ``u``, ``v``, ``w``, ``sigma_u``, ``sigma_v``, ``sigma_w`` [m], (row, column), NaN where not measured.
    region
        First column, first row, width and height [px of the reference image].
    spacing, origin
        Distance of the points [px], and (row, column) of the first one.
    reference_step
        Step that the displacement is measured against.
    """
    column, row, width, height = region
    rows, columns = (
        slice(max(-(-(first - start) // spacing), 0), max(-(-(first + size - start) // spacing), 0))
        for first, size, start in ((row, height, origin[0]), (column, width, origin[1]))
    )
    inside = {name: np.asarray(displacement[name])[rows, columns] for name in _MAPS}
    known = np.isfinite(inside["u"]) & np.isfinite(inside["w"])
    measured = float(known.mean()) if known.size else 0.0
    if measured < _LEAST_PART:
        values = dict.fromkeys(inside, float("nan"))
    else:
        values = {name: float(np.median(each[known])) for name, each in inside.items()}
    return WatchedMotion(**values, measured=measured, reference_step=reference_step)


def watched_steps(dataset: xr.Dataset, region: Sequence[int]) -> dict[int, WatchedMotion]:
    """Return the same for every step of a recorded experiment that has a 3D displacement, by step.

    Parameters
    ----------
    dataset
        From `fringedic.open_experiment`.
    region
        As of `watched_motion`.
    """
    if any(name not in dataset for name in _MAPS):
        return {}
    column, row, width, height = region
    inside = (
        (dataset.row >= row) & (dataset.row < row + height),
        (dataset.column >= column) & (dataset.column < column + width),
    )
    part = dataset[list(_MAPS)].isel(row=np.flatnonzero(inside[0]), column=np.flatnonzero(inside[1]))
    found = {}
    for index, step in enumerate(dataset.step.values):
        values = {name: part[name].isel(step=index).values for name in _MAPS}
        if np.isfinite(dataset["u"].isel(step=index).values).any():
            reference = int(dataset["reference_step"].values[index]) if "reference_step" in dataset else 0
            whole = (0, 0, part.sizes["column"], part.sizes["row"])
            found[int(step)] = watched_motion(values, whole, reference_step=reference)
    return found
