"""Live signals of a rig."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node

from fringedic.errors import RecordingError
from fringedic.signals import SignalCollector
from fringedic_msgs.msg import LoadState, Signal

SIGNAL_TYPES: dict[str, type[Any]] = {"load_frame/state": LoadState, "signals": Signal}
"""Types of the topics in `fringedic.signals.SIGNAL_TOPICS`."""


def add_signals(node: Node, collector: SignalCollector, topic: str, message: Any) -> list[str]:
    """Add a message to the signals, and return the names of those that have new samples.

    An incomplete message is reported in the log of the node and ignored.
    """
    try:
        return collector.add(topic, message)
    except RecordingError as error:
        node.get_logger().warning(f"{error}; this message is ignored", throttle_duration_sec=10.0)
        return []
