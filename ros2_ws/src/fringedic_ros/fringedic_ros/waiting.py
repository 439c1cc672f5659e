"""Waiting inside coroutines of a single-threaded executor: exact, without leaks, and without polling for events.

A coroutine occupies its callback group while it waits. Every callback that waits needs a group of its own
(`MutuallyExclusiveCallbackGroup` to serve one call after the other); the timers here have their own groups.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Hashable, Iterator
from typing import Any, Self

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.task import Future

from fringedic.errors import WaitTimeoutError
from fringedic_ros.middleware import servers_of

_STEADY = Clock(clock_type=ClockType.STEADY_TIME)
_POLL_S = 0.01
AGAIN_S = 2.0  # after which a request without response is sent again
LOST_S = 10.0  # without its server, after which a request fails; a node that is started again is back earlier
LONGEST_TURN_S = 0.5  # between two looks of a wait at its time limit: few, because a wait may last hours
TURNS = 4  # at least, in a time limit


class Patience:
    """Time limit that counts only the time in which this process could have taken an answer.

    When a process stands still (busy computer, Ctrl-Z, suspended laptop), the clock passes the limit while the answer
    waits unread in its queue, from which the executor takes one message per turn. Of the time between two looks
    therefore at most two turns count, and after the first stop near the end of the limit some turns are left.

    Parameters
    ----------
    limit_s
        Time limit [s].

    Attributes
    ----------
    turn_s
        Longest time [s] to the next look, `is_over`.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = max(limit_s, 0.0)
        self.turn_s = self._limit_s / max(TURNS, math.ceil(self._limit_s / LONGEST_TURN_S))
        self.renew()

    def renew(self) -> None:
        """Begin again, as after a sign of the other side."""
        self._left_s, self._reserve_s = self._limit_s, TURNS * self.turn_s
        self._looked_s = time.monotonic()

    def is_over(self) -> bool:
        """Return whether the limit has passed; look at least every `turn_s`."""
        now = time.monotonic()
        passed, self._looked_s = now - self._looked_s, now
        most = 2 * self.turn_s  # two: a timer that is a little late is counted in full
        if self._left_s > 0:
            self._left_s -= min(passed, most)
            if passed > most > self._left_s:
                self._left_s, self._reserve_s = max(self._left_s, self._reserve_s), 0.0
        return self._left_s <= 0


async def wait_for(node: Node, future: Future, timeout_s: float, what: str = "an answer") -> Any:
    """Return the result of a future, which any thread may complete.

    Raises
    ------
    WaitTimeoutError
        The future was not done within `timeout_s`; `what` names it in the message.
    """
    gate, patience = Future(), Patience(timeout_s)
    open_gate = _opener(node, gate)

    def look() -> None:
        if patience.is_over():
            open_gate()

    if not future.done():
        future.add_done_callback(open_gate)
        try:
            with _timer(node, patience.turn_s, look):
                await gate
        finally:
            future.remove_done_callback(open_gate)
    if not future.done():
        raise WaitTimeoutError(f"{what} did not come within {timeout_s:g} s")
    return future.result()


async def sleep(node: Node, seconds: float) -> None:
    """Wait for a time on the steady clock, while other callbacks run."""
    if seconds > 0:
        gate = Future()
        with _timer(node, seconds, _opener(node, gate)):
            await gate


async def until(node: Node, predicate: Callable[[], bool], timeout_s: float, what: str = "the condition") -> None:
    """Wait for a condition without event, such as a change of the graph, which is checked every 10 ms.

    Raises
    ------
    WaitTimeoutError
        The predicate was false for `timeout_s`.
    """
    gate, patience = Future(), Patience(timeout_s)

    def look() -> None:
        if not gate.done() and (predicate() or patience.is_over()):
            gate.set_result(None)

    look()
    with _timer(node, _POLL_S, look):
        await gate
    if not predicate():
        raise WaitTimeoutError(f"{what} did not come within {timeout_s:g} s")


async def call(node: Node, client: Client, request: Any, timeout_s: float) -> Any:
    """Return the response of a service; waits for the service and then for the response, `timeout_s` for each.

    Raises
    ------
    WaitTimeoutError
        There is no such service, or no response in time; the pending request is removed.
    """
    await until(node, client.service_is_ready, timeout_s, f"service {client.srv_name}")
    future = client.call_async(request)
    try:
        return await wait_for(node, future, timeout_s, f"the answer of service {client.srv_name}")
    except WaitTimeoutError:
        client.remove_pending_request(future)
        raise


