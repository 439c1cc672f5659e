"""Machine driven by ros2_control: force and position arrive as messages; only its own controller moves it."""

from __future__ import annotations

import math
import time
from typing import NamedTuple

from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

from fringedic.errors import MachineError
from fringedic.frames.clocks import wall_minus_monotonic_ns
from fringedic.settings.base import MILLI
from fringedic.settings.load_frame import ControllerLoadFrame
from fringedic_ros.arrivals import Arrivals, Problem, stamp_problem
from fringedic_ros.stamps import to_nanoseconds
from load_frame_node.machines.machine import FARTHEST_M, LARGEST_FORCE_N, LoadMode, Motion, Sample

_OLDEST_S = 1.0  # older messages do not describe the present state


class ControllerMachine:
    """Combines the latest joint state and wrench to a sample with the stamp of the joint state.

    Parameters
    ----------
    settings
        Topics that contain position and force, and how a motion is recognised.
    node
        Owner of the subscriptions.
    """

    def __init__(self, settings: ControllerLoadFrame, node: Node) -> None:
        self._node = node
        self._source = settings
        self._position: _Value | None = None
        self._force: _Value | None = None
        self._motion = Motion(MILLI * settings.slowest_mm_per_s, settings.motion_span_s)
        self._mode = LoadMode.UNKNOWN
        self._joint_arrivals = Arrivals(node, JointState, settings.joint_states_topic)
        self._wrench_arrivals = Arrivals(node, WrenchStamped, settings.wrench_topic)
        self._subscriptions = [
            node.create_subscription(
                JointState, settings.joint_states_topic, self._take_joints, qos_profile_sensor_data
            ),
            node.create_subscription(WrenchStamped, settings.wrench_topic, self._take_wrench, qos_profile_sensor_data),
        ]

    def sample(self) -> Sample:
        """Return the latest position and force.

        Raises
        ------
        MachineError
            One of the two topics has had no usable message for a second.
        """
        now = time.monotonic_ns()
        for latest, arrivals in ((self._position, self._joint_arrivals), (self._force, self._wrench_arrivals)):
            if latest is None or now - latest.acquired_ns > 1e9 * _OLDEST_S:
                raise MachineError(str(arrivals))
        assert self._position is not None, "checked above"
        assert self._force is not None, "checked above"
        force, position = self._force.value, self._position.value
        unknown = "; ".join(
            f"{topic}: the {what} is unknown: its value is beyond {largest:g} {unit}, which no testing machine shows"
            for topic, what, value, largest, unit in (
                (self._source.wrench_topic, "force", force, LARGEST_FORCE_N, "N"),
                (self._source.joint_states_topic, "position", position, FARTHEST_M, "m"),
            )
            if math.isnan(value)
        )
        return Sample(self._position.stamp_ns, self._mode, force, position, unknown=unknown)

    def move_to(self, position: float, speed: float) -> None:  # noqa: ARG002 (the interface of every machine)
        """Refuse: only the controller moves the machine.

        Raises
        ------
        MachineError
            Always.
        """
        raise MachineError("this machine is moved by its own controller; send the goal there")

    def hold(self) -> None:
        """Refuse: only the controller holds the machine.

        Raises
        ------
        MachineError
            Always.
        """
        raise MachineError("this machine is held by its own controller; request the hold there")

    def close(self) -> None:
        """Unsubscribe."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []

    def _take_joints(self, message: JointState) -> None:
        position = dict(zip(message.name, message.position, strict=False)).get(self._source.joint, math.nan)
        if not math.isfinite(position):  # a message may name joints without their positions
            names = ", ".join(f"'{name}'" for name in message.name)
            self._joint_arrivals.take(
                Problem(f"without a position of the joint '{self._source.joint}'", "set joint", f"names {names}")
            )
        elif _is_present(message, self._position, self._joint_arrivals):
            position = position if abs(position) <= FARTHEST_M else math.nan
            self._position = _Value.of(message, position)
            self._mode = self._motion.mode(self._position.acquired_ns, position)

    def _take_wrench(self, message: WrenchStamped) -> None:
        force = self._source.force_sign * getattr(message.wrench.force, self._source.force_axis)
        if not math.isfinite(force):
            self._wrench_arrivals.take(
                Problem(f"without a force along {self._source.force_axis}", "check the load cell, or set force_axis")
            )
        elif _is_present(message, self._force, self._wrench_arrivals):
            force = force if abs(force) <= LARGEST_FORCE_N else math.nan
            self._force = _Value.of(message, force)


def _is_present(message: JointState | WrenchStamped, latest: _Value | None, arrivals: Arrivals) -> bool:
    """Count a message, and return whether its stamp is of the present: new, and close to the clock of this computer."""
    stamp_ns = to_nanoseconds(message.header.stamp)
    repeated = latest is not None and latest.stamp_ns == stamp_ns
    # an earlier stamp is that of a clock that was set back
    problem = stamp_problem(stamp_ns, stamp_ns if repeated else 0, time.time_ns(), _OLDEST_S)
    arrivals.take(problem)
    if problem is None:
        arrivals.renew()
    return problem is None


class _Value(NamedTuple):
    stamp_ns: int
    acquired_ns: int  # on the monotonic clock, so that later changes of the clock do not change the age
    value: float

    @classmethod
    def of(cls, message: JointState | WrenchStamped, value: float) -> _Value:
        stamp_ns = to_nanoseconds(message.header.stamp)
        return cls(stamp_ns, stamp_ns - wall_minus_monotonic_ns(), value)
