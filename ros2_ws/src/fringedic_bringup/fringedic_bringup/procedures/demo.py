"""The demo: virtual rigs are calibrated with their own images and then measure their specimens."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from fringedic.command.outcome import CalibrationReport, Progress, RunReport
from fringedic.errors import StepFailedError
from fringedic_bringup.procedures.calibrate import calibrate
from fringedic_bringup.procedures.run import load_rig, run_experiment


def run_demo(
    rigs: Mapping[str, Path], folder: Path, progress: Progress, *, domain: int | None = None
) -> Iterator[RunReport]:
    """Calibrate each rig with its grid and planes, run its programme with that calibration, and yield the outcome.

    Rigs with the same camera, projector and stage are calibrated once.

    Parameters
    ----------
    rigs
        Rig files by the names of their experiments.
    folder
        Where a folder for each calibration and each experiment is created.
    progress
        Receives the progress.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    StepFailedError
        The result of a calibration is NO-GO.
    """
    calibrations: dict[str, CalibrationReport] = {}
    for name, path in rigs.items():
        rig, programme = load_rig(path, None, None)
        twin = rig.virtual_configuration()
        optics = twin.model_dump_json(include={"camera", "projector", "sensor", "stage"})
        if optics not in calibrations:
            place = folder / f"calibration-{name}"
            calibrations[optics] = calibrate(rig, path, place, progress, ask=lambda _: False, domain=domain)
            for words in calibrations[optics].words:
                progress.note(words)
        calibration = calibrations[optics]
        if not calibration.go:
            raise StepFailedError(f"{name}: {calibration.words[-1]}")
        rig = rig.with_calibration(calibration.file.absolute())
        yield run_experiment(rig, path, programme, folder / name, progress, domain=domain)
