"""Finite-element models and nominal shapes: the surface of a mesh, and the displacement of its nodes at each load."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fringedic.errors import ModelError
from fringedic.models.results_table import DISPLACEMENT, NodalResults, find_columns, node_labels, read_results
from fringedic.wording.arguments import check_arguments, number, one_of, optional, path, several, text, whole
from fringedic.wording.causes import cause_of
from fringedic.wording.numbers import counted
from fringedic.wording.optional_packages import optional_import

if TYPE_CHECKING:
    import pyvista

UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "inch": 25.4e-3}
_LARGEST_FILE = 2**30  # byte; its surface is far smaller
_VTK_SUFFIXES = {".vtk", ".vtu", ".vtp", ".stl", ".ply", ".obj"}
_EXODUS_SUFFIXES = {".e", ".ex2", ".exo", ".exii"}
_SERIES_SUFFIXES = {".pvd"} | _EXODUS_SUFFIXES
_MESHIO_SUFFIXES = {".inp", ".msh", ".bdf", ".nas", ".med", ".xdmf"}
_PREFIX, _STRAIN_PREFIX = "displacement at load ", "strain at load "


@dataclass(frozen=True)
class Model:
    """The surface of a mesh and its motion.

    Attributes
    ----------
    name
        Of its file.
    nodes : (node, 3)
        Positions without load [m], in the frame of the model.
    triangles : (triangle, 3)
        Numbers of their nodes.
    closed
        Whether the triangles enclose a volume, counterclockwise seen from outside. Of a closed surface only the side
        towards the camera is compared.
    loads : (load,)
        Force [N] or crosshead position [m] of each load, increasing; empty for a nominal shape.
    displacement : (load, node, 3)
        Displacement of the nodes [m].
    strain : (load, node, 6)
        Strain at the nodes [1]: xx, yy, zz, xy, yz, xz, tensor shear; empty (0, node, 6) if it is to follow from the
        displacement.
    unit
        Unit of lengths in the file.
    """

    name: str
    nodes: np.ndarray
    triangles: np.ndarray
    closed: bool
    loads: np.ndarray
    displacement: np.ndarray
    strain: np.ndarray = field(default_factory=lambda: np.empty((0, 0, 6)))
    unit: str = "m"

    def strain_at(self, load: float) -> np.ndarray:
        """Return the strain at the nodes (node, 6) [1] at a load, as `displacement_at`."""
        return self._at(load, self.strain)

    def displacement_at(self, load: float) -> np.ndarray:
        """Return the displacement of the nodes (node, 3) [m] at a load, linear between the loads of the model.

        Raises
        ------
        ModelError
            The load is outside the loads of the model.
        """
        return self._at(load, self.displacement)

    def _at(self, load: float, values: np.ndarray) -> np.ndarray:
        if not self.covers(load):
            raise ModelError(
                f"{self.name}: the load {load:g} is outside the model's loads, {self.loads[0]:g} to "
                f"{self.loads[-1]:g}; compute this load step, or choose other steps"
            )
        place = float(np.interp(load, self.loads, np.arange(len(self.loads))))
        first = min(int(place), len(self.loads) - 2)
        return np.asarray((first + 1 - place) * values[first] + (place - first) * values[first + 1])

    def covers(self, load: float) -> bool:
        """Return whether a load is within the loads of the model, up to 0.1 % of their range."""
        tolerance = 1e-3 * float(np.ptp(self.loads))
        return bool(self.loads[0] - tolerance <= load <= self.loads[-1] + tolerance)


@check_arguments(
    ModelError,
    file=path,
    unit=one_of(*UNITS),
    displacement=optional(text),
    strain=optional(text),
    results=several(path),
    loads=optional(several(number(), least=1)),
    model_step=optional(whole(1)),
)
def read_model(
    file: str | os.PathLike[str],
    *,
    unit: str,
    displacement: str | None = None,
    strain: str | None = None,
    results: Sequence[str | os.PathLike[str]] = (),
    loads: Sequence[float] | None = None,
    times_are_loads: bool = False,
    model_step: int | None = None,
) -> Model:
    """Read a mesh of surface or volume elements with the displacement of its nodes.

    Elements with nodes on their edges (quadratic ones) are divided there, so that all nodes are used. A model without
    load at the load 0 is added if the loads of the file start above 0.

    Parameters
    ----------
    file
        Mesh: VTK, VTU, VTP, STL, PLY or OBJ; Abaqus ``.inp``, gmsh ``.msh``, Nastran, MED or XDMF; a ``.pvd``, whose
        files are the load steps; or Exodus (``.e``, ``.ex2``, ``.exo``), whose times are the load steps.
    unit
        Of lengths and displacements in the file: ``"m"``, ``"mm"``, ``"um"`` or ``"inch"``. A mesh does not contain it.
    displacement
        Name of the field of displacement vectors at the nodes, or the names of two or three scalar fields, such as
        ``"ux,uy"``; by default the only vector field, or scalar fields with usual names (``ux``, ``U1``, ``u``,
        ``displacement_x`` ...). A third component that is missing, or NaN at all nodes, is 0. A file without a
        displacement is a nominal shape.
    strain
        Name of a field of strain at the nodes: 6 components xx, yy, zz, xy, yz, xz with the tensor shear, or all 9. By
        default the strain is computed from the displacement, as the measured one is.
    results
        CSV tables with displacement and perhaps strain of the nodes of an Abaqus ``.inp``, one for each load step: a
        column of node labels, ``U1``, ``U2``, ``U3``, and ``E11``, ``E22``, ``E12`` ... with the engineering shear.
    loads
        Force [N] or crosshead position [m] of each load step of the file; by default the times of a ``.pvd``.
    times_are_loads
        The times of an Exodus file are its loads [N or m], as those of a ``.pvd`` are.
    model_step
        Only this load step of the file, counted from 1.

    Returns
    -------
    Model
        In metres.

    Raises
    ------
    ModelError
        The file cannot be read, is larger than 1 GB, or contains no surface, nodes that are NaN, or not the
        displacement; the number of loads is not that of its load steps, or a load occurs twice.
    FringedicError
        The extra ``models`` is not installed.

    Examples
    --------
    >>> model = read_model("plate.vtu", unit="mm", loads=[1000.0])  # doctest: +SKIP
    >>> model.loads  # doctest: +SKIP
    array([   0., 1000.])
    """
    source = Path(file)
    require_readable(source)
    if results and source.suffix.lower() != ".inp":
        raise ModelError(f"{source.name}: tables of results belong to an Abaqus .inp; leave them out")
    meshes = _load_steps(source) if source.suffix.lower() in _SERIES_SUFFIXES else {0.0: _read_mesh(source)}
    if results:
        fields = _tables(source, next(iter(meshes.values())), [Path(each) for each in results])
    else:
        found = [_field_results(mesh, displacement, strain, source.name) for mesh in meshes.values()]
        fields = [each for each in found if each is not None]
    times = list(meshes)
    if model_step is not None:
        if model_step > len(fields):
            raise ModelError(f"{source.name}: has no load step {model_step}, it has {len(fields)}; choose one of them")
        fields, times = fields[model_step - 1 : model_step], times[model_step - 1 : model_step]
    given = (times if loads is None else loads) if fields else []
    if fields and loads is None and source.suffix.lower() != ".pvd" and not times_are_loads:
        raise ModelError(
            f"{source.name}: the load of its displacement is unknown, it has {counted(len(fields), 'load step')}: give "
            "the load of each (--load in N or mm; in Python loads=[...] in N or m)"
        )
    if len(given) != len(fields) or len(set(given)) != len(given):
        raise ModelError(
            f"{source.name}: has {counted(len(fields), 'load step')} with a displacement, and {len(set(given))} "
            "different loads are given: give one load for each (--load; in Python loads), or choose a step of the file "
            "(--model-step, model_step)"
        )
    first = next(iter(meshes.values()))
    return _model(source.name, first, dict(zip(given, fields, strict=True)), unit)


def require_readable(source: Path) -> None:
    """Check that a model can be read, as far as its name and size show.

    Raises
    ------
    ModelError
        It cannot.
    """
    if not source.is_file():
        raise ModelError(f"{source}: no such model file; give a mesh such as model.vtu")
    if source.stat().st_size > _LARGEST_FILE:
        raise ModelError(
            f"{source.name}: has {source.stat().st_size / 1e9:.1f} GB, the limit is 1.1 GB: export only the surface of "
            "the part, or fewer fields"
        )
    suffix = source.suffix.lower()
    known = _VTK_SUFFIXES | _MESHIO_SUFFIXES | _SERIES_SUFFIXES
    if suffix not in known:
        raise ModelError(
            f"{source.name}: {suffix or 'a file without suffix'} is not read; convert it to one of "
            f"{', '.join(sorted(known))}"
        )


@contextmanager
def _damage_named(source: Path) -> Iterator[None]:
    """Raise ModelError for everything that readers of foreign formats raise; one of them ends the process."""
    try:
        yield
    except ModelError:
        raise
    except (Exception, SystemExit) as error:
        cause = cause_of(error)
        raise ModelError(
            f"{source.name}: cannot be read as a mesh ({cause}); write it again, for example as .vtu"
        ) from error


def _read_mesh(source: Path) -> pyvista.DataSet:
    with optional_import("models"):
        import meshio  # type: ignore[import-untyped]
        import pyvista

        from fringedic.models.legacy_vtk import read_legacy
    suffix = source.suffix.lower()
    with _damage_named(source):
        if suffix == ".vtk":
            return read_legacy(source)
        mesh = pyvista.read(source) if suffix in _VTK_SUFFIXES else pyvista.from_meshio(meshio.read(source))
    return mesh


def _load_steps(source: Path) -> dict[float, pyvista.UnstructuredGrid]:
    """Return the meshes of a series by their times."""
    with optional_import("models"):
        import pyvista
    with _damage_named(source):
        exodus = source.suffix.lower() in _EXODUS_SUFFIXES
        reader = (pyvista.ExodusIIReader if exodus else pyvista.PVDReader)(source)
        meshes = {time: _at_time(reader, time, exodus) for time in map(float, reader.time_values)}
    if not meshes:
        raise ModelError(f"{source.name}: contains no load step or is damaged; write it again, or as .vtu")
    if len({mesh.n_points for mesh in meshes.values()}) != 1:
        raise ModelError(f"{source.name}: its files have different numbers of nodes; write one mesh for all load steps")
    return meshes


def _at_time(reader: Any, time: float, exodus: bool) -> pyvista.UnstructuredGrid:
    """Return the elements at a time of a series; of an Exodus file where they are without displacement."""
    import pyvista

    if exodus:
        reader.reader.SetApplyDisplacements(False)
    reader.set_active_time_value(time)
    blocks: pyvista.MultiBlock = reader.read()
    elements = blocks["Element Blocks"] if exodus else blocks  # not the sets of sides and nodes
    assert isinstance(elements, pyvista.MultiBlock)
    grid: pyvista.UnstructuredGrid = elements.combine()
    return grid


def _tables(source: Path, mesh: pyvista.DataSet, files: Sequence[Path]) -> list[NodalResults]:
    """Return the results of the load steps of an Abaqus input file."""
    labels = node_labels(source)
    if len(labels) != mesh.n_points:
        raise ModelError(
            f"{source.name}: lists {len(labels)} nodes and its mesh has {mesh.n_points}; write a flat input file "
            "without parts and includes"
        )
    return [read_results(file, labels) for file in files]


def _field_results(
    mesh: pyvista.DataSet, displacement: str | None, strain: str | None, source: str
) -> NodalResults | None:
    """Return the fields of a mesh; None for a mesh without vectors that names none."""
    moved = _displacement(mesh, displacement, source)
    return None if moved is None else NodalResults(moved, None if strain is None else _strain(mesh, strain, source))


def _strain(mesh: pyvista.DataSet, name: str, source: str) -> np.ndarray:
    values = np.asarray(mesh.point_data[name], float) if name in mesh.point_data else np.empty((0, 0))
    components = values.shape[1] if values.ndim == 2 else 1
    if components not in (6, 9):
        raise ModelError(
            f"{source}: has no strain {name!r} with 6 or 9 components at its nodes, it has "
            f"{', '.join(mesh.point_data) or 'no field'}; export it at the nodes, or leave it out"
        )
    return values[:, [0, 4, 8, 1, 5, 2]] if components == 9 else values


def _displacement(mesh: pyvista.DataSet, name: str | None, source: str) -> np.ndarray | None:
    """Return the vectors (node, 3) of the displacement; None for a mesh without a displacement that names none."""
    fields = {each: np.asarray(mesh.point_data[each]) for each in mesh.point_data}
    scalars = [each for each, values in fields.items() if values.ndim == 1]
    vectors = [each for each, values in fields.items() if values.ndim == 2 and values.shape[1] <= 3]
    if name is None:
        others = {mesh.point_data.active_normals_name, mesh.point_data.active_texture_coordinates_name}
        chosen = [each for each in vectors if each not in others]
        if len(chosen) > 1:
            raise ModelError(
                f"{source}: has the vector fields {', '.join(chosen)}; name the one of the displacement "
                "(--displacement)"
            )
        if not chosen:
            components = find_columns(scalars, DISPLACEMENT)
            if {0, 1} - components.keys():
                return None
            chosen = [scalars[place] for place in components.values()]
    elif name in vectors:
        chosen = [name]
    else:
        chosen = [each.strip() for each in name.split(",")]
        if len(chosen) not in (2, 3) or set(chosen) - set(scalars):
            raise ModelError(
                f"{source}: has no vectors {name!r} at its nodes, it has {', '.join([*vectors, *scalars]) or 'none'}; "
                "export the displacement at the nodes, or name a vector field or two scalar fields, such as ux,uy "
                "(--displacement)"
            )
    field = np.column_stack([fields[each] for each in chosen]).astype(float)
    if field.shape[1] not in (2, 3):
        raise ModelError(f"{source}: {chosen[0]} has {field.shape[1]} components; a displacement has 3")
    return np.pad(field, ((0, 0), (0, 3 - field.shape[1])))


def _model(name: str, mesh: pyvista.DataSet, fields: dict[float, NodalResults], unit: str) -> Model:
    """Return the model of a mesh with results by load; fields move with the nodes to the surface."""
    scale = UNITS[unit]
    for load, results in fields.items():
        plane = np.isnan(results.displacement[:, 2]).all()  # written by a plane model
        mesh.point_data[f"{_PREFIX}{load}"] = np.where([False, False, plane], 0.0, results.displacement)
        if results.strain is not None:
            mesh.point_data[f"{_STRAIN_PREFIX}{load}"] = results.strain
    surface = _surface(name, mesh)
    nodes, triangles = scale * np.asarray(surface.points, float), surface.regular_faces.astype(np.int64)
    moved = {load: scale * np.asarray(surface.point_data[f"{_PREFIX}{load}"], float) for load in sorted(fields)}
    strained = {
        load: np.asarray(surface.point_data[f"{_STRAIN_PREFIX}{load}"], float)
        for load in sorted(fields)
        if fields[load].strain is not None
    }
    if strained and len(strained) < len(moved):
        raise ModelError(f"{name}: has a strain at {len(strained)} of {len(moved)} load steps; export it for all")
    missing = sum(
        int(np.count_nonzero(~np.isfinite(each).all(axis=1))) for each in (nodes, *moved.values(), *strained.values())
    )
    if missing:
        raise ModelError(f"{name}: {missing} nodes have a position or result that is not finite; compute it again")
    if moved and min(moved) > 0:  # from the state without load
        moved = {0.0: np.zeros_like(nodes), **moved}
        strained = {0.0: np.zeros((len(nodes), 6)), **strained} if strained else {}
    elif len(moved) == 1:
        raise ModelError(f"{name}: one load step at {min(moved):g} cannot be interpolated; add a load step beyond it")
    closed = surface.n_open_edges == 0
    if closed and _volume(nodes, triangles) < 0:
        triangles = triangles[:, ::-1]
    displacement = np.array(list(moved.values())) if moved else np.empty((0, *nodes.shape))
    strain = np.array(list(strained.values())) if strained else np.empty((0, len(nodes), 6))
    loads = np.array(list(moved), float)
    return Model(name, nodes, np.ascontiguousarray(triangles), closed, loads, displacement, strain, unit)


def _surface(name: str, mesh: pyvista.DataSet) -> pyvista.PolyData:
    """Return the triangles of the surface; of a mesh with volume elements without its separate surface elements."""
    import pyvista

    grid = mesh.cast_to_unstructured_grid()
    _, examples, kinds = np.unique(grid.celltypes, return_index=True, return_inverse=True)
    dimensions = np.array([grid.get_cell(index).dimension for index in examples.tolist()], int)[kinds]
    if not dimensions.size or dimensions.max() < 2:
        raise ModelError(f"{name}: contains no surface and no volume elements; export the mesh of the part")
    grid = grid.extract_cells(dimensions == dimensions.max())
    surface = grid.extract_surface(nonlinear_subdivision=1, algorithm="dataset_surface").triangulate()
    cleaned = surface.clean()
    assert isinstance(cleaned, pyvista.PolyData)
    return cleaned


def _volume(nodes: np.ndarray, triangles: np.ndarray) -> float:
    first, second, third = (nodes[triangles[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->", first, np.cross(second, third)) / 6)
