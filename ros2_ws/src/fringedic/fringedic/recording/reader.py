"""Reads finished or truncated recordings message by message, without ROS."""

from __future__ import annotations

import heapq
import os
from collections import Counter
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from mcap.records import Channel, Message, Schema
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fringedic.errors import ErrorCode, RecordingError
from fringedic.recording.bag_files import BagFiles, find_files, open_file, parts_of_run, recording_of
from fringedic.recording.earlier_versions import translate
from fringedic.recording.mcap_file import FOREIGN, McapFile, count_without_checksum, read_messages
from fringedic.recording.topics import RawMessage, Topic, is_named

_SET_BACK_NS = 1_000_000_000  # chunks of messages that were received one after the other overlap by less
REORDER_WINDOW = 64  # messages by which topics may overtake each other on their way into the recording


class BagReader:
    """Reads a finished or truncated recording one message after the other.

    Parameters
    ----------
    path
        A rosbag2 folder with MCAP files, one MCAP file, or the folder of a run with its recording ``bag``.
    check
        Read every chunk on opening and leave out those that are damaged. Without it, a file with an undamaged index is
        opened by its index alone, and a damaged chunk raises an error when it is reached.

    Attributes
    ----------
    files
        The MCAP files in their order.
    topics
        Every topic by its full name.
    counts
        Messages of each topic.
    missing
        Messages of each topic that an index or ``metadata.yaml`` counts and that are not in the files.
    set_back
        Description of a clock that was set back during the recording, by the times of its chunks; empty if it was not.
    damage
        Description of damaged and missing files and of a clock that was set back; empty if there are none.
    parts
        Folders of later parts of the recording of a run whose command was killed before it joined them.
    lost
        The damage with the missing messages of each topic and the parts that were not joined; empty for a complete
        recording.
    unlisted
        Names of files that are read although ``metadata.yaml`` does not list them.

    Raises
    ------
    RecordingError
        There is no such recording, it has another format, or its files define a topic differently.

    Examples
    --------
    >>> import tempfile
    >>> from fringedic.recording import BagWriter, Topic
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with BagWriter(f"{folder}/bag") as writer:
    ...         writer.add_recorded_topic(Topic("/force", "bench_msgs/msg/Force", "uint8 newton", "ros2msg", "", ""))
    ...         writer.write("/force", bytes([0, 1, 0, 0, 42]), log_time=10, publish_time=9)
    ...     reader = BagReader(f"{folder}/bag")
    ...     [(topic, message.newton, time) for topic, message, time in reader.messages()]
    [('/force', 42, 10)]
    """

    def __init__(self, path: str | os.PathLike[str], *, check: bool = False) -> None:
        self.path = recording_of(Path(path))
        found = find_files(self.path)
        self.files, self.unlisted = tuple(found.present), tuple(found.unlisted)
        self._files = [open_file(file, check=check) for file in found.present]
        if all(file.foreign for file in self._files):
            raise RecordingError(f"{self._files[0].path}: {FOREIGN}")
        self.topics: dict[str, Topic] = {}
        self.counts: dict[str, int] = {}
        indexed: Counter[str] = Counter()
        for file in self._files:
            for number, channel in file.channels.items():
                topic = topic_of(channel, file.schemas.get(channel.schema_id))
                if not self.topics.setdefault(topic.name, topic).has_messages_of(topic):
                    raise RecordingError(
                        f"{file.path}: defines the messages of {topic.name} differently from the files before it; "
                        "recordings of different versions belong in folders of their own"
                    )
                self.counts[channel.topic] = self.counts.get(channel.topic, 0) + file.counts[number]
                indexed[channel.topic] += file.indexed[number]
        missing = (indexed | Counter(found.counts)) - Counter(self.counts)
        self.missing = dict(sorted(missing.items()))
        self.set_back = describe_set_back(_spans(file for file in self._files if file.path.name not in self.unlisted))
        self.damage = "; ".join(filter(None, (*_damage(self._files, found), self.set_back)))
        self.parts = parts_of_run(self.path)
        words = self.damage, _missing_words(self.missing), describe_parts(part.name for part in self.parts)
        self.lost = "; ".join(filter(None, words))

    @property
    def start_time(self) -> int:
        """Log time of the first message [ns], 0 for an empty recording."""
        return min((chunk.start_time for file in self._files for chunk in file.chunks), default=0)

    @property
    def end_time(self) -> int:
        """Log time of the last message [ns], 0 for an empty recording."""
        return max((chunk.end_time for file in self._files for chunk in file.chunks), default=0)

    @property
    def chunks_without_checksum(self) -> int:
        """Number of chunks without a checksum, which other recorders may leave out."""
        return sum(count_without_checksum(file) for file in self._files)

    def find(self, *relative_names: str) -> dict[str, str]:
        """Return the full names of topics by their names relative to the rig's namespace.

        Parameters
        ----------
        relative_names
            Such as ``camera/image_raw``; the namespace in the recording may be any prefix.

        Returns
        -------
        dict
            Relative name -> full name.

        Raises
        ------
        RecordingError
            With the code MISSING_TOPIC: topics are missing or without messages; the message names them. Without code:
            the recording contains a topic of several rigs.
        """
        found = {name: self._full_names(name) for name in relative_names}
        missing = [name for name, full in found.items() if not full]
        if missing:
            present = ", ".join(sorted(topic for topic, count in self.counts.items() if count)) or "no message at all"
            others = (f"{topic.name} is a {topic.type_name}" for topic in self._of_other_types(missing))
            words = "; ".join([f"{self.path} has no {', '.join(missing)}", *others, f"it holds {present}"])
            raise RecordingError(words, code=ErrorCode.MISSING_TOPIC)
        for name, full in found.items():
            if len(full) > 1:
                raise RecordingError(f"{self.path} contains {name} of several rigs: {', '.join(full)}")
        return {name: full[0] for name, full in found.items()}

    def find_optional(self, *relative_names: str) -> dict[str, str]:
        """Return the full names of those topics that are in the recording; see `find`."""
        return self.find(*(name for name in relative_names if self._full_names(name)))

    def raw(self, topics: Iterable[str] | None = None, *, start: int = 0) -> Iterator[RawMessage]:
        """Iterate over serialised messages in the order of their log time.

        Messages of equal time keep their order in the file. One chunk (about a megabyte) is in memory at a time, or
        as many as overlap in time.

        Parameters
        ----------
        topics
            Full names; None for all topics.
        start
            Messages of an earlier log time [ns] are left out.

        Raises
        ------
        RecordingError
            A chunk is damaged although the index is complete.
        """
        wanted = set(self.topics if topics is None else topics)
        places = [
            (chunk, number, file)
            for number, file in enumerate(self._files)
            for chunk in file.chunks
            if chunk.end_time >= start
            and any(file.channels[known].topic in wanted for known in chunk.channels & file.channels.keys())
        ]
        places.sort(key=lambda place: (place[0].start_time, place[1], place[0].offset))
        waiting: list[tuple[int, int, int, int, RawMessage]] = []
        for chunk, number, file in places:
            while waiting and waiting[0][0] < chunk.start_time:
                yield heapq.heappop(waiting)[-1]
            for order, message in enumerate(read_messages(file, chunk)):
                topic = file.channels[message.channel_id].topic
                if topic in wanted and message.log_time >= start:
                    raw = RawMessage(topic, message.data, message.log_time, message.publish_time, message.sequence)
                    heapq.heappush(waiting, (message.log_time, number, chunk.offset, order, raw))
        while waiting:
            yield heapq.heappop(waiting)[-1]

    def newest(self, topics: Iterable[str], before: int) -> list[RawMessage]:
        """Return the last message of each topic before a log time [ns], as far as there is one.

        Raises
        ------
        RecordingError
            See `raw`.
        """
        missing, found = set(topics), dict[str, RawMessage]()
        places = [(chunk, file) for file in self._files for chunk in file.chunks if chunk.start_time < before]
        for chunk, file in sorted(places, key=lambda place: place[0].end_time, reverse=True):
            if any(file.channels[known].topic in missing for known in chunk.channels & file.channels.keys()):
                messages = (_raw(file, each) for each in read_messages(file, chunk) if each.log_time < before)
                found |= {each.topic: each for each in messages if each.topic in missing}
                missing -= found.keys()
        return list(found.values())

    def stored(self) -> Iterator[RawMessage]:
        """Iterate over serialised messages in the order in which they were written, which is that of their receipt.

        It differs from `raw` if the clock of the computer was set back during the recording.

        Raises
        ------
        RecordingError
            See `raw`.
        """
        for file in self._files:
            for chunk in sorted(file.chunks, key=lambda place: place.offset):
                for message in read_messages(file, chunk):
                    yield _raw(file, message)

    def published(self, topics: Iterable[str] | None = None) -> Iterator[RawMessage]:
        """Iterate over serialised messages in the order of publishing, in which every cause precedes its effect.

        Topics reach a recorder through separate queues and can overtake each other by a few messages there.

        Parameters
        ----------
        topics
            Full names; None for all topics.

        Raises
        ------
        RecordingError
            See `raw`.
        """
        waiting: list[tuple[int, int, RawMessage]] = []
        for order, message in enumerate(self.raw(topics)):
            heapq.heappush(waiting, (message.publish_time, order, message))
            if len(waiting) > REORDER_WINDOW:
                yield heapq.heappop(waiting)[-1]
        while waiting:
            yield heapq.heappop(waiting)[-1]

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[tuple[str, Any, int]]:
        """Iterate over (topic, decoded message, log time [ns]) in the order of `raw`."""
        for raw in self.raw(topics):
            yield raw.topic, self.decode(raw.topic, raw.data), raw.log_time

    def decode(self, topic: str, data: bytes) -> Any:
        """Return one message, decoded by the definition in the recording; its arrays are NumPy arrays.

        Raises
        ------
        RecordingError
            The bytes do not fit the definition, or the definition is not in the language ``ros2msg``.
        """
        return decode(self.topics[topic], data, self.path)

    def _of_other_types(self, names: Iterable[str]) -> list[Topic]:
        """Return the topics that have one of these names and the type of another program."""
        return [topic for topic in self.topics.values() if any(is_named(topic.name, "", name) for name in names)]

    def _full_names(self, name: str) -> list[str]:
        return sorted(
            topic
            for topic, count in self.counts.items()
            if count and is_named(topic, self.topics[topic].type_name, name)
        )


