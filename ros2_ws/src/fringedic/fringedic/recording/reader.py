"""Reads finished or truncated recordings message by message, without ROS."""

from __future__ import annotations

import heapq
import os
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cached_property
from itertools import accumulate, islice
from pathlib import Path
from typing import Any

from mcap.records import Message

from fringedic.errors import ErrorCode, RecordingError
from fringedic.frames.records import frame_record
from fringedic.frames.sensor import SENSOR, choice_of_sensors
from fringedic.recording.bag_files import BagFiles, find_files, open_file, parts_of_run, recording_of
from fringedic.recording.conversion import readable
from fringedic.recording.decoding import decode
from fringedic.recording.latched import CopyFilter
from fringedic.recording.mcap_file import FOREIGN, McapFile, count_without_checksum, read_messages, topic_of
from fringedic.recording.order import ClockCheck
from fringedic.recording.topics import EXPOSURE, RawMessage, Topic, is_named

_LARGEST_OVERLAP = 1 << 30  # [byte] of messages in memory whose chunks overlap in time, besides one chunk
_MESSAGE_BYTES = 300  # of memory beside the data of a message
REORDER_WINDOW = 64  # messages by which topics may overtake each other on their way into the recording


class BagReader:
    """Reads a finished or truncated recording one message after the other.

    Parameters
    ----------
    path
        A rosbag2 folder, one of its files, or the folder of a run with its recording ``bag``. Other storage than MCAP
        in chunks is read through a copy in the folder of temporary files.
    check
        Read every chunk on opening and leave out those that are damaged. Without it, a file with an undamaged index is
        opened by its index alone, and a damaged chunk raises an error when it is reached.
    sensor
        Name of the sensor whose topics `find` returns; None for the only one.

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
        Description of a clock that was set back during the recording; empty if it was not, or if it was set back within
        a single chunk, which only `verify` reads.
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
        There is no such recording, it has another format, its files define a topic differently, or it contains
        exposures of other sensors only.

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

    def __init__(self, path: str | os.PathLike[str], *, check: bool = False, sensor: str | None = None) -> None:
        self.path = recording_of(Path(path))
        self._readable = readable(self.path)
        found = find_files(self._readable.path)
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
        self.set_back = self._set_back()
        damage = (self._readable.damage, *_damage(self._files, found), self.set_back)
        self.damage = "; ".join(filter(None, damage))
        self.parts = parts_of_run(self.path)
        words = self.damage, _missing_words(self.missing), describe_parts(part.name for part in self.parts)
        self.lost = "; ".join(filter(None, words))
        if sensor is not None and self.sensors and sensor not in self.sensors:
            names = ", ".join(sorted(self.sensors))
            raise RecordingError(f"{self.path} contains no sensor '{sensor}', it contains {names}: choose one of these")
        self._sensor = sensor

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
        """Number of chunks without a checksum: other recorders may leave it out, and other storage has none."""
        if self.is_converted:
            return sum(len(file.chunks) for file in self._files)
        return sum(count_without_checksum(file) for file in self._files)

    @property
    def is_converted(self) -> bool:
        """Whether its storage is read through a copy; see `fringedic.recording.conversion`."""
        return self._readable.path != self.path

    def find(self, *relative_names: str) -> dict[str, str]:
        """Return the full names of topics by their names relative to the namespace of the sensor or of its rig.

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
            the recording contains several sensors and none was chosen, or a topic of several rigs.
        """
        found = {name: self._full_names(name) for name in relative_names}
        missing = [name for name, full in found.items() if not full]
        if missing:
            present = ", ".join(sorted(topic for topic, count in self.counts.items() if count)) or "no message at all"
            others = (f"{topic.name} is a {topic.type_name}" for topic in self._of_other_types(missing))
            words = "; ".join([f"{self.path} has no {', '.join(missing)}", *others, f"it holds {present}"])
            raise RecordingError(words, code=ErrorCode.MISSING_TOPIC)
        for name, full in found.items():
            if len(full) > 1 and self.sensor:  # which raises when there are several sensors
                raise _of_several_rigs(self.path, name, full)
        return {name: full[0] for name, full in found.items()}

    def find_optional(self, *relative_names: str) -> dict[str, str]:
        """Return the full names of those topics that are in the recording; see `find`."""
        return self.find(*(name for name in relative_names if self._full_names(name)))

    def raw(self, topics: Iterable[str] | None = None, *, start: int = 0) -> Iterator[RawMessage]:
        """Iterate over serialised messages in the order of their log time.

        Messages of equal time keep their order in the file. Copies of latched messages, with which each file of a split
        recording begins, are left out. One chunk (about a megabyte) is in memory at a time, or as many as overlap in
        time.

        Parameters
        ----------
        topics
            Full names; None for all topics.
        start
            Messages of an earlier log time [ns] are left out.

        Raises
        ------
        RecordingError
            A chunk is damaged although the index is complete, or chunks that overlap in time do not fit into memory.
        """
        copies = CopyFilter()
        for message in self._in_order(set(self.topics if topics is None else topics), start):
            if not copies.is_copy(self.topics[message.topic], message):
                yield message

    def _in_order(self, wanted: set[str], start: int) -> Iterator[RawMessage]:
        places = [
            (chunk, number, file)
            for number, file in enumerate(self._files)
            for chunk in file.chunks
            if chunk.end_time >= start
            and any(file.channels[known].topic in wanted for known in chunk.channels & file.channels.keys())
        ]
        places.sort(key=lambda place: (place[0].start_time, place[1], place[0].offset))
        waiting: list[tuple[int, int, int, int, RawMessage]] = []
        waiting_bytes = 0
        for chunk, number, file in places:
            while waiting and waiting[0][0] < chunk.start_time:
                message = heapq.heappop(waiting)[-1]
                waiting_bytes -= _MESSAGE_BYTES + len(message.data)
                yield message
            for order, message in enumerate(_raw(file, each) for each in read_messages(file, chunk)):
                if message.topic in wanted and message.log_time >= start:
                    heapq.heappush(waiting, (message.log_time, number, chunk.offset, order, message))
                    waiting_bytes += _MESSAGE_BYTES + len(message.data)
            if waiting_bytes > _LARGEST_OVERLAP:
                raise RecordingError(
                    f"{self.path}: messages of the same time lie far apart in it, so that more than "
                    f"{_LARGEST_OVERLAP >> 20} MB would be in memory; write it in the order of time, for example with "
                    "`mcap sort`"
                )
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

    def _set_back(self) -> str:
        """Return that the clock was set back; the messages are read only where the times of the chunks go back.

        Files of other recordings have times of their own.
        """
        files = [file for file in self._files if file.path.name not in self.unlisted]
        chunks = [(file, chunk) for file in files for chunk in sorted(file.chunks, key=lambda place: place.offset)]
        ends = accumulate((chunk.end_time for _, chunk in chunks), max)
        check = ClockCheck(self.topics.values())
        if any(chunk.end_time and chunk.start_time < end for (_, chunk), end in zip(chunks[1:], ends, strict=False)):
            for file, chunk in chunks:
                with suppress(RecordingError):  # damage is reported where the chunk is needed
                    for message in read_messages(file, chunk):
                        check.add(_raw(file, message))
        return check.description

    def _of_other_types(self, names: Iterable[str]) -> list[Topic]:
        """Return the topics that have one of these names and the type of another program."""
        return [
            topic
            for topic in self.topics.values()
            if any(is_named(topic.name, "", name) and not is_named(topic.name, topic.type_name, name) for name in names)
        ]

    @cached_property
    def sensors(self) -> dict[str, str]:
        """Name of each sensor whose exposures are recorded, with the beginning of the names of its topics."""
        exposures, found = self._named(EXPOSURE), dict[str, str]()
        for topic in exposures:
            for raw in islice(self.raw([topic]), 1):  # not `messages`, of which a subclass may need the sensor
                sensor = frame_record(self.decode(topic, raw.data)).sensor
                if sensor in found:
                    raise _of_several_rigs(self.path, EXPOSURE, exposures)
                found[sensor] = topic.removesuffix(EXPOSURE)
        return found

    @property
    def sensor(self) -> str:
        """Name of the chosen sensor, or of the only one.

        Raises
        ------
        RecordingError
            The recording contains several and none was chosen.
        """
        if self._sensor is None and len(self.sensors) > 1:
            raise RecordingError(choice_of_sensors(self.path, self.sensors))
        return self._sensor or next(iter(self.sensors), SENSOR)

    def _named(self, name: str) -> list[str]:
        return sorted(
            topic
            for topic, count in self.counts.items()
            if count and is_named(topic, self.topics[topic].type_name, name)
        )

    def _full_names(self, name: str) -> list[str]:
        """Return the topics of this name: that of the chosen sensor, otherwise those that are of no other sensor."""
        full = self._named(name)
        if self._sensor is None:
            return full
        of_sensors = {sensor: f"{beginning}{name}" for sensor, beginning in self.sensors.items()}
        own = of_sensors.pop(self._sensor, "")
        return [own] if own in full else [topic for topic in full if topic not in of_sensors.values()]


def _of_several_rigs(path: Path, name: str, topics: Iterable[str]) -> RecordingError:
    return RecordingError(f"{path} contains {name} of several rigs: {', '.join(topics)}")


def _raw(file: McapFile, message: Message) -> RawMessage:
    topic = file.channels[message.channel_id].topic
    return RawMessage(topic, message.data, message.log_time, message.publish_time, message.sequence)


def _damage(files: Iterable[McapFile], found: BagFiles) -> Iterator[str]:
    """Yield a description of each damaged or missing file."""
    for file in files:
        if file.damage:
            yield f"{file.path.name}: {' and '.join(file.damage)}"
    for name in found.missing:
        yield f"{name} is missing"
    if found.damage:
        yield found.damage


def describe_parts(names: Iterable[str]) -> str:
    """Return a description of the parts of a recording that were not joined with it; empty if there are none."""
    listed = ", ".join(names)
    return listed and f"{listed} beside it, later parts of the same run, are not read"


def _missing_words(missing: dict[str, int]) -> str:
    counts = ", ".join(f"{count} of {name}" for name, count in missing.items())
    return counts and f"missing messages: {counts}"
