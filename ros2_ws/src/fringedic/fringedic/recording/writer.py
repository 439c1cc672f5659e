"""Writes rosbag2 directories with an MCAP file that stays readable after a crash."""

from __future__ import annotations

import errno
import os
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, Literal

import yaml
from mcap.writer import CompressionType, Writer

from fringedic import __version__
from fringedic.errors import ErrorCode, RecordingError
from fringedic.recording.definitions import interface_definition, type_hash
from fringedic.recording.topics import Qos, Topic

_COMPRESSIONS = {"none": CompressionType.NONE, "zstd": CompressionType.ZSTD}
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


class BagWriter:
    """Writes a rosbag2 directory with one MCAP file that stays readable when the process or the machine dies.

    Written messages are passed to the operating system about every half second while messages arrive; an owner without
    messages for longer calls `flush` by timer. `sync` makes all messages survive a power cut. It takes about 150 ms and
    is meant for the end of a step.

    Parameters
    ----------
    path
        Folder of the recording; it must not exist yet.
    compression
        ``zstd`` or ``none``.
    flush_interval_s
        Time [s] after which messages are passed to the operating system, so that they survive a crash of this process.

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
    ) -> None:
        self.path = Path(path)
        self._flush_interval = flush_interval_s
        if self.path.exists():
            raise RecordingError(f"{self.path} exists already; choose another name, nothing was overwritten")
        self._file_name = f"{self.path.name}_0.mcap"
        self._topics: dict[str, tuple[int, Topic]] = {}
        self._counts: defaultdict[str, int] = defaultdict(int)
        self._first_time, self._last_time = 2**63 - 1, 0
        self._flushed_at = 0.0
        self._closed = False
        self._failure: OSError | None = None
        with self._named_errors():
            self.path.mkdir(parents=True)
            self._stream: BinaryIO = (self.path / self._file_name).open("xb")
            self._writer = Writer(self._stream, compression=_COMPRESSIONS[compression])
            self._writer.start(profile="ros2", library=f"fringedic {__version__}")
            self._writer.flush()  # type: ignore[no-untyped-call]
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
        """Bytes in the file so far."""
        return (self.path / self._file_name).stat().st_size

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
            known = self._topics[name][1].type_name
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
        """Announce a topic with the definition from another recording."""
        with self._named_errors():
            schema = self._writer.register_schema(topic.type_name, topic.encoding, topic.definition.encode())
            metadata = {"offered_qos_profiles": topic.qos, "topic_type_hash": topic.hash}
            channel = self._writer.register_channel(topic.name, "cdr", schema, metadata)
        self._topics[topic.name] = (channel, topic)

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
        try:
            channel = self._topics[topic][0]
        except KeyError:
            raise RecordingError(f"{self.path}: topic {topic} was not announced; call add_topic first") from None
        with self._named_errors():
            count = self._counts[topic] if sequence is None else sequence
            self._writer.add_message(channel, log_time, data, publish_time, count)
        self._counts[topic] += 1
        self._first_time = min(self._first_time, log_time)
        self._last_time = max(self._last_time, log_time)
        if time.monotonic() - self._flushed_at > self._flush_interval:
            self.flush()

    def flush(self) -> None:
        """Pass all messages to the operating system, so that they survive a crash of this process."""
        with self._named_errors():
            self._writer.flush()  # type: ignore[no-untyped-call]
        self._flushed_at = time.monotonic()

    def sync(self) -> None:
        """Write all messages to the disk, so that they survive a power cut."""
        self.flush()
        with self._named_errors():
            os.fsync(self._stream.fileno())

    def close(self) -> None:
        """Write index and metadata and close the file; a recording that has failed is closed without them."""
        if self._closed:
            return
        self._closed = True
        if self._failure is not None:
            with suppress(OSError):
                self._stream.close()
            return
        try:
            with self._named_errors():
                self._writer.add_metadata("rosbag2", {"serialized_metadata": yaml.safe_dump(self._metadata())})
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._stream.flush()
                os.fsync(self._stream.fileno())
                self._write_metadata()
        finally:
            with suppress(OSError):
                self._stream.close()

    @contextmanager
    def _named_errors(self) -> Iterator[None]:
        if self._failure is not None:
            raise self._failure
        try:
            yield
        except OSError as error:
            if error.errno in _FULL:
                self._failure = RecordingError(
                    f"{self.path}: the disk is full ({error.strerror}); what was recorded before stays readable, "
                    "free some space and start a new recording",
                    code=ErrorCode.DISK_FULL,
                )
            else:
                self._failure = RecordingError(f"{self.path}: cannot be written: {error.strerror}")
            raise self._failure from error

    def _metadata(self) -> dict[str, Any]:
        count = self.message_count
        start = {"nanoseconds_since_epoch": self._first_time if count else 0}
        duration = {"nanoseconds": self._last_time - self._first_time if count else 0}
        return {
            "version": 9,
            "storage_identifier": "mcap",
            "relative_file_paths": [self._file_name],
            "duration": duration,
            "starting_time": start,
            "message_count": count,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": topic.name,
                        "type": topic.type_name,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": yaml.safe_load(topic.qos) or [],
                        "type_description_hash": topic.hash,
                    },
                    "message_count": self._counts[topic.name],
                }
                for _, topic in self._topics.values()
            ],
            "compression_format": "",
            "compression_mode": "",
            "files": [
                {
                    "path": self._file_name,
                    "starting_time": dict(start),
                    "duration": dict(duration),
                    "message_count": count,
                }
            ],
            "custom_data": {"fringedic_version": __version__},
            "ros_distro": os.environ.get("ROS_DISTRO", "jazzy"),
        }

    def _write_metadata(self) -> None:
        """Replace metadata.yaml atomically, so that it is complete at any time."""
        temporary = self.path / "metadata.yaml.writing"
        with open(temporary, "w", encoding="utf-8") as file:
            yaml.safe_dump({"rosbag2_bagfile_information": self._metadata()}, file, sort_keys=False)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(self.path / "metadata.yaml")
