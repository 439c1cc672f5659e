"""The subcommands that compare a measurement with a model or with another one, without ROS."""

from __future__ import annotations

import math
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fringedic.command.app import RESULTS, Overwrite, Sensor, Source, Sources, app, output_file, refuse_unused, say
from fringedic.errors import ConfigurationError

if TYPE_CHECKING:
    from fringedic.models.observed import Edge, Pair

_MILLI = 1e-3
_OF_THE_DISPLACEMENT = {  # options
    *("by", "by_displacement", "remove_rigid_motion", "reference_image", "results", "strain", "load_table"),
}


@app.command(
    "compare-model",
    rich_help_panel=RESULTS,
    epilog="Example: fringedic compare-model recordings/plate-7/bag plate.vtu --unit mm --load 1000",
)
def compare_model(  # noqa: PLR0913 (options of a command)
    context: typer.Context,
    source: Source,
    model: Annotated[
        Path, typer.Argument(metavar="MODEL", help="Mesh with nodal displacement: VTU, VTK, PVD, gmsh, Nastran ...")
    ],
    unit: Annotated[str, typer.Option(help="Of lengths in the mesh: m, mm, um or inch.")],
    sensor: Sensor = None,
    load: Annotated[
        list[float] | None,
        typer.Option(help="Force in N of each load step of the mesh, or crosshead position in mm; may be repeated."),
    ] = None,
    by: Annotated[
        str, typer.Option(help="What the loads of the mesh are: force, position, or another signal.")
    ] = "force",
    times_are_loads: Annotated[
        bool, typer.Option("--times-are-loads", help="The times of an Exodus file are its loads, in N or m.")
    ] = False,
    model_step: Annotated[
        int | None, typer.Option(min=1, help="Only this load step of the mesh, counted from 1.")
    ] = None,
    displacement: Annotated[
        str | None,
        typer.Option(help="Name of the displacement in the mesh, or of its scalar components, such as ux,uy."),
    ] = None,
    pair: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COLUMN,ROW=X,Y,Z",
            help="A point of the reference image in px and of the mesh in its unit; three or more align the mesh.",
        ),
    ] = None,
    hole: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COLUMN,ROW=X,Y,Z",
            help="A pixel in a round hole, and the centre of the hole in the mesh; may be repeated.",
        ),
    ] = None,
    edge: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COLUMN,ROW;COLUMN,ROW=X,Y,Z;X,Y,Z",
            help="Two pixels on a straight edge, and two points of this edge in the mesh; may be repeated.",
        ),
    ] = None,
    principal_axes: Annotated[
        bool, typer.Option("--principal-axes", help="Start from the principal axes of mesh and surface.")
    ] = False,
    by_displacement: Annotated[
        bool,
        typer.Option("--by-displacement", help="Fit directions that nothing else determines to the displacement."),
    ] = False,
    remove_rigid_motion: Annotated[
        bool,
        typer.Option("--remove-rigid-motion", help="Remove the motion of the specimen as a whole from the difference."),
    ] = False,
    reference_image: Annotated[
        Path | None,
        typer.Option(help="Image of the reference without fringes: the model is rendered with it and measured."),
    ] = None,
    results: Annotated[
        list[Path] | None,
        typer.Option(help="CSV with the results of a load step at the nodes of an Abaqus .inp; may be repeated."),
    ] = None,
    strain: Annotated[
        str | None, typer.Option(help="Name of the strain at the nodes; by default it follows from the displacement.")
    ] = None,
    load_table: Annotated[
        Path | None,
        typer.Option(help="CSV with the columns step and load (N, or mm by position) instead of the recorded loads."),
    ] = None,
    shape: Annotated[
        bool, typer.Option("--shape", help="Compare the shape alone with a nominal one, such as an STL.")
    ] = False,
    pair_sigma_mm: Annotated[
        float | None,
        typer.Option(help="Standard uncertainty of each coordinate of the pairs; by default one point spacing."),
    ] = None,
    steps: Annotated[list[int] | None, typer.Option("--step", help="Only this step; may be repeated.")] = None,
    output: Annotated[Path, typer.Option(help="Folder for page, dataset and VTK files.")] = Path("compared"),
    overwrite: Overwrite = False,
) -> None:
    """Compare displacement and strain with a finite-element model, or the shape; write page, dataset and VTK files."""
    if shape:
        reason = "--shape compares the shape alone; leave out either --shape or what belongs to the displacement"
        refuse_unused(context, _OF_THE_DISPLACEMENT, reason)
    page = output_file(output / "comparison.html", overwrite)
    # what the options alone show to be wrong is told before anything is read
    from fringedic.models.model import UNITS, require_readable

    if unit not in UNITS:
        raise ConfigurationError(f"--unit {unit}: give one of {', '.join(UNITS)}")
    scale = _MILLI if by == "position" else 1.0
    loads = None if load_table is None else _load_table(load_table, scale)
    pairs, holes = (_pairs(name, texts or [], UNITS[unit]) for name, texts in (("pair", pair), ("hole", hole)))
    edges = _edges(edge or [], UNITS[unit])
    only = _only(steps) if shape else None
    require_readable(model)
    from fringedic.datasets import open_experiment
    from fringedic.export import export_dataset, write_mesh
    from fringedic.frames.files import read_grey
    from fringedic.models import compare_model as compare
    from fringedic.models import compare_shape, on_mesh, read_model
    from fringedic.models.observed import Features
    from fringedic.models.sentences import (
        agreement_sentences,
        left_out_sentences,
        placement_sentences,
        shape_sentences,
    )
    from fringedic.report.model_comparison import write_model_comparison, write_shape_comparison

    of_mesh = None if load is None else [scale * each for each in load]
    if shape and of_mesh is None:
        of_mesh = [1.0]  # a displacement of the mesh is not used, whatever its load
    features = Features(
        pairs=pairs,
        holes=holes,
        edges=edges,
        pair_sigma=None if pair_sigma_mm is None else _MILLI * pair_sigma_mm,
        principal_axes=principal_axes,
    )._asdict()
    mesh = read_model(
        model,
        unit=unit,
        displacement=displacement,
        strain=strain,
        results=results or [],
        loads=of_mesh,
        times_are_loads=times_are_loads,
        model_step=model_step,
    )
    with open_experiment(source, sensor=sensor) as experiment:
        if shape:
            comparison = compare_shape(experiment, mesh, step=only, **features)
        else:
            comparison = compare(
                experiment,
                mesh,
                by_displacement=by_displacement,
                reference_image=None if reference_image is None else read_grey(reference_image),
                remove_rigid_motion=remove_rigid_motion,
                steps=steps or None,
                by=by,
                load_table=loads,
                **features,
            )
    output.mkdir(parents=True, exist_ok=True)
    sentences = shape_sentences(comparison) if shape else agreement_sentences(comparison.isel(step=-1))
    say(*left_out_sentences(comparison), f"step {int(comparison.step[-1])}:", *sentences)
    say(*placement_sentences(comparison))
    write = write_shape_comparison if shape else write_model_comparison
    say(f"page: {write(comparison, page, overwrite=overwrite)}")
    if not shape:
        say(f"mesh: {write_mesh(on_mesh(comparison, mesh), output / 'mesh', overwrite=overwrite)}")
    for done in export_dataset(comparison, output, ["netcdf", "vtk"], overwrite=overwrite):
        say(f"{done.format}: {done.path or '; '.join(done.problems)}")


