"""One action goal at a time uses the rig: the active goal, how it waits, and how it fails."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rclpy.action.server import CancelResponse, ServerGoalHandle
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

from fringedic.errors import WaitTimeoutError
from fringedic_msgs.action import MeasureStep
from fringedic_ros.middleware import servers_of
from fringedic_ros.waiting import Condition, until

LOOK_S = 0.5  # between two looks for the server of a request
Failure = tuple[int, str]  # error code of the action, and message


class StepFailure(Exception):
    """Ends the active goal with one of the error codes of its action."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class ActiveGoal:
    """The action goal that uses the rig until it ends; each of its waits ends when the client cancels it.

    Parameters
    ----------
    node, changed
        The node, and its condition that every callback notifies.
    goal
        The goal.
    activity
        What the goal does, for messages to other clients: "step 3 is being measured".
    """

    def __init__(self, node: Node, changed: Condition, goal: ServerGoalHandle, activity: str) -> None:
        self.goal = goal
        self.activity = activity
        self._node = node
        self._changed = changed
        self._cancelled = False

    @property
    def cancelled(self) -> bool:
        """Whether the client cancelled the goal."""
        return self._cancelled

    def cancel(self) -> None:
        """End every wait of this goal."""
        self._cancelled = True
        self._changed.notify()

    def check(self) -> None:
        """End the goal when the client cancelled it.

        Raises
        ------
        StepFailure
            CANCELLED.
        """
        if self._cancelled:
            raise StepFailure(MeasureStep.Result.CANCELLED, "cancelled by the client")

    async def pause(self, seconds: float) -> None:
        """Wait for a time, unless the client cancels."""
        if seconds > 0:
            with suppress(WaitTimeoutError):
                await self._changed.wait(lambda: self._cancelled, seconds)
        self.check()

    async def wait(self, predicate: Callable[[], bool], timeout_s: float, failure: Callable[[], Failure]) -> None:
        """Wait until a callback makes the predicate true; after the time-out the goal ends with `failure`."""
        with suppress(WaitTimeoutError):
            await self._changed.wait(lambda: self._cancelled or predicate(), timeout_s)
        self._conclude(predicate, failure)

    async def wait_polling(
        self, predicate: Callable[[], bool], timeout_s: float, failure: Callable[[], Failure]
    ) -> None:
        """Wait like `wait` for a property of the graph, whose changes cause no callback."""
        with suppress(WaitTimeoutError):
            await until(self._node, lambda: self._cancelled or predicate(), timeout_s)
        self._conclude(predicate, failure)

    async def call(
        self, client: Client, request: Any, timeout_s: float, code: int, what: str, *, again_s: float = math.inf
    ) -> Any:
        """Return the response of a service; without service or response in time the goal ends with `code`.

        A server that has just started may not have discovered the reader of its responses yet. A request without effect
        or with the same effect every time is therefore sent again after `again_s` without response. Any other one fails
        when its server ends: the successor, which this node may discover later, has not received it.
        """
        name = client.srv_name
        if not client.service_is_ready():
            await self.wait_polling(
                client.service_is_ready, timeout_s, lambda: (code, f"{what}: there is no service {name}")
            )
        response, how, left = Future(), "", timeout_s
        # without the clock, which runs on while this process stands still
        while not response.done() and not self._cancelled and left > 0:
            response, ended = await self._ask(client, request, min(left, again_s))
            how = ": its node has ended, or stands still" if ended else f" in {timeout_s:g} s"
            left -= again_s
        self._conclude(response.done, lambda: (code, f"{what}: {name} did not answer{how}"))
        return response.result()

    async def _ask(self, client: Client, request: Any, timeout_s: float) -> tuple[Future, bool]:
        """Send a request; return its response, which may not be done, and whether a server of it has ended."""
        servers, ended, left = servers_of(self._node, client.srv_name), False, timeout_s
        response = client.call_async(request)
        response.add_done_callback(lambda _: self._changed.notify())
        try:
            while not response.done() and not self._cancelled and not ended and left > 0:
                with suppress(WaitTimeoutError):
                    await self._changed.wait(lambda: self._cancelled or response.done(), min(left, LOOK_S))
                left -= LOOK_S
                ended = not response.done() and not servers <= servers_of(self._node, client.srv_name)
        finally:
            client.remove_pending_request(response)
        return response, ended

    def _conclude(self, predicate: Callable[[], bool], failure: Callable[[], Failure]) -> None:
        self.check()
        if not predicate():
            raise StepFailure(*failure())


class GoalSlot:
    """The place of the one active goal; goals of every action of the node compete for it.

    Parameters
    ----------
    node
        Owner of the actions.

    Attributes
    ----------
    changed
        Notified by every callback of the node; the active goal waits for it.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.changed = Condition(node)
        self._active: ActiveGoal | None = None

    @property
    def activity(self) -> str:
        """What the active goal does; empty when the rig is free."""
        return self._active.activity if self._active is not None else ""

    def begin(self, goal: ServerGoalHandle, activity: str) -> ActiveGoal:
        """Make a goal the active one; the slot must be free."""
        self._active = ActiveGoal(self._node, self.changed, goal, activity)
        return self._active

    def end(self) -> None:
        """Free the slot."""
        self._active = None

    def cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        """Answer a request to cancel a goal: only the active goal can be cancelled."""
        if self._active is None or goal.goal_id != self._active.goal.goal_id:
            return CancelResponse.REJECT
        self._active.cancel()
        return CancelResponse.ACCEPT
