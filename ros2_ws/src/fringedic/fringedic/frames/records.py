"""The exposure record of a frame, and its translation from ``fringedic_msgs/Exposure`` messages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from fringedic.errors import ImageError
from fringedic.frames.sensor import SENSOR, sensor_name
from fringedic.patterns.pattern import PatternMessage, ProjectedPattern, moving_frames, pattern_of_message
from fringedic.wording.arguments import check_value


class StepKey(NamedTuple):
    """Identity of the frames of one step: experiment and number of the step, and the sensor that exposed them."""

    experiment: str
    step: int
    sensor: str = SENSOR


@dataclass(frozen=True)
class FrameRecord:
    """The exposure record that belongs to one image.

    Attributes
    ----------
    experiment, step, index
        Identity of the exposure, with the sensor; ``index`` runs from 0 to ``count - 1``.
    count
        Frames in the step's sequence.
    pattern
        The projected pattern.
    stamp
        Middle of the exposure on the acquisition clock [ns].
    exposure_time
        Length of the exposure [s].
    dropped
        Frames that the camera has lost since it was started.
    image_crc
        CRC-32 (zlib) of the image's data; 0 in recordings of version 0.1.
    sensor
        Name of the camera with its projector.
    """

    experiment: str
    step: int
    index: int
    count: int
    pattern: ProjectedPattern
    stamp: int
    exposure_time: float
    dropped: int = 0
    image_crc: int = 0
    sensor: str = SENSOR

    def __post_init__(self) -> None:
        check_value(ImageError, "sensor", self.sensor, sensor_name)

    @property
    def step_key(self) -> StepKey:
        """The frames of one step have it in common."""
        return StepKey(self.experiment, self.step, self.sensor)


def time_of(records: Sequence[FrameRecord]) -> int:
    """Return the time that the results of a stack belong to [ns].

    It is the middle of the finest pitch of a moving surface, see `moving_frames`; of a surface at rest, which has the
    same results at all times of its exposures, it is the stamp of the last one.

    Parameters
    ----------
    records
        Of the frames, in their order.
    """
    finest = moving_frames([record.pattern for record in records])
    if not finest:
        return records[-1].stamp
    first = records[finest[0]].stamp
    return first + round(sum(records[k].stamp - first for k in finest) / len(finest))


class Frame(NamedTuple):
    """One image, grey levels (row, column), with its exposure record."""

    image: np.ndarray
    record: FrameRecord


def image_stack(frames: Iterable[Frame]) -> np.ndarray:
    """Return the images of frames of one size, shape (frame, row, column)."""
    return np.stack([each.image for each in frames])


class StampedMessage(Protocol):
    """A message with a ``std_msgs/Header``."""

    header: Any


class ExposureMessage(StampedMessage, PatternMessage, Protocol):
    """Fields of ``fringedic_msgs/Exposure``."""

    experiment: str
    step: int
    index: int
    count: int
    exposure_time: float
    dropped: int
    image_crc: int
    sensor: str


def stamp_of(message: StampedMessage) -> int:
    """Return the stamp of a message's header [ns].

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> stamp_of(Message(header=Message(stamp=Message(sec=2, nanosec=5))))
    2000000005
    """
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def frame_record(exposure: ExposureMessage) -> FrameRecord:
    """Return the record in a ``fringedic_msgs/Exposure`` message.

    Parameters
    ----------
    exposure
        The message, decoded by rclpy or by `BagReader.decode`.

    Raises
    ------
    PatternError
        Kind or orientation is not one of the defined numbers.
    ImageError
        The sensor has no valid name.
    """
    return FrameRecord(
        experiment=exposure.experiment,
        step=exposure.step,
        index=exposure.index,
        count=exposure.count,
        pattern=pattern_of_message(exposure),
        stamp=stamp_of(exposure),
        exposure_time=exposure.exposure_time,
        dropped=exposure.dropped,
        image_crc=exposure.image_crc,
        sensor=exposure.sensor or SENSOR,
    )