@app.command(
    rich_help_panel=RESULTS,
    epilog="Example: fringedic compare recordings/plate-7/bag recordings/plate-8/bag --output plates.html",
)
def compare(
    sources: Sources,
    output: Annotated[Path, typer.Option(help="HTML file.")] = Path("comparison.html"),
    overwrite: Overwrite = False,
) -> None:
    """Compare two experiments, one recording processed with two settings, or a group of specimens; write a page."""
    from fringedic.campaign.settings import FILE as CAMPAIGN
    from fringedic.datasets import open_experiment
    from fringedic.evaluation import compare_experiments, compare_specimens
    from fringedic.evaluation.sentences import comparison_sentences, specimen_sentences
    from fringedic.report.specimens import write_specimens
    from fringedic.report.two_experiments import write_comparison
    from fringedic.wording.path_names import recording_names

    if len(sources) < 2:
        raise ConfigurationError("compare takes two or more recordings or datasets; name another one")
    for each in sources:
        if (each / CAMPAIGN).is_file():
            raise ConfigurationError(
                f"{each}: is a campaign; 'fringedic campaign open {each}' shows its groups, and 'compare' takes "
                f"its recordings, such as {each}/store/recordings/*"
            )
    page = output_file(output, overwrite)
    with ExitStack() as opened:
        found = [opened.enter_context(open_experiment(each)) for each in sources]
        first, second, *others = found
        if not others:
            say(*comparison_sentences(compare_experiments(first, second)))
            say(f"page: {write_comparison(first, second, page, overwrite=overwrite)}")
            return
        say(*specimen_sentences(compare_specimens(found)))
        names = recording_names(sources)
        specimens = {names[str(path)]: each for path, each in zip(sources, found, strict=True)}
        say(f"page: {write_specimens(specimens, page, overwrite=overwrite)}")


