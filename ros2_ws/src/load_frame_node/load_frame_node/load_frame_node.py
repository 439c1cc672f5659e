"""Talks to the testing machine: publishes force and position, asks for moves and holds."""

from __future__ import annotations

import math
import time
from functools import partial

from geometry_msgs.msg import WrenchStamped
from pydantic import ConfigDict, Field
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from fringedic.errors import CrossheadRangeError, WaitTimeoutError
from fringedic.virtual_rig import LoadMode, LoadSample
from fringedic_msgs.action import MoveCrosshead
from fringedic_msgs.msg import LoadState
from fringedic_ros.lifecycle import HardwareNode, HardwareParameters
from fringedic_ros.main import run
from fringedic_ros.qos import STATE
from fringedic_ros.virtual import virtual_configuration
from fringedic_ros.waiting import Condition
from load_frame_node.machine import Machine, SimulatedMachine

Result = MoveCrosshead.Result
FRAME_ID = "load_frame"
JOINT = "crosshead"
FEEDBACK_PERIOD_S = 0.1


class LoadFrameParameters(HardwareParameters):
    """Parameters of the load frame node."""

    model_config = ConfigDict(frozen=True)

    rig_file: str = Field(
        "", description="Rig file whose `virtual_rig` the simulated machine belongs to; empty is the preset plate."
    )
    rate_hz: float = Field(100.0, gt=0, le=1000, description="Samples of force and position per second [Hz].")
    move_timeout_s: float = Field(
        10.0, gt=0, le=3600, description="A move fails this long after its way at its speed should be done [s]."
    )


class LoadFrameNode(HardwareNode[LoadFrameParameters]):
    """Samples the machine and serves `move_crosshead` and `load_frame/hold`."""

    def __init__(self) -> None:
        super().__init__("load_frame", LoadFrameParameters)
        self._machine: Machine | None = None
        self._timer: Timer | None = None
        self._sample = LoadSample(LoadMode.UNKNOWN, math.nan, math.nan)
        self._sampled = Condition(self)
        self._moving: ServerGoalHandle | None = None
        self._states = self.create_publisher(LoadState, "load_frame/state", STATE)
        self._wrenches = self.create_publisher(WrenchStamped, "load_frame/wrench", STATE)
        self._joints = self.create_publisher(JointState, "load_frame/joint_states", STATE)
        self.create_service(Trigger, "load_frame/hold", self._serve_hold)
        self._actions = ActionServer(self, MoveCrosshead, "move_crosshead", self._move, cancel_callback=self._cancel)

    def open(self) -> None:
        """Connect to the machine."""
        self._machine = SimulatedMachine(virtual_configuration(self.parameters.value.rig_file))

    def activate(self) -> None:
        """Begin to sample."""
        self._publish_sample()
        self._timer = self.create_timer(1 / self.parameters.value.rate_hz, self._publish_sample)

    def deactivate(self) -> None:
        """Stop sampling. A move that is running is asked to hold: nobody would watch it."""
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        if self._moving is not None and self._machine is not None:
            self._machine.hold()
            self._sampled.notify()

    def close(self) -> None:
        """Leave the machine to itself."""
        self._machine = None

    def destroy_node(self) -> None:
        """End the action server with the node."""
        self._actions.destroy()
        super().destroy_node()

    def _publish_sample(self) -> None:
        assert self._machine is not None
        self._sample = sample = self._machine.sample()
        stamp = self.get_clock().now().to_msg()
        state = LoadState(mode=int(sample.mode), force=sample.force, position=sample.position)
        state.header.stamp, state.header.frame_id = stamp, FRAME_ID
        self._states.publish(state)
        wrench = WrenchStamped(header=state.header)
        wrench.wrench.force.y = sample.force
        self._wrenches.publish(wrench)
        self._joints.publish(
            JointState(header=state.header, name=[JOINT], position=[sample.position], effort=[sample.force])
        )
        self.diagnostics.success()
        self._sampled.notify()

    def _serve_hold(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self.active and self._machine is not None:
            self._machine.hold()
            response.success, response.message = True, "asked the machine to hold"
        else:
            response.message = "the load frame is not active; configure and activate it first"
        return response

    def _cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        if self._moving is None or goal.goal_id != self._moving.goal_id or self._machine is None:
            return CancelResponse.REJECT
        self._machine.hold()
        return CancelResponse.ACCEPT

    async def _move(self, goal: ServerGoalHandle) -> MoveCrosshead.Result:
        code, words = self._begin(goal)
        if code == Result.NONE:
            try:
                code, words = await self._arrive(goal)
            finally:
                self._moving = None
        if code == Result.NONE:
            goal.succeed()
        else:
            self.get_logger().warning(words)
            if code == Result.CANCELLED and goal.is_cancel_requested:
                goal.canceled()
            else:
                goal.abort()
        return Result(error_code=code, error_message=words, position=self._sample.position, force=self._sample.force)

    def _begin(self, goal: ServerGoalHandle) -> tuple[int, str]:
        """Ask the machine for the move; say why not."""
        if not self.active or self._machine is None:
            return Result.MACHINE_FAULT, "the load frame is not active; configure and activate it first"
        if self._moving is not None:
            target = self._moving.request.position * 1e3
            return Result.BUSY, f"the crosshead is moving to {target:g} mm; wait for it or cancel that move"
        if self._sample.mode is LoadMode.FAULT:
            return Result.MACHINE_FAULT, "the machine reports a fault; clear it at the machine"
        try:
            self._machine.move_to(goal.request.position, goal.request.speed)
        except CrossheadRangeError as error:
            return Result.INVALID_GOAL, str(error)
        self._moving = goal
        self._sample = self._machine.sample()
        return Result.NONE, ""

    async def _arrive(self, goal: ServerGoalHandle) -> tuple[int, str]:
        """Wait until the machine has ended the move; say how."""
        target = goal.request.position
        way = abs(target - self._sample.position)
        end = time.monotonic() + way / goal.request.speed + self.parameters.value.move_timeout_s
        while not self._standing():
            goal.publish_feedback(MoveCrosshead.Feedback(position=self._sample.position, force=self._sample.force))
            pause = time.monotonic() + FEEDBACK_PERIOD_S
            try:
                await self._sampled.wait(partial(self._standing, pause), max(end - time.monotonic(), 0.0))
            except WaitTimeoutError:
                if self._machine is not None:
                    self._machine.hold()
                return Result.TIMEOUT, f"the crosshead had not come to {target * 1e3:g} mm in time and is to hold"
        where = f"at {self._sample.position * 1e3:.4f} mm on its way to {target * 1e3:g} mm"
        if goal.is_cancel_requested:
            return Result.CANCELLED, f"cancelled; the crosshead holds {where}"
        if self._sample.mode is LoadMode.FAULT or not self.active:
            return Result.MACHINE_FAULT, f"the machine stopped {where}: it reports a fault or was deactivated"
        if abs(self._sample.position - target) > 1e-3 * max(way, 1e-6):
            return Result.CANCELLED, f"a hold was asked for; the crosshead holds {where}"
        return Result.NONE, ""

    def _standing(self, pause: float = math.inf) -> bool:
        """Whether the move is over, or it is time for feedback."""
        return not self.active or self._sample.mode is not LoadMode.MOVING or time.monotonic() >= pause


def main() -> int:
    """Run the load frame node."""
    return run(LoadFrameNode.started)
