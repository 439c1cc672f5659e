"""Our messages are the same for every distribution: hashes and bytes equal those of an independent implementation."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ament_index_python.packages import get_package_share_directory
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fringedic.recording.definitions import type_hash

DEFINITIONS = sorted(Path(get_package_share_directory("fringedic_msgs"), "msg").glob("*.msg"))
NAMES = [f"fringedic_msgs/msg/{path.stem}" for path in DEFINITIONS]


def store_of(distribution: Stores) -> Any:
    """Return the message types of a distribution with ours."""
    store = get_typestore(distribution)
    for path, name in zip(DEFINITIONS, NAMES, strict=True):
        store.register(get_types_from_msg(path.read_text(), name))
    return store


def filled(message: Any, random: np.random.Generator) -> Any:
    """Give every field of a message another value than it has at first."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            filled(value, random)
        elif kind.startswith("sequence<") or "[" in kind:
            element = kind.removeprefix("sequence<").rstrip(">").split("[")[0]
            length = len(value) if "[" in kind else 3
            setattr(message, name, [new_value(element, random) for _ in range(length)])
        else:
            setattr(message, name, new_value(kind, random))
    return message


def new_value(kind: str, random: np.random.Generator) -> Any:
    """Return a value of a type as messages name it."""
    if "/" in kind:
        package, name = kind.split("/")
        return filled(getattr(importlib.import_module(f"{package}.msg"), name)(), random)
    if kind == "string":
        return "µm, " + "x" * int(random.integers(9))
    if kind == "octet":
        return bytes([int(random.integers(256))])
    if kind in ("float", "double"):
        return float(np.float32(random.normal()))
    return bool(random.integers(2)) if kind == "boolean" else int(random.integers(1, 100))


@pytest.mark.parametrize(
    "distribution", [Stores.ROS2_JAZZY, Stores.ROS2_KILTED, Stores.ROS2_LYRICAL], ids=lambda store: store.value
)
def test_type_hashes(distribution: Stores) -> None:
    store = store_of(distribution)
    assert {name: store.hash_rihs01(name) for name in NAMES} == {name: type_hash(name) for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_bytes(name: str) -> None:
    """What rclpy writes is read by the other implementation, written again, and read by rclpy: nothing changes."""
    kind = getattr(importlib.import_module("fringedic_msgs.msg"), name.split("/")[-1])
    message = filled(kind(), np.random.default_rng(5))
    store = store_of(Stores.LATEST)
    again = bytes(store.serialize_cdr(store.deserialize_cdr(serialize_message(message), name), name))
    assert deserialize_message(again, kind) == message
