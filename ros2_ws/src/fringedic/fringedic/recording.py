"""Recordings: rosbag2 directories of MCAP, written so that a crash loses next to nothing, and read without ROS.

Messages go in and out as serialised CDR bytes with their definitions beside them, so a recording stays readable by
anyone, including this library where no ROS is installed.
"""

from __future__ import annotations

import errno
import heapq
import json
import os
import re
import struct
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple

import yaml
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import CRCValidationError, breakup_chunk
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fringedic import __version__
from fringedic.errors import DiskFullError, MissingTopicError, RecordingError, UnknownSchemaError

REORDER_WINDOW = 64  # messages
MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEADER = struct.Struct("<BQ")
_COMPRESSIONS = {"none": CompressionType.NONE, "zstd": CompressionType.ZSTD}
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_DAMAGE = (McapError, CRCValidationError, zstandard.ZstdError, struct.error, UnicodeDecodeError)


# ---------------------------------------------------------------------------------------------- message definitions


def interface_definition(type_name: str) -> str:
    """Return the definition of a message type with those of all nested types, as MCAP's ``ros2msg`` wants it.

    Parameters
    ----------
    type_name
        ``package/msg/Name``, looked up in ``share`` of every prefix in ``AMENT_PREFIX_PATH``.

    Raises
    ------
    UnknownSchemaError
        The type or one of its nested types is not installed.
    """
    text = _definition_file(type_name, ".msg").read_text("utf-8")
    parts, known, waiting = [text], {type_name}, _nested_types(type_name, text)
    while waiting:
        nested = waiting.pop(0)
        if nested in known:
            continue
        known.add(nested)
        text = _definition_file(nested, ".msg").read_text("utf-8")
        package, _, name = nested.split("/")
        parts.append(f"{'=' * 80}\nMSG: {package}/{name}\n{text}")
        waiting += _nested_types(nested, text)
    return "\n".join(parts)


def type_hash(type_name: str) -> str:
    """Return the RIHS01 hash of a message type, with which ROS 2 tells versions of a definition apart.

    Raises
    ------
    UnknownSchemaError
        The type's description is not installed.
    """
    description = json.loads(_definition_file(type_name, ".json").read_text("utf-8"))
    return next(each["hash_string"] for each in description["type_hashes"] if each["type_name"] == type_name)


def _definition_file(type_name: str, suffix: str) -> Path:
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    if len(type_name.split("/")) == 3:
        for prefix in prefixes:
            file = prefix / "share" / f"{type_name}{suffix}"
            if file.is_file():
                return file
    places = ", ".join(map(str, prefixes)) or "AMENT_PREFIX_PATH, which is empty"
    raise UnknownSchemaError(f"no definition of the message type '{type_name}' ({suffix}) in {places}")


def _nested_types(type_name: str, text: str) -> list[str]:
    """Types of the fields that are messages themselves, in the order of the fields."""
    found = []
    for line in text.splitlines():
        declared = re.match(r"\s*([A-Za-z]\w*(?:/\w+)*)(?:\[.*?\])?\s+\w", line)
        if declared and (name := declared[1])[name.rfind("/") + 1].isupper():
            *package, short = name.split("/")
            found.append(f"{package[0] if package else type_name.split('/')[0]}/msg/{short}")
    return found


# ------------------------------------------------------------------------------------------------------------ topics


@dataclass(frozen=True)
class Qos:
    """Quality of service offered by the publisher of a recorded topic; players offer the same."""

    depth: int = 10
    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    history: Literal["keep_last", "keep_all"] = "keep_last"

    def profile(self) -> dict[str, Any]:
        """Return the profile as rosbag2 writes it (version 9), without limits of time."""
        forever = {"sec": 9223372036, "nsec": 854775807}
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": dict(forever),
            "lifespan": dict(forever),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(forever),
            "avoid_ros_namespace_conventions": False,
        }


@dataclass(frozen=True)
class Topic:
    """One recorded topic.

    Attributes
    ----------
    name, type_name
        ``/rig/camera/image_raw``, ``sensor_msgs/msg/Image``.
    definition
        Full text of the message definition with nested types.
    encoding
        Language of ``definition``; ``ros2msg`` can be decoded.
    hash
        RIHS01 hash of the type, empty when unknown.
    qos
        Offered profiles as YAML text.
    """

    name: str
    type_name: str
    definition: str
    encoding: str
    hash: str
    qos: str


