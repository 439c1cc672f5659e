"""The ``fringedic`` command. ROS is imported only by what starts nodes: the rest works on any machine."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml
from rich.console import Console
from rich.table import Table

from fringedic.errors import ExportError, FringedicError, ParameterError, RecordingError, RigFileError
from fringedic_bringup.display import LiveProgress, report_table
from fringedic_bringup.live_display import Pattern

if TYPE_CHECKING:
    from fringedic_bringup.report import RunReport

app = typer.Typer(
    help="3D shape and displacement of surfaces, measured with one camera and one projector.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
console = Console(width=None if sys.stdout.isatty() else 120)

Bag = Annotated[Path, typer.Argument(help="Folder of a recording.")]
Bags = Annotated[list[Path], typer.Argument(help="Folders of recordings, one after the other.")]
Steps = Annotated[list[int] | None, typer.Option("--step", help="Only this step and its reference; may be repeated.")]
ReferenceStep = Annotated[
    int | None, typer.Option("--reference", help="Step that all others are measured against, earlier ones too.")
]
Calibration = Annotated[
    Path | None, typer.Option(help="Calibration of the rig instead of the recorded one: its file or folder.")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there already.")]
Output = Annotated[Path | None, typer.Option(help="Folder for what is written.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NODE.PARAMETER=VALUE", help="Replaces a recorded parameter; may be repeated."),
]


class Specimen(StrEnum):
    """The virtual experiments of the demo."""

    PLATE = "plate"
    SKIN = "skin"
    LEATHER = "leather"


@app.command(epilog="Example: fringedic run plate.yaml --programme slow.yaml --output recordings/plate-7")
def run(
    rig: Annotated[Path, typer.Argument(help="Rig file; those that come with fringedic are found by their name.")],
    programme: Annotated[Path | None, typer.Option(help="Load steps instead of those in the rig file.")] = None,
    output: Output = None,
    images: Annotated[Path | None, typer.Option(help="Folder of images for a rig whose camera reads files.")] = None,
) -> None:
    """Run the load steps of a rig: start its nodes, move, hold and measure, record everything."""
    from fringedic_bringup.run import load_rig, run_experiment

    path = _rig_path(rig)
    rig_file, steps = load_rig(path, programme, images)
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%S")
    folder = output or Path(rig_file.recording.folder) / f"{steps.experiment}-{stamp}"
    with LiveProgress(console) as progress:
        report = run_experiment(rig_file, path, steps, folder, progress)
    _finish([report])


@app.command(epilog="Example: fringedic calibrate plate.yaml --angles-deg 0,-15,-10,-5,5,10,15 --output calibration")
def calibrate(
    rig: Annotated[Path | None, typer.Argument(help="Rig file; its section reference_plane tells the planes.")] = None,
    angles_deg: Annotated[
        str | None,
        typer.Option(help="Other angles of the plane, with commas; the last but one tests the result."),
    ] = None,
    recording: Annotated[
        Path | None, typer.Option("--from", help="Calibrate once more from the recording of a calibration.")
    ] = None,
    output: Annotated[Path, typer.Option(help="Folder for calibration, report and recording.")] = Path("calibration"),
) -> None:
    """Calibrate camera and rig with a printed grid and a plane at known angles; exit code 1 when it cannot be used."""
    if (rig is None) == (recording is None):
        raise ParameterError("name a rig file, or with --from the recording of a calibration")
    folder = _unused(output)
    with LiveProgress(console) as progress:
        if recording is not None:
            from fringedic_bringup.calibrate_again import calibrate_again

            report = calibrate_again(recording, folder, progress)
        elif rig is not None:
            from fringedic.rig_file import load_rig_file
            from fringedic_bringup.calibrate import calibrate as calibrate_rig
            from fringedic_bringup.calibrate import with_angles

            path = _rig_path(rig)
            rig_file = load_rig_file(path)
            if angles_deg is not None:
                rig_file = with_angles(rig_file, angles_deg)
            report = calibrate_rig(rig_file, path, folder, progress, ask=progress.ask)
    for words in report.words:
        console.print(words, markup=False, highlight=False)
    console.print("go" if report.go else "no go", style="green" if report.go else "red")
    if report.report is not None:
        console.print(f"report: {report.report}", markup=False, highlight=False)
    if report.go:
        console.print(f"calibration: {report.file}; name it in the rig file", markup=False, highlight=False)
    else:
        raise typer.Exit(1)


@app.command(epilog="Example: fringedic check plate.yaml --distance-mm 5")
def check(
    rig: Annotated[Path, typer.Argument(help="Rig file with the calibration to check.")],
    distance_mm: Annotated[
        float, typer.Option(help="By how much the plane is lifted towards the camera: a gauge block, a stage, in mm.")
    ] = 5.0,
    output: Annotated[Path, typer.Option(help="Folder for the recording.")] = Path("check"),
) -> None:
    """Measure the reference plane and a known distance; exit code 1 when the rig does not hold its calibration."""
    from fringedic.rig_file import load_rig_file
    from fringedic_bringup.check import check as check_rig

    path = _rig_path(rig)
    with LiveProgress(console) as progress:
        result = check_rig(
            load_rig_file(path), path, _unused(output), progress, distance=1e-3 * distance_mm, ask=progress.ask
        )
    for words in (result.verdict, *result.warnings):
        console.print(words, markup=False, highlight=False)
    if not result.holds:
        raise typer.Exit(1)


@app.command(epilog="Example: fringedic live plate.yaml --pattern fringes --region 320,240,640,480")
def live(
    rig: Annotated[Path, typer.Argument(help="Rig file; those that come with fringedic are found by their name.")],
    pattern: Annotated[Pattern, typer.Option(help="What is projected; focus: lines of 1 to 4 px.")] = Pattern.WHITE,
    region: Annotated[
        str, typer.Option(help="What is looked at: first column, first row, width and height in px, with commas.")
    ] = "",
    once: Annotated[bool, typer.Option("--once", help="Say once what is seen, and end.")] = False,
) -> None:
    """Show what the camera sees while the rig is set up: focus, grey levels, speckles, fringes and noise."""
    from fringedic.rig_file import load_rig_file
    from fringedic_bringup.live import show_live

    path = _rig_path(rig)
    with suppress(KeyboardInterrupt):
        show_live(load_rig_file(path), path, pattern, console, region=region, once=once)


@app.command(epilog="Example: fringedic noise plate.yaml --output noise")
def noise(
    rig: Annotated[Path | None, typer.Argument(help="Rig file, its specimen mounted and at rest.")] = None,
    images: Annotated[
        list[Path] | None, typer.Option("--images", help="An image at rest, instead of a rig; repeat it.")
    ] = None,
    steps: Annotated[int, typer.Option(help="Steps at rest, with the reference.")] = 10,
    window: Annotated[int, typer.Option(min=8, max=256, help="Of images: width of the window [px].")] = 32,
    spacing: Annotated[int, typer.Option(min=1, max=256, help="Of images: distance of the points [px].")] = 4,
    output: Annotated[Path, typer.Option(help="Folder for noise_floor.yaml, its picture and the recording.")] = Path(
        "noise"
    ),
) -> None:
    """Measure the noise floor of camera, displacement, height and strain with the specimen at rest."""
    from fringedic_bringup.noise import measure_noise, measure_noise_of_images, noise_in_words

    if (rig is None) == (not images):
        raise ParameterError("name a rig file, or with --images at least three images at rest")
    folder = _unused(output)
    if images:
        measured = measure_noise_of_images(images, folder, window=window, spacing=spacing)
    else:
        from fringedic.rig_file import load_rig_file

        assert rig is not None, "there is one or the other"
        path = _rig_path(rig)
        with LiveProgress(console) as progress:
            measured = measure_noise(load_rig_file(path), path, folder, progress, steps=steps)
    typer.echo(noise_in_words(measured.facts))
    file = folder / "noise_floor.yaml"
    console.print(f"noise floor: {file}; name it in the rig file as noise_floor_file", markup=False, highlight=False)


@app.command(epilog="Example: fringedic show RIG.yaml crosshair")
def show(
    rig: Annotated[Path, typer.Argument(help="Rig file; those that come with fringedic are found by their name.")],
    pattern: Annotated[
        str, typer.Argument(help="crosshair, grid, focus (lines of 1 to 4 px), white, grey, dark or fringes.")
    ] = "crosshair",
) -> None:
    """Hold a pattern on the projector until Enter or Ctrl-C, while the rig is adjusted."""
    from fringedic.rig_file import load_rig_file
    from fringedic_bringup.show import ShownPattern, hold_pattern

    if pattern not in list(ShownPattern):
        raise ParameterError(f"pattern {pattern} is unknown: use one of {', '.join(ShownPattern)}")

    def enough() -> None:
        console.print(f"the projector shows {pattern}; Enter ends it", markup=False, highlight=False)
        with suppress(EOFError):
            input()

    path = _rig_path(rig)
    with suppress(KeyboardInterrupt):
        hold_pattern(load_rig_file(path), path, ShownPattern(pattern), enough)


@app.command(epilog="Example: fringedic timing plate.yaml --output timing")
def timing(
    rig: Annotated[Path, typer.Argument(help="Rig file; those that come with fringedic are found by their name.")],
    exposure_ms: Annotated[
        float, typer.Option(min=0.05, max=1000, help="Of the frames: short against the refresh of the projector.")
    ] = 3.0,
    longest_ms: Annotated[
        float, typer.Option(min=20, max=10_000, help="Time that the projector may take for a pattern.")
    ] = 300.0,
    output: Annotated[Path, typer.Option(help="Folder for timing.yaml and its picture.")] = Path("timing"),
) -> None:
    """Measure when the projector shows what it is asked for, and say what exposure and settle time to set."""
    from fringedic.rig_file import load_rig_file
    from fringedic_bringup.timing import measure_rig_timing

    path = _rig_path(rig)
    folder = _unused(output)
    with LiveProgress(console) as progress:
        report = measure_rig_timing(
            load_rig_file(path), path, folder, progress, exposure_time=1e-3 * exposure_ms, longest=1e-3 * longest_ms
        )
    for words in report.words:
        console.print(words, markup=False, highlight=False)
    console.print(f"set in the rig file:\n{report.settings}", markup=False, highlight=False)
    console.print(f"picture: {folder / 'timing.png'}", markup=False, highlight=False)


@app.command(epilog="Example: fringedic response plate.yaml --output response")
def response(
    rig: Annotated[Path, typer.Argument(help="Rig file; those that come with fringedic are found by their name.")],
    output: Annotated[Path, typer.Option(help="Folder for response.yaml and its picture.")] = Path("response"),
) -> None:
    """Measure how bright the projector's grey levels are in the image, and what correcting them does for the phase."""
    from fringedic.rig_file import load_rig_file
    from fringedic_bringup.response import PICTURE, measure_rig_response

    path = _rig_path(rig)
    folder = _unused(output)
    with LiveProgress(console) as progress:
        report = measure_rig_response(load_rig_file(path), path, folder, progress)
    for words in report.words:
        console.print(words, markup=False, highlight=False)
    if report.setting:
        console.print(f"set in the rig file:\n{report.setting}", markup=False, highlight=False)
    console.print(f"picture: {folder / PICTURE}", markup=False, highlight=False)