def _only(steps: list[int] | None) -> int | None:
    """Return the step of a comparison of the shape.

    Raises
    ------
    ConfigurationError
        There are several.
    """
    if steps and len(steps) > 1:
        raise ConfigurationError("--shape compares one step; give --step once")
    return steps[0] if steps else None


def _load_table(file: Path, scale: float) -> dict[int, float]:
    """Return the load of each step from a CSV with the columns step and load.

    Raises
    ------
    ConfigurationError
        The file is no such table.
    ModelError
        It cannot be read, or a row has another number of cells than the heading.
    """
    from fringedic.models.results_table import read_table

    heading, rows = read_table(file)
    if not {"step", "load"} <= set(heading):
        raise ConfigurationError(f"{file}: is no table of loads; write a CSV with the columns step,load")
    loads: dict[int, float] = {}
    for line, row in rows.items():
        entry = dict(zip(heading, row, strict=True))
        try:
            step, load = int(entry["step"]), float(entry["load"])
        except ValueError as error:
            raise ConfigurationError(f"{file}: line {line} has no number of a step and load") from error
        if step in loads or not math.isfinite(load):
            raise ConfigurationError(f"{file}: line {line} repeats step {step}, or its load {load} is not finite")
        loads[step] = scale * load
    if not loads:
        raise ConfigurationError(f"{file}: contains no load; write a line for each step")
    return loads


def _pairs(option: str, texts: list[str], scale: float) -> list[Pair]:
    """Return point pairs from ``["120,80=-5,3,0"]``; the point of the mesh is multiplied by its unit.

    Raises
    ------
    ConfigurationError
        A text has another form.
    """
    form = f"--{option} {{}}: give COLUMN,ROW=X,Y,Z with finite numbers, such as 120,80=-5,3,0"
    found = [_points(each, form, scale, 1) for each in texts]
    return [(pixels[0], points[0]) for pixels, points in found]


def _edges(texts: list[str], scale: float) -> list[Edge]:
    """Return edges from ``["120,80;860,80=-5,3,0;5,3,0"]``, as `_pairs`."""
    form = "--edge {}: give COLUMN,ROW;COLUMN,ROW=X,Y,Z;X,Y,Z with finite numbers, such as 120,80;860,80=-5,3,0;5,3,0"
    return [_points(each, form, scale, 2) for each in texts]


def _points(given: str, form: str, scale: float, number: int) -> Edge:
    """Return as many pixels and points of the mesh [m] from a text."""
    pixels, _, points = given.partition("=")
    try:
        found = [[[float(part) for part in each.split(",")] for each in half.split(";")] for half in (pixels, points)]
    except ValueError as error:
        raise ConfigurationError(form.format(given)) from error
    sizes = [[len(each) for each in half] for half in found]
    if sizes != [[2] * number, [3] * number] or not all(math.isfinite(part) for h in found for e in h for part in e):
        raise ConfigurationError(form.format(given))
    return found[0], [[scale * part for part in each] for each in found[1]]
