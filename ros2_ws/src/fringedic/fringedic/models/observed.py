"""Alignment of a model with one step of a dataset, by points that a person gives in the image."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
import xarray as xr

from fringedic.errors import ModelError
from fringedic.models.model import Model
from fringedic.models.placement import Placement, PointPair, place_model

Pair = tuple[Sequence[float], Sequence[float]]
"""(column, row) [px of the reference image] of a point, and its (x, y, z) [m] in the frame of the model."""
_PLANE_POINTS = 9  # of the plane through a clicked point
_FARTHEST = 10  # spacings of a clicked point from the next measured one


def place_on_step(
    step: xr.Dataset,
    names: Sequence[str],
    model: Model,
    pairs: Sequence[Pair],
    pair_sigma: float | None,
    load: float | None,
) -> Placement:
    """Align a model with the surface of a step, whose positions have three names, as `place_model` does."""
    surface = np.stack([step[name].values.astype(float) for name in names])
    distances = np.hypot(*(np.diff(surface[axis], axis=1) for axis in (0, 1)))
    measured = [PointPair(_measured_at(step, surface, pair[0]), _three(pair[1])) for pair in pairs]
    spacing = float(np.nanmedian(distances)) if np.isfinite(distances).any() else np.nan
    return place_model(surface, model, measured, spacing=spacing, pair_sigma=pair_sigma, load=load)


def _three(position: Sequence[float]) -> tuple[float, float, float]:
    if len(position) != 3:
        raise ModelError(
            f"the point {tuple(position)} of the model has {len(position)} coordinates; it needs (x, y, z) in m"
        )
    return float(position[0]), float(position[1]), float(position[2])


def _measured_at(step: xr.Dataset, surface: np.ndarray, at: Sequence[float]) -> tuple[float, float, float]:
    """Return the position in space of a pixel: of the plane through the nearest measured points."""
    row, column = np.meshgrid(step["row"].values, step["column"].values, indexing="ij")
    known = np.isfinite(surface).all(axis=0)
    offset = np.stack([column[known] - at[0], row[known] - at[1]])
    distance = np.hypot(*offset)
    near = np.argsort(distance)[:_PLANE_POINTS]
    spacing = abs(float(step["column"][1] - step["column"][0]))
    if len(near) < _PLANE_POINTS or distance[near[0]] > _FARTHEST * spacing:
        raise ModelError(f"nothing is measured near the point {tuple(at)} px (column, row); choose another point pair")
    basis = np.column_stack([np.ones(_PLANE_POINTS), *offset[:, near]])
    found = np.linalg.lstsq(basis, surface[:, known][:, near].T, rcond=None)[0][0]
    return _three(found.tolist())


def placement_text(placement: Placement) -> str:
    """Return the rigid transformation and its uncertainty as JSON."""
    free = None if placement.free is None else placement.free.__dict__
    return json.dumps(
        {
            "rotation": placement.rotation.tolist(),
            "translation": placement.translation.tolist(),
            "centre": placement.centre.tolist(),
            "sigma_translation": np.sqrt(np.diag(placement.covariance)[:3]).tolist(),
            "sigma_rotation": np.sqrt(np.diag(placement.covariance)[3:]).tolist(),
            "residual": placement.residual,
            "points": placement.used,
            "free": free,
        }
    )
