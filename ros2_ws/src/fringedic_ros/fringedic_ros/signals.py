"""Live signals of a rig."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rclpy.node import Node

from fringedic.errors import RecordingError
from fringedic.signals import Channel, SignalCollector
from fringedic_msgs.msg import LoadState, Signal
from fringedic_ros.stamps import to_msg

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


def signal_message(channel: Channel, stamps: Sequence[int], values: np.ndarray, sigmas: np.ndarray) -> Signal:
    """Return the message of samples of a signal.

    Parameters
    ----------
    channel
        What they measure.
    stamps, values, sigmas
        Times of acquisition [ns], values and standard uncertainties in the unit of the channel; shape (n,), n > 0.
    """
    message = Signal(**channel._asdict(), stamps=[to_msg(each) for each in stamps])
    message.header.stamp = message.stamps[-1]
    message.values, message.sigmas = values.tolist(), sigmas.tolist()
    return message