@app.command(epilog="Example: fringedic region plate.yaml --output region.png")
def region(
    source: Annotated[Path, typer.Argument(metavar="IMAGE|RIG", help="Image, or rig file: then one frame of it.")],
    output: Annotated[Path, typer.Option(help="Mask image; the polygons go beside it as .yaml.")] = Path("region.png"),
) -> None:
    """Draw the region of interest in a window: a mask for fringedic measure, polygons for the rig file."""
    from fringedic_bringup.region import RIG_SUFFIXES, image_of
    from fringedic_bringup.region_window import draw_region

    is_rig = source.suffix in ("", *RIG_SUFFIXES)  # the rigs that come with fringedic have names without an ending
    drawn = draw_region(image_of(_rig_path(source) if is_rig else source))
    if drawn is None:
        console.print("nothing was drawn", markup=False, highlight=False)
        raise typer.Exit(1)
    picture, corners = drawn.save(output)
    share = 100 * drawn.mask().mean()
    console.print(
        f"mask: {picture}, {share:.0f} % of the image\npolygons: {corners}; name them in the rig file as region_file",
        markup=False,
        highlight=False,
    )


@app.command(epilog="Example: fringedic demo --output demo plate leather")
def demo(
    specimens: Annotated[list[Specimen] | None, typer.Argument(help="Which experiments; all by default.")] = None,
    output: Annotated[Path, typer.Option(help="Folder for recordings, datasets and pictures.")] = Path("demo"),
) -> None:
    """Calibrate the virtual rigs, measure three specimens through the real nodes and compare them with the truth."""
    from fringedic_bringup.demo import run_demo
    from fringedic_bringup.processes import private_domain

    rigs = {specimen.value: _rig_path(Path(specimen)) for specimen in specimens or list(Specimen)}
    with LiveProgress(console) as progress, private_domain() as domain:
        reports = run_demo(rigs, _unused(output), progress, domain=domain)
    _finish(reports)


