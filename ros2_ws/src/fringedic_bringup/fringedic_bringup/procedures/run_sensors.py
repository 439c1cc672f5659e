"""One experiment of several sensors: one load frame, one recording, and results of each sensor and of all together."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path

from fringedic.command.outcome import Progress, RunReport
from fringedic.command.run_results import sign_results, write_joined_results, write_results
from fringedic.configuration.forecast import Forecast, forecast
from fringedic.configuration.programme import Programme
from fringedic.configuration.programme_check import check_programme
from fringedic.configuration.rig_sensors import RigSensors
from fringedic.errors import ConfigurationError, FringedicError
from fringedic.evidence.changes import noted
from fringedic.sensors.files import REGISTRATION_FILE
from fringedic.settings.camera import FilesCamera
from fringedic_bringup.launch.graph import registration_of, rig_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.continuing import (
    CONTINUED,
    calibrations_in,
    folder_of_one_command,
    go_on,
    require_recording,
)
from fringedic_bringup.procedures.driving import Driven, drive
from fringedic_bringup.procedures.outcome import RunControl
from fringedic_bringup.procedures.recording_parts import join_parts
from fringedic_bringup.procedures.run import announce, exact_reconstruction, load_rig, note_calibrations


@dataclass(frozen=True)
class SensorsReport:
    """Outcome of a run of several sensors.

    Attributes
    ----------
    reports
        Of each sensor.
    joined
        Dataset of the joined surface; None without one.
    words
        Sentences about the joined surface, or why there is none.
    """

    reports: list[RunReport]
    joined: Path | None
    words: list[str]


def load_sensors(sensors: RigSensors, rig_path: Path, programme_path: Path | None) -> tuple[RigSensors, Programme]:
    """Return what a run of several sensors needs, from the sensors of a rig file.

    Raises
    ------
    ConfigurationError
        A file is not valid, or no programme defines the steps; or these sensors cannot measure it.
    CalibrationError
        The registration cannot be used, or is that of other sensors or calibrations.
    """
    first, programme = load_rig(rig_path, programme_path, None, sensor=sensors.names[0])
    if any(step.mode == "moving" for step in programme.load_steps()):
        raise ConfigurationError(
            f"{rig_path}: several sensors measure one after the other, so that a moving specimen would be in another "
            "place for each: measure it step by step, or with --sensor"
        )
    if any(isinstance(rig.camera, FilesCamera) for rig in sensors.rigs):
        raise ConfigurationError(
            f"{rig_path}: images of several sensors are processed one sensor at a time: use --sensor"
        )
    registration_of(sensors)
    return sensors.changed(lambda rig: rig.model_copy(update={"specimen": first.specimen})), programme


def run_sensors(
    sensors: RigSensors,
    rig_path: Path,
    programme: Programme,
    folder: Path,
    progress: Progress,
    *,
    domain: int | None = None,
    resume: bool = False,
    control: RunControl | None = None,
) -> SensorsReport:
    """Run a programme on a rig of several sensors, see `run_experiment`.

    A step is measured by the sensors one after the other. One that fails fails its own part; the programme continues.

    Parameters
    ----------
    sensors, rig_path, programme
        From `load_sensors`, and where the rig file was read.
    folder
        Where ``bag``, ``logs``, for each sensor ``results.left.nc``, ``report.left.html`` and a folder of pictures
        ``left`` are written, and ``bag.joined.nc`` with ``report.html`` where the sensors are registered.
    progress, domain, resume, control
        As of `run_experiment`.

    Raises
    ------
    ConfigurationError, RecordingError, NodeDiedError, WaitTimeoutError, StepFailedError
        As of `run_experiment`.
    """
    for rig in sensors.rigs:
        check_programme(rig, programme)
    require_recording(folder, is_there=resume)
    name = f"{programme.experiment}: {', '.join(sensors.names)}"
    if not resume:
        announce(_forecast(sensors, programme), name, folder, progress)
    common, *others = sensors.rigs
    registration = registration_of(sensors)
    with folder_of_one_command(folder), noted(folder, CONTINUED):
        before, calibrations = None, calibrations_in(folder, sensors.rigs)
        graph = rig_graph(
            common, rig_path, folder, experiment=programme.experiment, others=others, registration=registration
        )
        if resume:
            graph, before = go_on(graph, folder, programme, sensors.rigs, calibrations, progress, domain=domain)
            announce(_forecast(sensors, programme, before.done), name, folder, progress)
        elif sensors.registration is not None:  # it belongs to the recording, as the calibrations
            shutil.copyfile(sensors.registration, folder / REGISTRATION_FILE)
        note_calibrations(sensors.rigs, progress)
        progress.stage(f"{programme.experiment}: starting {len(graph.nodes)} nodes")
        with RunningGraph(graph, folder / "logs", domain=domain) as running:
            driven = drive(running, programme, progress, domain=domain, before=before, control=control)
            progress.stage(f"{programme.experiment}: closing the recording")
        join_parts(folder / "bag", progress, common.recording.split)
        return _results(sensors, programme.experiment, folder, driven, progress)


def _results(sensors: RigSensors, experiment: str, folder: Path, driven: Driven, progress: Progress) -> SensorsReport:
    """Write the results of each sensor, sign the run, and join the sensors."""
    reports = []
    for rig in sensors.rigs:
        progress.stage(f"{experiment}: writing dataset, pictures and report of {rig.sensor}")
        report = write_results(
            experiment,
            folder,
            [step for step in driven.steps if step.sensor == rig.sensor],
            exact=exact_reconstruction(rig),
            measure_again=rig.sensor in driven.sensors_again,
            sensor=rig.sensor,
        )
        report.ended_early, report.interrupted = driven.ended_early, driven.interrupted
        reports.append(report)
    files = {rig.sensor: rig.calibration_file for rig in sensors.rigs}
    if problem := sign_results(*reports, operator=sensors.common.specimen.operator, calibration=files):
        progress.note(problem)
    if sensors.registration is None:
        unregistered = (
            "the sensors are not registered, so that there is no joined surface: record an object that all see, and "
            f"'fringedic register'; then 'fringedic process {folder / 'bag'} --registration FILE' joins this test, too"
        )
        return SensorsReport(reports, None, [unregistered])
    progress.stage(f"{experiment}: joining the surfaces of {', '.join(sensors.names)}")
    try:
        joined, words = write_joined_results(folder)
    except FringedicError as error:
        return SensorsReport(reports, None, [f"no joined surface: {error}"])
    return SensorsReport(reports, joined, words)


def _forecast(sensors: RigSensors, programme: Programme, done: int = 0) -> Forecast:
    """Return the forecast of all sensors for the steps that are not done."""
    return reduce(_added, (forecast(rig, programme, done) for rig in sensors.rigs))


def _added(first: Forecast, second: Forecast) -> Forecast:
    """Return the forecast of two sensors that measure the same steps one after the other."""
    return replace(
        first,
        frames=first.frames + second.frames,
        duration=first.duration + second.duration,
        writing=first.writing + second.writing,
        size=first.size + second.size,
    )
