"""Latched messages: the last ones of their topics, which each file of a split recording repeats at its beginning."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from fringedic.errors import RecordingError
from fringedic.recording.decoding import decode
from fringedic.recording.order import is_latched
from fringedic.recording.topics import RawMessage, Topic

_PARAMETERS = "fringedic_msgs/msg/NodeParameters"
_MOST = 100  # messages of a topic that a publisher may offer to later subscribers


class LatchedMessages:
    """The last messages of latched topics, which a recording without the messages before them needs to be understood.

    Of the parameters of a node only the last ones count. The messages of other topics have no such key: the last
    hundred different ones are kept.
    """

    def __init__(self) -> None:
        self._kept: dict[str, dict[object, RawMessage]] = {}
        self._topics: dict[str, Topic] = {}

    def add_topic(self, topic: Topic) -> None:
        """Take a topic before its first message."""
        if is_latched(topic):
            self._topics[topic.name], self._kept[topic.name] = topic, {}

    def keep(self, message: RawMessage) -> None:
        """Keep a message of a latched topic; others are ignored."""
        if message.topic not in self._kept:
            return
        topic, kept = self._topics[message.topic], self._kept[message.topic]
        key: object = message.data
        if topic.type_name == _PARAMETERS:
            with suppress(RecordingError):  # a message that cannot be read is recorded as it is
                key = decode(topic, message.data, Path(topic.name)).node
        kept.pop(key, None)
        kept[key] = message
        if len(kept) > _MOST:
            del kept[next(iter(kept))]

    def messages(self) -> list[RawMessage]:
        """Return the kept messages, those of each topic in their order."""
        return [message for kept in self._kept.values() for message in kept.values()]


class CopyFilter:
    """Leaves out the copies of latched messages, which differ from the original in their log time only."""

    def __init__(self) -> None:
        self._seen: set[tuple[str, bytes, int, int]] = set()
        self._latched: dict[str, bool] = {}

    def is_copy(self, topic: Topic, message: RawMessage) -> bool:
        """Return whether a message of a topic is latched, and equal to one that was taken before."""
        if topic.name not in self._latched:
            self._latched[topic.name] = is_latched(topic)
        if not self._latched[topic.name]:
            return False
        identity = message.topic, message.data, message.publish_time, message.sequence
        known = identity in self._seen
        self._seen.add(identity)
        return known
