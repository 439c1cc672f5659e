"""Decodes messages by the definitions in their recording."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fringedic.errors import RecordingError
from fringedic.recording.earlier_versions import translate
from fringedic.recording.topics import Topic

_MOST_OBJECTS = 10_000  # of a message without its lists of variable length: code is generated for each


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
    try:
        types = _types(topic.definition, topic.type_name)
        message = types.deserialize_cdr(data, topic.type_name)
    except Exception as error:
        raise RecordingError(f"{path}: a message of {topic.name} is not a {topic.type_name}: {error}") from error
    translate(topic.type_name, message)
    return message


@lru_cache(maxsize=256)
def _types(definition: str, type_name: str) -> Typestore:
    """Return the types of a definition; their code is generated once for all recordings with the same definition."""
    types, defined = get_typestore(Stores.EMPTY), get_types_from_msg(definition, type_name)
    counts: dict[str, int] = {}
    for name in defined:
        _count_objects(name, defined, counts)
    types.register(defined)
    return types


def _count_objects(name: str, defined: Typesdict, counts: dict[str, int]) -> int:
    """Return the number of texts and messages in a message of a type, and keep it in `counts`.

    Raises
    ------
    ValueError
        There are more than a message of a measurement needs, or a message contains itself.
    """
    if name not in counts:
        counts[name] = _MOST_OBJECTS  # until it is known: of a message that contains itself
        fields = defined[name][1] if name in defined else []
        counts[name] = 1 + sum(_count_in_field(field, defined, counts) for _, field in fields)
    if counts[name] > _MOST_OBJECTS:
        raise ValueError(f"its definition has more than {_MOST_OBJECTS} texts and messages within a {name}")
    return counts[name]


def _count_in_field(field: FieldDesc, defined: Typesdict, counts: dict[str, int]) -> int:
    if field[0] == Nodetype.NAME:
        return _count_objects(field[1], defined, counts)
    if field[0] != Nodetype.ARRAY:  # the data of a list contain its length, which is compared with theirs
        return 1
    content, length = field[1]
    if content[0] == Nodetype.NAME:
        return length * _count_objects(content[1], defined, counts)
    return length if content[1][0] == "string" else 1
