"""One MCAP file while it is written."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple

from mcap.writer import CompressionType, Writer

from fringedic import __version__
from fringedic.recording.topics import RawMessage, Topic

_COMPRESSIONS = {"none": CompressionType.NONE, "zstd": CompressionType.ZSTD}
_MESSAGE_HEADER = 31  # bytes of a message besides its data


class WrittenFile(NamedTuple):
    """A file of a recording: messages, log times of the first and last one [ns], and SHA-256 once it is closed."""

    name: str
    messages: int
    start_time: int
    end_time: int
    checksum: str = ""


class McapOutput:
    """Writes one MCAP file, whose written part stays readable when the process or the machine dies.

    Parameters
    ----------
    path
        The new file.
    compression
        ``zstd`` or ``none``.

    Raises
    ------
    OSError
        The file exists or cannot be written; also from every other method.
    """

    def __init__(self, path: Path, compression: Literal["zstd", "none"]) -> None:
        self._path = path
        self._file = path.open("xb")
        self._stream = _HashedStream(self._file)
        self._writer = Writer(self._stream, compression=_COMPRESSIONS[compression])  # type: ignore[arg-type]
        self._channels: dict[str, int] = {}
        self._waiting = 0
        self._messages, self._start_time, self._end_time = 0, 2**63 - 1, 0
        self._writer.start(profile="ros2", library=f"fringedic {__version__}")
        self.flush()

    @property
    def size(self) -> int:
        """Bytes of all messages so far, also of the chunk that is being filled, which is not compressed yet."""
        return self._stream.tell() + self._waiting

    @property
    def size_on_disk(self) -> int:
        """Size of the file [byte]; it fails when the file has been removed."""
        return self._path.stat().st_size

    @property
    def summary(self) -> WrittenFile:
        """What has been written so far."""
        if not self._messages:
            return WrittenFile(self._path.name, 0, 0, 0)
        return WrittenFile(self._path.name, self._messages, self._start_time, self._end_time)

    def announce(self, topic: Topic) -> None:
        """Define a topic, once, before its first message."""
        schema = self._writer.register_schema(topic.type_name, topic.encoding, topic.definition.encode())
        metadata = {"offered_qos_profiles": topic.qos, "topic_type_hash": topic.hash}
        self._channels[topic.name] = self._writer.register_channel(topic.name, "cdr", schema, metadata)

    def write(self, message: RawMessage) -> None:
        """Append a message of an announced topic."""
        topic, data, log_time, publish_time, sequence = message
        written = self._stream.tell()
        self._writer.add_message(self._channels[topic], log_time, data, publish_time, sequence & 0xFFFFFFFF)
        self._waiting = self._waiting + _MESSAGE_HEADER + len(data) if self._stream.tell() == written else 0
        self._messages += 1
        self._start_time, self._end_time = min(self._start_time, log_time), max(self._end_time, log_time)

    def flush(self) -> None:
        """Pass all messages to the operating system, and touch the file: readers see that its writer is alive."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._waiting = 0
        os.utime(self._path)

    def sync(self) -> None:
        """Write all messages to the disk."""
        self.flush()
        os.fsync(self._file.fileno())

    def finish(self, metadata: str) -> WrittenFile:
        """Write the index, close the file and return what it contains.

        Parameters
        ----------
        metadata
            Metadata of the recording, as rosbag2 stores it in its files.
        """
        self._writer.add_metadata("rosbag2", {"serialized_metadata": metadata})
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        return self.summary._replace(checksum=self._stream.checksum)

    def abandon(self) -> None:
        """Close the file without its index."""
        self._file.close()


class _HashedStream:
    """Computes the checksum of the bytes on their way to a file, so that a finished file is not read again."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._hash = hashlib.sha256()
        self._size = 0

    @property
    def checksum(self) -> str:
        """SHA-256 of all bytes written, in hexadecimal digits."""
        return self._hash.hexdigest()

    def write(self, data: bytes) -> int:
        """Append bytes."""
        self._file.write(data)
        self._hash.update(data)
        self._size += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._size

    def flush(self) -> None:
        """Pass all bytes to the operating system."""
        self._file.flush()
