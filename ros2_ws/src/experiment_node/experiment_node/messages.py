"""Message types by name, and the stamps of serialised messages without decoding them."""

from __future__ import annotations

import importlib
import struct


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
