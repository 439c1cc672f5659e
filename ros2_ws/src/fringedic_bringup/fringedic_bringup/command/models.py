"""The subcommands that compare a measurement with a model or with another one, without ROS."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fringedic.errors import ConfigurationError
from fringedic_bringup.command.app import Overwrite, Source, app, output_file, say

if TYPE_CHECKING:
    from fringedic.models.comparison import Pair

_MILLI = 1e-3


@app.command(
    "compare-model",
    epilog="Example: fringedic compare-model recordings/plate-7/bag plate.vtu --unit mm --load 1000",
)
def compare_model(  # noqa: PLR0913 (options of a command)
    source: Source,
    model: Annotated[Path, typer.Argument(help="Mesh with nodal displacement: VTU, VTK, PVD, gmsh, Nastran ...")],
    unit: Annotated[str, typer.Option(help="Of lengths in the mesh: m, mm, um or inch.")],
    load: Annotated[
        list[float] | None,
        typer.Option(help="Force in N of each load step of the mesh, or crosshead position in mm; may be repeated."),
    ] = None,
    by: Annotated[str, typer.Option(help="What the loads of the mesh are: force or position.")] = "force",
    field: Annotated[str | None, typer.Option(help="Name of the displacement in the mesh.")] = None,
    pair: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COLUMN,ROW=X,Y,Z",
            help="A point of the reference image in px and of the mesh in its unit; three or more align the mesh.",
        ),
    ] = None,
    pair_sigma_mm: Annotated[
        float | None,
        typer.Option(help="Standard uncertainty of each coordinate of the pairs; by default one point spacing."),
    ] = None,
    steps: Annotated[list[int] | None, typer.Option("--step", help="Only this step; may be repeated.")] = None,
    output: Annotated[Path, typer.Option(help="Folder for page, dataset and VTK files.")] = Path("compared"),
    overwrite: Overwrite = False,
) -> None:
    """Compare displacement and strain with a finite-element model; write page, dataset and VTK files."""
    page = output_file(output / "comparison.html", overwrite)
    from fringedic.export import export_dataset
    from fringedic.models import compare_model as compare
    from fringedic.models import read_model
    from fringedic.models.model import UNITS
    from fringedic.report.model_comparison import agreement_sentences, placement_sentences, write_model_comparison
    from fringedic.results import open_experiment

    scale = _MILLI if by == "position" else 1.0
    mesh = read_model(
        model, unit=unit, displacement=field, loads=None if load is None else [scale * each for each in load]
    )
    pairs = _pairs(pair or [], UNITS[unit])
    with open_experiment(source) as experiment:
        sigma = None if pair_sigma_mm is None else _MILLI * pair_sigma_mm
        comparison = compare(experiment, mesh, pairs=pairs, pair_sigma=sigma, steps=steps or None, load=by)
    output.mkdir(parents=True, exist_ok=True)
    say(f"step {int(comparison.step[-1])}:", *agreement_sentences(comparison.isel(step=-1)))
    say(*placement_sentences(comparison))
    say(f"page: {write_model_comparison(comparison, page, overwrite=overwrite)}")
    for done in export_dataset(comparison, output, ["netcdf", "vtk"], overwrite=overwrite):
        say(f"{done.format}: {done.path or '; '.join(done.problems)}")


@app.command(epilog="Example: fringedic compare recordings/plate-7/bag recordings/plate-8/bag --output plates.html")
def compare(
    one: Source,
    other: Source,
    output: Annotated[Path, typer.Option(help="HTML file.")] = Path("comparison.html"),
    overwrite: Overwrite = False,
) -> None:
    """Compare two experiments, or one recording processed with two settings, and write a page."""
    from fringedic.report.two_experiments import comparison_sentences, write_comparison
    from fringedic.results import compare_experiments, open_experiment

    page = output_file(output, overwrite)
    with open_experiment(one) as first, open_experiment(other) as second:
        say(*comparison_sentences(compare_experiments(first, second)))
        say(f"page: {write_comparison(first, second, page, overwrite=overwrite)}")


def _pairs(texts: list[str], scale: float) -> list[Pair]:
    """Return point pairs from ``["120,80=-5,3,0"]``; the point of the mesh is multiplied by its unit.

    Raises
    ------
    ConfigurationError
        A text has another form.
    """
    pairs: list[Pair] = []
    for each in texts:
        pixel, _, point = each.partition("=")
        try:
            (column, row), (x, y, z) = ([float(part) for part in half.split(",")] for half in (pixel, point))
        except ValueError as error:
            raise ConfigurationError(f"--pair {each}: give COLUMN,ROW=X,Y,Z, such as 120,80=-5,3,0") from error
        if not all(map(math.isfinite, (column, row, x, y, z))):
            raise ConfigurationError(f"--pair {each}: give finite numbers")
        pairs.append(((column, row), (scale * x, scale * y, scale * z)))
    return pairs
