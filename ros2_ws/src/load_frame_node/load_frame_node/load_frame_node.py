"""Moves and holds the crosshead, and publishes mode, force and position.

The machine's own limits and emergency stop are in charge; this node only passes requests on.
"""

from __future__ import annotations

import math
import threading
import time
from typing import Literal, Self

from geometry_msgs.msg import WrenchStamped
from pydantic import Field, model_validator
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from fringedic.clocks import DeviceClock
from fringedic.errors import ClockJumpError, CrossheadRangeError, FringedicError, MachineError, WaitTimeoutError
from fringedic.virtual_rig import LoadMode, SimulatedLoadFrame
from fringedic_msgs.action import MoveCrosshead
from fringedic_msgs.msg import ClockDrift, LoadState
from fringedic_ros.lifecycle import HardwareNode, HardwareParameters
from fringedic_ros.main import run
from fringedic_ros.qos import LATCHED, SAMPLES
from fringedic_ros.records import clock_message
from fringedic_ros.stamps import to_msg
from fringedic_ros.virtual import VirtualRigText, virtual_configuration
from fringedic_ros.waiting import Condition
from load_frame_node.machines import Machine, Sample, SimulatedMachine, load_machine, open_machine
from load_frame_node.machines.controller import ControllerMachine

FRAME_ID = "load_frame"
JOINT = "crosshead"
Result = MoveCrosshead.Result
_FEEDBACK_PERIOD_S = 0.1
_CLOCK_PERIOD_S = 1.0  # between two reports of the machine's clock
_START_TIMEOUT_S = 5.0  # from the request to the first motion
_STOP_TIMEOUT_S = 30.0


class LoadFrameParameters(HardwareParameters):
    """Parameters of the load frame node."""

    source: Literal["simulated", "machine", "controller"] = Field(
        "simulated",
        description="simulated: the machine of the virtual rig; machine: the one that machine_file describes; "
        "controller: what a ros2_control controller publishes.",
    )
    rate_hz: float = Field(100.0, gt=0, le=1000, description="Samples of force and position per second [Hz].")
    virtual_rig: VirtualRigText = "{preset: plate}"
    machine_file: str = Field("", description="Source `machine`: YAML file with its protocol, registers and units.")
    position_tolerance_mm: float = Field(
        0.01, gt=0, le=10, description="A crosshead this near to its target has arrived, though it never moved [mm]."
    )
    joint_states_topic: str = Field("/joint_states", description="Source `controller`: JointState of the crosshead.")
    joint: str = Field(JOINT, description="Source `controller`: name of the crosshead's joint.")
    wrench_topic: str = Field("/wrench", description="Source `controller`: WrenchStamped of the load cell.")
    force_axis: Literal["x", "y", "z"] = Field("z", description="Source `controller`: axis of the force.")
    force_sign: int = Field(1, ge=-1, le=1, description="Source `controller`: -1 when tension comes negative.")

    @model_validator(mode="after")
    def _machine_is_described(self) -> Self:
        if self.source == "machine" and not self.machine_file:
            raise ValueError("source machine needs the parameter machine_file: a YAML file that describes it")
        if self.force_sign == 0:
            raise ValueError("force_sign is 0; use 1 or -1")
        return self


