"""Results of a programme from its recording: dataset, pictures and report, and what they add to the steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import xarray as xr

from fringedic.command.outcome import RunReport, StepReport
from fringedic.datasets import dataset_from_derived, open_experiment, process_bag
from fringedic.datasets.opening import RESULTS
from fringedic.datasets.processing import DATASETS, ProcessingSettings
from fringedic.datasets.sentences import confirmation_sentence
from fringedic.errors import DatasetError, EvidenceError
from fringedic.evaluation import compare_with_truth, open_truth
from fringedic.evaluation.truth import TRUTH
from fringedic.evidence.changes import begin_log, noted
from fringedic.evidence.log import CALIBRATION_SOURCE, CALIBRATION_SOURCES, has_log
from fringedic.figures.maps import save_pictures
from fringedic.frames.sensor import file_of
from fringedic.recording.frames import frame_losses
from fringedic.recording.reader import BagReader
from fringedic.report import write_report
from fringedic.signals import FORCE

RUN = "run"
"""Action of the first entry of the log of a run that was signed at its end."""
REPORT = "report.html"
Reconstruct = Callable[[xr.DataArray], xr.Dataset]


def write_results(
    experiment: str,
    folder: Path,
    steps: list[StepReport],
    *,
    exact: Reconstruct | None = None,
    measure_again: bool = False,
    sensor: str | None = None,
) -> RunReport:
    """Write dataset, pictures and report of a recording; add lost frames, force and errors to the steps.

    Parameters
    ----------
    measure_again
        Measure all steps again from the recorded frames, because results of the nodes are missing or count from another
        step.
    exact
        Reconstructs surfaces with the exact calibration of a virtual rig that was measured with another calibration;
        the errors of these heights are added as ``z_exact``.
    sensor
        Name of the sensor, of a rig of several; its pictures are in a folder of this name, as its ground truth is.
    """
    bag, name = folder / "bag", sensor or ""
    recorded = BagReader(bag)
    if sensor in (None, *recorded.sensors):
        recorded = BagReader(bag, sensor=sensor)
    if sensor not in (None, *recorded.sensors) or not recorded.find_optional("camera/exposure"):
        return RunReport(experiment, folder, steps, [], unmeasured="no frame was exposed", sensor=name)
    target = file_of(folder / f"{RESULTS}.nc", recorded.sensor)
    losses = frame_losses(recorded)
    for report in steps:
        report.dropped, report.missing = losses.get(report.step, (0, 0))
    try:
        if measure_again or not recorded.find_optional("phase/status"):
            process_bag(bag, output=target, experiment=experiment, overwrite=True, sensor=sensor)
        else:
            dataset_from_derived(bag, output=target, experiment=experiment, overwrite=True, sensor=sensor)
    except DatasetError as error:
        return RunReport(experiment, folder, steps, [], unmeasured=str(error), sensor=name)
    with open_experiment(target) as dataset:
        pictures, errors, no_errors = _compare(dataset, folder / name, exact)
        for report in steps:
            if report.step in dataset.step:
                row = dataset.sel(step=report.step)
                report.force = float(row[FORCE.name])  # with sign and tare of the specimen, unlike that of the nodes
                if measure_again:  # the nodes measured against another reference
                    report.rms_displacement = float(row.rms_displacement)
        verdict = confirmation_sentence(dataset)
    page = folder / REPORT
    write_report(target, page if sensor is None else file_of(page, sensor), overwrite=True)
    for report in steps:
        report.errors = errors.get(report.step, {})
    return RunReport(
        experiment,
        folder,
        steps,
        pictures,
        target.name,
        no_errors=no_errors,
        verdict=verdict,
        sensor=name,
    )


def write_joined_results(folder: Path) -> tuple[Path, list[str]]:
    """Write the joined surface of the sensors of a run, whose registration is in its folder, and its report.

    Returns
    -------
    tuple
        The dataset, and sentences about it.

    Raises
    ------
    DatasetError, CalibrationError
        As of `join_recording`.
    """
    from fringedic.sensors import join_recording
    from fringedic.sensors.files import REGISTRATION_FILE
    from fringedic.sensors.sentences import joined_sentences

    joined = join_recording(folder / "bag", folder / REGISTRATION_FILE, overwrite=True)
    with open_experiment(joined) as dataset:
        words = joined_sentences(dataset)
    write_report(joined, folder / REPORT, overwrite=True)
    return joined, words


def sign_results(
    report: RunReport, *others: RunReport, operator: str = "", calibration: Mapping[str, Path | None] | None = None
) -> str:
    """Begin the log of a run that has ended, and sign it; that of a continued run gets an entry.

    Parameters
    ----------
    report, others
        The run, and its reports about other sensors.
    operator
        Name of the operator.
    calibration
        File of the calibration of each sensor that the rig file names.

    Returns
    -------
    str
        Why the run is not signed, as a sentence; empty when it is.
    """
    reports = (report, *others)
    files = {name: None if file is None else str(file.absolute()) for name, file in (calibration or {}).items()}
    details = {
        "ended_early": report.ended_early,
        "interrupted": report.interrupted,
        "failed_steps": sum(bool(step.error) for each in reports for step in each.steps),
        DATASETS: {
            each.dataset: ProcessingSettings(experiment=each.experiment, sensor=each.sensor or None).as_details()
            for each in reports
            if each.dataset
        },
    }
    if others:
        details[CALIBRATION_SOURCES] = files
    else:
        details[CALIBRATION_SOURCE] = next(iter(files.values()), None)
    try:
        if has_log(report.folder):
            with noted(report.folder, RUN, details=details):  # within that of the command, which covers all files
                pass
        else:
            begin_log(report.folder, RUN, operator=operator, details=details)
    except EvidenceError as error:
        return f"the run is not signed: {error}; then 'fringedic note {report.folder}' signs it"
    return ""


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
            errors = compare_with_truth(told, folder, reconstruct=exact)
            pictures = save_pictures(told, folder, truth=truth)
    except DatasetError as error:
        return save_pictures(dataset, folder), {}, str(error)
    pictures += save_pictures(untold, folder) if untold.sizes["step"] else []
    table = errors.drop_vars("measured_fraction")
    return (
        pictures,
        {
            step: {str(name).removeprefix("error_"): float(column.sel(step=step)) for name, column in table.items()}
            for step in table.step.values.tolist()
        },
        "",
    )
