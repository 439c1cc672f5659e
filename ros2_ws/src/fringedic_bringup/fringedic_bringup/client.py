"""Drives a rig from a script: move, hold, measure, next.

from fringedic_bringup.client import RigClient

with RigClient("rig") as rig:
    for position in (0.0, 0.1e-3, 0.2e-3):
        rig.move(position, speed=1e-3)
        result = rig.measure()
        print(result.force_mean, result.rms_displacement)
"""

from __future__ import annotations

import os
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

import rclpy
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from fringedic.errors import NotAnsweredError, StepFailedError
from fringedic_msgs.action import MeasureStep, MoveCrosshead

ANSWER_TIMEOUT_S = 30.0


class RigClient:
    """The actions of a running rig as plain calls that return when they are done.

    The machine is in charge of its limits and its emergency stop; this client, like the whole system, only requests.

    Parameters
    ----------
    namespace
        Namespace of the rig.
    domain
        ROS_DOMAIN_ID of the rig; None takes the one of the environment.
    watch
        Called several times a second while waiting; what it raises ends the waiting.
    """

    def __init__(
        self, namespace: str = "rig", *, domain: int | None = None, watch: Callable[[], None] | None = None
    ) -> None:
        self._watch = watch
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = Node("client", namespace=namespace, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._measure = ActionClient(self.node, MeasureStep, "measure_step")
        self._move = ActionClient(self.node, MoveCrosshead, "move_crosshead")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave the rig; it goes on without this client."""
        self._executor.shutdown()
        self._measure.destroy()
        self._move.destroy()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def move(self, position: float, *, speed: float = 1e-3) -> MoveCrosshead.Result:
        """Ask the load frame to move to a position [m] at a speed [m/s] and hold there.

        Raises
        ------
        StepFailedError
            The load frame did not get there.
        NotAnsweredError
            There is no load frame.
        """
        goal = MoveCrosshead.Goal(position=float(position), speed=float(speed))
        return self._ask(self._move, goal, f"moving to {position * 1e3:g} mm", None)

    def measure(
        self,
        *,
        white: bool = False,
        set_reference: bool = False,
        feedback: Callable[[MeasureStep.Feedback], None] | None = None,
    ) -> MeasureStep.Result:
        """Measure one load step.

        Parameters
        ----------
        white
            One frame and the in-plane displacement only.
        set_reference
            Make this step the reference of the following ones.
        feedback
            Called with the stage and the number of frames taken.

        Raises
        ------
        StepFailedError
            The step failed; the message says why.
        NotAnsweredError
            There is no experiment node.
        """
        mode = MeasureStep.Goal.WHITE if white else MeasureStep.Goal.FRINGES
        goal = MeasureStep.Goal(mode=mode, set_reference=set_reference)
        return self._ask(self._measure, goal, "measuring", feedback)

    def wait(self, done: Callable[[], bool], timeout_s: float, what: str) -> None:
        """Serve this client's subscriptions until something is true.

        Raises
        ------
        NotAnsweredError
            It was not within ``timeout_s``.
        """
        end = self.node.get_clock().now().nanoseconds + int(timeout_s * 1e9)
        while not done():
            if self.node.get_clock().now().nanoseconds > end:
                raise NotAnsweredError(f"{what} did not come within {timeout_s:g} s")
            self._spin()

    def _ask(self, client: ActionClient, goal: Any, what: str, feedback: Callable[[Any], None] | None) -> Any:
        self.wait(client.server_is_ready, ANSWER_TIMEOUT_S, f"{what}: a server of the action")
        callback = None if feedback is None else lambda message: feedback(message.feedback)
        handle = self._result(client.send_goal_async(goal, feedback_callback=callback))
        if not handle.accepted:
            raise StepFailedError(f"{what}: the request was rejected")
        result = self._result(handle.get_result_async()).result
        if result.error_code:
            raise StepFailedError(f"{what}: {result.error_message} (code {result.error_code})")
        return result

    def _result(self, future: Future) -> Any:
        while not future.done():
            self._spin()
        return future.result()

    def _spin(self) -> None:
        self._executor.spin_once(timeout_sec=0.05)
        if self._watch is not None:
            self._watch()
