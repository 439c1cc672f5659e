"""Calibrates a rig once more from the recording of a calibration, without nodes and without ROS."""

from __future__ import annotations

from pathlib import Path

from fringedic.calibration_recording import calibrate_recording
from fringedic.calibration_session import grid_in_words
from fringedic_bringup.report import CalibrationReport, Progress


def calibrate_again(bag: Path, folder: Path, progress: Progress) -> CalibrationReport:
    """Calibrate once more from the recording of a calibration, without nodes.

    Raises
    ------
    RecordingError, MissingTopicError
        The recording holds no calibration.
    """
    session = calibrate_recording(bag, progress=progress.stage)
    assert session.grid is not None and session.result is not None
    session.save_grid(folder)
    session.save(folder)
    words = (grid_in_words(session.grid), " ".join([session.result.verdict, *session.result.warnings]))
    return CalibrationReport(folder, session.result.go, words)
