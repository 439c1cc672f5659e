"""Decodes messages by the definitions in their recording."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fringedic.errors import RecordingError
from fringedic.recording.earlier_versions import translate
from fringedic.recording.topics import Topic


def decode(topic: Topic, data: bytes, path: Path) -> Any:
    """Return a message of a topic, decoded by its recorded definition; its arrays are NumPy arrays.

    A message of an earlier version has the fields of the present one.

    Raises
    ------
    RecordingError
        The bytes do not fit the definition, or the definition is not in the language ``ros2msg``; the message names the
        recording `path`.
    """
    if topic.encoding != "ros2msg":
        raise RecordingError(f"{path}: {topic.name} is defined in {topic.encoding}, only ros2msg is supported")
    types = _types(topic.definition, topic.type_name)
    try:
        message = types.deserialize_cdr(data, topic.type_name)
    except Exception as error:
        raise RecordingError(f"{path}: a message of {topic.name} is not a {topic.type_name}: {error}") from error
    translate(topic.type_name, message)
    return message


@lru_cache(maxsize=256)
def _types(definition: str, type_name: str) -> Typestore:
    """Return the types of a definition; their code is generated once for all recordings with the same definition."""
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(definition, type_name))
    return types
