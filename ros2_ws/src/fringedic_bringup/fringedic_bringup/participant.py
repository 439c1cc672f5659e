"""A ROS node of this process, with the middleware settings of the nodes that the command starts."""

from __future__ import annotations

import os
from collections.abc import Callable

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from fringedic_bringup.launch.environment import node_environment


class Participant:
    """A node in a context of its own, whose callbacks run in `spin_once`.

    Parameters
    ----------
    name, namespace
        Of the node.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Attributes
    ----------
    node
        For publishers, subscriptions and clients.
    """

    def __init__(self, name: str, namespace: str, *, domain: int | None = None) -> None:
        for variable, value in node_environment().items():
            os.environ.setdefault(variable, value)
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = Node(name, namespace=namespace, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def spin_once(self, timeout_s: float) -> None:
        """Run one callback that is ready, or wait for one at most this long."""
        self._executor.spin_once(timeout_sec=timeout_s)

    def close(self, before: Callable[[], None] = lambda: None) -> None:
        """End the node.

        Parameters
        ----------
        before
            Called when no callback can run any more and the node still exists.
        """
        self._executor.shutdown()
        before()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)
