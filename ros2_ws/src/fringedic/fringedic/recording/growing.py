"""Reads a recording while it is made: each chunk as soon as the recorder has written it."""

from __future__ import annotations

import heapq
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from io import SEEK_END, BytesIO
from pathlib import Path
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema

from fringedic.errors import RecordingError
from fringedic.recording.bag_files import METADATA, find_files, recording_of
from fringedic.recording.decoding import decode
from fringedic.recording.latched import CopyFilter
from fringedic.recording.mcap_file import DAMAGE, MAGIC, RECORD_HEADER, McapFile, chunk_records, index_bytes, topic_of
from fringedic.recording.reader import REORDER_WINDOW, BagReader
from fringedic.recording.topics import RawMessage, Topic, is_named

STEP = "experiment/step"
PATIENCE_S = 120.0  # attributes of files on a file server are up to 60 s old
_POLL_S = 0.2
_ENDS = (3, 4)  # stages END and ERROR of fringedic_msgs/StepStatus


class FollowError(RecordingError):
    """A recording cannot be read in its final order while it is made; it has to be read when it is complete."""


class GrowingRecording:
    """A recording that is being made, or that has just been completed.

    The recorder writes whole chunks, at the end of each step at the latest, and touches its file about every half
    second. The index at the end of a file is not needed.

    Parameters
    ----------
    path
        A rosbag2 folder with MCAP files, one MCAP file, or the folder of a run with its recording ``bag``.
    patience_s
        Time without a change of the files [s] after which the recorder is taken for ended.

    Attributes
    ----------
    path
        The recording.

    Raises
    ------
    RecordingError
        There is no such recording.
    """

    def __init__(self, path: Path, *, patience_s: float = PATIENCE_S) -> None:
        self.path = recording_of(path)
        self._topics: dict[str, Topic] = {}
        self._patience = patience_s
        self._state = self._files_now()
        self._changed = time.monotonic()

    @property
    def size(self) -> int:
        """Size of the files so far [byte]."""
        return sum(size for _, size, _ in self._files_now())

    def is_complete(self) -> bool:
        """Return whether the recorder has closed the recording.

        Every file has an index then, and ``metadata.yaml`` counts all messages: between two files of a recording that
        is split, it counts those of the files before.
        """
        found = find_files(self.path)
        if not self._is_indexed():
            return False
        counts = BagReader(self.path).counts
        return bool(found.damage) or not (self.path / METADATA).is_file() or Counter(found.counts) == Counter(counts)

    def wait(self) -> None:
        """Wait until the recording is complete.

        Raises
        ------
        RecordingError
            The recorder has ended without closing it.
        """
        while not self.is_complete() and self._pause():
            pass

    def wait_for_writer(self) -> None:
        """Wait until the files change, so that nothing is processed of a recording that was cut off.

        Raises
        ------
        RecordingError
            The recorder has ended without closing it.
        """
        before = self._files_now()
        while before == self._files_now() and self._pause():
            pass

    def first(self, name: str) -> Any:
        """Return the first message of a topic, decoded; None if it is not written yet.

        Parameters
        ----------
        name
            Relative to the rig's namespace.
        """
        return next((decode(self._topics[raw.topic], raw.data, self.path) for raw in self._written({}, {name})), None)

    def published(self, names: Iterable[str]) -> Iterator[tuple[str, Any]]:
        """Iterate over decoded messages in the order of `BagReader.published`, and wait for those to come.

        At the end of a step everything that was published before it is returned at once. That the order is the final
        one is checked with each later message.

        Parameters
        ----------
        names
            Of topics, relative to the rig's namespace.

        Yields
        ------
        tuple
            (relative name of the topic, message).

        Raises
        ------
        FollowError
            A message was published before one that has been returned, or the complete recording contains others.
        RecordingError
            The recorder has ended without closing the recording, or a chunk is damaged.
        """
        wanted = set(names)
        waiting: list[tuple[int, int, str, Any]] = []
        logged, passed = 0, (0, -1)
        for order, raw in enumerate(self._until_complete(wanted)):
            topic = self._topics[raw.topic]
            name, message = _relative(topic, wanted), decode(topic, raw.data, self.path)
            if raw.log_time < logged or (raw.publish_time, order) < passed:
                raise FollowError(f"{self.path}: its messages are not in the order of their times")
            logged = raw.log_time
            heapq.heappush(waiting, (raw.publish_time, order, name, message))
            ended = raw.publish_time if name == STEP and message.stage in _ENDS else -1
            while waiting and (len(waiting) > REORDER_WINDOW or waiting[0][0] <= ended):
                *passed_now, name, message = heapq.heappop(waiting)
                passed = passed_now[0], passed_now[1]
                yield name, message
        while waiting:
            yield heapq.heappop(waiting)[2:]

    def _until_complete(self, wanted: set[str]) -> Iterator[RawMessage]:
        """Yield the messages of topics in the order in which they are written until the recording is complete."""
        tails: dict[Path, _Tail] = {}
        copies, complete = CopyFilter(), False
        while not complete:
            complete = self.is_complete()  # before reading, so that nothing is missed
            for raw in self._written(tails, wanted):
                if not copies.is_copy(self._topics[raw.topic], raw):
                    yield raw
            complete = complete or not self._pause()
        if sum((tail.counts for tail in tails.values()), Counter()) != Counter(BagReader(self.path).counts):
            raise FollowError(f"{self.path}: other messages were read than it contains")

    def _written(self, tails: dict[Path, _Tail], wanted: set[str]) -> Iterator[RawMessage]:
        """Yield the messages of topics that were written since the last time."""
        for path in find_files(self.path).present:
            tail = tails.setdefault(path, _Tail(path))
            for messages in tail.new_chunks():
                topics = {number: topic_of(each, tail.schema(each)) for number, each in tail.file.channels.items()}
                self._topics |= {topic.name: topic for topic in topics.values()}
                for each in messages:
                    name = topics[each.channel_id].name
                    if _relative(topics[each.channel_id], wanted):
                        yield RawMessage(name, each.data, each.log_time, each.publish_time, each.sequence)

    def _pause(self) -> bool:
        """Wait a moment; return False at once if nothing has changed for long and there is an index all the same.

        Raises
        ------
        RecordingError
            Nothing has changed for long, and there is no index.
        """
        state = self._files_now()
        if state != self._state:
            self._state, self._changed = state, time.monotonic()
        elif time.monotonic() - self._changed > self._patience:
            if self._is_indexed():
                return False
            raise RecordingError(
                f"{self.path}: its recorder has ended without closing it (no change for {self._patience:g} s): "
                f"'fringedic recover {self.path}' writes a complete recording from it"
            )
        time.sleep(_POLL_S)
        return True

    def _is_indexed(self) -> bool:
        return all(index_bytes(file) is not None for file in find_files(self.path).present)

    def _files_now(self) -> list[tuple[Path, int, int]]:
        """Return size and time of modification of each file."""
        found = [(path, path.stat()) for path in find_files(self.path).present]
        return [(path, stat.st_size, stat.st_mtime_ns) for path, stat in found]