class RawMessage(NamedTuple):
    """One serialised message with its times [ns]."""

    topic: str
    data: bytes
    log_time: int
    publish_time: int


# ------------------------------------------------------------------------------------------------------------ writing


class BagWriter:
    """Writes a rosbag2 directory with one MCAP file that stays readable when the process or the machine dies.

    What was written is handed to the operating system about every half second while messages come in; an owner that
    hears nothing for longer calls `flush` by timer. `sync` makes everything survive a power cut; it costs about 150 ms,
    so it belongs to the end of a step.

    Parameters
    ----------
    path
        Folder of the recording; it must not exist yet.
    compression
        ``zstd`` or ``none``.
    flush_interval_s
        Time after which a message makes what was written before it survive the death of this process [s].

    Raises
    ------
    RecordingError
        The folder exists or cannot be written.
    DiskFullError
        The disk is full (also from every other method). What was written before stays readable.
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
            self._writer.flush()
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
            What the topic's publishers offer.
        publisher_hash
            Hash of the type that the publisher uses, to be compared with the installed definition's.

        Raises
        ------
        UnknownSchemaError
            The definition of the type is not installed, or the publisher's is another one: the messages could never be
            read again.
        RecordingError
            The topic is there already with another type.
        """
        if name in self._topics:
            known = self._topics[name][1].type_name
            if known != type_name:
                raise RecordingError(f"{self.path}: topic {name} is recorded as {known}, not as {type_name}")
            return
        profiles = yaml.safe_dump([each.profile() for each in qos], sort_keys=False)
        definition, hash_ = interface_definition(type_name), type_hash(type_name)
        if publisher_hash is not None and publisher_hash != hash_:
            raise UnknownSchemaError(
                f"topic {name}: its publisher was built with another definition of {type_name} than the one installed "
                "here; build both from the same sources"
            )
        self.add_recorded_topic(Topic(name, type_name, definition, "ros2msg", hash_, profiles))

    def add_recorded_topic(self, topic: Topic) -> None:
        """Announce a topic with the definition that another recording holds."""
        with self._named_errors():
            schema = self._writer.register_schema(topic.type_name, topic.encoding, topic.definition.encode())
            metadata = {"offered_qos_profiles": topic.qos, "topic_type_hash": topic.hash}
            channel = self._writer.register_channel(topic.name, "cdr", schema, metadata)
        self._topics[topic.name] = (channel, topic)

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int, sequence: int | None = None) -> None:
        """Append one serialised message; times in nanoseconds.

        Parameters
        ----------
        sequence
            The publisher's own count of its messages, whose gaps tell what was lost on the way; by default the count
            of what was written.
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
        """Hand everything written so far to the operating system: it survives the death of this process."""
        with self._named_errors():
            self._writer.flush()
        self._flushed_at = time.monotonic()

    def sync(self) -> None:
        """Bring everything written so far onto the disk: it survives a power cut."""
        self.flush()
        with self._named_errors():
            os.fsync(self._stream.fileno())

    def close(self) -> None:
        """Write index and metadata and close; a recording that has failed is only closed and stays as it is."""
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
                self._writer.finish()
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
                self._failure = DiskFullError(
                    f"{self.path}: the disk is full ({error.strerror}); what was recorded before stays readable, "
                    "free some space and start a new recording"
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
        """Replace metadata.yaml in one go, so that there is a whole one at any time."""
        temporary = self.path / "metadata.yaml.writing"
        with open(temporary, "w", encoding="utf-8") as file:
            yaml.safe_dump({"rosbag2_bagfile_information": self._metadata()}, file, sort_keys=False)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(self.path / "metadata.yaml")


# ------------------------------------------------------------------------------------------------------------ reading


@dataclass
class _File:
    """One MCAP file: where its chunks are, and what its channels mean."""

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    chunks: list[_ChunkPlace] = field(default_factory=list)
    counts: defaultdict[int, int] = field(default_factory=lambda: defaultdict(int))
    lost: str = ""


class _ChunkPlace(NamedTuple):
    start_time: int
    end_time: int
    offset: int
    channels: frozenset[int]


class BagReader:
    """Reads a recording, finished or cut off, one message after the other.

    Parameters
    ----------
    path
        A rosbag2 folder with MCAP files, or one MCAP file.
    rescan
        Read the whole file to find what is in it instead of trusting its index; done anyway when there is none.

    Attributes
    ----------
    topics
        Every topic by its full name.
    counts
        Messages of each topic.
    lost
        What is damaged or cut off, empty for a whole recording.

    Raises
    ------
    RecordingError
        There is no such recording or it is none that this reader knows.
    """

    def __init__(self, path: str | os.PathLike[str], *, rescan: bool = False) -> None:
        self.path = Path(path)
        self._files = [_open_file(file, rescan) for file in _mcap_files(self.path)]
        self.topics: dict[str, Topic] = {}
        self.counts: dict[str, int] = {}
        for file in self._files:
            for number, channel in file.channels.items():
                schema = file.schemas[channel.schema_id]
                self.topics[channel.topic] = Topic(
                    channel.topic,
                    schema.name,
                    schema.data.decode(),
                    schema.encoding,
                    channel.metadata.get("topic_type_hash", ""),
                    channel.metadata.get("offered_qos_profiles", ""),
                )
                self.counts[channel.topic] = self.counts.get(channel.topic, 0) + file.counts[number]
        self.lost = "; ".join(f"{file.path.name}: {file.lost}" for file in self._files if file.lost)
        self._typestore = get_typestore(Stores.EMPTY)
        self._registered: set[str] = set()

    @property
    def start_time(self) -> int:
        """Log time of the first message [ns], 0 for an empty recording."""
        return min((chunk.start_time for file in self._files for chunk in file.chunks), default=0)

    @property
    def end_time(self) -> int:
        """Log time of the last message [ns], 0 for an empty recording."""
        return max((chunk.end_time for file in self._files for chunk in file.chunks), default=0)

    def find(self, *relative_names: str) -> dict[str, str]:
        """Return the full names of topics given relative to the rig's namespace, which any prefix may be.

        Raises
        ------
        MissingTopicError
            Topics are not in the recording, or only announced and empty; the message names them.
        RecordingError
            Two rigs are in the recording.
        """
        found = {name: self._full_names(name) for name in relative_names}
        missing = [name for name, full in found.items() if not full]
        if missing:
            present = ", ".join(sorted(topic for topic, count in self.counts.items() if count)) or "no message at all"
            raise MissingTopicError(f"{self.path} has no {', '.join(missing)}; it holds {present}")
        for name, full in found.items():
            if len(full) > 1:
                raise RecordingError(f"{self.path} holds {name} of several rigs: {', '.join(full)}")
        return {name: full[0] for name, full in found.items()}

    def find_optional(self, *relative_names: str) -> dict[str, str]:
        """Return the full names of those topics that are in the recording, like `find`."""
        return self.find(*(name for name in relative_names if self._full_names(name)))

    def raw(self, topics: Iterable[str] | None = None) -> Iterator[RawMessage]:
        """Iterate over serialised messages in the order of their log time, of some topics (full names) or of all.

        Messages of equal time keep their order in the file. One chunk (about a megabyte) is in memory at a time, or
        as many as overlap in time.

        Raises
        ------
        RecordingError
            The file is damaged here although its index is whole.
        """
        wanted = set(self.topics if topics is None else topics)
        places = [
            (chunk, number, file)
            for number, file in enumerate(self._files)
            for chunk in file.chunks
            if any(file.channels[channel].topic in wanted for channel in chunk.channels)
        ]
        places.sort(key=lambda place: (place[0].start_time, place[1], place[0].offset))
        waiting: list[tuple[int, int, int, int, RawMessage]] = []
        for chunk, number, file in places:
            while waiting and waiting[0][0] < chunk.start_time:
                yield heapq.heappop(waiting)[-1]
            for order, message in enumerate(_read_messages(file, chunk)):
                topic = file.channels[message.channel_id].topic
                if topic in wanted:
                    raw = RawMessage(topic, message.data, message.log_time, message.publish_time)
                    heapq.heappush(waiting, (message.log_time, number, chunk.offset, order, raw))
        while waiting:
            yield heapq.heappop(waiting)[-1]

    def published(self, topics: Iterable[str] | None = None) -> Iterator[RawMessage]:
        """Iterate in the order of publishing, which is that of cause and effect.

        Topics reach a recorder through separate queues, where they can overtake each other by a few messages.
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
        """Decode one message by the definition in the recording; arrays come as NumPy arrays.

        Raises
        ------
        RecordingError
            The bytes do not fit the definition, or it is written in another language than ``ros2msg``.
        """
        known = self.topics[topic]
        if known.type_name not in self._registered:
            if known.encoding != "ros2msg":
                raise RecordingError(f"{self.path}: {topic} is defined in {known.encoding}, only ros2msg is known")
            definitions = get_types_from_msg(known.definition, known.type_name)
            self._typestore.register(
                {name: fields for name, fields in definitions.items() if name not in self._typestore.fielddefs}
            )
            self._registered.add(known.type_name)
        try:
            return self._typestore.deserialize_cdr(data, known.type_name)
        except Exception as error:
            raise RecordingError(f"{self.path}: a message of {topic} is no {known.type_name}: {error}") from error

    def _full_names(self, name: str) -> list[str]:
        return sorted(
            topic for topic, count in self.counts.items() if count and (topic == name or topic.endswith(f"/{name}"))
        )


