"""Subcommands for setting up a rig before a test."""

from __future__ import annotations

from contextlib import closing, suppress
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from fringedic.errors import ConfigurationError
from fringedic_bringup.command.app import (
    SET_UP,
    Overwrite,
    Rig,
    app,
    begin,
    console,
    output_file,
    parameter_values,
    refuse_unused,
    say,
)
from fringedic_bringup.display.progress import LiveProgress
from fringedic_bringup.launch.rig_files import rig_path_of
from fringedic_bringup.procedures.folders import unused_folder
from fringedic_bringup.procedures.setup_patterns import LivePattern, ShownPattern


class CameraKind(StrEnum):
    """The cameras that a new rig file can name."""

    ARAVIS = "aravis"
    V4L2 = "v4l2"


@app.command(rich_help_panel=SET_UP, epilog="Example: fringedic init bench.yaml")
def init(  # noqa: PLR0913 (options of a command)
    camera: Annotated[
        CameraKind,
        typer.Option(prompt="1 of 7  Camera: GigE or USB3 Vision, or USB video", help="Kind."),
    ],
    image_size: Annotated[str, typer.Option(prompt="2 of 7  Image size in px, such as 1280x960", help="In px.")],
    rig: Annotated[Path, typer.Argument(metavar="RIG", help="Rig file to write.")] = Path("bench.yaml"),
    camera_address: Annotated[
        str,
        typer.Option(prompt="3 of 7  Its address or device, Enter for the only one", help="Of the camera."),
    ] = "",
    display: Annotated[
        int, typer.Option(prompt="4 of 7  Number of the projector among the displays, from 0", help="Of the projector.")
    ] = 1,
    projector_size: Annotated[
        str, typer.Option(prompt="5 of 7  Resolution of the projector in px", help="Of the projector in px.")
    ] = "1920x1080",
    grid_pitch_mm: Annotated[
        float,
        typer.Option(prompt="6 of 7  Distance of the printed grid's lines in mm", help="Of the grid's lines."),
    ] = 0.5,
    operator: Annotated[str, typer.Option(prompt="7 of 7  Your name, for the reports", help="For the reports.")] = "",
    overwrite: Overwrite = False,
) -> None:
    """Ask seven questions and write a rig file; options answer questions in advance."""
    from fringedic_bringup.procedures.new_rig import Answers, write_rig_file

    answers = Answers(camera.value, camera_address, image_size, display, projector_size, grid_pitch_mm, operator)
    write_rig_file(output_file(rig, overwrite), answers)
    say(f"rig file: {rig}; next: fringedic live {rig}")


@app.command(
    rich_help_panel=SET_UP, epilog="Example: fringedic plan planned --set plan.angle_degree=35 --output plan.html"
)
def plan(
    rig: Rig,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="SECTION.KEY=VALUE", help="Replaces a value of the rig file; may be repeated."),
    ] = None,
    output: Annotated[Path, typer.Option(help="Page to write.")] = Path("plan.html"),
    overwrite: Overwrite = False,
) -> None:
    """Predict the uncertainties of a rig from the data of its components, before anything is bought."""
    page = output_file(output, overwrite)
    from fringedic.configuration.changes import load_changed_rig_file
    from fringedic.planning import PlannedRig, make_plan
    from fringedic.planning.sentences import plan_text
    from fringedic.report.plan import write_plan_page

    path = rig_path_of(rig)
    found = make_plan(PlannedRig.of(load_changed_rig_file(path, parameter_values(settings)), str(path)))
    say(plan_text(found))
    page.parent.mkdir(parents=True, exist_ok=True)
    say(f"page: {write_plan_page(found, page, rig=path.stem)}")


