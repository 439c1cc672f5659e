"""Finds the chunks of an MCAP file without its index, and continues behind damaged bytes at the next chunk."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from fringedic.errors import RecordingError
from fringedic.recording.mcap_file import (
    DAMAGE,
    MAGIC,
    RECORD_HEADER,
    WRONG_CHECKSUM,
    FileBytes,
    McapFile,
    chunk_records,
    left_out,
    reason_of,
)

# Opcode and length of the record; two times and the size; the checksum; name of the compression; length of the data.
_CHUNK_HEADER = re.compile(rb"(?s)(.)(.{8}).{24}(.{4})(?:\0{4}|\x04\0{3}zstd|\x03\0{3}lz4)(.{8})")
_CHUNK_START = re.compile(rb"(?s)\x06(?=.{5}\0{3}.{28}(?:\0{4}|\x04\0{3}zstd|\x03\0{3}lz4).{5}\0{3})")
_CHUNK_HEADER_BYTES = 64  # at least those of _CHUNK_HEADER, which has 61 with zstd
_READ_BYTES = 1 << 16
_READERS: dict[int, Callable[[ReadDataStream], records.McapRecord]] = {
    Opcode.HEADER: records.Header.read,
    Opcode.SCHEMA: records.Schema.read,
    Opcode.CHANNEL: records.Channel.read,
    Opcode.MESSAGE_INDEX: records.MessageIndex.read,
    Opcode.ATTACHMENT: records.Attachment.read,
    Opcode.METADATA: records.Metadata.read,
    Opcode.DATA_END: records.DataEnd.read,
}


class _ChunkHeader(NamedTuple):
    """Header of a chunk: its end by the length of its data, and whether opcode and length of its record fit that."""

    end: int
    fits: bool
    has_checksum: bool


def scan_file(path: Path, data: FileBytes) -> McapFile:
    """Return a file by all its readable chunks; bytes that are no record are left out up to the next one.

    Parameters
    ----------
    path, data
        The file and its content.

    Raises
    ------
    RecordingError
        The file is written without chunks.
    """
    scan = _Scan(path, data)
    unfinished_at = scan.run()
    damage = scan.file.damage
    if scan.messages_outside and not scan.file.chunks:
        raise RecordingError(f"{path}: is written without chunks; give its folder or the file itself to be converted")
    damage += left_out(scan.broken_chunks)
    if scan.damaged_bytes:
        damage.append(f"{scan.damaged_bytes} bytes outside of chunks are damaged")
    if scan.messages_outside:
        damage.append(f"{scan.messages_outside} messages outside of chunks left out")
    if scan.undefined_messages:
        damage.append(f"{scan.undefined_messages} messages left out because the definition of their topic is lost")
    if unfinished_at is not None:
        unread = len(data) - unfinished_at
        damage.append("not closed" + (f"; {unread} bytes after the last complete record are lost" if unread else ""))
    return scan.file


def ends_with_magic(data: FileBytes) -> bool:
    """Return whether a file ends as a finished one."""
    return data.read(max(0, len(data) - len(MAGIC)), len(data)) == MAGIC


def has_chunk(path: Path, data: FileBytes) -> bool:
    """Return whether there is a chunk anywhere in a file, by the lengths in its header."""
    return _Scan(path, data).next_chunk(0) is not None


class _Scan:
    """A scan of one file: its readable chunks, and how much was left out."""

    def __init__(self, path: Path, data: FileBytes) -> None:
        self.file = McapFile(path)
        self.broken_chunks = Counter[str]()
        self.damaged_bytes = 0
        self.messages_outside = 0
        self.undefined_messages = 0
        self._data = data

    def run(self) -> int | None:
        """Read all chunks; return the end of the last record of an unfinished file, None for a finished one."""
        position = min(len(MAGIC), len(self._data))
        closed = len(self._data) >= 2 * len(MAGIC) and ends_with_magic(self._data)
        while position < len(self._data):
            end = self._other_record(position)
            if end is not None and self._opcode(position) == Opcode.DATA_END:
                return None if closed else end
            end = end or self._chunk(position)
            if end is None:
                end = self.next_chunk(position + 1)
                if end is None:
                    break
                self._leave_out(position, end)
            position = end
        if not closed:
            return position
        self._leave_out(position, len(self._data))
        return None

    def _other_record(self, position: int) -> int | None:
        """Return the end of a record that is no chunk; None if its content does not have the stated length."""
        begin = position + RECORD_HEADER.size
        if begin > len(self._data):
            return None
        opcode, length = RECORD_HEADER.unpack(self._data.read(position, begin))
        end = begin + length
        if end > len(self._data):
            return None
        if opcode == Opcode.MESSAGE:
            self.messages_outside += 1
            return int(end)
        if opcode not in _READERS:
            return None
        stream = ReadDataStream(BytesIO(self._data.read(begin, end)))
        try:
            record = _READERS[opcode](stream)
        except DAMAGE:
            return None
        if stream.count != length:
            return None
        if isinstance(record, records.Schema):  # without a checksum, unlike those in chunks
            self.file.schemas.setdefault(record.id, record)
        elif isinstance(record, records.Channel):
            self.file.channels.setdefault(record.id, record)
        return int(end)

    def _chunk(self, position: int) -> int | None:
        """Add the chunk at a position and return its end, also if opcode or length of its record are damaged."""
        header = self._chunk_header(position)
        if header is None or not (header.fits or header.has_checksum):
            return None
        data = self._data.read(position, header.end)
        try:
            content = chunk_records(data)
        except DAMAGE as error:
            if not header.fits:
                return None
            self.broken_chunks[reason_of(error)] += 1
            return header.end
        if not header.fits:
            self.damaged_bytes += RECORD_HEADER.size
        self.undefined_messages += self.file.add_chunk(position, header.end - position, content)
        return header.end

    def _chunk_header(self, position: int) -> _ChunkHeader | None:
        header = _CHUNK_HEADER.match(self._data.read(position, position + _CHUNK_HEADER_BYTES))
        if header is None:
            return None
        end = position + header.end() + int.from_bytes(header[4], "little")
        stated_end = position + RECORD_HEADER.size + int.from_bytes(header[2], "little")
        fits = header[1][0] == Opcode.CHUNK and stated_end == end
        return _ChunkHeader(end, fits, any(header[3])) if end <= len(self._data) else None

    def next_chunk(self, position: int) -> int | None:
        """Return the position of the next chunk whose lengths agree."""
        for candidate in self._chunk_starts(position):
            header = self._chunk_header(candidate)
            if header is not None and header.fits:
                return candidate
        return None

    def _chunk_starts(self, position: int) -> Iterator[int]:
        """Yield the positions at which a chunk may begin; parts of the file overlap by the header of a chunk."""
        while position < len(self._data):
            part = self._data.read(position, position + _READ_BYTES + _CHUNK_HEADER_BYTES)
            starts = (position + found.start() for found in _CHUNK_START.finditer(part))
            yield from (start for start in starts if start < position + _READ_BYTES)
            position += _READ_BYTES

    def _opcode(self, position: int) -> int:
        return self._data.read(position, position + 1)[0]

    def _leave_out(self, begin: int, end: int) -> None:
        if end > begin and self._opcode(begin) == Opcode.CHUNK:
            self.broken_chunks[WRONG_CHECKSUM] += 1
        else:
            self.damaged_bytes += end - begin
