"""Messages of a recording, in the order of publishing and cut into steps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from rclpy.serialization import serialize_message

from fringedic.frames.records import frame_record, stamp_of
from fringedic.recording.definitions import type_hash
from fringedic.recording.reader import BagReader
from fringedic.recording.topics import RawMessage
from fringedic.rig.model import RigModel
from fringedic.steps.recorded_references import REFERENCE_TOPICS, RecordedReferences
from fringedic_msgs.msg import Exposure, LoadState, Reference, RigCalibration, StepStatus
from fringedic_ros.records import calibration_message, exposure_message
from fringedic_ros.serialized import header_stamp, read
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.topics import CALIBRATION, EXPOSURE, IMAGE, LOAD_STATE, STEP

# Topics whose messages concern one step only.
OF_ONE_STEP = (IMAGE, "camera/camera_info", EXPOSURE, STEP)


@dataclass
class RecordedStep:
    """Messages of one step in the order of publishing, from its BEGIN to the BEGIN of the next one.

    Attributes
    ----------
    begin
        The message of the stage BEGIN; None for the messages before the first step of a recording.
    messages
        The messages, under names relative to the rig.
    """

    begin: StepStatus | None
    messages: list[RawMessage] = field(default_factory=list)

    @property
    def number(self) -> int | None:
        """Number of the step; None before the first one."""
        return None if self.begin is None else self.begin.step

    @property
    def frames(self) -> int:
        """Number of images."""
        return sum(message.topic == IMAGE for message in self.messages)

    @property
    def is_complete(self) -> bool:
        """Whether the last frame of the sequence is present with its exposure record.

        Then the nodes answer by themselves, with an error if an earlier frame is missing.
        """
        images = {header_stamp(each.data) for each in self.messages if each.topic == IMAGE}
        for message in self.messages:
            if message.topic == EXPOSURE:
                exposure = read(message.data, Exposure)
                if exposure.index == exposure.count - 1 and to_nanoseconds(exposure.header.stamp) in images:
                    return True
        return False

    def without(self, *topics: str) -> RecordedStep:
        """Return the step without the messages of some topics."""
        return RecordedStep(self.begin, [message for message in self.messages if message.topic not in topics])


def recorded_messages(bag: BagReader, names: Mapping[str, str]) -> Iterator[RawMessage]:
    """Yield messages under relative names; those of older definitions become present ones.

    References are those of `RecordedReferences`: a step that took the place of one that the nodes had lost is none.

    Parameters
    ----------
    bag
        The recording.
    names
        Relative name by full name of the topics to read.
    """
    references = RecordedReferences()
    for message in bag.published(names):
        name, data = names[message.topic], message.data
        topic = bag.topics[message.topic]
        if name in REFERENCE_TOPICS:
            recorded = bag.decode(message.topic, data)
            reference = references.take(name, recorded)
            if reference is not None:
                data = serialize_message(reference_message(recorded, reference))
        if name in _PRESENT and topic.hash != type_hash(topic.type_name):
            data = serialize_message(_PRESENT[name](bag.decode(message.topic, data)))
        yield message._replace(topic=name, data=data)


def _present_calibration(recorded: Any) -> RigCalibration:
    model = RigModel.from_message(recorded)
    return calibration_message(model, stamp_ns=stamp_of(recorded), frame_id=recorded.header.frame_id)


def _present_exposure(recorded: Any) -> Exposure:
    return exposure_message(frame_record(recorded), frame_id=recorded.header.frame_id)


def _present_load(recorded: Any) -> LoadState:
    message = LoadState(mode=recorded.mode, force=recorded.force, position=recorded.position, reason=recorded.reason)
    message.header.stamp = to_msg(stamp_of(recorded))
    message.header.frame_id = recorded.header.frame_id
    return message


_PRESENT: dict[str, Callable[[Any], RigCalibration | Exposure | LoadState]] = {
    CALIBRATION: _present_calibration,
    EXPOSURE: _present_exposure,
    LOAD_STATE: _present_load,
}
"""Messages whose definition has changed, from one of an earlier definition."""


def reference_message(recorded: Any, step: int) -> Reference:
    """Return a recorded reference with another step."""
    message = Reference(experiment=recorded.experiment, step=step)
    message.previous_lost = step == recorded.step and bool(recorded.previous_lost)  # of a recording without that one
    message.header.stamp = to_msg(stamp_of(recorded))
    message.header.frame_id = recorded.header.frame_id
    return message


def split_steps(messages: Iterable[RawMessage]) -> Iterator[RecordedStep]:
    """Cut messages with relative topic names, in the order of publishing, at the BEGIN of each step."""
    current = RecordedStep(None)
    for message in messages:
        if message.topic == STEP:
            status = read(message.data, StepStatus)
            if status.stage == StepStatus.BEGIN:
                yield current
                current = RecordedStep(status)
        current.messages.append(message)
    yield current


def ends_step(message: RawMessage) -> bool:
    """Return whether a message ends its step: the stage END or ERROR."""
    if message.topic != STEP:
        return False
    return read(message.data, StepStatus).stage in (StepStatus.END, StepStatus.ERROR)
