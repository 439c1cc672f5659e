"""Message types by name, and the stamps of serialised messages without decoding them."""

from __future__ import annotations

import importlib
import struct
import zlib


def message_type(name: str) -> type:
    """Return the class of ``package/msg/Name``.

    Raises
    ------
    ImportError, AttributeError
        The package is not installed, or it has no such message.
    """
    package, folder, message = name.split("/")
    return getattr(importlib.import_module(f"{package}.{folder}"), message)


def header_stamp(data: bytes) -> int:
    """Return the stamp [ns] of a serialised message that begins with a header (CDR: 4 bytes, then sec, nanosec)."""
    little_endian = data[1] & 1
    seconds, nanoseconds = struct.unpack_from("<iI" if little_endian else ">iI", data, 4)
    return seconds * 1_000_000_000 + nanoseconds


def image_crc(data: bytes) -> int:
    """Return the CRC-32 of the pixels of a serialised ``sensor_msgs/Image``, whose last field they are.

    The field begins with its length, which with padding of strings before it stands at a multiple of four bytes.
    """
    order = "<" if data[1] & 1 else ">"
    offset = 4 + 8  # encapsulation, stamp
    offset = _after_string(data, offset, order)  # frame_id
    offset = _aligned(offset) + 8  # height, width
    offset = _after_string(data, offset, order)  # encoding
    offset = _aligned(offset + 1) + 4  # is_bigendian, step
    (size,) = struct.unpack_from(f"{order}I", data, offset)
    return zlib.crc32(memoryview(data)[offset + 4 : offset + 4 + size])


def _after_string(data: bytes, offset: int, order: str) -> int:
    offset = _aligned(offset)
    (size,) = struct.unpack_from(f"{order}I", data, offset)
    return offset + 4 + int(size)


def _aligned(offset: int) -> int:
    """Return the next multiple of four behind the encapsulation, whose size is one, too."""
    return -4 * (-offset // 4)
