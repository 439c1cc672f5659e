"""What a run tells while it goes on, and what is known of its steps afterwards."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from fringedic.calibration_session import REPORT_FILE

CALIBRATION_FILE = "calibration.yaml"


class Progress(Protocol):
    """What a run tells while it goes on."""

    def stage(self, text: str) -> None:
        """Say what is being done now."""

    def step(self, number: int, steps: int, text: str, frame: int = 0, frames: int = 0) -> None:
        """Say where a load step is; `number` counts from 1."""

    def note(self, text: str) -> None:
        """Say something that stays on the screen."""


@dataclass
class StepReport:
    """What is known of one load step after a run.

    Attributes
    ----------
    step
        Number in the experiment.
    position, force, force_range
        Mean over the exposures [m], [N], and the range of the force [N].
    valid_fraction
        Measured points over all points.
    rms_displacement, white
        RMS of the displacement: [m], but [px] for a step in white light.
    processing_time
        From the last exposure to the last result [s].
    dropped, missing
        Frames that the camera lost; exposures whose image is not in the recording.
    errors
        RMS of measured minus true u, v, w and z [µm]; empty without a ground truth.
    error
        Why the step failed, empty when it did not.
    """

    step: int
    position: float = float("nan")
    force: float = float("nan")
    force_range: float = float("nan")
    valid_fraction: float = float("nan")
    rms_displacement: float = float("nan")
    white: bool = False
    processing_time: float = float("nan")
    dropped: int = 0
    missing: int = 0
    errors: dict[str, float] = field(default_factory=dict)
    error: str = ""


@dataclass
class RunReport:
    """One run: its folder, which holds recording, dataset and pictures, and its steps.

    Attributes
    ----------
    unmeasured
        Why there is no dataset of what was recorded; empty when there is one.
    """

    experiment: str
    folder: Path
    steps: list[StepReport]
    pictures: list[Path]
    unmeasured: str = ""

    @property
    def failed(self) -> bool:
        """Whether a step failed, a frame was lost, or nothing could be measured."""
        return bool(self.unmeasured) or any(step.error or step.missing for step in self.steps)


@dataclass(frozen=True)
class CalibrationReport:
    """How a calibration ended.

    Attributes
    ----------
    folder
        Holds ``calibration.yaml`` and its companions when the calibration may be used, ``report.html``,
        ``distortion.yaml``, the recording ``bag`` and ``logs``.
    go
        Whether the calibration may be used.
    words
        About the camera and about the rig, or why there is no result.
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
        """The report for people; None when the calibration did not get that far."""
        path = self.folder / REPORT_FILE
        return path if path.exists() else None
