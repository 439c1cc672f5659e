"""Message definitions in the form that MCAP stores, from the installed ROS packages."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

from fringedic.errors import RecordingError


def interface_definition(type_name: str) -> str:
    """Return the definition of a message type with those of all nested types, in MCAP's format ``ros2msg``.

    Parameters
    ----------
    type_name
        ``package/msg/Name``, looked up in ``share`` of every prefix in ``AMENT_PREFIX_PATH``.

    Raises
    ------
    RecordingError
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
    """Return the RIHS01 hash of a message type, by which ROS 2 distinguishes versions of a definition.

    Raises
    ------
    RecordingError
        The type's description is not installed.
    """
    description = json.loads(_definition_file(type_name, ".json").read_text("utf-8"))
    return next(str(each["hash_string"]) for each in description["type_hashes"] if each["type_name"] == type_name)


def _definition_file(type_name: str, suffix: str) -> Path:
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    if len(type_name.split("/")) == 3:
        for prefix in prefixes:
            file = prefix / "share" / f"{type_name}{suffix}"
            if file.is_file():
                return file
    places = ", ".join(map(str, prefixes)) or "AMENT_PREFIX_PATH, which is empty"
    raise RecordingError(f"no definition of the message type '{type_name}' ({suffix}) in {places}")


def _nested_types(type_name: str, text: str) -> list[str]:
    """Return the types of the fields that are messages themselves, in the order of the fields."""
    found = []
    for line in text.splitlines():
        declared = re.match(r"\s*([A-Za-z]\w*(?:/\w+)*)(?:\[.*?\])?\s+\w", line)
        if declared and (name := declared[1])[name.rfind("/") + 1].isupper():
            *package, short = name.split("/")
            found.append(f"{package[0] if package else type_name.split('/')[0]}/msg/{short}")
    return found
