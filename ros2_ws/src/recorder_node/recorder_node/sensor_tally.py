"""What a recorder counts of one sensor: its frames, and the step under way."""

from __future__ import annotations

from dataclasses import dataclass, field

from fringedic_msgs.msg import Exposure, RecorderStatus, StepStatus
from fringedic_ros.serialized import header_stamp, image_crc, read
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.topics import IMAGE, STEP
from recorder_node.exposure_tally import ExposureTally
from recorder_node.step_tally import StepTally

_ENDS = (StepStatus.END, StepStatus.ERROR)


@dataclass
class SensorTally:
    """Frames and steps of one sensor.

    Attributes
    ----------
    step
        Its latest step.
    in_step
        A step has begun and not ended.
    images
        Number of its images.
    confirmed
        Experiment, step, frames and CRC of the step in the recording, set by the writing thread.
    """

    step: StepTally = field(default_factory=StepTally)
    in_step: bool = False
    images: int = 0
    confirmed: tuple[str, int, int, int] = ("", 0, 0, 0)
    _exposures: ExposureTally = field(default_factory=ExposureTally)
    _exposed: bool = False  # all frames of the step

    @property
    def missing(self) -> int:
        """Exposure records without an image."""
        return self._exposures.missing

    def count(self, name: str, data: bytes) -> bool:
        """Count an image or exposure record, or the stage of a step; return whether the step has ended.

        Raises
        ------
        RecordingError
            The message cannot be read.
        """
        if name == IMAGE:
            stamp = header_stamp(data)
            self.images += 1
            self._exposures.add_image(stamp)
            self.step.add_image(stamp, image_crc(data))
        elif name == STEP:
            message = read(data, StepStatus)
            self.step.begin(message.experiment, message.step)
            self._exposed = message.stage == StepStatus.PROCESS
            self.in_step = message.stage not in _ENDS
            if not self.in_step:
                self._exposures.end_step()
                return True
        else:
            record = read(data, Exposure)
            self._exposures.add_exposure(to_nanoseconds(record.header.stamp))
            self.step.add_record(record)
        return False

    def to_confirm(self) -> tuple[str, int, list[int]] | None:
        """Return experiment, step and CRCs of the complete frames, once all were exposed; None before."""
        return (self.step.experiment, self.step.step, self.step.confirmed()) if self._exposed else None

    def fill_in(self, status: RecorderStatus) -> RecorderStatus:
        """Enter what was counted into the status of the recorder."""
        status.images, status.missing_images = self.images, self.missing
        status.experiment, status.step, status.step_frames, status.step_crc = self.confirmed
        return status
