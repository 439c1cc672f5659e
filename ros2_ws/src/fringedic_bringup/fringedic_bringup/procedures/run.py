"""One experiment from start to end: start the nodes, drive move -> hold -> measure, write the results."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from fringedic.calibration.sentences import in_force_words
from fringedic.command.outcome import Progress, RunReport
from fringedic.command.run_results import Reconstruct, sign_results, write_results
from fringedic.configuration.forecast import Forecast, forecast
from fringedic.configuration.programme import Programme
from fringedic.configuration.programme_check import check_programme
from fringedic.configuration.rig_file import RigFile, load_programme, load_rig_file
from fringedic.configuration.sections import VIRTUAL_RIG
from fringedic.configuration.sentences import forecast_sentence
from fringedic.configuration.virtual_calibration import calibration_of
from fringedic.errors import ConfigurationError, ImageError
from fringedic.evidence.changes import noted
from fringedic.frames.files import image_files
from fringedic.settings.camera import FilesCamera, StoredImages
from fringedic_bringup.launch.graph import rig_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.continuing import (
    CONTINUED,
    calibrations_in,
    folder_of_one_command,
    go_on,
    require_recording,
)
from fringedic_bringup.procedures.driving import drive
from fringedic_bringup.procedures.outcome import RunControl
from fringedic_bringup.procedures.recording_parts import join_parts


def load_rig(
    rig_path: Path, programme_path: Path | None, images: Path | None, *, sensor: str | None = None
) -> tuple[RigFile, Programme]:
    """Read what a run needs.

    Parameters
    ----------
    rig_path, programme_path
        The rig file, and a programme that replaces the one in it.
    images
        Folder or pattern that replaces ``camera.files``.
    sensor
        Name of the sensor, if the rig file has several.

    Raises
    ------
    ConfigurationError
        A file is not valid, names images that do not exist, or no programme defines the steps.
    """
    rig = load_rig_file(rig_path, sensor=sensor)
    if images is not None:
        if rig.camera.source != "files":
            raise ConfigurationError(f"{rig_path}: camera.source is {rig.camera.source}; only 'files' takes images")
        rig = rig.model_copy(update={"camera": rig.camera.model_copy(update={"files": str(images.absolute())})})
    programme = load_programme(programme_path) if programme_path is not None else rig.programme
    if isinstance(rig.camera, FilesCamera):
        try:
            count = len(image_files([Path(rig.camera.files)]))
        except ImageError as error:
            raise ConfigurationError(f"{error}; give their folder with --images") from error
        if programme is None:
            programme = Programme.model_validate({"experiment": rig_path.stem, "steps": [{"mode": "white"}] * count})
    if programme is None:
        raise ConfigurationError(f"{rig_path}: has no programme; add one or give it with --programme")
    if programme.specimen is not None:
        rig = rig.model_copy(update={"specimen": programme.specimen})
    return rig, programme


def run_experiment(
    rig: RigFile,
    rig_path: Path,
    programme: Programme,
    folder: Path,
    progress: Progress,
    *,
    domain: int | None = None,
    resume: bool = False,
    control: RunControl | None = None,
) -> RunReport:
    """Run a programme on a rig and leave recording, dataset, pictures, report and logs in a folder.

    A step that fails is reported and the programme continues. A node that ends is started again, and the step is
    repeated. When that does not help the programme ends early, with the results of what was measured.

    Parameters
    ----------
    rig, rig_path
        The rig file, and where it was read.
    programme
        The load steps.
    folder
        Where ``bag``, ``logs``, the dataset ``results.nc``, ``report.html``, a picture per step and, for a virtual
        rig, ``truth.nc`` are written.
    progress
        Receives the progress.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.
    resume
        Go on with the programme where the recording in the folder ends; all steps are then measured again from the
        recorded frames, against the first one.
    control
        Pauses or ends the programme on request of an operator.

    Raises
    ------
    ConfigurationError
        The programme has moves that the rig cannot make; the folder contains a recording already, or another
        command uses it; or, with `resume`, it contains none, or programme, settings or camera do not continue it.
    RecordingError
        The disk has less space than the programme needs; nothing was started.
    NodeDiedError, WaitTimeoutError, StepFailedError
        The nodes did not start, or one of them ended repeatedly.
    """
    check_programme(rig, programme)
    require_recording(folder, is_there=resume)
    if resume and isinstance(rig.camera, StoredImages):
        raise ConfigurationError(
            f"{folder} cannot be continued, because the camera would read its files from the first image again; start "
            "a new run"
        )
    if not resume:
        announce(forecast(rig, programme), programme.experiment, folder, progress)
    with folder_of_one_command(folder), noted(folder, CONTINUED):
        before, calibrations = None, calibrations_in(folder, [rig])
        graph = rig_graph(rig, rig_path, folder, experiment=programme.experiment)
        if resume:
            graph, before = go_on(graph, folder, programme, [rig], calibrations, progress, domain=domain)
            announce(forecast(rig, programme, before.done), programme.experiment, folder, progress)
        note_calibrations([rig], progress)
        progress.stage(f"{programme.experiment}: starting {len(graph.nodes)} nodes")
        with RunningGraph(graph, folder / "logs", domain=domain) as running:
            driven = drive(running, programme, progress, domain=domain, before=before, control=control)
            progress.stage(f"{programme.experiment}: closing the recording")
        join_parts(folder / "bag", progress, rig.recording.split)
        progress.stage(f"{programme.experiment}: writing dataset, pictures and report")
        report = write_results(
            programme.experiment,
            folder,
            driven.steps,
            exact=exact_reconstruction(rig),
            measure_again=driven.measure_again,
        )
        report.ended_early, report.interrupted = driven.ended_early, driven.interrupted
        if problem := sign_results(
            report, operator=rig.specimen.operator, calibration={rig.sensor: rig.calibration_file}
        ):
            progress.note(problem)
        return report


def announce(expected: Forecast, name: str, folder: Path, progress: Progress) -> None:
    """Tell what a programme needs, and refuse it if the disk has less space."""
    progress.note(f"{name}: {forecast_sentence(expected)}")
    expected.check_disk(folder)


def note_calibrations(rigs: Sequence[RigFile], progress: Progress) -> None:
    """Tell which calibrations are in force, and what is to know about them; of several sensors with their names."""
    for rig in rigs:
        whose = f"{rig.sensor}: " if len(rigs) > 1 else ""
        if rig.calibration_file is not None:
            for words in in_force_words(rig.calibration_file, datetime.now(UTC)):
                progress.note(f"{whose}{words}")


def exact_reconstruction(rig: RigFile) -> Reconstruct | None:
    """Return a reconstruction with the exact calibration of a virtual rig; None when the run uses that one anyway."""
    if rig.virtual_rig is None or rig.calibration in (None, VIRTUAL_RIG):
        return None
    model, finest = calibration_of(rig.virtual_configuration()), rig.patterns()[-1]
    return lambda phase: model.reconstruct(phase, finest.pitch, orientation=finest.orientation)
