"""One experiment from start to end: start the nodes, drive move -> hold -> measure, write the results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import xarray as xr

from fringedic.calibration.sentences import in_force_words
from fringedic.command.outcome import Progress
from fringedic.configuration.forecast import Forecast, forecast
from fringedic.configuration.programme import Programme
from fringedic.configuration.rig_file import RigFile, load_programme, load_rig_file
from fringedic.configuration.sections import VIRTUAL_RIG
from fringedic.configuration.sentences import forecast_sentence
from fringedic.configuration.virtual_calibration import calibration_of
from fringedic.datasets import dataset_from_derived, open_experiment, process_bag
from fringedic.datasets.sentences import confirmation_sentence
from fringedic.errors import ConfigurationError, DatasetError, ImageError
from fringedic.evaluation import compare_with_truth, open_truth
from fringedic.evaluation.truth import TRUTH
from fringedic.figures.maps import save_pictures
from fringedic.frames.files import image_files
from fringedic.frames.records import frame_record, stamp_of
from fringedic.recording.frames import EXPOSURE, IMAGE, with_losses
from fringedic.recording.reader import BagReader
from fringedic.report import write_report
from fringedic.settings.camera import FilesCamera, StoredImages
from fringedic_bringup.launch.environment import domain_of, node_environment
from fringedic_bringup.launch.graph import rig_graph
from fringedic_bringup.launch.processes import RunningGraph, require_no_nodes
from fringedic_bringup.procedures.continuing import (
    continued,
    folder_of_one_command,
    recorded_steps,
    require_same_calibration,
    require_same_messages,
    require_same_settings,
)
from fringedic_bringup.procedures.driving import drive
from fringedic_bringup.procedures.outcome import RunControl, RunReport, StepReport
from fringedic_bringup.procedures.recording_parts import join_parts

Reconstruct = Callable[[xr.DataArray], xr.Dataset]


def load_rig(rig_path: Path, programme_path: Path | None, images: Path | None) -> tuple[RigFile, Programme]:
    """Read what a run needs.

    Parameters
    ----------
    rig_path, programme_path
        The rig file, and a programme that replaces the one in it.
    images
        Folder or pattern that replaces ``camera.files``.

    Raises
    ------
    ConfigurationError
        A file is not valid, names images that do not exist, or no programme defines the steps.
    """
    rig = load_rig_file(rig_path)
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
        The programme moves a machine that the rig does not move; the folder contains a recording already, or another
        command uses it; or, with `resume`, it contains none, or programme, settings or camera do not continue it.
    RecordingError
        The disk has less space than the programme needs; nothing was started.
    NodeDiedError, WaitTimeoutError, StepFailedError
        The nodes did not start, or one of them ended repeatedly.
    """
    _require_moves(rig, programme)
    if (folder / "bag").exists() != resume:
        raise ConfigurationError(
            f"{folder} contains no recording to continue; give the folder of the run as --output"
            if resume
            else f"{folder} contains a recording already; choose another --output, or go on with it by --continue"
        )
    if resume and isinstance(rig.camera, StoredImages):
        raise ConfigurationError(
            f"{folder} cannot be continued, because the camera would read its files from the first image again; start "
            "a new run"
        )
    if not resume:
        _announce(forecast(rig, programme), programme, folder, progress)
    with folder_of_one_command(folder):
        bag, calibration, before = folder / "bag", folder / "calibration.yaml", None
        first_calibration = calibration.read_text() if resume and calibration.exists() else ""
        graph = rig_graph(rig, rig_path, folder, experiment=programme.experiment)
        if resume:
            require_same_calibration(calibration, first_calibration)
            # a recorder may still be writing what it has received
            require_no_nodes(domain_of(node_environment(domain)), graph)
            require_same_messages(bag)
            join_parts(bag, progress, rig.recording.split)  # of a command that was killed before it joined them
            before = recorded_steps(bag, programme, rig.namespace)
            require_same_settings(graph, folder / "logs")
            progress.note(f"{programme.experiment}: {len(before.measured)} steps are measured already")
            _announce(forecast(rig, programme, before.done), programme, folder, progress)
            graph = continued(graph, bag, before)
        if (calibration_file := rig.calibration_file(rig_path)) is not None:
            for words in in_force_words(calibration_file, datetime.now(UTC)):
                progress.note(words)
        progress.stage(f"{programme.experiment}: starting {len(graph.nodes)} nodes")
        with RunningGraph(graph, folder / "logs", domain=domain) as running:
            driven = drive(running, programme, progress, domain=domain, before=before, control=control)
            progress.stage(f"{programme.experiment}: closing the recording")
        join_parts(bag, progress, rig.recording.split)
        progress.stage(f"{programme.experiment}: writing dataset, pictures and report")
        report = write_results(
            programme.experiment, folder, driven.steps, exact=_exact(rig), measure_again=driven.measure_again
        )
        report.ended_early, report.interrupted = driven.ended_early, driven.interrupted
        return report


def _require_moves(rig: RigFile, programme: Programme) -> None:
    """Refuse positions that nothing would move to: all steps would be measured at the same load."""
    if rig.has_load_frame_node:
        return
    for number, step in enumerate(steps := programme.load_steps(), start=1):
        if step.position_mm is not None:
            raise ConfigurationError(
                f"step {number} of {len(steps)} of {programme.experiment} moves the crosshead to {step.position_mm:g} "
                "mm, but this rig moves no machine; remove the positions from the programme, or describe the machine "
                "in a machine file (load_frame: {source: machine, file: ...})"
            )


