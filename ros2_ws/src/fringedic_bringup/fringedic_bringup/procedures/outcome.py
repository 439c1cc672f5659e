"""Outcome of a programme and its steps, and how an operator controls it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path


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


class RunControl:
    """Lets an operator pause or end a programme, and see its steps; this one does neither."""

    def check(self) -> None:
        """End the programme by a `FringedicError`; called about ten times a second while it waits."""

    def may_begin(self) -> bool:
        """Return whether the next step may begin; asked until it may."""
        return True

    def measured(self, report: StepReport) -> None:
        """Take the outcome of a step."""


@dataclass
class RunReport:
    """Outcome of a run: the folder with recording, dataset and pictures, and the steps.

    Attributes
    ----------
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
    """

    experiment: str
    folder: Path
    steps: list[StepReport]
    pictures: list[Path]
    unmeasured: str = ""
    no_errors: str = ""
    verdict: str = ""
    ended_early: str = ""
    interrupted: bool = False

    @property
    def failed(self) -> bool:
        """Whether the programme ended early, a step failed, a frame is missing, or nothing could be measured."""
        return bool(self.unmeasured or self.ended_early) or any(step.error or step.missing for step in self.steps)
