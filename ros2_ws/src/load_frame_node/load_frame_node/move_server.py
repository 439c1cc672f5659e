"""Action `move_crosshead`: one move at a time, followed by the samples of the machine."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from rclpy.action.server import ActionServer, CancelResponse, ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup

from fringedic.errors import CrossheadRangeError, FringedicError, MachineError, MachineNotReadyError, WaitTimeoutError
from fringedic.settings.load_frame import LoadFrameNodeSettings
from fringedic_msgs.action import MoveCrosshead
from fringedic_ros.lifecycle import HardwareNode
from fringedic_ros.middleware import OtherUsers
from load_frame_node.crosshead import FAULT, REPEAT_S, Crosshead, reason_not_to_move
from load_frame_node.machines import LoadMode, Sample

Result = MoveCrosshead.Result
_FEEDBACK_PERIOD_S = 0.1
_STATE_TIMEOUT_S = 10.0  # of a machine that was lost: longer than the longest pause before it is connected again
_START_TIMEOUT_S = 5.0  # from the request to the first motion
_RAMPS_S = 30.0  # allowance for the speed ramps of a move
_STOPPING_S = 15.0  # from a hold to standstill; more than the longest span from which a motion is derived
_ENDS_OF_MOTION = (LoadMode.IDLE, LoadMode.HOLD, LoadMode.FAULT)
_RETRY_S = 10.0  # within which a client that was refused because of another move tries again
_LOST_MODES = (LoadMode.FAULT, LoadMode.UNKNOWN)  # the machine does not follow the move any more


class MoveServer:
    """Passes the goals of `move_crosshead` to the machine, one at a time, and reports how each ends.

    Parameters
    ----------
    node
        Owner of the action server.
    crosshead
        The machine and its samples.
    """

    def __init__(self, node: HardwareNode[LoadFrameNodeSettings], crosshead: Crosshead) -> None:
        self._node = node
        self._crosshead = crosshead
        self._goal: ServerGoalHandle | None = None
        self._others = OtherUsers(node)
        self._waiting: set[str] = set()  # controllers that were refused during the present move
        self._stopped: dict[str, tuple[float, str]] = {}  # those that waited for a move that was stopped: when, and how
        ActionServer(
            node,
            MoveCrosshead,
            "move_crosshead",
            self._move,
            cancel_callback=self._cancel,
            callback_group=ReentrantCallbackGroup(),
        )

    def _cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        return CancelResponse.ACCEPT if goal is self._goal else CancelResponse.REJECT

    async def _move(self, goal: ServerGoalHandle) -> MoveCrosshead.Result:
        request, crosshead = goal.request, self._crosshead
        if not self._node.active:
            return self._end(goal, Result.MACHINE_FAULT, "the load frame is not active; configure and activate it")
        if reason := self._others.reason_to_refuse:
            return self._end(goal, Result.MACHINE_FAULT, f"no move was sent: {reason}")
        if self._goal is not None:
            self._waiting.add(request.controller)
            return self._end(goal, Result.BUSY, _busy_message(self._goal.request, request))
        stopped_s, stop = self._stopped.pop(request.controller, (-math.inf, ""))
        if time.monotonic() - stopped_s < _RETRY_S:
            return self._end(
                goal, Result.STOPPED_ELSEWHERE, f"no move was sent, because the move before was stopped: {stop}"
            )
        self._goal, crosshead.hold_requested = goal, False
        result = MoveCrosshead.Result()
        try:
            result = await self._carry_out(goal)
            return result
        finally:
            self._goal = None
            crosshead.end_move()
            self._tell_waiting(goal, result)

    async def _carry_out(self, goal: ServerGoalHandle) -> MoveCrosshead.Result:
        """Move, and return the result."""
        request, crosshead = goal.request, self._crosshead
        ends_s, is_sent = time.monotonic() + _STATE_TIMEOUT_S, False
        try:
            while not is_sent:
                await self._wait_for_a_state(goal)
                if self._is_called_off(goal):
                    return self._end(goal, Result.CANCELLED, "cancelled before the move began")
                begin = crosshead.sample.position
                try:
                    crosshead.move_to(request.position, request.speed, _limits_of(request))
                    is_sent = True
                except MachineNotReadyError:
                    if crosshead.sample.mode is LoadMode.FAULT or time.monotonic() > ends_s:
                        raise  # otherwise it is waited for: a single answer may be unreadable
            return await self._follow(goal, begin)
        except CrossheadRangeError as error:
            return self._end(goal, Result.INVALID_GOAL, str(error))
        except FringedicError as error:
            return self._end(goal, Result.MACHINE_FAULT, str(error))

    def _tell_waiting(self, goal: ServerGoalHandle, result: MoveCrosshead.Result) -> None:
        """Keep for the controllers that wait for the end of a move that something else than its client stopped it.

        They would move the machine a second later, while a person wants it to stand still.
        """
        waiting, self._waiting = self._waiting, set()
        is_stopped = result.error_code in (Result.MACHINE_FAULT, Result.STOPPED_ELSEWHERE)
        if is_stopped or (result.error_code == Result.CANCELLED and not goal.is_cancel_requested):
            self._stopped = dict.fromkeys(waiting, (time.monotonic(), result.error_message))

    def _is_called_off(self, goal: ServerGoalHandle) -> bool:
        return goal.is_cancel_requested or self._crosshead.hold_requested or not self._node.active

    async def _wait_for_a_state(self, goal: ServerGoalHandle) -> None:
        """Wait until the machine reports that it works and where it is, or the goal is called off.

        Raises
        ------
        MachineError
            It reports a fault, or nothing.
        """
        crosshead = self._crosshead

        def is_over() -> bool:
            is_known = not reason_not_to_move(crosshead.sample) or crosshead.sample.mode is LoadMode.FAULT
            return is_known or self._is_called_off(goal)

        try:
            await crosshead.changed.wait(is_over, _STATE_TIMEOUT_S)
        except WaitTimeoutError:
            unknown = "position" if crosshead.sample.mode is not LoadMode.UNKNOWN else "state"
            message = f"the machine has reported no {unknown} for {_STATE_TIMEOUT_S:g} s and is not moved"
            try:
                reason = reason_not_to_move(crosshead.read())
            except MachineError as error:
                reason = str(error)
            raise MachineError(f"{message}: {reason}" if reason else message) from None

    async def _follow(self, goal: ServerGoalHandle, begin: float) -> MoveCrosshead.Result:
        """Publish feedback until the move from a position, just requested, has ended, and return its result."""
        crosshead, requested, moved = self._crosshead, time.monotonic(), False

        def is_over() -> bool:
            nonlocal moved
            if self._is_called_off(goal) or crosshead.reached:
                return True
            sample = crosshead.sample
            if sample.begun_s < requested:
                return False
            moved |= sample.mode is LoadMode.MOVING
            return sample.mode in _LOST_MODES or (
                sample.mode is not LoadMode.MOVING and (moved or self._has_arrived(goal))
            )

        while not is_over():
            if math.isnan(begin):
                begin = crosshead.sample.position  # it could not be read before
            distance = 0.0 if math.isnan(begin) else abs(goal.request.position - begin)
            timeout_s = 2 * distance / goal.request.speed + _RAMPS_S  # twice the time at constant speed
            passed = time.monotonic() - requested
            if passed > timeout_s or (not moved and passed > _START_TIMEOUT_S):
                await self._stop(goal)
                done = f"arrive within {timeout_s:g} s" if moved else f"begin to move within {_START_TIMEOUT_S:g} s"
                return self._end(goal, Result.TIMEOUT, f"the crosshead did not {done}; a hold was requested")
            sample = crosshead.sample
            goal.publish_feedback(MoveCrosshead.Feedback(position=sample.position, force=sample.force))
            try:
                await crosshead.changed.wait(is_over, _FEEDBACK_PERIOD_S)
            except WaitTimeoutError:
                continue
        return await self._outcome(goal)

    async def _outcome(self, goal: ServerGoalHandle) -> MoveCrosshead.Result:
        crosshead = self._crosshead
        if goal.is_cancel_requested:
            await self._stop(goal)
            how = "arrived" if self._has_arrived(goal) else "holding"
            return self._end(goal, Result.CANCELLED, f"cancelled; {how} at {1e3 * crosshead.sample.position:.4f} mm")
        if crosshead.hold_requested:
            await self._wait_until_still(goal)
            how = "was requested when the crosshead arrived" if self._has_arrived(goal) else "stopped the move"
            stopped = f"load_frame/hold {how} at {1e3 * crosshead.sample.position:.4f} mm"
            return self._end(goal, Result.CANCELLED, stopped)
        if crosshead.reached is not None and crosshead.reached.mode not in _LOST_MODES:
            await self._wait_until_still(goal)
            return self._end(goal, Result.NONE, "", crosshead.reached)
        if not self._node.active or crosshead.sample.mode in _LOST_MODES:
            # an unreadable answer does not stop a move
            if crosshead.sample.mode is LoadMode.FAULT:
                message = FAULT
            elif self._node.active:
                message = "the machine no longer reports its state; look at the machine, and check its connection"
            else:
                message = "the load frame was deactivated during the move"
            return self._end(goal, Result.MACHINE_FAULT, self._holding(message))
        if not self._has_arrived(goal):
            # the mode may be wrong that a machine reports, or that is determined from its positions
            return self._end(goal, Result.STOPPED_ELSEWHERE, self._holding(self._short_of_target(goal)))
        return self._end(goal, Result.NONE, "")

    def _holding(self, message: str) -> str:
        """Request a hold; return the message with whether the machine accepted it."""
        try:
            self._crosshead.hold()
        except MachineError as error:
            return f"{message}; a hold was not accepted and is requested again with every sample: {error}"
        return f"{message}; a hold was requested"

    def _has_arrived(self, goal: ServerGoalHandle) -> bool:
        tolerance_mm = self._node.parameters.value.device.position_tolerance_mm
        return 1e3 * abs(self._crosshead.sample.position - goal.request.position) <= tolerance_mm

    def _short_of_target(self, goal: ServerGoalHandle) -> str:
        sample = self._crosshead.sample
        target, position = 1e3 * goal.request.position, 1e3 * sample.position
        if math.isnan(position):
            return f"the crosshead stopped, and whether at its target of {target:.4f} mm is unknown: {sample.unknown}"
        return (
            f"the crosshead stopped at {position:.4f} mm, {abs(position - target):.4f} mm from its target: it was "
            "stopped at the machine or by a limit of the machine; if this is its usual accuracy, increase "
            "position_tolerance_mm"
        )

    async def _stop(self, goal: ServerGoalHandle) -> None:
        """Request a hold and wait until the crosshead stands still."""
        if self._crosshead.machine is not None:
            self._crosshead.hold()
            await self._wait_until_still(goal)

    async def _wait_until_still(self, goal: ServerGoalHandle) -> None:
        """Wait until a sample reports standstill after a hold was requested.

        Raises
        ------
        MachineError
            The machine reports a fault, does not stop in time, or has completed the move instead of the hold.
        """
        requested, crosshead = time.monotonic(), self._crosshead
        had_arrived = self._has_arrived(goal)

        def is_over() -> bool:
            sample = crosshead.sample
            return not self._node.active or (sample.begun_s >= requested and sample.mode in _ENDS_OF_MOTION)

        try:
            await crosshead.changed.wait(is_over, _STOPPING_S)
        except WaitTimeoutError:
            state = "still moves" if crosshead.sample.mode is LoadMode.MOVING else "reports no standstill"
            raise MachineError(
                f"the machine {state} {_STOPPING_S:g} s after a hold was requested; stop it at its own controls"
            ) from None
        if crosshead.sample.mode is LoadMode.FAULT:
            raise MachineError(FAULT)
        passed = time.monotonic() - requested
        if passed > REPEAT_S and self._has_arrived(goal) and not had_arrived:  # earlier, its ramp may have ended there
            raise MachineError(
                f"the machine did not follow a hold: it moved on for {passed:.1f} s, to the target of the move; check "
                "the hold in the machine file and at the machine before the next move"
            )

    def _end(
        self, goal: ServerGoalHandle, code: int, message: str, reached: Sample | None = None
    ) -> MoveCrosshead.Result:
        if code == Result.NONE:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            self._node.get_logger().error(message)
            self._node.diagnostics.failure(message)
            goal.abort()
        sample = self._crosshead.sample
        return MoveCrosshead.Result(
            error_code=code,
            error_message=message,
            position=sample.position,
            force=sample.force,
            force_reached=reached is not None,
            reached_force=math.nan if reached is None else reached.force,
        )


def _limits_of(request: MoveCrosshead.Goal) -> Callable[[Sample], bool]:
    """Return a function that returns whether a sample reaches a limit of the force; an unknown force does.

    Raises
    ------
    CrossheadRangeError
        A limit is not a finite number, so that no force or every force reaches it.
    """
    above, below = list(request.force_above), list(request.force_below)
    for limit in (*above, *below):
        if not math.isfinite(limit):
            raise CrossheadRangeError(f"a limit of the force is {limit:g} N; give a finite number, or no limit")

    def are_reached(sample: Sample) -> bool:
        if not above and not below:
            return False
        force = sample.force
        return math.isnan(force) or any(force >= limit for limit in above) or any(force <= limit for limit in below)

    return are_reached


def _busy_message(active: MoveCrosshead.Goal, refused: MoveCrosshead.Goal) -> str:
    of = f"of {active.controller} " if active.controller else ""
    who = f"{refused.controller} has to" if refused.controller else "you have to"
    return f"the crosshead follows another goal, {of}to {1e3 * active.position:g} mm; {who} wait until it has arrived"
