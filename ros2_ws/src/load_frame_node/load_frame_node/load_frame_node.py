"""Moves and holds the crosshead, and publishes mode, force and position.

The machine's own limits and emergency stop are in charge; this node only passes requests on.
"""

from __future__ import annotations

from geometry_msgs.msg import WrenchStamped
from pydantic import Field
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from fringedic.errors import CrossheadRangeError, WaitTimeoutError
from fringedic.virtual_rig import LoadMode, LoadSample, SimulatedLoadFrame
from fringedic_msgs.action import MoveCrosshead
from fringedic_msgs.msg import LoadState
from fringedic_ros.lifecycle import HardwareNode, HardwareParameters
from fringedic_ros.main import run
from fringedic_ros.qos import STATE
from fringedic_ros.virtual import VirtualRigText, virtual_configuration
from fringedic_ros.waiting import Condition

FRAME_ID = "load_frame"
JOINT = "crosshead"
Result = MoveCrosshead.Result
_FEEDBACK_PERIOD_S = 0.1
_STOP_TIMEOUT_S = 30.0


class LoadFrameParameters(HardwareParameters):
    """Parameters of the load frame node."""

    rate_hz: float = Field(100.0, gt=0, le=1000, description="Samples of force and position per second [Hz].")
    virtual_rig: VirtualRigText = "{preset: plate}"


class LoadFrameNode(HardwareNode[LoadFrameParameters]):
    """Action `move_crosshead`, service `load_frame/hold`, and the machine's samples."""

    def __init__(self) -> None:
        super().__init__("load_frame", LoadFrameParameters)
        self._machine: SimulatedLoadFrame | None = None
        self._sampling: Timer | None = None
        self._sample = LoadSample(LoadMode.UNKNOWN, 0.0, 0.0)
        self._sampled_ns = 0
        self._goal: ServerGoalHandle | None = None
        self._held = False
        self._changed = Condition(self)
        self._states = self.create_publisher(LoadState, "load_frame/state", STATE)
        self._wrenches = self.create_publisher(WrenchStamped, "load_frame/wrench", STATE)
        self._joints = self.create_publisher(JointState, "load_frame/joint_states", STATE)
        self.create_service(Trigger, "load_frame/hold", self._hold)
        ActionServer(
            self,
            MoveCrosshead,
            "move_crosshead",
            self._move,
            cancel_callback=self._cancel,
            callback_group=ReentrantCallbackGroup(),
        )

    # lifecycle

    def open(self) -> None:
        """Connect to the simulated machine of the virtual rig."""
        configuration = virtual_configuration(self.parameters.value.virtual_rig)
        self._machine = SimulatedLoadFrame(configuration.load_frame, configuration.seed)

    def activate(self) -> None:
        """Begin to sample."""
        self._sampled_ns = self.get_clock().now().nanoseconds
        self._sampling = self.create_timer(
            1 / self.parameters.value.rate_hz, self._take_sample, callback_group=MutuallyExclusiveCallbackGroup()
        )

    def deactivate(self) -> None:
        """Hold, and stop sampling."""
        if self._machine is not None:
            self._machine.hold()
        if self._sampling is not None:
            self.destroy_timer(self._sampling)
            self._sampling = None

    def close(self) -> None:
        """Let go of the machine."""
        self._machine = None

    # samples

    def _take_sample(self) -> None:
        if self._machine is None:
            return
        now = self.get_clock().now()
        # a clock that was set back must not turn the machine's time back
        self._machine.advance(1e-9 * max(now.nanoseconds - self._sampled_ns, 0))
        self._sampled_ns = now.nanoseconds
        self._sample = self._machine.sample()
        state = LoadState(mode=int(self._sample.mode), force=self._sample.force, position=self._sample.position)
        state.header.stamp, state.header.frame_id = now.to_msg(), FRAME_ID
        wrench = WrenchStamped(header=state.header)
        wrench.wrench.force.z = state.force
        joint = JointState(header=state.header, name=[JOINT], position=[state.position], effort=[state.force])
        self._states.publish(state)
        self._wrenches.publish(wrench)
        self._joints.publish(joint)
        self.diagnostics.success()
        self._changed.notify()

    # moving and holding

    def _hold(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._machine is None or not self.active:
            response.message = "the load frame is not active; configure and activate it"
        else:
            self._machine.hold()
            self._held = True
            response.success = True
            response.message = f"holding at {1e3 * self._sample.position:.4f} mm"
        return response

    def _cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        return CancelResponse.ACCEPT if goal is self._goal else CancelResponse.REJECT

    async def _move(self, goal: ServerGoalHandle) -> MoveCrosshead.Result:
        request = goal.request
        if self._machine is None or not self.active:
            return self._end(goal, Result.MACHINE_FAULT, "the load frame is not active; configure and activate it")
        if self._goal is not None:
            return self._end(goal, Result.BUSY, "the crosshead follows another goal; cancel it or wait")
        way = abs(request.position - self._sample.position)
        try:
            self._machine.move_to(request.position, request.speed)
        except CrossheadRangeError as error:
            return self._end(goal, Result.INVALID_GOAL, str(error))
        self._goal, self._held = goal, False
        self._sample = self._sample._replace(mode=LoadMode.MOVING)
        try:
            # twice the time at constant speed, and some for the ramps
            return await self._follow(goal, 2 * way / request.speed + _STOP_TIMEOUT_S)
        finally:
            self._goal = None

    async def _follow(self, goal: ServerGoalHandle, timeout_s: float) -> MoveCrosshead.Result:
        deadline = self.get_clock().now().nanoseconds + round(1e9 * timeout_s)
        while not (goal.is_cancel_requested or self._is_still()):
            if self.get_clock().now().nanoseconds > deadline:
                await self._stop()
                return self._end(goal, Result.TIMEOUT, f"the crosshead did not arrive within {timeout_s:g} s")
            goal.publish_feedback(MoveCrosshead.Feedback(position=self._sample.position, force=self._sample.force))
            try:
                await self._changed.wait(lambda: goal.is_cancel_requested or self._is_still(), _FEEDBACK_PERIOD_S)
            except WaitTimeoutError:
                continue
        if goal.is_cancel_requested:
            await self._stop()
            return self._end(goal, Result.CANCELLED, f"cancelled; holding at {1e3 * self._sample.position:.4f} mm")
        if not self.active or self._sample.mode == LoadMode.FAULT:
            return self._end(goal, Result.MACHINE_FAULT, "the machine stopped")
        if self._held:
            return self._end(
                goal, Result.CANCELLED, f"load_frame/hold stopped it at {1e3 * self._sample.position:.4f} mm"
            )
        return self._end(goal, Result.NONE, "")

    def _is_still(self) -> bool:
        return self._sample.mode != LoadMode.MOVING or not self.active

    async def _stop(self) -> None:
        if self._machine is not None:
            self._machine.hold()
            await self._changed.wait(self._is_still, _STOP_TIMEOUT_S, "the crosshead's stop")

    def _end(self, goal: ServerGoalHandle, code: int, message: str) -> MoveCrosshead.Result:
        if code == Result.NONE:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            self.get_logger().error(message)
            self.diagnostics.failure(message)
            goal.abort()
        return MoveCrosshead.Result(
            error_code=code, error_message=message, position=self._sample.position, force=self._sample.force
        )


def main() -> int:
    """Run the load frame node."""
    return run(LoadFrameNode.started)


if __name__ == "__main__":
    raise SystemExit(main())
