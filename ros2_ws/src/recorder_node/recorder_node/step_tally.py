"""Frames of the latest step that the recorder has, to confirm that they are complete and unchanged."""

from __future__ import annotations

from fringedic_msgs.msg import Exposure
from fringedic_ros.stamps import to_nanoseconds

_MOST_IMAGES = 1000  # whose record may still come: images and records arrive in any order
_MOST_STEPS = 8  # whose records are kept: the latest step, its successor, and strays


class StepTally:
    """Images and exposure records of the latest step; a frame counts when both are there and their CRCs agree.

    Attributes
    ----------
    experiment, step
        Identity of the step; empty and 0 before the first.
    """

    def __init__(self) -> None:
        self.experiment, self.step = "", 0
        self._images: dict[int, int] = {}  # stamp -> CRC
        self._records: dict[tuple[str, int], dict[int, tuple[int, int]]] = {}  # step -> index -> stamp, CRC

    def begin(self, experiment: str, step: int) -> None:
        """Forget the records of other steps; those of the step may have come before this announcement of it."""
        if (experiment, step) != (self.experiment, self.step):
            self.experiment, self.step = experiment, step
            self._records = {(experiment, step): self._records.get((experiment, step), {})}

    def add_image(self, stamp: int, crc: int) -> None:
        """Add an image with the CRC-32 of its data.

        A thousand are kept. The images of a free run, which have no record of a step, replace each other: the frames
        of the step stay until the next step begins.
        """
        self._images[stamp] = crc
        if len(self._images) > _MOST_IMAGES:
            frames = {each for records in self._records.values() for each, _ in records.values()}
            del self._images[next((each for each in self._images if each not in frames), stamp)]

    def add_record(self, record: Exposure) -> None:
        """Add the exposure record of a frame of a step, which may be another one than the announced step."""
        if record.count:
            identity = record.experiment, record.step
            self._records.setdefault(identity, {})[record.index] = to_nanoseconds(record.header.stamp), record.image_crc
            strays = [each for each in self._records if each != (self.experiment, self.step)]
            if len(strays) >= _MOST_STEPS:
                del self._records[strays[0]]

    def confirmed(self) -> list[int]:
        """Return the CRCs of the complete frames, in the order of the frames."""
        records = self._records.get((self.experiment, self.step), {})
        return [crc for _, (stamp, crc) in sorted(records.items()) if self._images.get(stamp) == crc]
