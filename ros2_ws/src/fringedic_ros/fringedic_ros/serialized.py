"""Message types by name, and what is read of serialised messages; their bytes may be those of any program."""

from __future__ import annotations

import importlib
import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
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


@dataclass
class ImageView:
    """A serialised ``sensor_msgs/Image`` in the form of `fringedic.frames.messages.ImageMessage`; pixels not copied.

    Attributes
    ----------
    stamp
        Of its header [ns].
    height, width, encoding, is_bigendian, step
        Fields of the message.
    data
        The bytes of the pixels, in those of the message.
    """

    stamp: int
    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: memoryview


def image_view(data: bytes) -> ImageView:
    """Return the fields of a serialised ``sensor_msgs/Image``; `read` would copy its pixels.

    Fields of four bytes stand at multiples of four (CDR), behind the padding of strings and bytes before them.

    Raises
    ------
    RecordingError
        The bytes are not those of an image.
    """
    try:
        order = "<" if data[1] & 1 else ">"
        _, offset = _string(data, 4 + 8, order)  # frame_id, after encapsulation and stamp
        height, width = struct.unpack_from(f"{order}II", data, offset := _aligned(offset))
        encoding, offset = _string(data, offset + 8, order)
        step, size = struct.unpack_from(f"{order}II", data, _aligned(offset + 1))
        is_bigendian = data[offset]
    except (struct.error, IndexError, UnicodeDecodeError):
        raise _unreadable(data, "Image") from None
    first = _aligned(offset + 1) + 8
    pixels = memoryview(data)[first : first + size]
    return ImageView(header_stamp(data), height, width, encoding, is_bigendian, step, pixels)


def image_crc(data: bytes) -> int:
    """Return the CRC-32 of the pixels of a serialised ``sensor_msgs/Image``.

    Raises
    ------
    RecordingError
        The bytes are not those of an image.
    """
    return zlib.crc32(image_view(data).data)


def step_crc(crcs: Iterable[int]) -> int:
    """Return the CRC-32 of a step: that of the CRC-32s of its images in their order, each little-endian.

    Examples
    --------
    >>> step_crc([1, 2]) == step_crc([2, 1])
    False
    """
    numbers = list(crcs)
    return zlib.crc32(struct.pack(f"<{len(numbers)}I", *numbers))


def _unreadable(data: bytes, kind: str) -> RecordingError:
    return RecordingError(f"a message of {len(data)} bytes cannot be read as {kind}; check which program publishes it")


def _string(data: bytes, offset: int, order: str) -> tuple[str, int]:
    """Return the string at or behind an offset, and the offset behind it."""
    offset = _aligned(offset)
    (size,) = struct.unpack_from(f"{order}I", data, offset)
    end = offset + 4 + size
    return data[offset + 4 : end].rstrip(b"\0").decode(), end


def _aligned(offset: int) -> int:
    """Return the next multiple of four behind the encapsulation, whose size is one, too."""
    return -4 * (-offset // 4)
