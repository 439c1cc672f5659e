"""Finds and reads the chunks of one MCAP file, by its index or, without one, by a scan of the file."""

from __future__ import annotations

import re
import struct
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import yaml
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import CRCValidationError, breakup_chunk

from fringedic.errors import RecordingError

MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEADER = struct.Struct("<BQ")
_DAMAGE = (McapError, CRCValidationError, zstandard.ZstdError, struct.error, UnicodeDecodeError)


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
    lost
        Description of the damage; empty for a complete file.
    """

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    counts: defaultdict[int, int] = field(default_factory=lambda: defaultdict(int))
    lost: str = ""


class ChunkPlace(NamedTuple):
    """One chunk: log times of its first and last message [ns], offset in the file [byte], numbers of its channels."""

    start_time: int
    end_time: int
    offset: int
    channels: frozenset[int]


def mcap_files(path: Path) -> list[Path]:
    """Return the MCAP files of a recording in their order.

    Parameters
    ----------
    path
        A rosbag2 folder or one MCAP file.

    Raises
    ------
    RecordingError
        There is no such recording, or it contains no MCAP file.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise RecordingError(f"{path}: no such recording")
    files = sorted(path.glob("*.mcap"), key=lambda file: [int(n) for n in re.findall(r"\d+", file.stem)] or [0])
    metadata = path / "metadata.yaml"
    if metadata.is_file():
        with suppress(yaml.YAMLError, KeyError, TypeError):
            named = yaml.safe_load(metadata.read_text("utf-8"))["rosbag2_bagfile_information"]["relative_file_paths"]
            listed = [path / Path(name).name for name in named]
            if listed and all(file.is_file() for file in listed):
                files = listed
    if not files:
        raise RecordingError(f"{path}: holds no .mcap file; convert other storage with 'ros2 bag convert'")
    return files


def open_file(path: Path, rescan: bool) -> McapFile:
    """Return the chunks and channels of a file.

    Parameters
    ----------
    path
        The file.
    rescan
        Scan the whole file instead of reading its index; a file without index is always scanned.

    Raises
    ------
    RecordingError
        The file cannot be read or is not a file of this format.
    """
    try:
        with open(path, "rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise RecordingError(f"{path}: is not an MCAP file")
            file = None if rescan else _from_index(path, stream)
            return file or _from_scan(path, stream)
    except RecordingError:
        raise
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error


def _from_index(path: Path, stream: BinaryIO) -> McapFile | None:
    """Read the index at the end of a finished file; None when there is none."""
    try:
        stream.seek(0)
        summary = make_reader(stream).get_summary()
    except (*_DAMAGE, OSError, ValueError):
        return None
    if summary is None or summary.statistics is None:
        return None
    if summary.statistics.message_count and not summary.chunk_indexes:
        return None
    file = McapFile(path, summary.channels, summary.schemas)
    file.counts.update(summary.statistics.channel_message_counts)
    for index in summary.chunk_indexes:
        present = frozenset(index.message_index_offsets) or frozenset(summary.channels)
        file.chunks.append(
            ChunkPlace(index.message_start_time, index.message_end_time, index.chunk_start_offset, present)
        )
    return file


def _from_scan(path: Path, stream: BinaryIO) -> McapFile:
    """Read a file up to its last complete record; a chunk with a wrong checksum is left out."""
    file = McapFile(path)
    size = path.stat().st_size
    position, finished, broken, messages_outside = len(MAGIC), False, 0, 0
    while position + _RECORD_HEADER.size <= size:
        stream.seek(position)
        opcode, length = _RECORD_HEADER.unpack(stream.read(_RECORD_HEADER.size))
        end = position + _RECORD_HEADER.size + length
        if end > size:
            break
        if opcode == Opcode.CHUNK:
            try:
                _index_chunk(file, position, stream.read(length))
            except _DAMAGE:
                broken += 1
        elif opcode == Opcode.MESSAGE:
            messages_outside += 1
        position = end
        if opcode == Opcode.FOOTER:
            finished = True
            break
    if messages_outside:
        raise RecordingError(f"{path}: is written without chunks; convert it with 'ros2 bag convert'")
    damage = []
    if broken:
        damage.append(f"{broken} chunk{'s' if broken > 1 else ''} left out because of a wrong checksum")
    if not finished:
        damage.append(f"not closed; {size - position} bytes after the last complete record are lost")
    file.lost = " and ".join(damage)
    return file


def _index_chunk(file: McapFile, position: int, data: bytes) -> None:
    chunk = Chunk.read(ReadDataStream(BytesIO(data)))
    counts: defaultdict[int, int] = defaultdict(int)
    for record in breakup_chunk(chunk, validate_crc=True):
        if isinstance(record, Schema):
            file.schemas[record.id] = record
        elif isinstance(record, Channel):
            file.channels[record.id] = record
        elif isinstance(record, Message):
            counts[record.channel_id] += 1
    known = {channel: count for channel, count in counts.items() if channel in file.channels}
    for channel, count in known.items():
        file.counts[channel] += count
    file.chunks.append(ChunkPlace(chunk.message_start_time, chunk.message_end_time, position, frozenset(known)))


def read_messages(file: McapFile, place: ChunkPlace) -> list[Message]:
    """Return the messages of one chunk in their order.

    Raises
    ------
    RecordingError
        The chunk is damaged.
    """
    try:
        with open(file.path, "rb") as stream:
            stream.seek(place.offset)
            _, length = _RECORD_HEADER.unpack(stream.read(_RECORD_HEADER.size))
            chunk = Chunk.read(ReadDataStream(BytesIO(stream.read(length))))
        records = breakup_chunk(chunk, validate_crc=True)
    except (*_DAMAGE, OSError) as error:
        raise RecordingError(
            f"{file.path}: damaged at byte {place.offset} ({error}); use 'fringedic recover' to save the rest"
        ) from error
    return [record for record in records if isinstance(record, Message) and record.channel_id in file.channels]