@app.command(epilog="Example: fringedic replay recordings/plate-7/bag --set dic.window=24 --output window-24")
def replay(
    bags: Bags,
    settings: Settings = None,
    steps: Steps = None,
    reference: ReferenceStep = None,
    calibration: Calibration = None,
    output: Output = None,
) -> None:
    """Process recordings again by fresh nodes, as fast as they go, and record the results."""
    from fringedic_bringup.replay import replay as replay_bag

    overrides = _by_node(_values(settings))

    def work(bag: Path) -> None:
        _existing(bag)
        folder = _unused(bag.with_name(f"{bag.name}_replayed"))
        if output is not None:
            folder = output if len(bags) == 1 else output / _title(bag)
        with LiveProgress(console) as progress:
            target = replay_bag(
                bag,
                folder,
                progress,
                overrides=overrides,
                steps=steps or (),
                reference=reference,
                calibration=None if calibration is None else _calibration_file(calibration),
            )
        console.print(f"recording: {target}", markup=False, highlight=False)

    _for_each(bags, work)


@app.command(epilog="Example: fringedic process recordings/plate-7/bag --set coupling.z_filter_px=4 --output new.nc")
def process(
    bags: Bags,
    settings: Settings = None,
    steps: Steps = None,
    reference: ReferenceStep = None,
    calibration: Calibration = None,
    output: Annotated[
        Path | None,
        typer.Option(help="Dataset, .nc or .zarr, beside the recording by default; of several recordings a folder."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Measure recordings again without ROS and write the results as datasets."""
    from fringedic.results import process_bag
    from fringedic.rig import RigModel

    values = _values(settings)
    model = None if calibration is None else RigModel.from_yaml(_calibration_file(calibration))

    def work(bag: Path) -> None:
        target = output
        if output is not None and len(bags) > 1:
            output.mkdir(parents=True, exist_ok=True)
            target = output / f"{_title(bag)}.nc"
        with LiveProgress(console) as progress:
            progress.stage(f"processing {bag}")
            written = process_bag(
                bag,
                output=target,
                overrides=values,
                steps=steps or None,
                reference=reference,
                calibration=model,
                overwrite=overwrite,
                progress=lambda step, error: progress.note(f"step {step}: {error or 'measured'}"),
            )
        console.print(f"dataset: {written}", markup=False, highlight=False)

    _for_each(bags, work)


@app.command(epilog="Example: fringedic info recordings/plate-7/bag")
def info(bag: Bag) -> None:
    """Say what a recording holds and whether it is whole."""
    from fringedic.recording import info as bag_info
    from fringedic_bringup.clocks import clocks_in_words

    summary = bag_info(bag)
    start = datetime.fromtimestamp(summary.start_time * 1e-9, UTC).isoformat(sep=" ", timespec="seconds")
    duration = (summary.end_time - summary.start_time) * 1e-9
    table = Table(title=f"{bag}: {start} UTC, {duration:.1f} s, {summary.size / 1e6:.1f} MB", title_justify="left")
    table.add_column("topic")
    table.add_column("type")
    table.add_column("messages", justify="right")
    for name, (type_name, count) in summary.topics.items():
        table.add_row(name, type_name, str(count))
    console.print(table)
    for words in clocks_in_words(bag):
        console.print(words, markup=False, highlight=False)
    if summary.lost:
        console.print(f"damaged: {summary.lost}; `fringedic recover {bag}` saves the rest", markup=False)


@app.command(epilog="Example: fringedic recover recordings/plate-7/bag --output saved")
def recover(bag: Bag, output: Output = None) -> None:
    """Write a whole recording from what can be read of a damaged one."""
    from fringedic.recording import recover as recover_bag

    console.print(f"recording: {recover_bag(bag, output)}", markup=False, highlight=False)


@app.command(epilog="Example: fringedic measure reference.tif loaded-1.tif loaded-2.tif --window 24 --output measured")
def measure(
    images: Annotated[list[Path], typer.Argument(help="The reference image, then the deformed ones in their order.")],
    window: Annotated[int, typer.Option(min=8, max=256, help="Width of the correlation window [px].")] = 32,
    spacing: Annotated[int, typer.Option(min=1, max=256, help="Distance of the measured points [px].")] = 1,
    mask: Annotated[
        Path | None, typer.Option(help="What is measured: a mask image, or polygons, as fringedic region writes them.")
    ] = None,
    output: Annotated[Path, typer.Option(help="Folder for dataset and pictures.")] = Path("measured"),
) -> None:
    """Measure the in-plane displacement between images and write it as NetCDF and PNG."""
    from fringedic_bringup.images import measure_images

    with LiveProgress(console) as progress:
        dataset, pictures = measure_images(images, output, progress, window=window, spacing=spacing, mask=mask)
    console.print(f"dataset: {dataset}\npictures: {len(pictures)} in {output}", markup=False, highlight=False)


@app.command(epilog="Example: fringedic advise reference.tif static-1.tif static-2.tif --wanted-noise-px 0.005")
def advise(
    reference: Annotated[Path, typer.Argument(help="Image of the mounted specimen before the test.")],
    static_1: Annotated[Path, typer.Argument(help="A second image of it, nothing moved.")],
    static_2: Annotated[Path, typer.Argument(help="A third one.")],
    wanted_noise_px: Annotated[
        float | None, typer.Option(help="Noise of the displacement to be reached, in pixels.")
    ] = None,
    wanted_period_px: Annotated[
        float | None, typer.Option(help="Shortest displacement wave that must keep 90 % of its amplitude, in pixels.")
    ] = None,
    pixel_size_mm: Annotated[
        float | None, typer.Option(help="Size of a pixel on the specimen in mm, for lengths.")
    ] = None,
    strain_window_points: Annotated[int, typer.Option(help="Width of the strain window in points, odd.")] = 5,
) -> None:
    """Recommend window and spacing from three images at rest, and tell noise floors and what to put right."""
    from fringedic_bringup.images import advise_on_images

    advice = advise_on_images(
        (reference, static_1, static_2),
        wanted_noise=wanted_noise_px,
        wanted_period=wanted_period_px,
        pixel_size=None if pixel_size_mm is None else 1e-3 * pixel_size_mm,
        strain_window=strain_window_points,
    )
    typer.echo(advice.report())


@app.command(epilog="Example: fringedic target --pitch-mm 0.5 --output grid.pdf")
def target(
    pitch_mm: Annotated[float, typer.Option(help="Period of the lines in mm; 6 to 15 pixels of the camera are good.")],
    output: Annotated[Path, typer.Option(help="File to write, .pdf or .svg.")] = Path("grid.pdf"),
    page: Annotated[str, typer.Option(help="A4 or A3.")] = "A4",
    turned_degree: Annotated[float, typer.Option(help="Turn of the grid on the page in degree.")] = 2.0,
) -> None:
    """Write the printable grid that measures the camera's distortion and gives the calibration its scale."""
    from fringedic.camera.target import Target

    Target(1e-3 * pitch_mm, page, math.radians(turned_degree)).save(output)
    console.print(
        f"grid: {output}; print it at 100 %, measure its ruler, and lay it flat", markup=False, highlight=False
    )


@app.command(epilog="Example: fringedic export recordings/plate-7/bag --to vtk --to csv --output plate-7")
def export(
    source: Annotated[Path, typer.Argument(metavar="BAG|DATASET", help="Recording or dataset.")],
    formats: Annotated[
        list[str] | None,
        typer.Option("--to", metavar="FORMAT", help="netcdf, zarr, vtk, ply, csv, mat, tiff, png, gif or r3xa."),
    ] = None,
    steps: Annotated[list[int] | None, typer.Option("--step", help="Only this step; may be repeated.")] = None,
    output: Output = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a dataset for other programs; by default as NetCDF and as pictures (PNG)."""
    from fringedic.export import export_dataset
    from fringedic.results import open_experiment

    folder = output or source.with_name(f"{source.stem}_exported")
    problems = 0
    with open_experiment(source) as dataset:
        for done in export_dataset(dataset, folder, formats or ["netcdf", "png"], steps=steps, overwrite=overwrite):
            lines = [f"{done.format}: {done.path}"] if done.path else []
            lines += [f"{done.format}: {problem}" for problem in done.problems]
            problems += done.path is None
            console.print("\n".join(lines), markup=False, highlight=False)
    if problems:
        raise ExportError(f"{problems} of {len(formats or ()) or 2} formats were not written, see above")


@app.command(epilog="Example: fringedic report recordings/plate-7/bag --output plate-7.html")
def report(
    source: Annotated[Path, typer.Argument(metavar="BAG|DATASET", help="Recording or dataset.")],
    output: Annotated[Path | None, typer.Option(help="HTML file; report.html beside the recording by default.")] = None,
    static: Annotated[
        list[int] | None,
        typer.Option(
            "--static",
            metavar="STEP",
            help="Step at rest, for the noise floor; by default those at the position of the reference.",
        ),
    ] = None,
    extensometer: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROW,COLUMN,ROW,COLUMN",
            help="Virtual extensometer between two pixels; by default those of the rig file.",
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write the report of an experiment as one HTML file that needs no network.

    Example: fringedic report my_test/bag --extensometer 480,200,480,1000
    """
    from fringedic.report import write_report

    places = [_two_pixels(each) for each in extensometer] if extensometer else None
    written = write_report(source, output, static_steps=static or None, extensometers=places, overwrite=overwrite)
    console.print(f"report: {written}", markup=False, highlight=False)


def _two_pixels(text: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 4:
        raise typer.BadParameter(
            f"--extensometer {text}: give ROW,COLUMN,ROW,COLUMN in pixels, such as 480,200,480,1000"
        )
    return numbers


def main() -> None:
    """Run the command; an error is one sentence on the error stream and exit code 1."""
    try:
        app()
    except FringedicError as error:
        print(error, file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("interrupted; the nodes have ended and the recording is closed", file=sys.stderr)
        sys.exit(130)


def _rig_path(rig: Path) -> Path:
    """Return a rig file as given, or the one that comes with fringedic under this name."""
    if rig.exists() or rig.parent != Path():
        return rig
    from fringedic_bringup.processes import configuration

    shipped = configuration(f"{rig.stem}.yaml")
    if shipped.exists():
        return shipped
    names = ", ".join(sorted(path.stem for path in shipped.parent.glob("*.yaml")))
    raise RigFileError(f"{rig}: no such rig file; {names} come with fringedic")


def _calibration_file(path: Path) -> Path:
    """Return the file of a calibration that is named by itself or by its folder."""
    file = path / "calibration.yaml" if path.is_dir() else path
    if not file.is_file():
        raise RigFileError(f"{file}: there is no calibration")
    return file


def _values(settings: list[str] | None) -> dict[str, Any]:
    """Return ``["dic.window=24"]`` as {"dic.window": 24}."""
    values = {}
    for setting in settings or []:
        name, equals, text = setting.partition("=")
        if not equals or name.count(".") != 1:
            raise ParameterError(f"--set {setting}: write it as node.parameter=value, for example dic.window=24")
        values[name] = yaml.safe_load(text)
    return values


def _by_node(values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    from fringedic_bringup.graph import PROCESSING_NODES

    nodes: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        node, parameter = name.split(".")
        if node not in PROCESSING_NODES:
            raise ParameterError(f"--set {name}: a replay runs {', '.join(PROCESSING_NODES)}, not {node}")
        nodes.setdefault(node, {})[parameter] = value
    return nodes


def _existing(bag: Path) -> None:
    from fringedic.recording import BagReader

    BagReader(bag).find("camera/image_raw", "camera/exposure", "experiment/step")


def _for_each(bags: list[Path], work: Callable[[Path], None]) -> None:
    """Do something with each recording; one that fails is named, the others go on."""
    if len(bags) == 1:
        work(bags[0])
        return
    failed = []
    for bag in bags:
        try:
            work(bag)
        except FringedicError as error:
            console.print(f"{bag}: {error}", markup=False, highlight=False)
            failed.append(str(bag))
    if failed:
        raise RecordingError(f"not done: {', '.join(failed)}")


def _title(bag: Path) -> str:
    """Return the name of a recording: that of its run, where it is the folder `bag` of one."""
    return bag.absolute().parent.name if bag.name == "bag" else bag.stem


def _unused(folder: Path) -> Path:
    """Return a folder name that is free: demo, demo-2, demo-3 ..."""
    candidate, number = folder, 1
    while candidate.exists():
        number += 1
        candidate = folder.with_name(f"{folder.name}-{number}")
    return candidate


def _finish(reports: list[RunReport]) -> None:
    for report in reports:
        console.print(report_table(report))
        left = f"report.html, recording (bag), dataset (results.nc), {len(report.pictures)} pictures"
        if report.unmeasured:
            left = f"recording (bag); it is whole, but {report.unmeasured}"
        console.print(f"{report.folder}: {left}", markup=False, highlight=False)
    failed = [report.experiment for report in reports if report.failed]
    if failed:
        raise RigFileError(f"steps failed, or frames or results are missing in: {', '.join(failed)}")
