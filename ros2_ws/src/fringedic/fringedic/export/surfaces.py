"""Measured surfaces as meshes: a VTK series for ParaView, and PLY."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import xarray as xr

from fringedic.datasets.attributes import file_stem, map_names, origin_text, seconds, step_numbers
from fringedic.datasets.quantities import people_unit
from fringedic.errors import ExportError
from fringedic.evaluation.motion import in_space
from fringedic.export.tables import write_origin
from fringedic.wording.optional_packages import optional_import

MILLI = 1e-3
_POSITIONS, _MOTION = ("x", "y", "z"), ("u", "v", "w")
_VECTORS = {"displacement_mm": ("u", "v", "w"), "displacement_sigma_mm": ("sigma_u", "sigma_v", "sigma_w")}


def measured_surface(step: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return where a step has a surface, and the quadrilaterals between its points.

    Where a step has a displacement, only displaced points belong to the surface.

    Parameters
    ----------
    step
        One step of an experiment.

    Returns
    -------
    tuple
        A mask (row, column), and for each quadrilateral whose four corners are measured the numbers of its points,
        counted through the mask row by row; counterclockwise seen from the camera, shape (number, 4).

    Raises
    ------
    ExportError
        The step has no such surface.
    """
    absent = [name for name in _POSITIONS if name not in step]
    valid = np.ones((step.sizes["row"], step.sizes["column"]), bool)
    for name in () if absent else (*_POSITIONS, *(each for each in _MOTION if each in step)):
        valid &= np.isfinite(step[name].values)
    if absent or not valid.any():
        raise ExportError(f"step {int(step.step)} has no surface")
    number = np.cumsum(valid).reshape(valid.shape) - 1
    whole = valid[:-1, :-1] & valid[1:, :-1] & valid[1:, 1:] & valid[:-1, 1:]
    # rows run downwards: down, right, up is counterclockwise for somebody who looks against z
    corners = (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    return valid, np.stack([corner[whole] for corner in corners], axis=-1)


def _surfaces(dataset: xr.Dataset, skipped: list[str]) -> Iterator[tuple[xr.Dataset, np.ndarray, np.ndarray]]:
    """Iterate over steps with a surface, their `measured_surface`; the others are named in `skipped`."""
    for number in dataset["step"].values:
        step = in_space(dataset.sel(step=number))
        try:
            surface = measured_surface(step)
        except ExportError as error:
            skipped.append(str(error))
            continue
        yield step, *surface
    if len(skipped) == dataset.sizes["step"]:
        raise ExportError("no step has a surface to export; images alone need a scale: measure with --pixel-size-mm")


def _maps(step: xr.Dataset, names: Iterable[str], valid: np.ndarray) -> dict[str, np.ndarray]:
    """Return the measured values of maps, named with their unit."""
    units = {name: people_unit(step[name]) for name in names}
    return {
        f"{name}_{unit.identifier}": _float32(step[name].values[valid], unit.factor) for name, unit in units.items()
    }


def write_vtk(dataset: xr.Dataset, folder: Path) -> list[str]:
    """Write one ``.vtp`` per step and a ``.pvd`` that gives them their times; without times the numbers of the steps.

    The points are those of the reference surface [mm]; ``displacement_mm`` moves them (Warp By Vector, factor 1).

    Returns
    -------
    list of str
        What could not be written: steps without a surface.

    Raises
    ------
    ExportError
        No step has a surface.
    """
    with optional_import("paraview"):
        import pyvista
    folder.mkdir(parents=True)
    entries: list[str] = []
    skipped: list[str] = []
    text = origin_text(dataset)
    timed, numbers = "time" in dataset, dataset["step"].values.tolist()
    times = dict(zip(numbers, seconds(dataset) if timed else numbers, strict=True))
    names = [
        name for name in map_names(dataset) if name not in (*_POSITIONS, *_MOTION) and not name.startswith("shape_")
    ]
    for step, valid, quads in _surfaces(dataset, skipped):
        time = times[int(step.step)]
        points = np.stack([step[name].values[valid] for name in "xyz"], axis=-1) / MILLI
        faces = np.hstack([np.full((len(quads), 1), 4, quads.dtype), quads])
        mesh = pyvista.PolyData(points.astype(np.float32), faces=faces.ravel() if len(quads) else None)
        for name, components in _VECTORS.items():
            if all(component in step for component in components):
                vectors = np.stack([step[component].values[valid] for component in components], axis=-1) / MILLI
                mesh.point_data[name] = vectors.astype(np.float32)
        for name, values in _maps(step, names, valid).items():
            mesh.point_data[name] = values
        mesh.field_data["metadata"] = [text]
        if timed:
            mesh.field_data["TimeValue"] = np.array([time])
        for name, value in step_numbers(step).items():
            mesh.field_data[name] = np.array([value])
        name = f"step_{int(step.step):03d}.vtp"
        mesh.save(folder / name)
        entries.append(collection_entry(time, name))
    write_collection(folder / f"{file_stem(dataset)}.pvd", entries)
    return skipped


def collection_entry(time: float, name: str) -> str:
    """Return the line of a file of a VTK collection."""
    return f'    <DataSet timestep="{time:.9g}" part="0" file={quoteattr(name)}/>'


def write_collection(file: Path, entries: Iterable[str]) -> None:
    """Write a ``.pvd`` of the entries `collection_entry`."""
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">',
        "  <Collection>",
        *entries,
        "  </Collection>",
        "</VTKFile>",
    ]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_ply(dataset: xr.Dataset, folder: Path) -> list[str]:
    """Write the surface of each step where it has moved to [mm], with its displacement and strain at every point.

    ``metadata.json`` is beside them, because readers of PLY allow short comments only.

    Returns
    -------
    list of str
        What could not be written: steps without a surface.

    Raises
    ------
    ExportError
        No step has a surface.
    """
    folder.mkdir(parents=True)
    skipped: list[str] = []
    names = [name for name in map_names(dataset) if not name.startswith("shape_") and name not in "xyz"]
    for step, valid, quads in _surfaces(dataset, skipped):
        columns = {
            axis: _float32((step[axis] + step[moved] if moved in step else step[axis]).values[valid], MILLI)
            for axis, moved in zip("xyz", "uvw", strict=True)
        }
        columns |= _maps(step, names, valid)
        comments = ["units mm", *(f"{name} {value}" for name, value in step_numbers(step).items())]
        file = folder / f"step_{int(step.step):03d}.ply"
        header = ["ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)]
        header += [f"element vertex {len(columns['x'])}", *(f"property float {name}" for name in columns)]
        header += [f"element face {len(quads)}", "property list uchar int vertex_indices", "end_header"]
        vertices = np.stack(list(columns.values()), axis=-1).astype("<f4")
        faces = np.empty(len(quads), np.dtype([("count", "u1"), ("corners", "<i4", 4)]))
        faces["count"], faces["corners"] = 4, quads
        with open(file, "wb") as stream:
            stream.write(("\n".join(header) + "\n").encode("ascii"))
            stream.write(vertices.tobytes())
            stream.write(faces.tobytes())
    write_origin(dataset, folder)
    return skipped


def _float32(values: np.ndarray, unit: float) -> np.ndarray:
    return (values / unit).astype(np.float32)
