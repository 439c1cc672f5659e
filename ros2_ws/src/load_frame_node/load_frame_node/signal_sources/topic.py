"""A number in the messages of any ROS topic."""

from __future__ import annotations

import importlib
import queue
import re
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from fringedic.errors import MachineError
from fringedic.settings.signals import TopicSignal
from fringedic_ros.rig_node import FIXED_QOS
from fringedic_ros.stamps import to_nanoseconds
from load_frame_node.signal_sources.source import Reading

_WAIT_S = 0.1
_LOOK_S = 0.5  # between two looks for a publisher
_DEPTH = 1000
_PART = re.compile(r"(?P<name>\w+)(\[(?P<index>\d+)\])?")


class TopicSource:
    """Readings from the messages of a topic, whose type is that of its publisher."""

    def __init__(self, settings: TopicSignal, node: Node) -> None:
        self._settings, self._node = settings, node
        self._topic = node.resolve_topic_name(settings.topic)
        self._readings: queue.Queue[Reading | MachineError] = queue.Queue(_DEPTH)
        self._subscription: Subscription | None = None
        self._looked_s = -_LOOK_S

    def read(self) -> Sequence[Reading]:
        """Return the readings that have arrived.

        Raises
        ------
        MachineError
            The messages have no such number, or their type is not installed.
        """
        if self._subscription is None and time.monotonic() - self._looked_s >= _LOOK_S:
            self._looked_s = time.monotonic()
            self._subscribe()
        found: list[Reading] = []
        with suppress(queue.Empty):
            while True:
                each = self._readings.get(not found, _WAIT_S)
                if isinstance(each, MachineError):
                    raise each
                found.append(each)
        return found

    def close(self) -> None:
        """End the subscription."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _subscribe(self) -> None:
        publishers = self._node.get_publishers_info_by_topic(self._topic)
        if not publishers:
            return
        reliable = all(each.qos_profile.reliability == ReliabilityPolicy.RELIABLE for each in publishers)
        reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        kind = _message_type(publishers[0].topic_type, self._topic)
        self._subscription = self._node.create_subscription(
            kind,
            self._topic,
            self._take,
            QoSProfile(depth=_DEPTH, reliability=reliability),
            qos_overriding_options=FIXED_QOS,
        )

    def _take(self, message: Any) -> None:
        with suppress(queue.Full):  # of a node that is not active, or of messages without such a number
            self._readings.put_nowait(self._reading(message))

    def _reading(self, message: Any) -> Reading | MachineError:
        now = time.time_ns()
        try:
            value = _number(message, self._settings.field)
            stamp = now if self._settings.clock == "arrival" else _stamp(message)
        except (AttributeError, IndexError, TypeError, ValueError) as error:
            return MachineError(
                f"topic {self._topic}: a message of type {type(message).__name__} has no number "
                f"'{self._settings.field}' ({error}); correct field"
            )
        if stamp == 0:
            return MachineError(
                f"topic {self._topic}: its messages have no stamp; write clock: arrival in the rig file"
            )
        return Reading(stamp, value)


def _message_type(name: str, topic: str) -> Any:
    """Return the class of a type such as ``sensor_msgs/msg/Temperature``."""
    package, _, kind = name.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError) as error:
        raise MachineError(
            f"topic {topic}: its type {name} is not installed here; install the package {package}"
        ) from error


def _number(message: Any, field: str) -> float:
    value = message
    for part in field.split("."):
        match = _PART.fullmatch(part)
        assert match is not None, "checked with the settings"
        value = getattr(value, match["name"])
        if match["index"] is not None:
            value = value[int(match["index"])]
    return float(value)


def _stamp(message: Any) -> int:
    """Return the stamp of the header of a message [ns], 0 for one without."""
    header = getattr(message, "header", None)
    return 0 if header is None else to_nanoseconds(header.stamp)
