"""A comparison with a model on the mesh of the model: a VTK series for ParaView."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import xarray as xr

from fringedic.datasets.attributes import file_stem, origin_text
from fringedic.datasets.quantities import people_unit
from fringedic.errors import ExportError
from fringedic.export.surfaces import MILLI, collection_entry, write_collection
from fringedic.wording.arguments import check_arguments, dataset, path
from fringedic.wording.causes import cause_of
from fringedic.wording.optional_packages import optional_import

_LOCATION = ("x", "y", "z", "triangles", "displacement_of_model")


@check_arguments(ExportError, mesh=dataset("x", "triangles", over=("step", "node")), folder=path)
def write_mesh(mesh: xr.Dataset, folder: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write one ``.vtp`` per step of a comparison on the mesh, and a ``.pvd`` that gives them the load as time.

    Parameters
    ----------
    mesh
        From `fringedic.models.on_mesh`.
    folder
        Made if it is missing.
    overwrite
        Replace an existing series.

    Returns
    -------
    Path
        The ``.pvd``. Points are in mm; ``displacement_of_model_mm`` moves them (Warp By Vector, factor 1).

    Raises
    ------
    ExportError
        The folder cannot be written, or contains such a series and `overwrite` is False.
    FringedicError
        The extra ``paraview`` is not installed.
    """
    with optional_import("paraview"):
        import pyvista
    folder = Path(folder)
    triangles = mesh["triangles"].values
    faces = np.hstack([np.full((len(triangles), 1), 3, triangles.dtype), triangles]).ravel()
    series = folder / f"{file_stem(mesh)}.pvd"
    if series.exists() and not overwrite:
        raise ExportError(f"{series} exists already; choose another folder or ask to overwrite it")
    entries = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for number in mesh["step"].values.tolist():
            step = mesh.sel(step=number)
            points = np.stack([step[axis].values for axis in "xyz"], axis=-1) / MILLI
            surface = pyvista.PolyData(points.astype(np.float32), faces=faces)
            surface.point_data["displacement_of_model_mm"] = step["displacement_of_model"].values / MILLI
            for name in map(str, step.data_vars):
                if name not in _LOCATION and step[name].dims == ("node",):
                    unit = people_unit(step[name])
                    surface.point_data[f"{name}_{unit.identifier}"] = step[name].values / unit.factor
            surface.field_data["metadata"] = [origin_text(mesh)]
            surface.save(folder / f"mesh_{number:03d}.vtp")
            entries.append(collection_entry(float(step["load_of_model"]), f"mesh_{number:03d}.vtp"))
        write_collection(series, entries)
    except OSError as error:
        raise ExportError(f"{folder}: cannot be written: {cause_of(error)}") from error
    return series
