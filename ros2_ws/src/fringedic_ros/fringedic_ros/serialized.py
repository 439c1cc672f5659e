"""Message types by name, and what is read of serialised messages; their bytes may be those of any program."""

from __future__ import annotations

import importlib
import struct
import zlib
from typing import TypeVar

from rclpy.serialization import deserialize_message

from fringedic.errors import RecordingError

Message = TypeVar("Message")


def message_type(name: str) -> type:
    """Return the class of ``package/msg/Name``.

    Raises
    ------
    ImportError, AttributeError
        The package is not installed, or it has no such message.
    """
    package, folder, message = name.split("/")
    return getattr(importlib.import_module(f"{package}.{folder}"), message)


def read(data: bytes, kind: type[Message]) -> Message:
    """Return a serialised message.

    Raises
    ------
    RecordingError
        The bytes are not those of a message of this type.
    """
    try:
        return deserialize_message(data, kind)
    except RuntimeError:
        raise _unreadable(data, kind.__name__) from None


def header_stamp(data: bytes) -> int:
    """Return the stamp [ns] of a serialised message that begins with a header (CDR: 4 bytes, then sec, nanosec).

    Raises
    ------
    RecordingError
        There are too few bytes.
    """
    if len(data) < 12:
        raise _unreadable(data, "a header")
    little_endian = data[1] & 1
    seconds, nanoseconds = struct.unpack_from("<iI" if little_endian else ">iI", data, 4)
    return seconds * 1_000_000_000 + nanoseconds


def image_crc(data: bytes) -> int:
    """Return the CRC-32 of the pixels of a serialised ``sensor_msgs/Image``, whose last field they are.

    The field begins with its length, which with padding of strings before it stands at a multiple of four bytes.

    Raises
    ------
    RecordingError
        The bytes are not those of an image.
    """
    try:
        order = "<" if data[1] & 1 else ">"
        offset = 4 + 8  # encapsulation, stamp
        offset = _after_string(data, offset, order)  # frame_id
        offset = _aligned(offset) + 8  # height, width
        offset = _after_string(data, offset, order)  # encoding
        offset = _aligned(offset + 1) + 4  # is_bigendian, step
        (size,) = struct.unpack_from(f"{order}I", data, offset)
    except (struct.error, IndexError):
        raise _unreadable(data, "Image") from None
    return zlib.crc32(memoryview(data)[offset + 4 : offset + 4 + size])


def _unreadable(data: bytes, kind: str) -> RecordingError:
    return RecordingError(f"a message of {len(data)} bytes cannot be read as {kind}; check which program publishes it")


def _after_string(data: bytes, offset: int, order: str) -> int:
    offset = _aligned(offset)
    (size,) = struct.unpack_from(f"{order}I", data, offset)
    return offset + 4 + int(size)


def _aligned(offset: int) -> int:
    """Return the next multiple of four behind the encapsulation, whose size is one, too."""
    return -4 * (-offset // 4)
