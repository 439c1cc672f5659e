"""Reads one MCAP file: its chunks by the index at its end, or by a scan where the index is missing or damaged."""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import SEEK_END, BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, ChunkIndex, McapRecord, Message, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk

from fringedic.errors import RecordingError
from fringedic.recording.topics import Topic
from fringedic.wording.causes import cause_of

MAGIC = b"\x89MCAP0\r\n"
FOREIGN = "is not an MCAP file"
RECORD_HEADER = struct.Struct("<BQ")  # opcode, length of the rest
# Raised by the parsing of damaged bytes: lengths beyond the file or the memory, wrong text, wrong checksums.
DAMAGE = (McapError, zstandard.ZstdError, struct.error, ValueError, RuntimeError, MemoryError, OverflowError)
WRONG_CHECKSUM = "because of a wrong checksum"
_UNREADABLE = "that the disk cannot read"
_ZSTD = b"\x28\xb5\x2f\xfd"  # begin of compressed data
_CHECKSUM = RECORD_HEADER.size + 24  # place of its four bytes in a chunk, after two times and the size
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, start of its offsets, checksum

LARGEST_CHUNK = (
    1 << 29
)  # [byte] uncompressed: recorders close a chunk after some megabytes, or after one larger message
_MOST_RECORDS = 1 << 20  # of one chunk; each takes about 300 bytes of memory


class ChunkPlace(NamedTuple):
    """One chunk: log times of its first and last message [ns], its bytes in the file, and channels of its messages."""

    start_time: int
    end_time: int
    offset: int
    length: int
    channels: frozenset[int]


@dataclass
class McapFile:
    """One MCAP file.

    Attributes
    ----------
    path
        The file.
    channels, schemas
        Channels and message definitions by their number.
    chunks
        Places of the chunks in the file.
    counts
        Messages of each channel.
    indexed
        Messages of each channel by the index of the file; empty without an index.
    damage
        Description of each kind of damage; empty for a complete file.
    foreign
        Whether it is a file of another format, without any chunk.
    """

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)
    indexed: Counter[int] = field(default_factory=Counter)
    damage: list[str] = field(default_factory=list)
    foreign: bool = False

    def add_chunk(self, offset: int, length: int, records: list[McapRecord]) -> int:
        """Add a chunk by its records; return the number of messages whose channel is not defined anywhere before.

        Raises
        ------
        RecordingError
            See `refuse_compressed_messages`.
        """
        refuse_compressed_messages(self.path, records)
        times, counts = [], Counter[int]()
        for record in records:
            if isinstance(record, Schema):
                self.schemas[record.id] = record
            elif isinstance(record, Channel):
                self.channels[record.id] = record
            elif isinstance(record, Message):
                counts[record.channel_id] += 1
                times.append(record.log_time)
        known = Counter({channel: count for channel, count in counts.items() if channel in self.channels})
        self.counts += known
        if known:
            self.chunks.append(ChunkPlace(min(times), max(times), offset, length, frozenset(counts)))
        return counts.total() - known.total()


def refuse_compressed_messages(path: Path, records: Iterable[McapRecord]) -> None:
    """Refuse messages that rosbag2 has compressed one by one; only its ``metadata.yaml`` states it.

    Raises
    ------
    RecordingError
        A message begins as compressed data; those of ROS begin with a zero.
    """
    if any(isinstance(record, Message) and record.data[: len(_ZSTD)] == _ZSTD for record in records):
        raise RecordingError(
            f"{path}: its messages are compressed by rosbag2; put it beside its metadata.yaml, which states it, and "
            "give the folder"
        )


class FileBytes:
    """Bytes of a file that are read when they are asked for.

    A file that is mapped into memory would end the process where it was shortened meanwhile, or where the disk cannot
    read it.

    Parameters
    ----------
    path
        The file.
    stream
        The file, opened.
    """

    def __init__(self, path: Path, stream: BinaryIO) -> None:
        self._path, self._number = path, stream.fileno()
        self._size = os.fstat(self._number).st_size

    def __len__(self) -> int:
        return self._size

    def read(self, begin: int, end: int) -> bytes:
        """Return the bytes from one position to another, fewer at the end of the file.

        Raises
        ------
        RecordingError
            The disk cannot read them, or the file has become shorter since it was opened.
        """
        end = min(end, self._size)
        parts: list[bytes] = []
        position = begin
        while position < end:
            try:
                part = os.pread(self._number, end - position, position)
            except OSError as error:
                raise RecordingError(
                    f"{self._path}: cannot be read behind byte {position} ({cause_of(error)}); copy it with a program "
                    "that skips what the disk cannot read, such as ddrescue, and recover the copy"
                ) from error
            if not part:
                size = os.fstat(self._number).st_size
                raise RecordingError(
                    f"{self._path}: was shortened to {size} bytes while it was read; wait until the program that "
                    "writes or copies it has ended, and start again"
                )
            parts.append(part)
            position += len(part)
        return b"".join(parts)


