"""Recorded topics, their quality of service, and serialised messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple


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


class RawMessage(NamedTuple):
    """One serialised message with its times [ns], and its number in its publisher's own count."""

    topic: str
    data: bytes
    log_time: int
    publish_time: int
    sequence: int = 0
