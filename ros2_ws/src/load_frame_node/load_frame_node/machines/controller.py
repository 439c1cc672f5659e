"""A machine that ros2_control drives: its force and position come as messages, its moves stay with its controller."""

from __future__ import annotations

import math
import time

from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

from fringedic.errors import MachineError
from fringedic.virtual_rig import LoadMode
from fringedic_ros.stamps import to_nanoseconds
from load_frame_node.machines.machine import Motion, Sample

_OLDEST_S = 1.0  # messages that are older tell nothing of now
_SLOWEST_M_PER_S = 1e-5
_SPAN_S = 0.2


class ControllerMachine:
    """Joins the latest joint state and wrench to a sample, stamped as the joint state is.

    Parameters
    ----------
    node
        Subscribes to the topics.
    joint_states_topic, joint
        Where the crosshead's position [m] comes from.
    wrench_topic, force_axis, force_sign
        Where the force [N] comes from, and the sign that makes tension positive.
    """

    def __init__(
        self,
        node: Node,
        *,
        joint_states_topic: str,
        joint: str,
        wrench_topic: str,
        force_axis: str,
        force_sign: int,
    ) -> None:
        self._node = node
        self._joint = joint
        self._axis, self._sign = force_axis, force_sign
        self._topics = (joint_states_topic, wrench_topic)
        self._position: tuple[int, float] | None = None
        self._force: tuple[int, float] | None = None
        self._motion = Motion(_SLOWEST_M_PER_S, _SPAN_S)
        self._mode = LoadMode.UNKNOWN
        self._subscriptions = [
            node.create_subscription(JointState, joint_states_topic, self._take_joints, qos_profile_sensor_data),
            node.create_subscription(WrenchStamped, wrench_topic, self._take_wrench, qos_profile_sensor_data),
        ]

    def sample(self) -> Sample:
        """Return the latest position and force.

        Raises
        ------
        MachineError
            One of them has not come for a second.
        """
        now = time.time_ns()
        for topic, latest in zip(self._topics, (self._position, self._force), strict=True):
            if latest is None or now - latest[0] > 1e9 * _OLDEST_S:
                raise MachineError(f"nothing has come on {topic} for {_OLDEST_S:g} s; does the controller run?")
        assert self._position is not None and self._force is not None, "checked above"
        return Sample(self._position[0], self._mode, self._force[1], self._position[1])

    def move_to(self, position: float, speed: float) -> None:
        """Refuse: the controller moves the machine.

        Raises
        ------
        MachineError
            Always.
        """
        raise MachineError("this machine is moved by its own controller; send the goal there")

    def hold(self) -> None:
        """Refuse: the controller holds the machine.

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
        if self._joint not in message.name:
            return
        position = message.position[message.name.index(self._joint)]
        if math.isfinite(position):
            stamp = to_nanoseconds(message.header.stamp)
            self._mode = self._motion.mode(stamp, position)
            self._position = stamp, position

    def _take_wrench(self, message: WrenchStamped) -> None:
        force = self._sign * getattr(message.wrench.force, self._axis)
        if math.isfinite(force):
            self._force = to_nanoseconds(message.header.stamp), force
