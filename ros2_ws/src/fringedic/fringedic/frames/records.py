"""The exposure record of a frame, and its translation from ``fringedic_msgs/Exposure`` messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from fringedic.patterns.pattern import PatternMessage, ProjectedPattern, pattern_of_message


@dataclass(frozen=True)
class FrameRecord:
    """The exposure record that belongs to one image.

    Attributes
    ----------
    experiment, step, index
        Identity of the exposure; ``index`` runs from 0 to ``count - 1``.
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
    )
