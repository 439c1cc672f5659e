"""Copies of recordings in other storage than MCAP in chunks, which the readers need.

Other programs compress whole files or single messages, write MCAP without chunks (``fastwrite``) or SQLite. The copy
lies in the folder of temporary files as long as the process needs it.
"""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
import weakref
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.errors import ReaderError
from rosbags.typesys import Stores, get_typestore
from yaml import YAMLError

from fringedic.errors import RecordingError
from fringedic.recording.bag_files import METADATA, STORED, convert_command
from fringedic.recording.definitions import interface_definition
from fringedic.recording.mcap_file import DAMAGE, LARGEST_CHUNK, MAGIC, RECORD_HEADER, records_of, topic_of
from fringedic.recording.topics import RawMessage, Topic
from fringedic.recording.writer import BagWriter
from fringedic.wording.causes import cause_of
from fringedic.wording.yaml_text import load_foreign_yaml, refuse_bombs

_KEPT = 4  # copies that a process keeps


class Readable:
    """A recording in chunks of MCAP.

    Attributes
    ----------
    path
        The recording itself, or its copy.
    damage
        Why the copy is not complete; empty if it is.
    """

    def __init__(self, path: Path, damage: str = "", temporary: Path | None = None) -> None:
        self.path, self.damage = path, damage
        if temporary is not None:
            weakref.finalize(self, shutil.rmtree, temporary, ignore_errors=True)


def readable(path: Path) -> Readable:
    """Return a recording as it is if it is MCAP in chunks, else a copy that is.

    Parameters
    ----------
    path
        A rosbag2 folder or one of its files.

    Raises
    ------
    RecordingError
        The recording cannot be copied: it is damaged, or the disk is full.
    """
    files = [path] if path.is_file() else sorted(each for each in path.glob("*") if each.name.endswith(STORED))
    if path.suffix == ".bag" and path.is_file():
        raise RecordingError(f"{path}: is a recording of ROS 1; convert it: {convert_command(path)}")
    stored = [file for file in files if file.name.endswith(STORED)]  # any other file is refused by the reader
    others = [file for file in stored if file.suffix != ".mcap" or _is_unchunked(file)]
    by_message = _with_compressed_messages((path if path.is_dir() else path.parent) / METADATA)
    if not (others or by_message.intersection(file.name for file in files)):
        return Readable(path)
    state = tuple((str(file), file.stat().st_size, file.stat().st_mtime_ns) for file in files)
    return _copied(path, state, by_message)


@lru_cache(maxsize=_KEPT)
def _copied(path: Path, state: tuple[tuple[str, int, int], ...], by_message: frozenset[str]) -> Readable:
    """Return the copy of a recording, which is made again when the size or time of a file has changed."""
    files = [Path(name) for name, _, _ in state]
    temporary = Path(tempfile.mkdtemp(prefix="fringedic-"))
    damage = []
    try:
        with BagWriter(temporary / path.name, compression="none") as writer:
            if any(".db3" in file.suffixes for file in files):
                _copy(_of_sqlite(path), writer)
            else:
                for file in files:
                    try:
                        _copy(_of_mcap(file, file.name in by_message), writer)
                    except (*DAMAGE, EOFError, OSError) as error:
                        damage.append(f"{file.name}: is damaged or was not closed ({error}), the rest is lost")
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    return Readable(temporary / path.name, "; ".join(damage), temporary)


def _copy(messages: Iterator[tuple[Topic, RawMessage]], writer: BagWriter) -> None:
    for topic, message in messages:
        writer.add_recorded_topic(topic)
        writer.write(*message)


