"""Progress of a procedure while it runs, and the outcome of a calibration, of a programme and of its steps."""

from __future__ import annotations

from dataclasses import dataclass, field
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


@dataclass
class StepReport:
    """Outcome of one load step.

    Attributes
    ----------
    step
        Number in the experiment; -1 when its move failed, so that it did not begin.
    position, force, force_range
        Mean over the exposures [m], [N], and the range of the force [N].
    valid_fraction
        Measured points over all points.
    rms_displacement, rms_displacement_px
        RMS of (u, v, w) [m], NaN for a step in white light, and of (d_x, d_y) [px].
    white
        A step in white light.
    processing_time
        From the last exposure to the last result [s].
    dropped, missing
        Frames that the camera dropped; exposures whose image is missing in the recording.
    errors
        RMS of measured minus true u, v, w and z [µm]; empty without a ground truth.
    error
        Why the step failed, empty when it did not.
    sensor
        Name of the sensor, of a rig of several.
    """

    step: int
    position: float = float("nan")
    force: float = float("nan")
    force_range: float = float("nan")
    valid_fraction: float = float("nan")
    rms_displacement: float = float("nan")
    rms_displacement_px: float = float("nan")
    white: bool = False
    processing_time: float = float("nan")
    dropped: int = 0
    missing: int = 0
    errors: dict[str, float] = field(default_factory=dict)
    error: str = ""
    sensor: str = ""


@dataclass
class RunReport:
    """Outcome of a run: the folder with recording, dataset and pictures, and the steps; of one of several sensors.

    Attributes
    ----------
    dataset
        Name of the dataset in the folder; empty without one.
    unmeasured
        Why there is no dataset of what was recorded; empty when there is one.
    no_errors
        Why the steps have no errors although there is a ground truth; empty when they have.
    verdict
        How many points an independent check confirms, in words; empty without a check.
    ended_early
        Why the programme ended before its last step; empty when it did not.
    interrupted
        Whether Ctrl-C or a signal ended it.
    sensor
        Name of the sensor, of a rig of several.
    """

    experiment: str
    folder: Path
    steps: list[StepReport]
    pictures: list[Path]
    dataset: str = ""
    unmeasured: str = ""
    no_errors: str = ""
    verdict: str = ""
    ended_early: str = ""
    interrupted: bool = False
    sensor: str = ""

    @property
    def failed(self) -> bool:
        """Whether the programme ended early, a step failed, a frame is missing, or nothing could be measured."""
        return bool(self.unmeasured or self.ended_early) or any(step.error or step.missing for step in self.steps)
