"""Subcommands that start nodes to set up a rig."""

from __future__ import annotations

from contextlib import closing, suppress
from pathlib import Path
from typing import Annotated

import typer

from fringedic.command.app import SET_UP, Rig, RigSensor, app, begin, console, say
from fringedic.command.folders import unused_folder
from fringedic.command.progress import LiveProgress
from fringedic.configuration.installed_rigs import rig_path_of
from fringedic.errors import ConfigurationError
from fringedic_bringup.setup_patterns import LivePattern, ShownPattern


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
    sensor: RigSensor = None,
) -> None:
    """Show the figures of the camera image during set-up: focus, grey levels, speckle size, fringes and noise."""
    from fringedic.configuration.rig_file import load_rig_file
    from fringedic_bringup.display.live import draw_continuously, print_once
    from fringedic_bringup.procedures.live import FRAMES_OF_ONE_LOOK, part_of_image, watch

    path, part = rig_path_of(rig), part_of_image(region)
    with (
        suppress(KeyboardInterrupt),
        closing(watch(load_rig_file(path, sensor=sensor), path, pattern, region=part)) as views,
    ):
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


@app.command(rich_help_panel=SET_UP, epilog="Example: fringedic show RIG.yaml crosshair")
def show(
    rig: Rig,
    pattern: Annotated[
        str,
        typer.Argument(
            metavar="PATTERN", help="crosshair, grid, focus (lines of 1 to 4 px), white, grey, dark or fringes."
        ),
    ] = "crosshair",
    sensor: RigSensor = None,
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
        hold_pattern(load_rig_file(path, sensor=sensor), path, ShownPattern(pattern), wait_for_enter)


@app.command(rich_help_panel=SET_UP, epilog="Example: fringedic timing plate.yaml --output timing")
def timing(
    rig: Rig,
    exposure_ms: Annotated[
        float, typer.Option(min=0.05, max=1000, help="Exposure time; short compared with the refresh of the projector.")
    ] = 3.0,
    longest_ms: Annotated[float, typer.Option(min=20, max=10_000, help="Longest delay of a pattern.")] = 300.0,
    output: Annotated[Path, typer.Option(help="Folder for timing.yaml and its picture.")] = Path("timing"),
    sensor: RigSensor = None,
) -> None:
    """Measure the delay and the refresh of the projector, and recommend exposure and settle time."""
    from fringedic.configuration.rig_file import load_rig_file
    from fringedic_bringup.procedures.timing import measure_rig_timing

    path = rig_path_of(rig)
    folder = unused_folder(output)
    with LiveProgress(console) as progress:
        report = measure_rig_timing(
            load_rig_file(path, sensor=sensor),
            path,
            folder,
            progress,
            exposure_time=1e-3 * exposure_ms,
            longest=1e-3 * longest_ms,
        )
    say(*report.words)
    say(f"set in the rig file:\n{report.settings}", f"picture: {folder / 'timing.png'}")


@app.command(rich_help_panel=SET_UP, epilog="Example: fringedic response plate.yaml --output response")
def response(
    rig: Rig,
    output: Annotated[Path, typer.Option(help="Folder for response.yaml and its picture.")] = Path("response"),
    sensor: RigSensor = None,
) -> None:
    """Measure the response curve of projector and camera, and the phase error without and with its correction."""
    from fringedic.configuration.rig_file import load_rig_file
    from fringedic_bringup.procedures.response import PICTURE, measure_rig_response

    path = rig_path_of(rig)
    folder = unused_folder(output)
    with LiveProgress(console) as progress:
        report = measure_rig_response(load_rig_file(path, sensor=sensor), path, folder, progress)
    say(*report.words)
    if report.setting:
        say(f"set in the rig file:\n{report.setting}")
    say(f"picture: {folder / PICTURE}")