def decode(topic: Topic, data: bytes, path: Path) -> Any:
    """Return a message of a topic, decoded by its recorded definition; its arrays are NumPy arrays.

    A message of an earlier version has the fields of the present one.

    Raises
    ------
    RecordingError
        See `BagReader.decode`; the message names the recording `path`.
    """
    if topic.encoding != "ros2msg":
        raise RecordingError(f"{path}: {topic.name} is defined in {topic.encoding}, only ros2msg is supported")
    types = _types(topic.definition, topic.type_name)
    try:
        message = types.deserialize_cdr(data, topic.type_name)
    except Exception as error:
        raise RecordingError(f"{path}: a message of {topic.name} is not a {topic.type_name}: {error}") from error
    translate(topic.type_name, message)
    return message


@lru_cache(maxsize=256)
def _types(definition: str, type_name: str) -> Typestore:
    """Return the types of a definition; their code is generated once for all recordings with the same definition."""
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(definition, type_name))
    return types


def _raw(file: McapFile, message: Message) -> RawMessage:
    topic = file.channels[message.channel_id].topic
    return RawMessage(topic, message.data, message.log_time, message.publish_time, message.sequence)


def topic_of(channel: Channel, schema: Schema | None) -> Topic:
    """Return the topic of a channel."""
    return Topic(
        channel.topic,
        schema.name if schema else "",
        schema.data.decode(errors="replace") if schema else "",
        schema.encoding if schema else "",
        channel.metadata.get("topic_type_hash", ""),
        channel.metadata.get("offered_qos_profiles", ""),
    )