@app.command(
    rich_help_panel=SET_UP, epilog="Example: fringedic live plate.yaml --pattern fringes --region 320,240,640,480"
)
def live(
    rig: Rig,
    pattern: Annotated[
        LivePattern, typer.Option(help="Projected pattern; focus: lines of 1 to 4 px.")
    ] = LivePattern.WHITE,
    region: Annotated[
        str,
        typer.Option(
            metavar="COLUMN,ROW,WIDTH,HEIGHT",
            help="Part of the image to evaluate, in pixels: first column, first row, width and height.",
        ),
    ] = "",
    once: Annotated[bool, typer.Option("--once", help="Print the figures once, and end.")] = False,
) -> None:
    """Show the figures of the camera image during set-up: focus, grey levels, speckle size, fringes and noise."""
    from fringedic.configuration.rig_file import load_rig_file
    from fringedic_bringup.display.live import draw_continuously, print_once
    from fringedic_bringup.procedures.live import FRAMES_OF_ONE_LOOK, part_of_image, watch

    path, part = rig_path_of(rig), part_of_image(region)
    with suppress(KeyboardInterrupt), closing(watch(load_rig_file(path), path, pattern, region=part)) as views:
        if once or not console.is_terminal:
            print_once(console, views, pattern, path.stem, frames=FRAMES_OF_ONE_LOOK)
        else:
            draw_continuously(console, views, pattern, path.stem)


@app.command(rich_help_panel=SET_UP, epilog="Example: fringedic machine frame.yaml --once")
def machine(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Machine file, with the protocol of the machine.", callback=begin)
    ],
    once: Annotated[
        bool, typer.Option("--once", help="Look once, and end; exit code 1 when something does not fit.")
    ] = False,
) -> None:
    """Show what a testing machine answers, what it means and what to change in its file; the machine is not moved."""
    from fringedic_bringup.display.machine import draw_continuously, look, print_view, requests
    from load_frame_node.machines import load_machine, open_machine

    with suppress(KeyboardInterrupt), closing(open_machine(load_machine(file), is_required=False)) as connected:
        if not once and console.is_terminal:
            draw_continuously(console, connected, requests(connected))
        say(*requests(connected))
        view = look(connected)
        print_view(console, connected, view)
        if view.problems:
            raise typer.Exit(1)


@app.command(rich_help_panel=SET_UP, epilog="Example: fringedic noise plate.yaml --output noise")
def noise(
    context: typer.Context,
    rig: Annotated[
        Path | None, typer.Argument(metavar="RIG", help="Rig file; the specimen is mounted and at rest.")
    ] = None,
    images: Annotated[
        list[Path] | None, typer.Option("--images", help="An image at rest, instead of a rig; give at least three.")
    ] = None,
    steps: Annotated[int, typer.Option(help="With a rig: number of steps at rest, with the reference.")] = 10,
    window: Annotated[
        int, typer.Option(min=8, max=256, help="With --images: width of the correlation window [px].")
    ] = 32,
    spacing: Annotated[
        int, typer.Option(min=1, max=256, help="With --images: distance of the measured points [px].")
    ] = 4,
    output: Annotated[Path, typer.Option(help="Folder for noise_floor.yaml, its picture and the recording.")] = Path(
        "noise"
    ),
) -> None:
    """Measure the noise floor of camera, displacement, height and strain with the specimen at rest."""
    if (rig is None) == (not images):
        raise ConfigurationError("give a rig file, or with --images at least three images at rest")
    if images:
        refuse_unused(context, {"steps"}, "with --images every image is a step; leave it out")
    else:
        refuse_unused(context, {"window", "spacing"}, "with a rig file they are nodes.dic in this file; set them there")
    begin(rig or (images or [])[0])
    from fringedic.rig_setup.settings_sentences import noise_floor_text
    from fringedic_bringup.procedures.noise import measure_noise, measure_noise_of_images

    folder = unused_folder(output)
    if images:
        measured = measure_noise_of_images(images, folder, window=window, spacing=spacing)
    else:
        from fringedic.configuration.rig_file import load_rig_file

        assert rig is not None, "checked above"
        path = rig_path_of(rig)
        with LiveProgress(console) as progress:
            measured = measure_noise(load_rig_file(path), path, folder, progress, steps=steps)
    typer.echo(noise_floor_text(measured.metadata))
    file = folder / "noise_floor.yaml"
    say(f"noise floor: {file}; to use it, write its path into the rig file as noise_floor_file")


