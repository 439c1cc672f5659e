"""The rig belongs to one action goal at a time: whose turn it is, and how that goal waits."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rclpy.action.server import ServerGoalHandle
from rclpy.client import Client
from rclpy.node import Node

from fringedic.errors import WaitTimeoutError
from fringedic_msgs.action import MeasureStep
from fringedic_ros.waiting import Condition, until


class StepFailure(Exception):
    """Ends what runs with one of the error codes of its action."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class Turn:
    """One action goal that has the rig for itself until it ends; every wait of it ends when the caller cancels.

    Parameters
    ----------
    node, changed
        The node, and its condition that every callback notifies.
    goal
        The goal.
    doing
        For others who ask: "step 3 is being measured".
    """

    def __init__(self, node: Node, changed: Condition, goal: ServerGoalHandle, doing: str) -> None:
        self.goal = goal
        self.doing = doing
        self._node = node
        self._changed = changed
        self._cancelled = False

    @property
    def cancelled(self) -> bool:
        """Whether the caller cancelled."""
        return self._cancelled

    def cancel(self) -> None:
        """End every wait of this turn."""
        self._cancelled = True
        self._changed.notify()

    def check(self) -> None:
        """End the turn when the caller cancelled.

        Raises
        ------
        StepFailure
            CANCELLED.
        """
        if self._cancelled:
            raise StepFailure(MeasureStep.Result.CANCELLED, "cancelled by the caller")

    async def pause(self, seconds: float) -> None:
        """Let time pass, unless the caller cancels."""
        if seconds > 0:
            with suppress(WaitTimeoutError):
                await self._changed.wait(lambda: self._cancelled, seconds)
        self.check()

    async def wait(
        self, predicate: Callable[[], bool], timeout_s: float, failure: Callable[[], tuple[int, str]]
    ) -> None:
        """Wait for something that a callback changes; after the time-out the turn ends as `failure` says."""
        with suppress(WaitTimeoutError):
            await self._changed.wait(lambda: self._cancelled or predicate(), timeout_s)
        self._conclude(predicate, failure)

    async def wait_polling(
        self, predicate: Callable[[], bool], timeout_s: float, failure: Callable[[], tuple[int, str]]
    ) -> None:
        """Like `wait`, for the graph, which tells nobody that it changed."""
        with suppress(WaitTimeoutError):
            await until(self._node, lambda: self._cancelled or predicate(), timeout_s)
        self._conclude(predicate, failure)

    async def call(self, client: Client, request: Any, timeout_s: float, code: int, what: str) -> Any:
        """Answer of a service; the turn ends with `code` when there is no such service or no answer in time."""
        name = client.srv_name
        if not client.service_is_ready():
            await self.wait_polling(
                client.service_is_ready, timeout_s, lambda: (code, f"{what}: there is no service {name}")
            )
        future = client.call_async(request)
        future.add_done_callback(lambda _: self._changed.notify())
        try:
            await self.wait(future.done, timeout_s, lambda: (code, f"{what}: {name} did not answer in {timeout_s:g} s"))
        finally:
            client.remove_pending_request(future)
        return future.result()

    def _conclude(self, predicate: Callable[[], bool], failure: Callable[[], tuple[int, str]]) -> None:
        self.check()
        if not predicate():
            raise StepFailure(*failure())