def _announce(expected: Forecast, programme: Programme, folder: Path, progress: Progress) -> None:
    progress.note(f"{programme.experiment}: {forecast_sentence(expected)}")
    expected.check_disk(folder)


def write_results(
    experiment: str,
    folder: Path,
    steps: list[StepReport],
    *,
    exact: Reconstruct | None = None,
    measure_again: Sequence[int] = (),
) -> RunReport:
    """Write dataset, pictures and report of a recording; add lost frames and errors against the truth to the steps.

    Parameters
    ----------
    measure_again
        Reference steps for a new measurement of all steps from the recorded frames; empty: the nodes' results.
    exact
        Reconstructs surfaces with the exact calibration of a virtual rig that was measured with another calibration;
        the errors of these heights are added as ``z_exact``.
    """
    bag = folder / "bag"
    recorded = BagReader(bag)
    if not recorded.find_optional("camera/exposure"):
        return RunReport(experiment, folder, steps, [], unmeasured="no frame was exposed")
    target = folder / "results.nc"
    losses = frame_losses(bag)
    for report in steps:
        report.dropped, report.missing = losses.get(report.step, (0, 0))
    try:
        if measure_again:
            process_bag(bag, output=target, experiment=experiment, reference=measure_again, overwrite=True)
        elif recorded.find_optional("phase/status"):
            dataset_from_derived(bag, output=target, experiment=experiment, overwrite=True)
        else:
            process_bag(bag, output=target, experiment=experiment, overwrite=True)
    except DatasetError as error:
        return RunReport(experiment, folder, steps, [], unmeasured=str(error))
    with open_experiment(target) as dataset:
        pictures, errors, no_errors = _compare(dataset, folder, exact)
        if measure_again:  # the nodes measured against another reference
            for report in steps:
                if report.step in dataset.step:
                    report.rms_displacement = float(dataset.rms_displacement.sel(step=report.step))
        verdict = confirmation_sentence(dataset)
    write_report(target, folder / "report.html", overwrite=True)
    for report in steps:
        report.errors = errors.get(report.step, {})
    return RunReport(experiment, folder, steps, pictures, no_errors=no_errors, verdict=verdict)


def _compare(
    dataset: xr.Dataset, folder: Path, exact: Reconstruct | None
) -> tuple[list[Path], dict[int, dict[str, float]], str]:
    """Draw the steps; return pictures, errors of each step, and why there are none although there is a truth."""
    if not (folder / TRUTH).exists():
        return save_pictures(dataset, folder), {}, ""
    try:
        with open_truth(folder) as truth:
            # failed steps have no truth, nor have those after a restart of the virtual camera
            is_told = dataset.step.values < truth.sizes.get("step", 0)
            told, untold = dataset.isel(step=is_told), dataset.isel(step=~is_told)
            errors = compare_with_truth(told, folder)
            pictures = save_pictures(told, folder, truth=truth)
            heights = {} if exact is None else _heights(told, truth, exact)
    except DatasetError as error:
        return save_pictures(dataset, folder), {}, str(error)
    pictures += save_pictures(untold, folder) if untold.sizes["step"] else []
    return (
        pictures,
        {step: _errors_of(errors, step) | heights.get(step, {}) for step in errors.step.values.tolist()},
        "",
    )


def frame_losses(bag: Path) -> dict[int, tuple[int, int]]:
    """Return (frames that the camera dropped, exposures without image in the recording) of each step.

    Those of the free run belong to no step.
    """
    reader = BagReader(bag)
    names = reader.find(IMAGE, EXPOSURE)
    images, records = set(), []
    for topic, message, _ in reader.messages(names.values()):
        if topic == names[IMAGE]:
            images.add(stamp_of(message))
        else:
            records.append(frame_record(message))
    dropped: Counter[int] = Counter()
    missing: Counter[int] = Counter()
    for record, lost in with_losses(records):
        dropped[record.step] += lost
        missing[record.step] += record.stamp not in images
    return {step: (dropped[step], missing[step]) for step in dropped}


def _exact(rig: RigFile) -> Reconstruct | None:
    """Return a reconstruction with the exact calibration of a virtual rig; None when the run uses that one anyway."""
    if rig.virtual_rig is None or rig.calibration in (None, VIRTUAL_RIG):
        return None
    model, finest = calibration_of(rig.virtual_configuration()), rig.patterns()[-1]
    return lambda phase: model.reconstruct(phase, finest.pitch, orientation=finest.orientation)


def _heights(dataset: xr.Dataset, truth: xr.Dataset, exact: Reconstruct) -> dict[int, dict[str, float]]:
    """Return the RMS error of z [µm] of the steps with the exact calibration."""
    errors = {}
    for step in dataset.step.values:
        measured = exact(dataset.phase.sel(step=step)).z.values
        true = truth.z_deformed.isel(step=int(step)).sel(row=dataset.row.values, column=dataset.column.values).values
        errors[int(step)] = {"z_exact": 1e6 * float(np.sqrt(np.nanmean((measured - true) ** 2)))}
    return errors


def _errors_of(errors: xr.Dataset, step: int) -> dict[str, float]:
    row = errors.sel(step=step)
    return {name: float(row[f"error_{name}"]) for name in ("u", "v", "w", "z")}