class LoadFrameNode(HardwareNode[LoadFrameParameters]):
    """Action `move_crosshead`, service `load_frame/hold`, and the machine's samples."""

    def __init__(self) -> None:
        super().__init__("load_frame", LoadFrameParameters)
        self._machine: Machine | None = None
        self._in_use = threading.Lock()  # of the machine: by the sampling thread, a move, a hold
        self._sampling: threading.Thread | None = None
        self._stop_sampling = threading.Event()
        self._sample = Sample(0, LoadMode.UNKNOWN, 0.0, 0.0)
        self._goal: ServerGoalHandle | None = None
        self._held = False
        self._changed = Condition(self)
        self._machine_clock = DeviceClock("testing machine")
        self._device_ns = 0  # of the latest sample, on the machine's clock
        self._told_of_clock = 0.0
        self._clocks = self.create_publisher(ClockDrift, "load_frame/clock", LATCHED)
        self._states = self.create_publisher(LoadState, "load_frame/state", SAMPLES)
        self._wrenches = self.create_publisher(WrenchStamped, "load_frame/wrench", SAMPLES)
        self._joints = self.create_publisher(JointState, "load_frame/joint_states", SAMPLES)
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
        """Connect to the machine that the parameters name."""
        parameters = self.parameters.value
        if parameters.source == "machine":
            self._machine = open_machine(load_machine(parameters.machine_file))
        elif parameters.source == "controller":
            self._machine = ControllerMachine(
                self,
                joint_states_topic=parameters.joint_states_topic,
                joint=parameters.joint,
                wrench_topic=parameters.wrench_topic,
                force_axis=parameters.force_axis,
                force_sign=parameters.force_sign,
            )
        else:
            configuration = virtual_configuration(parameters.virtual_rig)
            self._machine = SimulatedMachine(SimulatedLoadFrame(configuration.load_frame, configuration.seed))

    def activate(self) -> None:
        """Begin to sample."""
        self._machine_clock, self._device_ns = DeviceClock("testing machine"), 0
        self._stop_sampling.clear()
        self._sampling = threading.Thread(target=self._sample_all, name="load_frame-sampling", daemon=True)
        self._sampling.start()

    def deactivate(self) -> None:
        """Hold, and stop sampling."""
        self._stop_sampling.set()
        if self._sampling is not None:
            self._sampling.join()
            self._sampling = None
        if self._machine is not None and self.parameters.value.source != "controller":
            try:
                with self._in_use:
                    self._machine.hold()
            except MachineError as error:
                self.get_logger().warning(str(error))

    def close(self) -> None:
        """Let go of the machine."""
        if self._machine is not None:
            self._machine.close()
            self._machine = None

    # samples

    def _sample_all(self) -> None:
        """Take samples at their times until the node is deactivated; in a thread of its own."""
        period = 1 / self.parameters.value.rate_hz
        due = time.monotonic()
        while not self._stop_sampling.is_set():
            self._take_sample()
            due += period
            now = time.monotonic()
            if due < now - 1:  # the machine did not answer for a while: what was missed stays missed
                self.diagnostics.drop(int((now - due) / period))
                due = now
            self._stop_sampling.wait(max(due - now, 0))

    def _take_sample(self) -> None:
        assert self._machine is not None, "an active load frame has a machine"
        try:
            with self._in_use:
                sample = self._machine.sample()
        except MachineError as error:
            self.get_logger().error(str(error), throttle_duration_sec=1.0)
            self.diagnostics.failure(str(error))
            # whoever relies on a hold has to know that nothing is known
            sample = Sample(time.time_ns(), LoadMode.UNKNOWN, math.nan, math.nan)
        else:
            self.diagnostics.success()
        self._sample = sample
        state = LoadState(mode=int(sample.mode), force=sample.force, position=sample.position)
        state.header.stamp, state.header.frame_id = to_msg(sample.stamp_ns), FRAME_ID
        wrench = WrenchStamped(header=state.header)
        wrench.wrench.force.z = state.force
        joint = JointState(header=state.header, name=[JOINT], position=[state.position], effort=[state.force])
        self._states.publish(state)
        self._wrenches.publish(wrench)
        self._joints.publish(joint)
        self._compare_clocks(sample)
        self._changed.notify()

    def _compare_clocks(self, sample: Sample) -> None:
        """Publish how a machine's clock runs against this computer's, once a second."""
        if sample.device_ns is None or sample.device_ns == self._device_ns:
            return
        self._device_ns = sample.device_ns
        try:
            self._machine_clock.arrival(sample.device_ns, sample.stamp_ns)
        except ClockJumpError as error:
            self.get_logger().error(str(error))
            self.diagnostics.failure(str(error))
        known, now = self._machine_clock.estimate, time.monotonic()
        if known is None or now - self._told_of_clock < _CLOCK_PERIOD_S:
            return
        self._told_of_clock = now
        self._clocks.publish(clock_message("load_frame", known))

    # moving and holding

    def _hold(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._machine is None or not self.active:
            response.message = "the load frame is not active; configure and activate it"
            return response
        try:
            with self._in_use:
                self._machine.hold()
        except MachineError as error:
            self.get_logger().error(str(error))
            self.diagnostics.failure(str(error))
            response.message = str(error)
            return response
        self._held = True
        response.success = True
        response.message = f"hold requested at {1e3 * self._sample.position:.4f} mm"
        return response

    def _cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        return CancelResponse.ACCEPT if goal is self._goal else CancelResponse.REJECT

    async def _move(self, goal: ServerGoalHandle) -> MoveCrosshead.Result:
        request = goal.request
        if self._machine is None or not self.active:
            return self._end(goal, Result.MACHINE_FAULT, "the load frame is not active; configure and activate it")
        if self._goal is not None:
            return self._end(goal, Result.BUSY, _busy_words(self._goal.request, request))
        way = abs(request.position - self._sample.position)
        try:
            with self._in_use:
                self._machine.move_to(request.position, request.speed)
                requested = time.time_ns()
        except CrossheadRangeError as error:
            return self._end(goal, Result.INVALID_GOAL, str(error))
        except MachineError as error:
            return self._end(goal, Result.MACHINE_FAULT, str(error))
        self._goal, self._held = goal, False
        try:
            # twice the time at constant speed, and some for the ramps
            return await self._follow(goal, requested, 2 * way / request.speed + _STOP_TIMEOUT_S)
        except FringedicError as error:
            return self._end(goal, Result.MACHINE_FAULT, str(error))
        finally:
            self._goal = None

    async def _follow(self, goal: ServerGoalHandle, requested_ns: int, timeout_s: float) -> MoveCrosshead.Result:
        started = time.monotonic()
        moved = False
        tolerance = 1e-3 * self.parameters.value.position_tolerance_mm

        def is_over() -> bool:
            nonlocal moved
            if goal.is_cancel_requested or not self.active or self._held:
                return True
            sample = self._sample
            if sample.stamp_ns < requested_ns:  # of before the request
                return False
            moved |= sample.mode is LoadMode.MOVING
            if sample.mode in (LoadMode.FAULT, LoadMode.UNKNOWN):
                return True
            arrived = abs(sample.position - goal.request.position) <= tolerance
            return sample.mode is not LoadMode.MOVING and (moved or arrived)

        while not is_over():
            passed = time.monotonic() - started
            if passed > timeout_s or (not moved and passed > _START_TIMEOUT_S):
                await self._stop()
                done = f"arrive within {timeout_s:g} s" if moved else f"begin to move within {_START_TIMEOUT_S:g} s"
                return self._end(goal, Result.TIMEOUT, f"the crosshead did not {done}")
            goal.publish_feedback(MoveCrosshead.Feedback(position=self._sample.position, force=self._sample.force))
            try:
                await self._changed.wait(is_over, _FEEDBACK_PERIOD_S)
            except WaitTimeoutError:
                continue
        return await self._outcome(goal)

    async def _outcome(self, goal: ServerGoalHandle) -> MoveCrosshead.Result:
        if goal.is_cancel_requested:
            await self._stop()
            return self._end(goal, Result.CANCELLED, f"cancelled; holding at {1e3 * self._sample.position:.4f} mm")
        if self._held:
            await self._wait_until_still()
            return self._end(
                goal, Result.CANCELLED, f"load_frame/hold stopped it at {1e3 * self._sample.position:.4f} mm"
            )
        if not self.active or self._sample.mode in (LoadMode.FAULT, LoadMode.UNKNOWN):
            return self._end(goal, Result.MACHINE_FAULT, "the machine stopped, or no longer tells what it does")
        return self._end(goal, Result.NONE, "")

    def _is_still(self) -> bool:
        return self._sample.mode is not LoadMode.MOVING or not self.active

    async def _stop(self) -> None:
        """Request a hold and wait until the machine stands."""
        if self._machine is not None:
            with self._in_use:
                self._machine.hold()
            await self._wait_until_still()

    async def _wait_until_still(self) -> None:
        requested = time.time_ns()
        await self._changed.wait(
            lambda: (self._sample.stamp_ns > requested and self._is_still()) or not self.active,
            _STOP_TIMEOUT_S,
            "the crosshead's stop",
        )

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


def _busy_words(followed: MoveCrosshead.Goal, asked: MoveCrosshead.Goal) -> str:
    of = f"of {followed.controller} " if followed.controller else ""
    who = f"{asked.controller} has to" if asked.controller else "you have to"
    return f"the crosshead follows another goal, {of}to {1e3 * followed.position:g} mm; {who} wait until it is there"


def main() -> int:
    """Run the load frame node."""
    return run(LoadFrameNode.started)


if __name__ == "__main__":
    raise SystemExit(main())
