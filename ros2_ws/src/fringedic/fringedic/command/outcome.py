"""Progress of a procedure while it runs, and the outcome of a calibration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

CALIBRATION_FILE = "calibration.yaml"


class Progress(Protocol):
    """Receives the progress of a procedure."""

    def stage(self, text: str) -> None:
        """Take a text about what is being done now."""

    def step(self, number: int, last: int, text: str, frame: int = 0, frames: int = 0) -> None:
        """Take the progress of a load step; its number and that of the last one are those of the dataset, from 0."""

    def part(self, number: int, parts: int, text: str, frame: int = 0, frames: int = 0) -> None:
        """Take the progress of one of several parts of a procedure, such as planes; `number` counts from 1."""

    def note(self, text: str) -> None:
        """Take a text that stays on the screen."""


@dataclass(frozen=True)
class CalibrationReport:
    """Outcome of a calibration.

    Attributes
    ----------
    folder
        Contains ``calibration.yaml`` and its companions when the calibration may be used, ``report.html``,
        ``distortion.yaml``, the recording ``bag`` and ``logs``.
    go
        Whether the calibration may be used.
    words
        Sentences about the camera and the rig, or the reason why there is no result.
    """

    folder: Path
    go: bool
    words: tuple[str, ...]

    @property
    def file(self) -> Path:
        """The calibration, as a rig file names it."""
        return self.folder / CALIBRATION_FILE

    @property
    def report(self) -> Path | None:
        """The report; None when the calibration ended before it was written."""
        from fringedic.report.calibration import CALIBRATION_REPORT

        path = self.folder / CALIBRATION_REPORT
        return path if path.exists() else None
