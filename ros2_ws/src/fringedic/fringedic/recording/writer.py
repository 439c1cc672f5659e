"""Writes rosbag2 directories with MCAP files that stay readable after a crash."""

from __future__ import annotations

import errno
import hashlib
import math
import os
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import yaml

from fringedic.errors import ErrorCode, RecordingError
from fringedic.recording.bag_files import METADATA
from fringedic.recording.bag_metadata import bag_metadata
from fringedic.recording.definitions import interface_definition, type_hash
from fringedic.recording.latched import LatchedMessages
from fringedic.recording.manifest import write_manifest, write_whole
from fringedic.recording.mcap_output import McapOutput, WrittenFile
from fringedic.recording.topics import Qos, RawMessage, Topic
from fringedic.wording.causes import cause_of

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


@dataclass(frozen=True)
class Split:
    """When a recording continues in its next file: size [byte] and duration [s] of a file; by default never."""

    size: float = math.inf
    duration: float = math.inf


ONE_FILE = Split()


class _Repeated(NamedTuple):
    """Latched messages at the beginning of a file: their number, and the size of the file with them [byte]."""

    messages: int = 0
    size: int = 0


class BagWriter:
    """Writes a rosbag2 directory whose MCAP files stay readable when the process or the machine dies.

    Written messages are passed to the operating system about every half second while messages arrive; an owner without
    messages for longer calls `flush` by timer. `sync` makes all messages survive a power cut. It takes about 150 ms and
    is meant for the end of a step. The last act of `close` is a manifest with the SHA-256 of every file.

    Parameters
    ----------
    path
        Folder of the recording; it must not exist yet.
    compression
        ``zstd`` or ``none``.
    flush_interval_s
        Time [s] after which messages are passed to the operating system, so that they survive a crash of this process.
    split
        Size and duration after which the recording continues in its next file. A file exceeds the size by its index,
        its definitions, and the latched messages at its beginning: each file begins with copies of the last ones of
        before, such as settings and calibration, so that it can be read without the files before it.

    Raises
    ------
    RecordingError
        The folder exists or cannot be written; with the code DISK_FULL (also from every other method) the disk is
        full, and all messages written before stay readable.

    Examples
    --------
    >>> import tempfile
    >>> from fringedic.recording import Topic
    >>> with tempfile.TemporaryDirectory() as folder, BagWriter(f"{folder}/bag") as writer:
    ...     writer.add_recorded_topic(Topic("/force", "bench_msgs/msg/Force", "uint8 newton", "ros2msg", "", ""))
    ...     writer.write("/force", bytes([0, 1, 0, 0, 42]), log_time=10, publish_time=9)
    ...     writer.counts
    {'/force': 1}
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        compression: Literal["zstd", "none"] = "zstd",
        flush_interval_s: float = 0.5,
        split: Split = ONE_FILE,
    ) -> None:
        self.path = Path(path)
        self._compression = compression
        self._flush_interval = flush_interval_s
        self._split = split
        if self.path.exists():
            raise RecordingError(f"{self.path} exists already; choose another name, nothing was overwritten")
        self._topics: dict[str, Topic] = {}
        self._latched = LatchedMessages()
        self._counts: defaultdict[str, int] = defaultdict(int)
        self._copies: defaultdict[str, int] = defaultdict(int)  # of latched messages, among the counts
        self._finished: list[WrittenFile] = []
        self._repeated = _Repeated()
        self._flushed_at = 0.0
        self._closed = False
        self._failure: OSError | None = None
        with self._named_errors():
            self.path.mkdir(parents=True)
            self._output = self._next_output()
            self._write_metadata()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return sum(self._counts.values())

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far of each topic."""
        return dict(self._counts)

    @property
    def size(self) -> int:
        """Bytes in the files so far."""
        finished = {file.name for file in self._finished}  # also the last file, as soon as the recording is closed
        unfinished = 0 if self._output.summary.name in finished else self._output.size_on_disk
        return sum((self.path / name).stat().st_size for name in finished) + unfinished

    def add_topic(
        self, name: str, type_name: str, qos: Iterable[Qos] = (Qos(),), *, publisher_hash: str | None = None
    ) -> None:
        """Announce a topic, once, before its first message.

        Parameters
        ----------
        name, type_name
            ``/rig/camera/image_raw``, ``sensor_msgs/msg/Image``.
        qos
            Quality of service that the topic's publishers offer.
        publisher_hash
            Hash of the type that the publisher uses; compared with that of the installed definition.

        Raises
        ------
        RecordingError
            The definition of the type is not installed, the publisher's definition differs from the installed one (the
            messages could not be decoded), or the topic exists with another type.
        """
        if name in self._topics:
            known = self._topics[name].type_name
            if known != type_name:
                raise RecordingError(f"{self.path}: topic {name} is recorded as {known}, not as {type_name}")
            return
        profiles = yaml.safe_dump([each.profile() for each in qos], sort_keys=False)
        definition, hash_ = interface_definition(type_name), type_hash(type_name)
        if publisher_hash is not None and publisher_hash != hash_:
            raise RecordingError(
                f"topic {name}: its publisher was built with another definition of {type_name} than the one installed "
                "here; build both from the same sources"
            )
        self.add_recorded_topic(Topic(name, type_name, definition, "ros2msg", hash_, profiles))

    def add_recorded_topic(self, topic: Topic) -> None:
        """Announce a topic with the definition from another recording; one that is announced already stays as it is.

        Raises
        ------
        RecordingError
            The topic exists with another definition.
        """
        known = self._topics.get(topic.name)
        if known is not None:
            if not known.has_messages_of(topic):
                raise RecordingError(
                    f"{self.path}: topic {topic.name} has two definitions of its type {topic.type_name}; recordings of "
                    "different versions cannot be joined"
                )
            return
        with self._named_errors():
            self._output.announce(topic)
        self._topics[topic.name] = topic
        self._latched.add_topic(topic)

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int, sequence: int | None = None) -> None:
        """Append one serialised message.

        Parameters
        ----------
        topic
            Full name of an announced topic.
        data
            The message in CDR.
        log_time, publish_time
            When it was received and published [ns].
        sequence
            The publisher's own count of its messages, in which gaps show lost messages; by default the number of
            messages written.

        Raises
        ------
        RecordingError
            The topic was not announced, or the file cannot be written.
        """
        if topic not in self._topics:
            raise RecordingError(f"{self.path}: topic {topic} was not announced; call add_topic first")
        count = self._counts[topic] - self._copies[topic] if sequence is None else sequence
        with self._named_errors():
            if self._is_full(len(data), log_time):
                self._begin_next_file(log_time)
            message = RawMessage(topic, data, log_time, publish_time, count)
            self._output.write(message)
        self._counts[topic] += 1
        if self._split != ONE_FILE:
            self._latched.keep(message)
        if time.monotonic() - self._flushed_at > self._flush_interval:
            self.flush()

    def flush(self) -> None:
        """Pass all messages to the operating system, so that they survive a crash of this process."""
        with self._named_errors():
            self._output.flush()
        self._flushed_at = time.monotonic()

    def sync(self) -> None:
        """Write all messages to the disk, so that they survive a power cut."""
        with self._named_errors():
            self._output.sync()
        self._flushed_at = time.monotonic()

    def close(self) -> None:
        """Write index, metadata and manifest; a recording that has failed is closed without them."""
        if self._closed:
            return
        self._closed = True
        try:
            if self._failure is None:
                with self._named_errors():
                    self._finish_file()
                    metadata = self._write_metadata()
                    checksums = {file.name: file.checksum for file in self._finished}
                    write_manifest(self.path, checksums | {METADATA: hashlib.sha256(metadata.encode()).hexdigest()})
        finally:
            with suppress(OSError):
                self._output.abandon()

    def _next_output(self) -> McapOutput:
        return McapOutput(self.path / f"{self.path.name}_{len(self._finished)}.mcap", self._compression)

    def _is_full(self, size: int, log_time: int) -> bool:
        """Return whether the present file has to end before a message of a size [byte] and time [ns]."""
        file = self._output.summary
        if file.messages == self._repeated.messages:
            return False
        written = self._output.size - self._repeated.size
        return written + size > self._split.size or log_time - file.start_time > 1e9 * self._split.duration

    def _begin_next_file(self, log_time: int) -> None:
        self._finish_file()
        self._output = self._next_output()
        for topic in self._topics.values():
            self._output.announce(topic)
        for message in self._latched.messages():
            self._output.write(message._replace(log_time=log_time))
            self._counts[message.topic] += 1
            self._copies[message.topic] += 1
        self._repeated = _Repeated(self._output.summary.messages, self._output.size)
        self._write_metadata()

    def _finish_file(self) -> None:
        files = [*self._finished, self._output.summary]
        metadata = bag_metadata(files, self._topics.values(), self._counts)
        self._finished.append(self._output.finish(yaml.safe_dump(metadata)))

    @contextmanager
    def _named_errors(self) -> Iterator[None]:
        if self._failure is not None:
            raise self._failure
        try:
            yield
        except OSError as error:
            if error.errno in _FULL:
                self._failure = RecordingError(
                    f"{self.path}: the disk is full ({cause_of(error)}); what was recorded before stays readable, "
                    "free some space and start a new recording",
                    code=ErrorCode.DISK_FULL,
                )
            else:
                self._failure = RecordingError(f"{self.path}: cannot be written: {cause_of(error)}")
            raise self._failure from error

    def _write_metadata(self) -> str:
        """Write metadata.yaml and return its text."""
        files = self._finished if self._closed else [*self._finished, self._output.summary]
        content = {"rosbag2_bagfile_information": bag_metadata(files, self._topics.values(), self._counts)}
        text = yaml.safe_dump(content, sort_keys=False)
        write_whole(self.path / METADATA, text)
        return text
