"""Subcommands that read recordings, without ROS."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from fringedic.command.app import (
    RESULTS,
    Bag,
    Calibration,
    Output,
    Overwrite,
    Place,
    Places,
    ReferenceStep,
    Sensor,
    Settings,
    Source,
    Steps,
    Why,
    app,
    calibration_file,
    console,
    for_each,
    losses,
    named_gauges,
    named_regions,
    next_reading,
    output_file,
    parameter_values,
    say,
)
from fringedic.command.progress import LiveProgress
from fringedic.errors import ConfigurationError, ExportError, FringedicError, StepFailedError


@app.command(
    rich_help_panel=RESULTS,
    epilog="Example: fringedic process recordings/plate-7/bag --set coupling.z_filter_px=4 --output new.nc",
)
def process(  # noqa: PLR0913 (options of a command)
    bags: Places,
    settings: Settings = None,
    steps: Steps = None,
    reference: ReferenceStep = None,
    calibration: Calibration = None,
    experiment: Annotated[
        str | None, typer.Option(help="Name of the experiment, if the recording contains several.")
    ] = None,
    sensor: Sensor = None,
    output: Annotated[
        Path | None,
        typer.Option(help="Dataset, .nc or .zarr; by default beside the recording. For several recordings a folder."),
    ] = None,
    registration: Annotated[
        Path | None,
        typer.Option(help="Measure all sensors and their joined surface, with their poses from 'fringedic register'."),
    ] = None,
    overwrite: Overwrite = False,
    every_frame: Annotated[
        bool,
        typer.Option(
            "--every-frame",
            help="Between the stacks of a specimen in motion measure one for every frame; step 12 becomes 1200, and "
            "1203 is three frames later. By default written as bag.every-frame.nc beside the recording.",
        ),
    ] = False,
    why: Why = "",
) -> None:
    """Process recordings again without nodes and write the results as datasets.

    All sensors of a recording are measured, and their joined surface, if registration.yaml is beside it.
    """
    from fringedic.datasets import open_experiment, process_bag
    from fringedic.datasets.processing import PROCESSED_TOPICS
    from fringedic.datasets.sentences import confirmation_sentence, missing_settings_sentence, references_sentence
    from fringedic.evidence.changes import because
    from fringedic.recording.frames import records
    from fringedic.recording.reader import BagReader
    from fringedic.recording.remote import local_copy
    from fringedic.rig.model import RigModel
    from fringedic.steps.recorded_rig import missing_settings, require_calibration

    targets = _targets(bags, output, every_frame)
    values = parameter_values(settings)
    model = None if calibration is None else RigModel.from_yaml(calibration_file(calibration))

    def work(place: str) -> None:
        with local_copy(place, PROCESSED_TOPICS) as bag:
            sensors, poses = _sensors_to_join(bag, sensor, registration)
            if poses is None:
                measure(place, bag, sensor)
                return
            if model is not None or output is not None or every_frame:
                raise ConfigurationError(
                    "--calibration, --output and --every-frame are of one sensor: choose it with --sensor"
                )
            join_all(place, bag, sensors, poses)

    def join_all(place: str, bag: Path, sensors: list[str], poses: Path) -> None:
        from fringedic.sensors import join_recording
        from fringedic.sensors.sentences import joined_sentences

        for each in sensors:
            say(f"sensor {each}")
            try:
                measure(place, bag, each)
            except FringedicError as error:
                say(f"sensor {each}: {error}")
        written = join_recording(bag, poses, overwrite=overwrite)
        with open_experiment(written) as dataset:
            sentences = joined_sentences(dataset)
        say(f"joined surface: {written}", *sentences, next_reading(written))

    def measure(place: str, bag: Path, sensor: str | None) -> None:
        reader = BagReader(bag, sensor=sensor)
        if model is None:
            require_calibration(reader)
        missing = missing_settings(reader, records(reader))
        say(*losses(bag), *filter(None, [missing_settings_sentence(missing)]))
        errors = []
        with LiveProgress(console) as progress:
            progress.stage(f"processing {place}")

            def tell(step: int, error: str) -> None:
                errors.append(error)
                progress.note(f"step {step}: {error or 'measured'}")

            written = process_bag(
                bag,
                output=targets[place],
                overrides=values,
                steps=steps or None,
                reference=reference,
                calibration=model,
                experiment=experiment,
                sensor=sensor,
                overwrite=overwrite,
                every_frame=every_frame,
                progress=tell,
            )
        with open_experiment(written) as dataset:
            sentences = [references_sentence(dataset), confirmation_sentence(dataset)]
        say(f"dataset: {written}", f"whole: {errors.count('')} of {len(errors)} steps", *filter(None, sentences))
        if "" not in errors:
            raise StepFailedError(f"no step was measured, the reasons are above and in {written}")
        say(next_reading(written))

    if output is not None and len(bags) > 1:
        output.mkdir(parents=True, exist_ok=True)
    with because(why):
        for_each(bags, work)


def _sensors_to_join(bag: Path, sensor: str | None, registration: Path | None) -> tuple[list[str], Path | None]:
    """Return the sensors of a recording and the file with their poses; None if one sensor is to be measured."""
    from fringedic.recording.reader import BagReader

    if sensor is not None:
        if registration is not None:
            raise ConfigurationError("--registration joins all sensors: leave --sensor out")
        return [sensor], None
    sensors = sorted(BagReader(bag).sensors)
    if len(sensors) < 2:
        if registration is not None:
            raise ConfigurationError(f"{bag} contains one sensor only: leave --registration out")
        return sensors, None
    from fringedic.sensors.recorded import registration_of

    return sensors, registration or registration_of(bag)


def _targets(places: list[str], output: Path | None, every_frame: bool) -> dict[str, Path | None]:
    """Return the dataset of each recording, None for the one beside it."""
    from fringedic.recording.every_frame import EVERY_FRAME
    from fringedic.recording.remote import is_remote
    from fringedic.wording.path_names import recording_names

    suffix = f".{EVERY_FRAME}.nc" if every_frame else ".nc"
    if output is not None and len(places) == 1:
        return {places[0]: output}
    return {
        place: None if output is None and not is_remote(place) else (output or Path()) / f"{name}{suffix}"
        for place, name in recording_names(places).items()
    }


@app.command(rich_help_panel=RESULTS, epilog="Example: fringedic info recordings/plate-7/bag")
def info(bag: Place, sensor: Sensor = None) -> None:
    """List the content of a recording and whether it is complete."""
    from fringedic.frames.sensor import choice_of_sensors
    from fringedic.recording.programme_end import programme_end
    from fringedic.recording.reader import BagReader
    from fringedic.recording.remote import is_remote
    from fringedic.recording.repair import info as bag_info
    from fringedic.recording.sentences import clock_sentences, content_sentences, next_command, programme_sentences
    from fringedic.signals import attachment_names
    from fringedic.signals.clocks import recorded_clocks

    summary = bag_info(bag)
    start = datetime.fromtimestamp(summary.start_time * 1e-9, UTC)
    duration = (summary.end_time - summary.start_time) * 1e-9
    title = f"{bag}: {start:%Y-%m-%d %H:%M:%S} UTC, {duration:.1f} s, {summary.size / 1e6:.1f} MB"
    table = Table("topic", "type", title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("messages", justify="right")
    if summary.missing:
        table.add_column("lost", justify="right")
    for name, type_name in summary.types.items():
        lost = [str(summary.missing.get(name, ""))] if summary.missing else []
        table.add_row(name, type_name.replace("/msg/", "/"), str(summary.counts[name]), *lost)
    console.print(table)
    if is_remote(bag):  # clocks, programme and sensors are in the chunks, which are not fetched
        say(*content_sentences(summary), next_command(summary, summary.types))
        return
    sensors: dict[str, str] = {}
    with suppress(FringedicError):  # the records of a damaged recording may be unreadable
        sensors = BagReader(bag).sensors
    if sensor is None and len(sensors) > 1:
        say(choice_of_sensors(bag, sensors), *content_sentences(summary))
        return
    clocks, end = recorded_clocks(bag, sensor), programme_end(bag, sensor)
    attached = attachment_names(bag)
    say(
        *([f"attached: {', '.join(attached)}"] if attached else []),
        *clock_sentences(clocks),
        *content_sentences(summary),
        *programme_sentences(end),
        next_command(summary, summary.types),
    )


@app.command(rich_help_panel=RESULTS, epilog="Example: fringedic verify recordings/plate-7/bag")
def verify(bag: Bag) -> None:
    """Check that a recording or a dataset is complete and unchanged.

    Of a recording: checksums, the publishers' counts, the frames of every step. Of a dataset: all checksums.
    """
    from fringedic.datasets import open_experiment
    from fringedic.datasets.checksums import has_checksums, load_checked
    from fringedic.datasets.stores import SUFFIXES
    from fringedic.recording.sentences import verification_sentences
    from fringedic.recording.verification import verify as verify_bag

    if bag.suffix in SUFFIXES:
        with open_experiment(bag) as dataset:
            load_checked(dataset)
            known, count = has_checksums(dataset), len(dataset.variables)
        if not known:
            say(f"{bag}: contains no checksums; 'fringedic process' makes it again with them")
            raise typer.Exit(1)
        say(f"{bag}: the content of {count} variables is what was written")
        return
    verification = verify_bag(bag)
    say(*verification_sentences(verification))
    if not verification.complete:
        raise typer.Exit(1)


@app.command(rich_help_panel=RESULTS, epilog="Example: fringedic recover recordings/plate-7/bag --output saved")
def recover(bag: Bag, output: Output = None) -> None:
    """Write a complete recording from the readable part of a damaged one, and list what could not be read."""
    from fringedic.evidence.changes import noted
    from fringedic.recording.bag_files import beside
    from fringedic.recording.repair import recover as recover_bag
    from fringedic.recording.sentences import content_sentences, next_command

    target = beside(bag, "_recovered") if output is None else output
    with noted(target, "recovery of the readable part"):
        recovered = recover_bag(bag, target)
    whole = replace(recovered, missing={}, damage="")
    say(f"recording: {recovered.path}", *content_sentences(recovered), next_command(whole))


@app.command(
    rich_help_panel=RESULTS,
    epilog="Example: fringedic export recordings/plate-7/bag --to vtk --to csv --output plate-7",
)
def export(
    source: Source,
    formats: Annotated[
        list[str] | None,
        typer.Option("--to", metavar="FORMAT", help="netcdf, zarr, vtk, ply, csv, mat, tiff, png, gif or r3xa."),
    ] = None,
    steps: Annotated[list[int] | None, typer.Option("--step", help="Only this step; may be repeated.")] = None,
    sensor: Sensor = None,
    output: Output = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a dataset for other programs, by default as NetCDF and PNG."""
    from fringedic.datasets import open_experiment
    from fringedic.export import export_dataset
    from fringedic.recording.bag_files import beside

    folder = output or beside(source, "_exported")
    wanted = formats or ["netcdf", "png"]
    problems = 0
    with open_experiment(source, sensor=sensor) as dataset:
        for done in export_dataset(dataset, folder, wanted, steps=steps, overwrite=overwrite):
            if done.path:
                say(f"{done.format}: {done.path}")
            say(*(f"{done.format}: {problem}" for problem in done.problems))
            problems += done.path is None
    if problems:
        raise ExportError(f"{problems} of {len(wanted)} formats were not written, see above")