def recover(path: str | os.PathLike[str], output: str | os.PathLike[str] | None = None) -> Path:
    """Write a whole recording from what can be read of a damaged one, which is left as it is.

    Parameters
    ----------
    output
        The new folder, by default beside the old one with ``_recovered`` behind its name.

    Returns
    -------
    Path
        The new recording.
    """
    reader = BagReader(path, rescan=True)
    source = Path(path)
    target = Path(output) if output is not None else source.with_name(f"{source.stem}_recovered")
    with BagWriter(target) as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for message in reader.raw():
            writer.write(*message)
    return target


@dataclass(frozen=True)
class BagInfo:
    """What a recording holds: times in nanoseconds, size in bytes, (type, messages) of each topic, and the damage."""

    path: Path
    start_time: int
    end_time: int
    size: int
    topics: dict[str, tuple[str, int]]
    lost: str


def info(path: str | os.PathLike[str]) -> BagInfo:
    """Summarise a recording."""
    reader = BagReader(path)
    return BagInfo(
        path=reader.path,
        start_time=reader.start_time,
        end_time=reader.end_time,
        size=sum(file.stat().st_size for file in _mcap_files(reader.path)),
        topics={name: (topic.type_name, reader.counts[name]) for name, topic in sorted(reader.topics.items())},
        lost=reader.lost,
    )


