"""Common to all nodes of a rig: frame prefix, QoS overrides of every topic, timers on the steady clock."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from fringedic.errors import ConfigurationError
from fringedic.frames.sensor import SENSOR, sensor_name
from fringedic.wording.arguments import check_value

FRAME_PREFIX = "frame_prefix"
SENSOR_PARAMETER = "sensor"
RIG_FRAME = "reference_plane"
CAMERA_FRAME = "camera_optical_frame"
PROJECTOR_FRAME = "projector_optical_frame"
LOAD_FRAME = "load_frame"
FIXED_QOS = QoSOverridingOptions([])
"""Option `qos_overriding_options` of a topic whose QoS is read from its publishers."""

_STEADY = Clock(clock_type=ClockType.STEADY_TIME)
_OF_RCLPY = ("/parameter_events", "/clock")  # created by rclpy, some before parameters can be declared


class RigNode(Node):
    """A node of a rig.

    Parameters
    ----------
    name
        Node name.

    Attributes
    ----------
    sensor
        Name of the sensor (a camera with its projector) that the node belongs to.

    Raises
    ------
    ConfigurationError
        The parameter ``sensor`` is no name of a sensor.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        what = "Name of the sensor, a camera with its projector; in a rig file: sensor."
        named = self.declare_parameter(SENSOR_PARAMETER, SENSOR, ParameterDescriptor(description=what, read_only=True))
        self.sensor: str = check_value(ConfigurationError, f"{name}: sensor", named.value, sensor_name)
        what = "Prefix of all frame ids; empty: none. By default the namespace of the node."
        self.declare_parameter(
            FRAME_PREFIX,
            self.get_namespace().strip("/"),
            ParameterDescriptor(description=what, read_only=True),
        )

    def create_publisher(  # type: ignore[override]
        self, kind: Any, topic: str, qos_profile: QoSProfile | int, **options: Any
    ) -> Publisher:
        """Create a publisher whose history, depth and reliability can be overridden by parameters."""
        return super().create_publisher(kind, topic, *_overridable(topic, qos_profile, options), **options)

    def create_subscription(  # type: ignore[override]
        self, kind: Any, topic: str, callback: Callable[..., None], qos_profile: QoSProfile | int, **options: Any
    ) -> Subscription:
        """Create a subscription whose history, depth and reliability can be overridden by parameters."""
        return super().create_subscription(kind, topic, callback, *_overridable(topic, qos_profile, options), **options)

    def create_timer(  # type: ignore[override]
        self, period_s: float, callback: Callable[[], None], **options: Any
    ) -> Timer:
        """Create a timer on the steady clock: one on the clock of the node would stop with `/clock`."""
        return super().create_timer(period_s, callback, **{"clock": _STEADY} | options)


class RigLifecycleNode(RigNode, LifecycleNode):
    """A node of a rig with a lifecycle."""


def frame_id(node: Node, name: str) -> str:
    """Return the frame id of a frame of the rig that a node belongs to.

    Parameters
    ----------
    node
        A `RigNode` or `RigLifecycleNode`.
    name
        Such as ``reference_plane``.
    """
    prefix = str(node.get_parameter(FRAME_PREFIX).value)
    return f"{prefix}/{name}" if prefix else name


def _overridable(topic: str, qos: QoSProfile | int, options: dict[str, Any]) -> tuple[QoSProfile | int]:
    """Add the option for overrides, and return a copy of the profile: rclpy writes the overrides into it."""
    if topic not in _OF_RCLPY:
        options.setdefault("qos_overriding_options", QoSOverridingOptions.with_default_policies())
    return (copy.copy(qos),)