@contextmanager
def opened(path: Path) -> Iterator[FileBytes]:
    """Open a file whose bytes are read when they are asked for.

    Raises
    ------
    RecordingError
        The file cannot be read.
    """
    with _stream(path) as stream:
        yield FileBytes(path, stream)


@contextmanager
def _stream(path: Path) -> Iterator[BinaryIO]:
    try:
        with open(path, "rb") as stream:
            yield stream
    except RecordingError:
        raise
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {cause_of(error)}") from error


def first_bytes(path: Path) -> bytes:
    """Return the bytes at the beginning of a file, where `MAGIC` belongs; fewer of a shorter file.

    Raises
    ------
    RecordingError
        The file cannot be read.
    """
    with _stream(path) as stream:
        return stream.read(len(MAGIC))


def read_index(path: Path) -> McapFile | None:
    """Return a file by its index; None for a file without an index that lists all its messages.

    Raises
    ------
    DAMAGE
        The index does not fit its checksum, or its content is damaged.
    RecordingError
        The file cannot be read.
    """
    index = index_bytes(path)
    if index is None:
        return None
    start = path.stat().st_size - len(index)
    end = len(index) - len(MAGIC)
    checksum = _FOOTER.unpack(index[end - _FOOTER.size : end])[-1]
    if checksum and zlib.crc32(index[: end - 4]) != checksum:
        raise McapError("the index does not fit its checksum")
    file, statistics, indices = McapFile(path), None, []
    for record in StreamReader(BytesIO(index), skip_magic=True, emit_chunks=True).records:
        if isinstance(record, Statistics):
            statistics = record
        elif isinstance(record, Schema):
            file.schemas[record.id] = record
        elif isinstance(record, Channel):
            file.channels[record.id] = record
        elif isinstance(record, ChunkIndex):
            indices.append(record)
    if statistics is None or (statistics.message_count and not indices) or not _counts_channels(statistics):
        return None
    file.chunks = [_place(each, file) for each in indices]
    _refuse_overlaps(file.chunks, start)
    file.indexed = Counter({channel: count for channel, count in statistics.channel_message_counts.items() if count})
    file.counts = Counter(file.indexed)
    definitions = {channel.schema_id for channel in file.channels.values() if channel.schema_id}
    return file if file.counts.keys() <= file.channels.keys() and definitions <= file.schemas.keys() else None


def _counts_channels(statistics: Statistics) -> bool:
    """Return whether all messages are counted by their channel, which is optional in MCAP."""
    return sum(statistics.channel_message_counts.values()) == statistics.message_count


def index_bytes(path: Path) -> bytes | None:
    """Return the index at the end of a file; None for a file without one, which is not read any further.

    Raises
    ------
    RecordingError
        The file cannot be read.
    """
    with _stream(path) as stream:
        size = stream.seek(0, SEEK_END)
        stream.seek(max(0, size - _FOOTER.size - len(MAGIC)))
        start = index_start(stream.read(), size)
        if start is None:
            return None
        stream.seek(start)
        return stream.read()


def index_start(tail: bytes, size: int) -> int | None:
    """Return where the index of a file of `size` bytes starts, by its last bytes; None for a file without an index."""
    end = len(tail) - len(MAGIC)
    if end < _FOOTER.size or tail[end:] != MAGIC:
        return None
    _, _, start, _, _ = _FOOTER.unpack_from(tail, end - _FOOTER.size)
    return int(start) if 0 < start < size else None


def _place(index: ChunkIndex, file: McapFile) -> ChunkPlace:
    return ChunkPlace(
        index.message_start_time,
        index.message_end_time,
        index.chunk_start_offset,
        index.chunk_length,
        frozenset(index.message_index_offsets or file.channels),
    )


def _refuse_overlaps(chunks: Iterable[ChunkPlace], start: int) -> None:
    """Refuse an index in which chunks share bytes, or reach into the index, which starts at `start`.

    A small file could otherwise state a large recording.
    """
    end = 0
    for chunk in sorted(chunks, key=lambda place: place.offset):
        if chunk.offset < end:
            raise McapError("chunks of the index overlap")
        end = chunk.offset + chunk.length
    if end > start:
        raise McapError("chunks of the index lie outside of the file")


def check_chunks(indexed: McapFile) -> McapFile:
    """Return a file with an index without its damaged chunks; its damage contains their number.

    Raises
    ------
    RecordingError
        The file cannot be opened, or see `refuse_compressed_messages`.
    """
    file = McapFile(indexed.path, indexed.channels, indexed.schemas, indexed=indexed.indexed)
    reasons = Counter[str]()
    with _stream(indexed.path) as stream:
        for place in indexed.chunks:
            try:
                stream.seek(place.offset)
                data = stream.read(place.length)
            except OSError:
                reasons[_UNREADABLE] += 1
                continue
            try:
                file.add_chunk(place.offset, place.length, _records_at(place, data))
            except DAMAGE as error:
                reasons[reason_of(error)] += 1
    file.damage += left_out(reasons)
    return file


