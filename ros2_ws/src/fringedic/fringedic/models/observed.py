"""Alignment of a model with one step of a dataset, by points that a person gives in the image."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.ndimage import binary_dilation, label

from fringedic.errors import ModelError
from fringedic.models.model import UNITS, Model
from fringedic.models.placement import Placement, PointPair, place_model
from fringedic.wording.arguments import Check, number, optional, several
from fringedic.wording.numbers import number_text

Pair = tuple[Sequence[float], Sequence[float]]
"""(column, row) [px of the reference image] of a point, and its (x, y, z) [m] in the frame of the model."""
Edge = tuple[Sequence[Sequence[float]], Sequence[Sequence[float]]]
"""Two (column, row) [px] on a straight edge, and two (x, y, z) [m] on the same edge of the model."""
_PLANE_POINTS = 9  # of the plane through a clicked point
_RIM_POINTS = 8  # around a hole
_PAIRS_WITH_A_LENGTH = 2  # whose distance shows a wrong unit
_LARGEST_RATIO = 20.0  # of the sizes of model and surface, of which one may contain a part of the other
_FARTHEST = 10  # spacings of a clicked point from the next measured one


class Features(NamedTuple):
    """What a person gives for the alignment; as of `fringedic.compare_model`."""

    pairs: Sequence[Pair] = ()
    pair_sigma: float | None = None
    holes: Sequence[Pair] = ()
    edges: Sequence[Edge] = ()
    principal_axes: bool = False


FEATURE_CHECKS: dict[str, Check] = {
    "pairs": several(several(several(number()), length=2)),
    "pair_sigma": optional(number(1e-9, 1.0)),
    "holes": several(several(several(number()), length=2)),
    "edges": several(several(several(several(number()), length=2), length=2)),
}


def place_on_step(
    step: xr.Dataset, names: Sequence[str], model: Model, features: Features, load: float | None
) -> Placement:
    """Align a model with the surface of a step, whose positions have three names, as `place_model` does."""
    surface = np.stack([step[name].values.astype(float) for name in names])
    distances = np.hypot(*(np.diff(surface[axis], axis=1) for axis in (0, 1)))
    spacing = float(np.nanmedian(distances)) if np.isfinite(distances).any() else np.nan
    if len(features.pairs) + len(features.holes) < _PAIRS_WITH_A_LENGTH:
        _require_size(surface, model)
    observed = [PointPair(_measured_at(step, surface, pair[0]), _three(pair[1])) for pair in features.pairs]
    for hole in features.holes:
        centre, sigma = _centre_of_hole(step, surface, hole[0])
        observed.append(PointPair(centre, _three(hole[1]), max(sigma, 0.01 * spacing)))
    for pixels, ends in features.edges:
        first, second = (_three(end) for end in ends)
        length = float(np.linalg.norm(np.subtract(second, first)))
        if not length > 0:
            raise ModelError(f"both points {first} of an edge of the model are the same; give two of them")
        along = _three((np.subtract(second, first) / length).tolist())
        observed += [PointPair(_measured_at(step, surface, each), first, None, along) for each in pixels]
    return place_model(
        surface,
        model,
        observed,
        spacing=spacing,
        pair_sigma=features.pair_sigma,
        load=load,
        start="principal axes" if features.principal_axes else "given",
    )


def _require_size(surface: np.ndarray, model: Model) -> None:
    """Refuse a model of quite another size than the surface: its unit is wrong. Two point pairs have a length instead.

    Raises
    ------
    ModelError
        The sizes differ too much.
    """
    points = surface[:, np.isfinite(surface).all(axis=0)]
    if not points.size or not np.ptp(points, axis=1).any():  # nothing measured, or one point, which has no size
        return
    seen, size = (
        2 * float(np.linalg.norm(each - each.mean(axis=1, keepdims=True), axis=0).max())
        for each in (points, model.nodes.T)
    )
    if seen / _LARGEST_RATIO < size < seen * _LARGEST_RATIO:
        return
    wanted = UNITS[model.unit] * seen / max(size, 1e-12)
    unit = min(UNITS, key=lambda each: abs(np.log(UNITS[each] / wanted)))
    raise ModelError(
        f"{model.name}: has a size of {number_text(1e3 * size)} mm with lengths in {model.unit}, the measured surface "
        f"{number_text(1e3 * seen)} mm: check the unit (--unit), perhaps {unit}; a model of this size needs two "
        "or more point pairs"
    )


def _centre_of_hole(
    step: xr.Dataset, surface: np.ndarray, at: Sequence[float]
) -> tuple[tuple[float, float, float], float]:
    """Return the centre of a round hole that contains a pixel, and its standard deviation.

    A circle is fitted to the measured points around the hole (Kasa 1976). They begin somewhat beside its edge, as far
    all around, which leaves the centre unchanged.
    """
    row, column = (
        int(np.argmin(np.abs(step[name].values - value))) for name, value in (("row", at[1]), ("column", at[0]))
    )
    known = np.isfinite(surface).all(axis=0)
    holes, _ = label(~known)
    hole = holes == holes[row, column]
    at_border = hole[[0, -1]].any() or hole[:, [0, -1]].any()
    rim = binary_dilation(hole, np.ones((3, 3), bool)) & known
    if known[row, column] or at_border or np.count_nonzero(rim) < _RIM_POINTS:
        raise ModelError(
            f"there is no hole at the point {tuple(at)} px (column, row): give a point where nothing is measured, with "
            "measured points all around"
        )
    points = surface[:, rim].T
    offsets = points - points.mean(axis=0)
    basis = np.column_stack([2 * offsets[:, :2], np.ones(len(offsets))])
    squares = np.sum(offsets[:, :2] ** 2, axis=1)
    found = np.linalg.lstsq(basis, squares, rcond=None)[0]
    radii = np.linalg.norm(offsets[:, :2] - found[:2], axis=1)
    plane = np.linalg.lstsq(np.column_stack([np.ones(len(offsets)), offsets[:, :2]]), offsets[:, 2], rcond=None)[0]
    centre = points.mean(axis=0) + np.array([*found[:2], plane @ [1.0, *found[:2]]])
    return _three(centre.tolist()), float(np.std(radii) * np.sqrt(2 / len(radii)))


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
            "undetermined": placement.undetermined.shape[1],
            "alternatives": placement.alternatives,
        }
    )
