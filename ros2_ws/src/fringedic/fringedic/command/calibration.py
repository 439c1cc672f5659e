"""Subcommands that calibrate a rig and check its calibration."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from fringedic.command.app import (
    SET_UP,
    Overwrite,
    Rig,
    RigSensor,
    app,
    begin,
    console,
    given,
    losses,
    output_file,
    refuse_unused,
    say,
)
from fringedic.command.folders import unused_folder
from fringedic.command.outcome import CalibrationReport
from fringedic.command.plugins import rig_procedure
from fringedic.command.progress import LiveProgress
from fringedic.configuration.installed_rigs import rig_path_of
from fringedic.errors import ConfigurationError


@app.command(
    rich_help_panel=SET_UP,
    epilog="Example: fringedic calibrate plate.yaml --angles-deg 0,-15,-10,-5,5,10,15 --output calibration",
)
def calibrate(
    context: typer.Context,
    rig: Annotated[
        Path | None, typer.Argument(metavar="RIG", help="Rig file; its section reference_plane defines the planes.")
    ] = None,
    angles_deg: Annotated[
        str | None,
        typer.Option(help="Other angles of the plane in degree, separated by commas; the last but one tests the fit."),
    ] = None,
    recording: Annotated[
        Path | None, typer.Option("--from", help="Repeat the calculation from the recording of a calibration.")
    ] = None,
    sensor: Annotated[
        str | None,
        typer.Option("--sensor", metavar="NAME", help="Name of the sensor, if rig file or recording have several."),
    ] = None,
    output: Annotated[Path, typer.Option(help="Folder for calibration, report and recording.")] = Path("calibration"),
) -> None:
    """Calibrate camera and rig with a printed grid and a plane at known angles; exit code 1 for NO-GO."""
    if (rig is None) == (recording is None):
        raise ConfigurationError("give a rig file, or with --from the recording of a calibration")
    if recording is not None:
        refuse_unused(context, {"angles_deg"}, "--from takes the angles from the recording; leave one of them out")
    begin(rig or recording or output)
    folder = unused_folder(output)
    say(*(losses(recording) if recording is not None else []))
    with LiveProgress(console) as progress:
        if recording is not None:
            from fringedic.command.calibrate_again import calibrate_again

            report = calibrate_again(recording, folder, progress, sensor)
        elif rig is not None:
            report = _calibrate_with_nodes(rig_path_of(rig), sensor, angles_deg, folder, progress)
    say(*report.words)
    if report.report is not None:
        say(f"report: {report.report}")
    if not report.go:
        raise typer.Exit(1)
    say(f"calibration: {report.file}; to use it, write its path into the rig file as calibration")


def _calibrate_with_nodes(
    rig_path: Path, sensor: str | None, angles_deg: str | None, folder: Path, progress: LiveProgress
) -> CalibrationReport:
    from fringedic.configuration.changes import with_angles
    from fringedic.configuration.rig_file import load_rig_file

    calibrate_rig = rig_procedure("calibrate")
    rig_file = load_rig_file(rig_path, sensor=sensor)
    if angles_deg is not None:
        rig_file = with_angles(rig_file, angles_deg)
    report: CalibrationReport = calibrate_rig(rig_file, rig_path, folder, progress, ask=progress.ask)
    return report


@app.command(
    rich_help_panel=SET_UP,
    epilog="Example: fringedic check plate.yaml --distance-mm 5; of several sensors: "
    "fringedic check recordings/bar/bag --balls-mm 10 --distance-mm 80.002",
)
def check(  # noqa: PLR0913 (options of a command)
    context: typer.Context,
    rig: Rig,
    distance_mm: Annotated[
        float,
        typer.Option(
            min=0.1,
            max=1000,
            help="Distance in mm by which a gauge block or a stage lifts the plane towards the camera.",
        ),
    ] = 5.0,
    vdi: Annotated[
        bool,
        typer.Option("--vdi", help="Acceptance test with balls, a ball bar and a plane (section acceptance) instead."),
    ] = False,
    sensor: RigSensor = None,
    output: Annotated[Path, typer.Option(help="Folder for page and recording.")] = Path("check"),
    balls_mm: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            help="Diameter of the two balls of a bar that several sensors recorded: the argument is this recording, "
            "and --distance-mm the distance of their centres.",
        ),
    ] = None,
    sigma_um: Annotated[
        float, typer.Option(min=0.0, help="With --balls-mm: standard uncertainty of the distance in µm.")
    ] = 0.0,
    registration: Annotated[
        Path | None,
        typer.Option(help="With --balls-mm: poses of the sensors; by default registration.yaml beside the recording."),
    ] = None,
) -> None:
    """Measure the reference plane and a known distance; exit code 1 if the calibration is no longer valid.

    With --balls-mm the distance is one across several sensors, which tests their registration.
    """
    if balls_mm is not None:
        refuse_unused(context, {"vdi", "output"}, "--balls-mm checks a recording; leave this out")
        if not given(context, "distance_mm"):
            raise ConfigurationError("--balls-mm needs --distance-mm, the distance of the centres of the balls")
        _check_across(rig, 1e-3 * balls_mm, 1e-3 * distance_mm, 1e-6 * sigma_um, registration)
        return
    refuse_unused(context, {"sigma_um", "registration"}, "belongs to --balls-mm; leave it out")
    if vdi:
        refuse_unused(context, {"distance_mm"}, "--vdi measures artefacts, not a distance; leave one of them out")
        _accept(rig_path_of(rig), sensor, output)
        return
    from fringedic.calibration.sentences import check_sentence, check_warning_sentences
    from fringedic.configuration.rig_file import load_rig_file
    from fringedic.report.check import CHECK_PAGE

    check_rig = rig_procedure("check")
    path = rig_path_of(rig)
    folder = unused_folder(output)
    with LiveProgress(console) as progress:
        rig_file = load_rig_file(path, sensor=sensor)
        result = check_rig(rig_file, path, folder, progress, distance=1e-3 * distance_mm, ask=progress.ask)
    say(check_sentence(result), *check_warning_sentences(result), f"page: {folder / CHECK_PAGE}")
    if not result.holds:
        raise typer.Exit(1)


def _check_across(bag: Path, diameter: float, distance: float, sigma: float, registration: Path | None) -> None:
    """Compare a known distance across the sensors of a recording; exit code 1 if it deviates."""
    from fringedic.sensors import measure_distances
    from fringedic.sensors.files import load_registration
    from fringedic.sensors.recorded import registration_of
    from fringedic.sensors.sentences import distances_in_words

    file = registration or registration_of(bag)
    if file is None:
        raise ConfigurationError(
            f"{bag}: there is no registration.yaml beside the recording: give the file with --registration, or "
            "register the sensors with 'fringedic register'"
        )
    with LiveProgress(console) as progress:
        progress.stage(f"measuring the balls of {bag}")
        found = measure_distances(
            bag, load_registration(file), distance, diameter=diameter, sigma=sigma, progress=progress.note
        )
    say(*distances_in_words(found))
    if not all(each.holds for each in found):
        raise typer.Exit(1)


def _accept(path: Path, sensor: str | None, output: Path) -> None:
    """Run the acceptance test; exit code 1 if an error exceeds its limit."""
    from fringedic.calibration.acceptance_sentences import acceptance_text
    from fringedic.command.acceptance import accept
    from fringedic.configuration.rig_file import load_rig_file
    from fringedic.report.acceptance import ACCEPTANCE_PAGE

    folder = unused_folder(output)
    with LiveProgress(console) as progress:
        rig_file = load_rig_file(path, sensor=sensor)
        result = accept(rig_file, path, folder, progress, measure=lambda: rig_procedure("artefacts"), ask=progress.ask)
    say(acceptance_text(result), f"page: {folder / ACCEPTANCE_PAGE}")
    if not result.passed:
        raise typer.Exit(1)


@app.command(rich_help_panel=SET_UP, epilog="Example: fringedic target --pitch-mm 0.5 --output grid.pdf")
def target(
    pitch_mm: Annotated[float, typer.Option(help="Distance of the lines in mm; 6 to 15 pixels of the camera.")],
    output: Annotated[Path, typer.Option(help="File to write, .pdf or .svg.")] = Path("grid.pdf"),
    page: Annotated[str, typer.Option(help="A4 or A3.")] = "A4",
    turned_degree: Annotated[float, typer.Option(help="Angle of the grid on the page in degree.")] = 2.0,
    overwrite: Overwrite = False,
) -> None:
    """Write the printable grid from which the distortion of the camera and the scale are measured."""
    from fringedic.camera.target import Target

    grid = Target(1e-3 * pitch_mm, page, math.radians(turned_degree))
    file = output_file(output, overwrite)
    file.parent.mkdir(parents=True, exist_ok=True)
    grid.save(file)
    say(f"grid: {output}; print it at 100 %, measure its ruler and keep it flat")
