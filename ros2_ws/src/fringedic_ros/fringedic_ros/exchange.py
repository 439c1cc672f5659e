"""Whole results between the nodes of one process, as objects instead of messages."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable
from typing import Any

from rclpy.node import Node


class Exchange:
    """Passes the results of each node on to the nodes of the same process that need them.

    Results are not copied: who takes one must not change it.
    """

    def __init__(self) -> None:
        self._takers: defaultdict[str, list[Callable[[Any], None]]] = defaultdict(list)

    def give(self, name: str, result: Any) -> None:
        """Pass a result of the node `name` on; from any thread."""
        for put in self._takers[name]:
            put(result)

    def take(self, node: Node, name: str, callback: Callable[[Any], None]) -> None:
        """Call a function with each result of the node `name`, in the thread of the executor of `node`."""
        waiting: deque[Any] = deque()

        def pass_on() -> None:
            while waiting:
                callback(waiting.popleft())

        guard = node.create_guard_condition(pass_on)

        def put(result: Any) -> None:
            waiting.append(result)
            guard.trigger()

        self._takers[name].append(put)