def _of_mcap(file: Path, by_message: bool) -> Iterator[tuple[Topic, RawMessage]]:
    """Yield the messages of an MCAP file that is compressed, has compressed messages, or no chunks."""
    topics: dict[int, Topic] = {}
    schemas: dict[int, Schema] = {}
    with file.open("rb") as stored:
        stream: Any = zstandard.ZstdDecompressor().stream_reader(stored) if file.suffix == ".zstd" else stored
        for record in _records(stream):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                topics[record.id] = topic_of(record, schemas.get(record.schema_id))
            elif isinstance(record, Message) and (topic := topics.get(record.channel_id)):
                data = _decompressed(record.data) if by_message else record.data
                yield topic, RawMessage(topic.name, data, record.log_time, record.publish_time, record.sequence)


def _records(stream: Any) -> Iterator[McapRecord]:
    """Yield the records of an MCAP file in their order, also those in chunks."""
    for record in StreamReader(stream, emit_chunks=True, record_size_limit=LARGEST_CHUNK).records:
        yield from records_of(record) if isinstance(record, Chunk) else [record]


def _decompressed(data: bytes) -> bytes:
    parts, size = [], 0
    for part in zstandard.ZstdDecompressor().read_to_iter(data):
        parts.append(part)
        size += len(part)
        if size > LARGEST_CHUNK:
            raise McapError(f"a message has more than {LARGEST_CHUNK >> 20} MB")
    return b"".join(parts)


def _of_sqlite(path: Path) -> Iterator[tuple[Topic, RawMessage]]:
    """Yield the messages of a recording in SQLite, which have neither a time of publishing nor a number."""
    folder = path if path.is_dir() else path.parent
    metadata = folder / METADATA
    try:
        if metadata.is_file():
            refuse_bombs(metadata.read_text("utf-8", "replace"))
        with Reader(folder) as reader:
            topics = {each.id: _topic(each) for each in reader.connections}
            for connection, time, data in reader.messages():
                yield topics[connection.id], RawMessage(connection.topic, bytes(data), time, time)
    except (ReaderError, sqlite3.Error, OSError, YAMLError) as error:
        raise RecordingError(f"{path}: cannot be read: {cause_of(error)}") from error


def _topic(connection: Connection) -> Topic:
    profiles = getattr(connection.ext, "offered_qos_profiles", "")
    qos = profiles if isinstance(profiles, str) else ""
    return Topic(connection.topic, connection.msgtype, _definition(connection), "ros2msg", connection.digest or "", qos)


def _definition(connection: Connection) -> str:
    """Return the definition in the recording, which older versions of rosbag2 leave out, or the installed one."""
    if connection.msgdef.data:
        return str(connection.msgdef.data)
    try:
        return interface_definition(connection.msgtype)
    except RecordingError:
        store = get_typestore(Stores.ROS2_HUMBLE)
        known = connection.msgtype in store.types
        return str(store.generate_msgdef(connection.msgtype, ros_version=2)[0]) if known else ""


def _with_compressed_messages(metadata: Path) -> frozenset[str]:
    """Return the files of which ``metadata.yaml`` states that rosbag2 has compressed each message."""
    try:
        content = load_foreign_yaml(metadata.read_text("utf-8"))["rosbag2_bagfile_information"]
        compressed = str(content.get("compression_mode") or "").upper() == "MESSAGE"
        return frozenset(Path(name).name for name in content["relative_file_paths"] if compressed)
    except Exception:  # every kind of damage has its own error; `find_files` reports it
        return frozenset()


def _is_unchunked(file: Path) -> bool:
    """Return whether an MCAP file has a message before its first chunk."""
    with file.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            return False
        while opcode := _next_opcode(stream):
            if opcode in (Opcode.MESSAGE, Opcode.CHUNK, Opcode.DATA_END):
                return opcode == Opcode.MESSAGE
    return False


def _next_opcode(stream: BinaryIO) -> int:
    """Return the opcode of the next record, 0 at the end, and move behind the record."""
    header = stream.read(RECORD_HEADER.size)
    if len(header) < RECORD_HEADER.size:
        return 0
    opcode, length = RECORD_HEADER.unpack(header)
    stream.seek(min(length, 1 << 40), 1)
    return int(opcode)