class RepeatedRequest:
    """A request whose effect is the same every time, sent again and again until there is a response.

    A server that has just started, or a busy one, may not know the reader of its responses yet and loses a response.
    In a ``with`` block, at whose end no request stays pending.

    Parameters
    ----------
    client
        Of the service.
    request
        The request.
    """

    def __init__(self, client: Client, request: Any) -> None:
        self._client, self._request = client, request
        self._sent: list[Future] = []
        self._next_s = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        for future in self._sent:
            self._client.remove_pending_request(future)

    def is_answered(self) -> bool:
        """Return whether there is a response; send the request when it is due. Call it while the node is spun."""
        self._send_when_due()
        return any(future.done() for future in self._sent)

    def _send_when_due(self) -> None:
        if self._client.service_is_ready() and time.monotonic() >= self._next_s:
            self._sent.append(self._client.call_async(self._request))
            self._next_s = time.monotonic() + AGAIN_S

    @property
    def is_settled(self) -> bool:
        """Whether no request can arrive any more: a server takes them in order, and the last one has its response."""
        return not self._sent or self._sent[-1].done()

    @property
    def response(self) -> Any:
        """The response, once there is one."""
        return next(future.result() for future in self._sent if future.done())


class LongRequest(RepeatedRequest):
    """A request that a stage or a person needs long for: sent once, and again when a server of it has ended.

    Parameters
    ----------
    node
        Owner of the client.
    client, request
        As of `RepeatedRequest`.

    Attributes
    ----------
    loss
        Why there will be no response, in words; empty while there may be one.
    """

    def __init__(self, node: Node, client: Client, request: Any) -> None:
        super().__init__(client, request)
        self._node = node
        self._servers, self._absence = frozenset[Hashable](), Patience(LOST_S)
        self._most_sent = 1
        self.loss = ""

    def is_over(self) -> bool:
        """Return whether there is a response or will be none; as `is_answered`."""
        return self.is_answered() or bool(self.loss)

    def _send_when_due(self) -> None:
        servers = servers_of(self._node, self._client.srv_name)
        if self._servers - servers:
            # twice: a server that was started again may not know the reader of its responses yet
            self._most_sent, self._next_s = len(self._sent) + 2, 0.0
        self._servers = servers
        if servers:
            self._absence.renew()
        elif self._absence.is_over():
            name = self._client.srv_name
            self.loss = f"the service {name} is missing: start its node again, and repeat the measurement"
        if len(self._sent) < self._most_sent:
            super()._send_when_due()


class Condition:
    """State that callbacks change and coroutines wait for, like `asyncio.Condition` without its lock."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._changed = Future()

    def notify(self) -> None:
        """Let waiting coroutines check their predicates again. May be called from any thread."""
        changed, self._changed = self._changed, Future()
        changed.set_result(None)

    async def wait(
        self, predicate: Callable[[], bool], timeout_s: float, what: str = "the condition", reason: object = ""
    ) -> None:
        """Return when the predicate is true; it is evaluated now, after each `notify`, and at least every 0.5 s.

        The last for changes without `notify`, such as those of the graph. The text of `reason`, such as that of
        `Arrivals`, is part of the error.

        Raises
        ------
        WaitTimeoutError
            The predicate was false for `timeout_s`.
        """
        patience = Patience(timeout_s)
        with _timer(self._node, patience.turn_s, self.notify):
            while True:
                changed = self._changed  # taken before the check, so that no change is missed between check and wait
                if predicate():
                    return
                if patience.is_over():  # also when there is a change in every turn of the executor
                    why = f": {reason}" if str(reason) else ""
                    raise WaitTimeoutError(f"{what} did not come within {timeout_s:g} s{why}")
                changed.add_done_callback(lambda _: _wake(self._node))
                await changed


def _opener(node: Node, gate: Future) -> Callable[..., None]:
    def open_gate(*_: object) -> None:
        if not gate.done():
            gate.set_result(None)
            _wake(node)

    return open_gate


def _wake(node: Node) -> None:
    """Wake the executor, which may sleep while another thread completes a future."""
    if node.executor is not None:
        node.executor.wake()


@contextlib.contextmanager
def _timer(node: Node, seconds: float, callback: Callable[[], None]) -> Iterator[None]:
    # a group of its own: a shared one would block, and would keep a reference to every timer
    timer = node.create_timer(seconds, callback, callback_group=ReentrantCallbackGroup(), clock=_STEADY)
    try:
        yield
    finally:
        node.destroy_timer(timer)
