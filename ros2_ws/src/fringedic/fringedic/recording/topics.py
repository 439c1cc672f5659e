"""Recorded topics, their quality of service, and serialised messages."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

IMAGE = "camera/image_raw"
EXPOSURE = "camera/exposure"
_BEFORE_COMMENT = re.compile(r"""(?:[^#'"]|'[^']*'|"[^"]*")*""")
_NODES = ("phase", "dic", "coupling")
_TYPES = {
    "calibration": "fringedic_msgs/msg/RigCalibration",
    "camera/clock": "fringedic_msgs/msg/ClockDrift",
    EXPOSURE: "fringedic_msgs/msg/Exposure",
    IMAGE: "sensor_msgs/msg/Image",
    "experiment/plane": "fringedic_msgs/msg/ReferencePlane",
    "experiment/reference": "fringedic_msgs/msg/Reference",
    "experiment/step": "fringedic_msgs/msg/StepStatus",
    "load_frame/clock": "fringedic_msgs/msg/ClockDrift",
    "load_frame/state": "fringedic_msgs/msg/LoadState",
    "programme/status": "fringedic_msgs/msg/StepStatus",
    "signals": "fringedic_msgs/msg/Signal",
    "node_parameters": "fringedic_msgs/msg/NodeParameters",
} | {f"{node}/status": "fringedic_msgs/msg/NodeStatus" for node in _NODES}


def is_named(topic: str, type_name: str, name: str) -> bool:
    """Return whether a topic has a name relative to some rig's namespace, and is not of another program's type.

    Parameters
    ----------
    topic, type_name
        ``/rig/camera/exposure``, ``fringedic_msgs/msg/Exposure``; an empty type is not known.
    name
        ``camera/exposure``.

    Examples
    --------
    >>> is_named("/driver/camera/exposure", "std_msgs/msg/Float64", "camera/exposure")
    False
    """
    return f"/{topic}".endswith(f"/{name}") and type_name in ("", _TYPES.get(name, type_name))


@dataclass(frozen=True)
class Qos:
    """Quality of service that the publisher of a recorded topic offered, and that a player offers again.

    Most middlewares do not transmit history and depth of a publisher. The history is ``unknown`` then, and the depth is
    the default of a player, because players refuse a depth of 0.
    """

    depth: int = 10
    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    history: Literal["keep_last", "keep_all", "unknown"] = "unknown"

    def profile(self) -> dict[str, Any]:
        """Return the profile in the form of rosbag2 (version 9), without time limits."""
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

    def has_messages_of(self, other: Topic) -> bool:
        """Return whether messages of both have the same fields; comments of their definitions may differ."""
        if self.type_name != other.type_name:
            return False
        return bool(self.hash and self.hash == other.hash) or _fields(self.definition) == _fields(other.definition)


def _fields(definition: str) -> list[list[str]]:
    """Return the words of each line of a definition without comments; texts among the values may contain their sign."""
    lines = map(_BEFORE_COMMENT.match, definition.splitlines())
    return [line[0].split() for line in lines if line and line[0].strip()]


class RawMessage(NamedTuple):
    """One serialised message with its times [ns], and its number in its publisher's own count."""

    topic: str
    data: bytes
    log_time: int
    publish_time: int
    sequence: int = 0