@app.command(rich_help_panel=RESULTS, epilog="Example: fringedic report recordings/plate-7/bag --output plate-7.html")
def report(  # noqa: PLR0913 (options of a command)
    source: Source,
    output: Annotated[Path | None, typer.Option(help="HTML file; report.html beside the recording by default.")] = None,
    static: Annotated[
        list[int] | None,
        typer.Option(
            "--static",
            metavar="STEP",
            help="Step at rest for the noise floor; by default the steps at the position of the reference.",
        ),
    ] = None,
    extensometer: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=COLUMN,ROW,COLUMN,ROW",
            help="Virtual extensometer between two pixels; by default those of the rig file.",
        ),
    ] = None,
    region: Annotated[
        list[str] | None, typer.Option(metavar="NAME=POLYGONS.yaml", help="Region whose mean values are listed.")
    ] = None,
    laboratory: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.yaml",
            help="Settings of the laboratory for the first page; laboratory.yaml beside the run or above by default.",
        ),
    ] = None,
    sensor: Sensor = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Print it as PDF, too; needs chromium.")] = False,
    overwrite: Overwrite = False,
    why: Why = "",
) -> None:
    """Write the report of an experiment as one HTML file that needs no network.

    Example: fringedic report my_test/bag --extensometer 200,480,1000,480
    """
    from fringedic.evidence.changes import because
    from fringedic.report import write_report
    from fringedic.report.printing import print_page

    with because(why):
        written = write_report(
            source,
            output,
            sensor=sensor,
            static_steps=static or None,
            gauges=named_gauges(extensometer) or None,
            regions=named_regions(region),
            laboratory=laboratory,
            overwrite=overwrite,
        )
        say(f"report: {written}")
        if pdf:
            say(f"PDF: {print_page(written, output_file(written.with_suffix('.pdf'), overwrite))}")
