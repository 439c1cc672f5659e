"""Subcommands that run, replay and demonstrate experiments."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fringedic.command.app import (
    MEASURE,
    RESULTS,
    Bags,
    Calibration,
    Output,
    ReferenceStep,
    Rig,
    RigSensor,
    Sensor,
    Settings,
    Steps,
    app,
    begin,
    calibration_file,
    console,
    for_each,
    losses,
    next_reading,
    parameter_values,
    refuse_unused,
    say,
)
from fringedic.command.folders import output_folder, unused_folder
from fringedic.command.outcome import RunReport
from fringedic.command.progress import LiveProgress
from fringedic.command.run_table import report_table
from fringedic.configuration.installed_rigs import rig_path_of
from fringedic.errors import ConfigurationError, StepFailedError
from fringedic.frames.sensor import file_of
from fringedic.recording.bag_files import BAG
from fringedic.wording.path_names import recording_names

if TYPE_CHECKING:
    from fringedic.configuration.programme import Programme
    from fringedic.configuration.rig_file import RigFile
    from fringedic.configuration.rig_sensors import RigSensors


class Specimen(StrEnum):
    """The virtual experiments of the demo."""

    PLATE = "plate"
    SKIN = "skin"
    LEATHER = "leather"


@app.command(
    rich_help_panel=MEASURE,
    epilog="Example: fringedic run plate.yaml --programme slow.yaml --output recordings/plate-7",
)
def run(
    context: typer.Context,
    rig: Rig,
    programme: Annotated[Path | None, typer.Option(help="Load steps that replace those in the rig file.")] = None,
    output: Output = None,
    images: Annotated[Path | None, typer.Option(help="Folder of images for a rig whose camera reads files.")] = None,
    sensor: RigSensor = None,
    resume: Annotated[
        bool, typer.Option("--continue", help="Go on with the programme where the recording in --output ends.")
    ] = False,
) -> None:
    """Run the load steps of a rig: start its nodes; move, hold and measure each step; record everything."""
    from fringedic.configuration.rig_sensors import load_rig_sensors
    from fringedic_bringup.procedures.run import load_rig, run_experiment

    if resume and output is None:
        raise ConfigurationError("--continue needs --output, the folder of the run to go on with")
    path = rig_path_of(rig)
    sensors = load_rig_sensors(path, sensor)
    if len(sensors.rigs) > 1:
        refuse_unused(context, {"images"}, "is not possible for several sensors; leave it out")
        _run_sensors(sensors, path, programme, output, resume=resume)
        return
    rig_file, steps = load_rig(path, programme, images, sensor=sensor)
    folder = _folder(output, rig_file, steps)
    with LiveProgress(console) as progress:
        report = run_experiment(rig_file, path, steps, folder, progress, resume=resume)
    _tell(report)
    _check([report])


def _run_sensors(sensors: RigSensors, path: Path, programme: Path | None, output: Path | None, *, resume: bool) -> None:
    from fringedic_bringup.procedures.run_sensors import load_sensors, run_sensors

    sensors, steps = load_sensors(sensors, path, programme)
    folder = _folder(output, sensors.common, steps)
    with LiveProgress(console) as progress:
        outcome = run_sensors(sensors, path, steps, folder, progress, resume=resume)
    for report in outcome.reports:
        say(f"sensor {report.sensor}")
        _tell(report)
    if outcome.joined is not None:
        say(f"joined surface: {outcome.joined}, report: {folder / 'report.html'}")
    say(*outcome.words)
    _check(outcome.reports)


def _folder(output: Path | None, rig: RigFile, programme: Programme) -> Path:
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%S")
    return output_folder(output or Path(rig.recording.folder) / f"{programme.experiment}-{stamp}")


@app.command(rich_help_panel=MEASURE, epilog="Example: fringedic demo --output demo plate leather")
def demo(
    specimens: Annotated[
        list[Specimen] | None, typer.Argument(metavar="SPECIMENS", help="Virtual experiments; all by default.")
    ] = None,
    output: Annotated[Path, typer.Option(help="Folder for recordings, datasets and pictures.")] = Path("demo"),
) -> None:
    """Calibrate virtual rigs, measure three specimens with the real nodes and compare with the ground truth."""
    begin(Path(", ".join(specimens or list(Specimen))))
    from fringedic_bringup.launch.environment import private_domain
    from fringedic_bringup.procedures.demo import run_demo

    rigs = {specimen.value: rig_path_of(Path(specimen)) for specimen in specimens or list(Specimen)}
    with LiveProgress(console) as progress, private_domain() as domain:
        reports = []
        for report in run_demo(rigs, unused_folder(output), progress, domain=domain):
            _tell(report)  # at once: the next experiment takes minutes
            reports.append(report)
            if report.interrupted:
                break
    _check(reports)


@app.command(
    rich_help_panel=RESULTS,
    epilog="Example: fringedic replay recordings/plate-7/bag --set dic.window=24 --output window-24",
)
def replay(
    bags: Bags,
    settings: Settings = None,
    steps: Steps = None,
    reference: ReferenceStep = None,
    calibration: Calibration = None,
    sensor: Sensor = None,
    output: Output = None,
) -> None:
    """Process recordings again with newly started nodes, as fast as possible, and record the results."""
    from fringedic_bringup.procedures.replay import replay as replay_bag

    names = recording_names(bags)
    overrides = _by_node(parameter_values(settings))
    model = None if calibration is None else calibration_file(calibration)

    def work(bag: Path) -> None:
        folder = unused_folder(bag.with_name(f"{bag.name}_replayed"))
        if output is not None:
            folder = output_folder(output if len(bags) == 1 else output / names[str(bag)])
        say(*losses(bag))
        with LiveProgress(console) as progress:
            target = replay_bag(
                bag,
                folder,
                progress,
                overrides=overrides,
                steps=steps or (),
                reference=reference,
                calibration=model,
                sensor=sensor,
            )
        say(f"recording: {target}", next_reading(target))

    for_each(bags, work)


def _by_node(values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    from fringedic_bringup.launch.graph import PROCESSING_NODES

    nodes: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        node, parameter = name.split(".")
        if node not in PROCESSING_NODES:
            raise ConfigurationError(f"--set {name}: a replay starts {', '.join(PROCESSING_NODES)}, not {node}")
        nodes.setdefault(node, {})[parameter] = value
    return nodes


def _tell(report: RunReport) -> None:
    """Print the outcome of an experiment."""
    console.print(report_table(report))
    if report.ended_early:
        say(f"{report.experiment} ended early: {report.ended_early}")
    if report.unmeasured:
        say(f"{report.folder}: recording (bag), no dataset: {report.unmeasured}")
        say(f"'fringedic verify {report.folder / BAG}' checks the recording")
        return
    page = file_of(Path("report.html"), report.sensor) if report.sensor else "report.html"
    say(f"{report.folder}: {page}, recording (bag), dataset ({report.dataset}), {len(report.pictures)} pictures")
    if report.verdict:
        say(report.verdict)
    if report.pictures:
        say(f"picture of the last step: {_last_picture(report)}")


def _last_picture(report: RunReport) -> Path:
    """Return the picture of shape and displacement of the last step that has one."""
    return max(picture for picture in report.pictures if picture.stem.count("_") == 1)


def _check(reports: list[RunReport]) -> None:
    """End the command according to the outcome of experiments.

    Raises
    ------
    StepFailedError
        One of them is not complete.
    """
    for report in reports:
        if report.interrupted:
            say(f"{_measured(report)}; to go on, repeat the command with --output {report.folder} --continue")
            raise typer.Exit(130)
    failed = [" ".join(filter(None, (each.experiment, each.sensor))) for each in reports if each.failed]
    if failed:
        raise StepFailedError(f"steps failed, or frames or results are missing, in: {', '.join(failed)}")


def _measured(report: RunReport) -> str:
    count = sum(not step.error for step in report.steps)
    return f"{count} step{'s' if count != 1 else ''} measured and saved"
