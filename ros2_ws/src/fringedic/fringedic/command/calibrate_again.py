"""Repeats the calculation of a calibration from its recording, without nodes and without ROS."""

from __future__ import annotations

from pathlib import Path

from fringedic.calibration.recorded import calibrate_recording
from fringedic.calibration.sentences import (
    calibration_in_words,
    grid_in_words,
    recorded_plane_in_words,
    verdict_sentence,
)
from fringedic.calibration.traceability import recorded_traceability
from fringedic.command.outcome import CalibrationReport, Progress
from fringedic.report.calibration import CALIBRATION_REPORT, write_calibration_report


def calibrate_again(bag: Path, folder: Path, progress: Progress, sensor: str | None = None) -> CalibrationReport:
    """Repeat the calculation of a calibration from its recording.

    Parameters
    ----------
    bag
        Recording of a calibration.
    folder
        Where the files of the calibration and its report are written.
    progress
        Receives the progress.
    sensor
        Name of the sensor, if the recording contains several.

    Raises
    ------
    RecordingError
        The recording contains no calibration.
    """
    session = calibrate_recording(
        bag, sensor=sensor, progress=lambda plane: progress.stage(recorded_plane_in_words(plane))
    )
    assert session.grid is not None
    assert session.result is not None
    session.save_grid(folder)
    session.save(folder, summary=verdict_sentence(session.result))
    write_calibration_report(session.result, folder / CALIBRATION_REPORT, recorded_traceability(bag, sensor))
    words = (grid_in_words(session.grid), calibration_in_words(session.result))
    return CalibrationReport(folder, session.result.go, words)