def _damage(files: Iterable[McapFile], found: BagFiles) -> Iterator[str]:
    """Yield a description of each damaged or missing file."""
    for file in files:
        if file.damage:
            yield f"{file.path.name}: {' and '.join(file.damage)}"
    for name in found.missing:
        yield f"{name} is missing"
    if found.damage:
        yield found.damage


def _spans(files: Iterable[McapFile]) -> Iterator[tuple[int, int]]:
    """Yield the log times of the first and the last message of each chunk [ns], in the order of writing."""
    for file in files:
        for chunk in sorted(file.chunks, key=lambda place: place.offset):
            if chunk.end_time:  # 0 for a chunk without messages
                yield chunk.start_time, chunk.end_time


def describe_set_back(spans: Iterable[tuple[int, int]]) -> str:
    """Return that the clock was set back during a recording, and when; empty if it was not.

    Parameters
    ----------
    spans
        Log times of the first and the last message [ns] of each chunk or of each message, in the order of writing. A
        clock that is set back within a single chunk is found by the times of the messages only.

    Examples
    --------
    >>> describe_set_back([(0, 4_000_000_000), (3_900_000_000, 9_000_000_000), (6_000_000_000, 7_000_000_000)])
    'the clock was set back by 3.0 s at 1970-01-01 00:00:09 UTC; order and times of later messages are wrong'
    """
    back, when = 0, 0
    for (_, end), (start, _) in pairwise(spans):
        if end - start > max(back, _SET_BACK_NS):
            back, when = end - start, end
    if not back:
        return ""
    time = datetime.fromtimestamp(1e-9 * when, UTC)
    later = "order and times of later messages are wrong"
    return f"the clock was set back by {1e-9 * back:.1f} s at {time:%Y-%m-%d %H:%M:%S} UTC; {later}"


def describe_parts(names: Iterable[str]) -> str:
    """Return a description of the parts of a recording that were not joined with it; empty if there are none."""
    listed = ", ".join(names)
    return listed and f"{listed} beside it, later parts of the same run, are not read"


def _missing_words(missing: dict[str, int]) -> str:
    counts = ", ".join(f"{count} of {name}" for name, count in missing.items())
    return counts and f"missing messages: {counts}"