def _mcap_files(path: Path) -> list[Path]:
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
        raise RecordingError(f"{path}: holds no .mcap file; other storage is to be converted by 'ros2 bag convert'")
    return files


def _open_file(path: Path, rescan: bool) -> _File:
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


def _from_index(path: Path, stream: BinaryIO) -> _File | None:
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
    file = _File(path, summary.channels, summary.schemas)
    file.counts.update(summary.statistics.channel_message_counts)
    for index in summary.chunk_indexes:
        present = frozenset(index.message_index_offsets) or frozenset(summary.channels)
        file.chunks.append(
            _ChunkPlace(index.message_start_time, index.message_end_time, index.chunk_start_offset, present)
        )
    return file


def _from_scan(path: Path, stream: BinaryIO) -> _File:
    """Read a file from its beginning as far as it is whole; a chunk with a wrong checksum is left out."""
    file = _File(path)
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
        raise RecordingError(f"{path}: is written without chunks; convert it by 'ros2 bag convert'")
    damage = []
    if broken:
        damage.append(f"{broken} chunk{'s' if broken > 1 else ''} left out for a wrong checksum")
    if not finished:
        damage.append(f"not closed; {size - position} bytes behind the last whole record are lost")
    file.lost = " and ".join(damage)
    return file


def _index_chunk(file: _File, position: int, data: bytes) -> None:
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
    file.chunks.append(_ChunkPlace(chunk.message_start_time, chunk.message_end_time, position, frozenset(known)))


def _read_messages(file: _File, place: _ChunkPlace) -> list[Message]:
    try:
        with open(file.path, "rb") as stream:
            stream.seek(place.offset)
            _, length = _RECORD_HEADER.unpack(stream.read(_RECORD_HEADER.size))
            chunk = Chunk.read(ReadDataStream(BytesIO(stream.read(length))))
        records = breakup_chunk(chunk, validate_crc=True)
    except (*_DAMAGE, OSError) as error:
        raise RecordingError(
            f"{file.path}: damaged at byte {place.offset} ({error}); 'fringedic recover' saves the rest"
        ) from error
    return [record for record in records if isinstance(record, Message) and record.channel_id in file.channels]
