"""Nodes that spin in a thread beside the program, for scripts, notebooks and tests."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from rclpy.action import ActionClient, ActionServer
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from fringedic.errors import WaitTimeoutError

NodeT = TypeVar("NodeT", bound=Node)
ResultT = TypeVar("ResultT")


class Spinning:
    """Context in which one executor spins nodes in a thread of its own; at its end the nodes are destroyed."""

    def __init__(self) -> None:
        self._executor = SingleThreadedExecutor()
        self._thread = threading.Thread(target=self._spin, name="spinning", daemon=True)
        self._nodes: list[Node] = []

    def __enter__(self) -> Spinning:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        # in its own thread: from another one it destroys what a callback that has just been taken still uses
        self._executor.create_task(self._executor.shutdown)
        self._thread.join()
        self._executor.shutdown()  # when the context ended first
        for node in self._nodes:
            end_node(node)

    def add(self, node: NodeT) -> NodeT:
        """Spin a further node, which this context owns from now on."""
        self._nodes.append(node)
        self._executor.add_node(node)
        return node

    def run(
        self, function: Callable[..., Coroutine[Any, Any, ResultT]], *arguments: Any, timeout_s: float = 10.0
    ) -> ResultT:
        """Return the result of a coroutine function that the executor runs.

        Raises
        ------
        WaitTimeoutError
            The coroutine did not finish within `timeout_s`.
        """
        outcome: queue.SimpleQueue[tuple[Any, BaseException | None]] = queue.SimpleQueue()

        async def report() -> None:
            # the caller receives the exception, which must not end the executor
            try:
                outcome.put((await function(*arguments), None))
            except BaseException as error:
                outcome.put((None, error))

        self._executor.create_task(report)
        try:
            result, error = outcome.get(timeout=timeout_s)
        except queue.Empty:
            raise WaitTimeoutError(f"{function.__name__} did not finish within {timeout_s:g} s") from None
        if error is not None:
            raise error
        return result

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):  # the context ended first
            self._executor.spin()


def end_node(node: Node) -> None:
    """Destroy a node with its action clients and servers, for programs that go on.

    ``destroy_node`` leaves these, and they keep its participant in the graph, and the shared memory of other processes
    mapped, until Python collects them. Of some thirty such participants in a process, only half of the endpoints of one
    were known, and a client then takes its server as missing.
    """
    for waitable in list(node.waitables):
        if isinstance(waitable, ActionClient | ActionServer):
            waitable.destroy()
    node.destroy_node()