@app.command(rich_help_panel=SET_UP, epilog="Example: fringedic show RIG.yaml crosshair")
def show(
    rig: Rig,
    pattern: Annotated[
        str,
        typer.Argument(
            metavar="PATTERN", help="crosshair, grid, focus (lines of 1 to 4 px), white, grey, dark or fringes."
        ),
    ] = "crosshair",
) -> None:
    """Hold a pattern on the projector until Enter or Ctrl-C, while the rig is adjusted."""
    from fringedic.configuration.rig_file import load_rig_file
    from fringedic_bringup.procedures.show import hold_pattern

    if pattern not in list(ShownPattern):
        raise ConfigurationError(f"pattern {pattern} is unknown; use one of {', '.join(ShownPattern)}")

    def wait_for_enter() -> None:
        say(f"the projector shows {pattern}; Enter ends it")
        with suppress(EOFError):
            input()

    path = rig_path_of(rig)
    with suppress(KeyboardInterrupt):
        hold_pattern(load_rig_file(path), path, ShownPattern(pattern), wait_for_enter)


@app.command(rich_help_panel=SET_UP, epilog="Example: fringedic timing plate.yaml --output timing")
def timing(
    rig: Rig,
    exposure_ms: Annotated[
        float, typer.Option(min=0.05, max=1000, help="Exposure time; short compared with the refresh of the projector.")
    ] = 3.0,
    longest_ms: Annotated[float, typer.Option(min=20, max=10_000, help="Longest delay of a pattern.")] = 300.0,
    output: Annotated[Path, typer.Option(help="Folder for timing.yaml and its picture.")] = Path("timing"),
) -> None:
    """Measure the delay and the refresh of the projector, and recommend exposure and settle time."""
    from fringedic.configuration.rig_file import load_rig_file
    from fringedic_bringup.procedures.timing import measure_rig_timing

    path = rig_path_of(rig)
    folder = unused_folder(output)
    with LiveProgress(console) as progress:
        report = measure_rig_timing(
            load_rig_file(path), path, folder, progress, exposure_time=1e-3 * exposure_ms, longest=1e-3 * longest_ms
        )
    say(*report.words)
    say(f"set in the rig file:\n{report.settings}", f"picture: {folder / 'timing.png'}")


@app.command(rich_help_panel=SET_UP, epilog="Example: fringedic response plate.yaml --output response")
def response(
    rig: Rig,
    output: Annotated[Path, typer.Option(help="Folder for response.yaml and its picture.")] = Path("response"),
) -> None:
    """Measure the response curve of projector and camera, and the phase error without and with its correction."""
    from fringedic.configuration.rig_file import load_rig_file
    from fringedic_bringup.procedures.response import PICTURE, measure_rig_response

    path = rig_path_of(rig)
    folder = unused_folder(output)
    with LiveProgress(console) as progress:
        report = measure_rig_response(load_rig_file(path), path, folder, progress)
    say(*report.words)
    if report.setting:
        say(f"set in the rig file:\n{report.setting}")
    say(f"picture: {folder / PICTURE}")


@app.command(rich_help_panel=SET_UP, epilog="Example: fringedic region plate.yaml --output region.png")
def region(
    source: Annotated[
        Path,
        typer.Argument(metavar="IMAGE|RIG", help="Image file, or rig file to take one frame.", callback=begin),
    ],
    output: Annotated[Path, typer.Option(help="Mask image; the polygons are written beside it as .yaml.")] = Path(
        "region.png"
    ),
    overwrite: Overwrite = False,
) -> None:
    """Draw the region of interest in a window; write a mask for fringedic measure and polygons for the rig file."""
    from fringedic.frames.files import IMAGE_SUFFIXES
    from fringedic_bringup.display.region_window import draw_region
    from fringedic_bringup.procedures.region import RIG_SUFFIXES, image_of

    if output.suffix.lower() not in IMAGE_SUFFIXES:
        raise ConfigurationError(f"--output {output}: is no name of an image; take a name that ends in .png")
    for file in (output, output.with_suffix(".yaml")):
        if file.resolve() == source.resolve():
            raise ConfigurationError(f"--output {output}: would replace {source}; choose another --output")
        output_file(file, overwrite)
    is_rig = source.suffix in ("", *RIG_SUFFIXES)  # installed rig files are named without suffix
    drawn = draw_region(image_of(rig_path_of(source) if is_rig else source))
    if drawn is None:
        say("no region was drawn")
        raise typer.Exit(1)
    picture, corners = drawn.save(output)
    share = 100 * drawn.mask().mean()
    say(
        f"mask: {picture}, {share:.0f} % of the image",
        f"polygons: {corners}; to use them, write their path into the rig file as region_file",
    )
