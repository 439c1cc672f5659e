"""The ``fringedic`` command."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar
from rich.table import Table

from fringedic.errors import FringedicError, ImageTypeError, ParameterError, RigFileError

# Commands without ROS must start without it: what needs rclpy is imported by the command that uses it.

app = typer.Typer(
    help="3D shape and 3D displacement of a surface with one camera and one projector.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)
console = Console()

Bag = Annotated[Path, typer.Argument(help="Folder of a recording.", metavar="BAG")]
Output = Annotated[Path, typer.Option("--output", "-o", help="Folder for everything that the command writes.")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", help="A parameter in place of the recorded one, such as dic.window=24.")
]


@app.command()
def run(
    rig: Annotated[Path, typer.Argument(help="Rig file (YAML).", metavar="RIG.yaml")],
    programme: Annotated[
        Path | None, typer.Option("--programme", "-p", help="Load steps (YAML); by default those in the rig file.")
    ] = None,
    output: Output = Path("experiment"),
) -> None:
    """Run a programme of load steps on a rig: move, hold, measure, next; everything is recorded.

    Example: `fringedic run plate.yaml --programme tension.yaml --output tension_1`

    The machine's own limits and emergency stop are in charge; this command only requests.
    """
    from fringedic.rig_file import load_programme, load_rig_file
    from fringedic_bringup.run import run_programme

    chosen = load_programme(programme) if programme else load_rig_file(rig).programme
    if chosen is None:
        raise RigFileError(f"{rig}: has no section programme; give one with --programme")
    with _progress(chosen.experiment) as progress:
        ran = run_programme(rig, chosen, output, progress=progress)
    console.print(_answers(ran.results))
    console.print(f"recording: {ran.bag} ({ran.missing_images} images missing)")


@app.command()
def demo(
    specimens: Annotated[
        list[str] | None,
        typer.Argument(help="plate, skin, leather, or the path of a virtual rig file; all by default."),
    ] = None,
    output: Output = Path("demo"),
) -> None:
    """Run virtual experiments through the real nodes and compare them with the exact truth.

    Example: `fringedic demo skin --output demo`

    Leaves per specimen the recording, maps of shape, displacement and error, and one dataset.
    """
    from fringedic_bringup.demo import SPECIMENS, run_demo
    from fringedic_bringup.processes import private_domain

    finished = []
    with private_domain() as domain:
        for specimen in specimens or SPECIMENS:
            rig = Path(specimen) if specimen.endswith(".yaml") else configuration(f"{specimen}.yaml")
            with _progress(rig.stem) as progress:
                finished.append(
                    run_demo(
                        rig,
                        output / rig.stem,
                        domain=domain,
                        progress=progress,
                        say=lambda what, name=rig.stem: console.print(f"{name}: {what}"),
                    )
                )
    table = Table(title="measured minus true, root mean square")
    for heading in (
        "experiment",
        "step",
        "u [µm]",
        "v [µm]",
        "w [µm]",
        "z [µm]",
        "valid [%]",
        "lost frames",
        "cloud after [s]",
    ):
        table.add_column(heading, justify="left" if heading == "experiment" else "right")
    for result in finished:
        for number, answer in enumerate(result.run.results):
            errors = result.errors.isel(step=number)
            table.add_row(
                result.specimen,
                str(answer.step),
                *(f"{float(errors[f'error_{name}']):.3f}" for name in "uvwz"),
                f"{100 * float(errors.measured_fraction):.1f}",
                str(result.run.missing_images),
                f"{answer.processing_time:.2f}",
            )
    console.print(table)
    for result in finished:
        console.print(f"{result.folder}: recording, results.nc, truth.nc, pictures")


@app.command()
def replay(bag: Bag, set_: Overrides = None, output: Output = Path("replay")) -> None:
    """Play a recording through fresh phase, dic and coupling nodes, as fast as they go, into a new recording.

    Example: `fringedic replay my_test/bag --set dic.window=24 --output window_24`

    With unchanged parameters the results are the recorded ones, bit by bit.
    """
    from fringedic_bringup.processes import private_domain
    from fringedic_bringup.run import replay as play

    with private_domain() as domain:
        summary = play(bag, output / "bag", domain=domain, overrides=_overrides(set_), progress=console.print)
    console.print(f"{output / 'bag'}: {summary}")


@app.command()
def process(
    bag: Bag,
    set_: Overrides = None,
    steps: Annotated[str | None, typer.Option(help="Steps to measure, such as 0,3,7; all by default.")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="NetCDF file; by default beside BAG.")] = None,
    overwrite: Annotated[bool, typer.Option(help="Replace an existing file.")] = False,
) -> None:
    """Measure a recording again without ROS: the same arrays as the nodes give.

    Example: `fringedic process my_test/bag --set dic.window=24 --output window_24.nc`
    """
    from fringedic.results import process_bag

    def said(step: int, error: str) -> None:
        console.print(f"step {step}: {error or 'done'}")

    chosen = None if steps is None else _numbers(steps)
    file = process_bag(bag, output=output, overrides=_overrides(set_), steps=chosen, overwrite=overwrite, progress=said)
    console.print(f"dataset: {file}")


@app.command()
def info(bag: Bag) -> None:
    """Say what a recording holds, and whether it is whole.

    Example: `fringedic info my_test/bag`
    """
    from fringedic.recording import info as read

    found = read(bag)
    table = Table(title=f"{bag}: {(found.end_time - found.start_time) * 1e-9:.1f} s, {found.size * 1e-6:.1f} MB")
    for heading in ("topic", "type", "messages"):
        table.add_column(heading, justify="right" if heading == "messages" else "left")
    for name, (type_name, messages) in found.topics.items():
        table.add_row(name, type_name, str(messages))
    console.print(table)
    console.print(f"damaged: {found.lost}" if found.lost else "whole")


@app.command()
def recover(
    bag: Bag,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="New recording; by default BAG_recovered.")
    ] = None,
) -> None:
    """Make a whole recording of everything that can be read in a damaged one.

    Example: `fringedic recover my_test/bag`
    """
    from fringedic.recording import recover as rescue

    console.print(f"recovered: {rescue(bag, output)}")


@app.command()
def export(
    bag: Bag,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="NetCDF file; by default beside BAG.")] = None,
) -> None:
    """Write what the nodes published as one labelled NetCDF dataset.

    Example: `fringedic export my_test/bag --output my_test.nc`
    """
    from fringedic.results import dataset_from_derived

    console.print(f"dataset: {dataset_from_derived(bag, output=output)}")


@app.command()
def measure(
    images: Annotated[list[Path], typer.Argument(help="The reference image, then deformed ones.", metavar="IMAGES...")],
    window: Annotated[int, typer.Option(help="Width of the window [px].")] = 32,
    output: Output = Path("displacement"),
) -> None:
    """Measure the in-plane displacement between images, without a rig.

    Example: `fringedic measure reference.tif load_1.tif load_2.tif --window 32 --output plate`
    """
    from fringedic_bringup.images import measure_images

    if len(images) < 2:
        raise ImageTypeError("at least two images are needed: the reference first, then deformed ones")
    for file in measure_images(images, output, window=window):
        console.print(f"written: {file}")


def configuration(name: str) -> Path:
    """Return the path of a rig file that comes with the package."""
    from ament_index_python.packages import get_package_share_directory

    path = Path(get_package_share_directory("fringedic_bringup"), "config", name)
    if not path.exists():
        known = ", ".join(sorted(each.stem for each in path.parent.glob("*.yaml")))
        raise RigFileError(f"there is no rig '{path.stem}'; known are {known}, or give the path of a .yaml file")
    return path


def _overrides(given: list[str] | None) -> dict[str, Any]:
    overrides = {}
    for each in given or []:
        name, separator, value = each.partition("=")
        if not separator or name.partition(".")[0] not in ("phase", "dic", "coupling"):
            raise ParameterError(f"--set {each}: expected phase|dic|coupling.PARAMETER=VALUE, such as dic.window=24")
        overrides[name] = yaml.safe_load(value)
    return overrides


def _numbers(text: str) -> list[int]:
    try:
        return [int(each) for each in text.split(",")]
    except ValueError:
        raise ParameterError(f"--steps {text}: expected numbers such as 0,3,7") from None


@contextmanager
def _progress(name: str) -> Iterator[Callable[[Any], None]]:
    """Show stage, frame and step: a bar on a terminal, a line per step elsewhere."""
    if not console.is_terminal:
        last: list[tuple[int, str]] = []

        def line(progress: Any) -> None:
            if (progress.step, progress.stage) not in last:
                last.append((progress.step, progress.stage))
                console.print(f"{name}: step {progress.step + 1} of {progress.steps}: {progress.stage}")

        yield line
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Bar(*columns, console=console) as bar:
        task = bar.add_task(name)

        def show(progress: Any) -> None:
            words = f"{name}: step {progress.step + 1} of {progress.steps}, {progress.stage}"
            bar.update(task, description=words, completed=progress.frame, total=progress.frames or None)

        yield show


def _answers(results: list[Any]) -> Table:
    table = Table(title="load steps")
    for heading in ("step", "valid [%]", "rms displacement", "force [N]", "position [mm]", "cloud after [s]"):
        table.add_column(heading, justify="right")
    for each in results:
        table.add_row(
            str(each.step),
            f"{100 * each.valid_fraction:.1f}",
            f"{each.rms_displacement * 1e6:.1f} µm"
            if each.rms_displacement < 0.1
            else f"{each.rms_displacement:.3f} px",
            f"{each.force_mean:.1f}",
            f"{each.position_mean * 1e3:.4f}",
            f"{each.processing_time:.2f}",
        )
    return table


def main() -> int:
    """Run the command; whatever is wrong is said in one sentence."""
    try:
        app()
    except FringedicError as error:
        Console(stderr=True).print(f"fringedic: {error}", markup=False, highlight=False)
        return 1
    except KeyboardInterrupt:
        print("fringedic: interrupted", file=sys.stderr)
        return 130
    return 0
