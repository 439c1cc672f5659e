"""Action goals over a network that loses messages: a goal runs at most once, and only its own result counts.

A request that is sent before both processes have discovered each other is lost without an error; so is the response to
it. The same goal can be sent again, because a server refuses an identifier that it has (decision 0032).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any
from uuid import uuid4

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

from fringedic.errors import StepFailedError
from fringedic_ros.waiting import AGAIN_S


class RepeatedGoal:
    """One goal, sent again with the same identifier until there is a response, and likewise the request of its result.

    Parameters
    ----------
    client
        Of the action.
    goal
        The goal.
    feedback
        Called with each feedback.

    Attributes
    ----------
    last_sign_s
        When the latest feedback arrived, on the monotonic clock [s]; before the first, when this object was made.
    """

    def __init__(self, client: ActionClient, goal: Any, feedback: Callable[[Any], None]) -> None:
        identifier = UUID(uuid=list(uuid4().bytes))

        def take_feedback(message: Any) -> None:
            self.last_sign_s = time.monotonic()
            self._asking.postpone()  # the goal runs
            feedback(message.feedback)

        def send() -> Future:
            return client.send_goal_async(goal, take_feedback, identifier)

        self.client = client
        self.last_sign_s = time.monotonic()
        self._action = type(goal).__name__.removesuffix("_Goal")
        self._sending = _Repeated(client, send)
        self._asking = _Repeated(client, lambda: self.handle.get_result_async())

    @property
    def is_answered(self) -> bool:
        """Whether the server has responded to the goal."""
        return bool(self._sending.responses)

    @property
    def is_accepted(self) -> bool:
        """Whether the server has the goal: it accepted the goal, or refused it because the identifier is known."""
        sent, responses = self._sending.sent, self._sending.responses
        return self.is_answered and (any(each.accepted for each in responses) or not sent[0].done())

    @property
    def handle(self) -> ClientGoalHandle:
        """Handle of the goal, once it is answered."""
        return self._sending.responses[0]

    @property
    def result(self) -> Any | None:
        """The result, once it is there: see `result_of`."""
        return result_of(self._asking.responses[0], self._action)

    def send(self) -> bool:
        """Send the goal when it is due, and return whether it is answered. Call it while the node is spun."""
        return self._sending.update()

    def request_result(self) -> bool:
        """Request the result when it is due, and return whether it is there. Call it while the node is spun."""
        return self._asking.update()


def result_of(response: Any, action: str) -> Any | None:
    """Return the result in a response of an action server; None when the server does not know the goal.

    Parameters
    ----------
    response
        Response to the request of a result. A server that was started again does not know earlier goals.
    action
        Name of the action for the message.

    Raises
    ------
    StepFailedError
        The server ended the goal without a result, as after an exception in its callback.
    """
    if response.status == GoalStatus.STATUS_UNKNOWN:
        return None
    if response.status != GoalStatus.STATUS_SUCCEEDED and not response.result.error_code:
        # an empty message, whose error code is that of a success
        raise StepFailedError(f"{action}: its server failed; the log of the server contains the reason")
    return response.result


class _Repeated:
    """A request to an action server that is sent again and again until there is a response."""

    def __init__(self, client: ActionClient, send: Callable[[], Future]) -> None:
        self.sent: list[Future] = []
        self._client, self._send = client, send
        self._next_s = 0.0

    @property
    def responses(self) -> list[Any]:
        """Responses so far, in the order of their requests."""
        return [future.result() for future in self.sent if future.done()]

    def postpone(self) -> None:
        """Send the request later again; the first one is not postponed."""
        if self.sent:
            self._next_s = time.monotonic() + AGAIN_S

    def update(self) -> bool:
        """Send the request when it is due; return whether there is a response."""
        if not self.responses and time.monotonic() >= self._next_s and self._client.server_is_ready():
            self.sent.append(self._send())
            self._next_s = time.monotonic() + AGAIN_S
        return bool(self.responses)