class _Tail:
    """One MCAP file that is read up to its last complete record."""

    def __init__(self, path: Path) -> None:
        self.file = McapFile(path)
        self._position = len(MAGIC)

    @property
    def counts(self) -> Counter[str]:
        """Messages of each topic that have been read."""
        return Counter({each.topic: self.file.counts[number] for number, each in self.file.channels.items()})

    def schema(self, channel: Channel) -> Schema | None:
        """Return the message definition of a channel."""
        return self.file.schemas.get(channel.schema_id)

    def new_chunks(self) -> Iterator[list[Message]]:
        """Yield the messages of each chunk that was written since the last time."""
        with self.file.path.open("rb") as stream:
            size = stream.seek(0, SEEK_END)
            stream.seek(0)
            if not MAGIC.startswith(stream.read(len(MAGIC))):
                raise RecordingError(f"{self.file.path}: is not an MCAP file")
            while self._position + RECORD_HEADER.size <= size:
                stream.seek(self._position)
                header = stream.read(RECORD_HEADER.size)
                opcode, length = RECORD_HEADER.unpack(header)
                end = self._position + RECORD_HEADER.size + length
                if opcode == Opcode.DATA_END or end > size:
                    return
                if opcode == Opcode.MESSAGE:
                    raise FollowError(f"{self.file.path}: is written without chunks")
                if opcode == Opcode.CHUNK:
                    yield self._messages(header + stream.read(length))
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._define(opcode, stream.read(length))
                self._position = end

    def _define(self, opcode: int, data: bytes) -> None:
        content = ReadDataStream(BytesIO(data))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(content)
            self.file.schemas[schema.id] = schema
        else:
            channel = Channel.read(content)
            self.file.channels[channel.id] = channel

    def _messages(self, chunk: bytes) -> list[Message]:
        try:
            records = chunk_records(chunk)
        except DAMAGE as error:
            raise FollowError(f"{self.file.path}: damaged at byte {self._position} ({error})") from error
        self.file.add_chunk(self._position, len(chunk), records)
        return [each for each in records if isinstance(each, Message) and each.channel_id in self.file.channels]


def _relative(topic: Topic, names: set[str]) -> str:
    """Return which of some names relative to the rig's namespace a topic has; empty for none."""
    return next((name for name in names if is_named(topic.name, topic.type_name, name)), "")
