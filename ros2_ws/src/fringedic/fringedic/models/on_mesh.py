"""A comparison at the nodes of the model, where a finite-element program shows its own fields."""

from __future__ import annotations

import json

import numpy as np
import xarray as xr

from fringedic.errors import ModelError
from fringedic.models.model import Model
from fringedic.models.sampling import facing, sample
from fringedic.wording.arguments import check_arguments, dataset, of_type

_PREFIXES = ("", "model_", "difference_", "sigma_difference_", "normalized_")


@check_arguments(
    ModelError,
    comparison=dataset("x", "y", "z", over=("step", "row", "column")),
    model=of_type(Model),
)
def on_mesh(comparison: xr.Dataset, model: Model) -> xr.Dataset:
    """Interpolate the maps of a comparison at the nodes of the model.

    Parameters
    ----------
    comparison, model
        From `compare_model`, and the model that it was made with.

    Returns
    -------
    Dataset
        Over (step, node), float32: ``x``, ``y``, ``z`` of the nodes in the rig frame [m],
        ``displacement_of_model`` (step, node, axis) [m], not filtered, and for each quantity the measured map, that of
        the model as it would be measured, their difference, its standard uncertainty and their ratio; NaN at nodes
        where nothing is measured, or that do not face the camera. ``triangles`` (triangle, corner) of nodes.

    Raises
    ------
    ModelError
        The comparison was not made by `compare_model`.

    Examples
    --------
    >>> mesh = on_mesh(comparison, model)  # doctest: +SKIP
    >>> fringedic.export.write_mesh(mesh, "plate-7/mesh")  # doctest: +SKIP
    """
    if "placement" not in comparison.attrs or "load_of_reference" not in comparison:
        raise ModelError("the dataset has no placement of a model; give the result of compare_model")
    found = [_on_mesh(comparison.sel(step=number), model) for number in comparison["step"].values]
    joined = xr.concat(found, "step", data_vars="all").assign_coords(step=comparison["step"].values)
    joined["triangles"] = (("triangle", "corner"), model.triangles)
    return joined.assign_attrs(comparison.attrs)


def _on_mesh(step: xr.Dataset, model: Model) -> xr.Dataset:
    placement = json.loads(step.attrs["placement"])
    rotation, translation = np.array(placement["rotation"]), np.array(placement["translation"])
    before, after = (model.displacement_at(float(step[name])) for name in ("load_of_reference", "load_of_model"))
    nodes = (model.nodes + before) @ rotation.T + translation
    triangles = facing(nodes, model.triangles) if model.closed else model.triangles
    seen = np.zeros(len(nodes), bool)
    seen[triangles] = True
    names = [f"{prefix}{name}" for name in step["quantity"].values.tolist() for prefix in _PREFIXES]
    values = np.full((len(nodes), len(names)), np.nan)
    surface = np.stack([step[axis].values.astype(float) for axis in "xyz"])
    known = np.isfinite(surface).all(axis=0)
    number = np.where(known, np.cumsum(known).reshape(known.shape) - 1, -1)
    corners = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    halves = [np.stack([corners[i].ravel() for i in half], axis=-1) for half in ((0, 1, 2), (0, 2, 3))]
    cells = np.vstack(halves)
    points, cells = surface[:, known].T, cells[(cells >= 0).all(axis=1)]
    if len(cells) and seen.any():
        maps = np.stack([step[name].values[known] for name in names], axis=-1)
        values[seen] = sample(points, cells, nodes[seen]).interpolate(maps)
    fields: dict[str, object] = {
        name: ("node", column.astype(np.float32), step[name].attrs)
        for name, column in zip(names, values.T, strict=True)
    }
    fields |= {
        axis: ("node", column.astype(np.float32), {"units": "m"}) for axis, column in zip("xyz", nodes.T, strict=True)
    }
    motion = ((after - before) @ rotation.T).astype(np.float32)
    fields["displacement_of_model"] = (("node", "axis"), motion, {"units": "m"})
    fields["load_of_model"] = ((), float(step["load_of_model"]), {})
    return xr.Dataset(fields)