def count_without_checksum(file: McapFile) -> int:
    """Return the number of chunks without a checksum, in which a changed byte is not found.

    Raises
    ------
    RecordingError
        The file cannot be read.
    """
    without = 0
    with _stream(file.path) as stream:
        for chunk in file.chunks:
            stream.seek(chunk.offset + _CHECKSUM)
            without += not any(stream.read(4))
    return without


class ChunkTooLargeError(McapError):
    """A chunk would take more memory than any recorder needs; its text is the end of "1 chunk left out ..."."""


def reason_of(error: Exception) -> str:
    """Return why a chunk is left out, by one of the errors `DAMAGE`."""
    return str(error) if isinstance(error, ChunkTooLargeError) else WRONG_CHECKSUM


def left_out(reasons: Counter[str]) -> list[str]:
    """Return a description of the chunks that are left out for each reason of `reason_of`."""
    return [f"{number} chunk{'s' if number > 1 else ''} left out {reason}" for reason, number in reasons.items()]


def chunk_records(data: bytes) -> list[McapRecord]:
    """Return the records of a chunk.

    Parameters
    ----------
    data
        The chunk with the header of its record, the opcode and length of which are not used.

    Raises
    ------
    DAMAGE
        The chunk is damaged.
    """
    return records_of(Chunk.read(ReadDataStream(BytesIO(data[RECORD_HEADER.size :]))))


def records_of(chunk: Chunk) -> list[McapRecord]:
    """Return the records of a chunk, the content of which is uncompressed by this.

    Raises
    ------
    DAMAGE
        The chunk is damaged.
    """
    chunk.data, chunk.compression = _uncompressed(chunk), ""
    if len(chunk.data) > _MOST_RECORDS * RECORD_HEADER.size:
        _refuse_many_records(chunk.data)
    records = breakup_chunk(chunk, validate_crc=True)
    if not chunk.uncompressed_crc:  # written without a checksum, or the checksum is erased
        times = [record.log_time for record in records if isinstance(record, Message)]
        stated = (chunk.message_start_time, chunk.message_end_time)
        if not records or (min(times, default=0), max(times, default=0)) != stated:
            raise McapError("no checksum, and its messages are not those of its header")
    return records


def _uncompressed(chunk: Chunk) -> bytes:
    """Return the data of a chunk; memory is taken for the size that it states, up to a limit.

    Raises
    ------
    DAMAGE
        The data are damaged, have another size than they state, or are too large.
    """
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        stated = zstandard.get_frame_parameters(chunk.data).content_size
        if stated not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise McapError(f"{stated} bytes instead of {size}")
    if max(size, len(chunk.data)) > LARGEST_CHUNK:
        raise ChunkTooLargeError(f"because of a size above {LARGEST_CHUNK >> 20} MB")
    if chunk.compression == "zstd":
        return zstandard.decompress(chunk.data, size)
    if chunk.compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size))
    if chunk.compression:
        raise McapError(f"compression {chunk.compression!r} is not known")
    return chunk.data


def _refuse_many_records(data: bytes) -> None:
    position = count = 0
    while position + RECORD_HEADER.size <= len(data):
        position += RECORD_HEADER.size + RECORD_HEADER.unpack_from(data, position)[1]
        count += 1
        if count > _MOST_RECORDS:
            raise ChunkTooLargeError(f"because of more than {_MOST_RECORDS} records")


def _records_at(place: ChunkPlace, data: bytes) -> list[McapRecord]:
    """Return the records of a chunk, which have to be those that the index describes."""
    records = chunk_records(data)
    messages = [record for record in records if isinstance(record, Message)]
    times = [message.log_time for message in messages]
    if (min(times, default=0), max(times, default=0)) != (place.start_time, place.end_time):
        raise McapError("its messages are not those of the index")
    if not place.channels.issuperset(message.channel_id for message in messages):
        raise McapError("its messages are not those of the index")
    return records


def read_messages(file: McapFile, place: ChunkPlace) -> list[Message]:
    """Return the messages of one chunk in their order.

    Raises
    ------
    RecordingError
        The chunk is damaged, or see `refuse_compressed_messages`.
    """
    try:
        with open(file.path, "rb") as stream:
            stream.seek(place.offset)
            records = _records_at(place, stream.read(place.length))
    except (*DAMAGE, OSError) as error:
        raise RecordingError(
            f"{file.path}: damaged at byte {place.offset} ({error}); use 'fringedic recover' to save the rest"
        ) from error
    refuse_compressed_messages(file.path, records)
    return [record for record in records if isinstance(record, Message) and record.channel_id in file.channels]


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
