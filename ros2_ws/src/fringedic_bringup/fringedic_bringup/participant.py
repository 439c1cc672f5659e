"""A ROS node of this process, with the middleware settings of the nodes that the command starts."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from fringedic_bringup.launch.environment import node_environment
from fringedic_ros.spinning import end_node


class Participant:
    """A node in a context of its own, whose callbacks run in `spin_once`.

    Parameters
    ----------
    name, namespace
        Of the node.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.
    beside
        Another one, whose context the node is in: `spin_once` of either runs the callbacks of both.

    Attributes
    ----------
    node
        For publishers, subscriptions and clients.
    """

    def __init__(
        self, name: str, namespace: str, *, domain: int | None = None, beside: Participant | None = None
    ) -> None:
        self._owns_context = beside is None
        if beside is None:
            for variable, value in node_environment().items():
                os.environ.setdefault(variable, value)
            self.context = Context()
            rclpy.init(context=self.context, domain_id=domain)
            self.executor = SingleThreadedExecutor(context=self.context)
        else:
            self.context, self.executor = beside.context, beside.executor
        self.node = Node(name, namespace=namespace, context=self.context)
        self.executor.add_node(self.node)

    def spin_once(self, timeout_s: float) -> None:
        """Run one callback that is ready, or wait for one at most this long; Ctrl-C interrupts it afterwards."""
        with _signals_afterwards():
            self.executor.spin_once(timeout_sec=timeout_s)

    def close(self) -> None:
        """End the node, and the context unless it is that of another one, which does not spin any more either."""
        if self._owns_context:
            self.executor.shutdown()
        end_node(self.node)
        if self._owns_context:
            rclpy.try_shutdown(context=self.context)


@contextmanager
def _signals_afterwards() -> Iterator[None]:
    """Handle the signals that interrupt a command after the `with` block.

    An exception of a signal handler while rclpy converts a message would come out as a RuntimeError about the message.
    """
    if threading.current_thread() is not threading.main_thread():  # which alone handles signals
        yield
        return
    came: list[tuple[int, Any]] = []
    with ExitStack() as afterwards:  # which calls all, also when a handler raises

        def handle_all() -> None:
            with ExitStack() as handling:
                for number, frame in came:
                    handling.callback(handlers[number], number, frame)

        handlers: dict[int, Callable[[int, Any], Any]] = {}
        afterwards.callback(handle_all)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if callable(handler := signal.getsignal(number)):
                handlers[number] = handler
                afterwards.callback(signal.signal, number, handler)
                signal.signal(number, lambda *signalled: came.append(signalled))
        yield
