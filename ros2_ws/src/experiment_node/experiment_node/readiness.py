"""Readiness before the first frame: all nodes that need the messages of a step have to be connected."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import Any

from rclpy.event_handler import QoSSubscriptionMatchedInfo, SubscriptionEventCallbacks
from rclpy.node import Node

from experiment_node.active_goal import ActiveGoal
from experiment_node.frame_taker import FrameTaker
from experiment_node.running_step import RunningStep
from fringedic.settings.experiment import ExperimentNodeSettings
from fringedic_msgs.action import MeasureStep
from fringedic_ros.arrivals import mismatches, unconnected
from fringedic_ros.matching import Matching
from fringedic_ros.qos import EVENTS
from fringedic_ros.topics import PUBLISHED, READERS, WATCHERS
from fringedic_ros.waiting import Condition

Result = MeasureStep.Result
CONNECTING_TIME = 1.0  # [s] from the last node that connects to the first exposure
_SERVICES = ("projector/show", "camera/capture")
_QUIET_TOPICS = ("camera/image_raw", "camera/exposure")


class Readiness:
    """Tracks which publishers are connected, and waits until a step can begin.

    Parameters
    ----------
    node
        Owner of the subscriptions.
    changed
        Notified when a publisher connects or disconnects.
    frames
        Its services have to be there.
    """

    def __init__(self, node: Node, changed: Condition, frames: FrameTaker) -> None:
        self._node = node
        self._changed = changed
        self._frames = frames
        self._connected: dict[str, bool] = {}
        self._kinds: dict[str, type[Any]] = {}
        self._connected_at = time.monotonic()
        self._graph_changed = True
        self._known_endpoints: list[int] = []
        self._matching = Matching(node, PUBLISHED, (*READERS, *WATCHERS))

    def subscribe(self, kind: type[Any], topic: str, callback: Callable[[Any], None]) -> None:
        """Subscribe to a topic of every step, and keep in mind whether its publisher is connected."""
        self._connected[topic], self._kinds[topic] = False, kind

        def matched(event: QoSSubscriptionMatchedInfo) -> None:
            self._connected[topic] = event.current_count > 0
            self._graph_changed = True
            self._connected_at = time.monotonic()
            self._changed.notify()

        events = SubscriptionEventCallbacks(matched=matched)
        self._node.create_subscription(kind, topic, callback, EVENTS, event_callbacks=events)

    def forget(self) -> None:
        """Check all connections again before the next step: a node has started."""
        self._graph_changed, self._connected_at = True, time.monotonic()

    async def await_nodes(
        self, step: RunningStep, parameters: ExperimentNodeSettings, witness: Callable[[], str]
    ) -> None:
        """Wait until all nodes of a step are connected, once per experiment and after each change of the graph.

        A message that is published before a node is connected never reaches that node.

        Parameters
        ----------
        step
            That is to begin.
        parameters
            Of the experiment.
        witness
            Returns the topic of a recorder of results; empty while there is none.

        Raises
        ------
        StepFailure
            NO_SUBSCRIBER.
        """

        def absent() -> list[str]:
            needed = ("camera/exposure", *(f"{name}/status" for name in step.nodes))
            return [topic for topic in needed if not self._connected[topic]]

        timeout = parameters.start_timeout_s
        await step.goal.wait(
            lambda: not absent(),
            timeout,
            lambda: (Result.NO_SUBSCRIBER, "; ".join(self._reason(topic) for topic in absent())),
        )
        end = time.monotonic() + timeout
        await self._await_quiet_graph(step, self._connected_at, end)
        while self._doubled():
            await step.goal.wait_polling(
                lambda: not self._doubled(),
                end - time.monotonic(),
                lambda: (Result.NO_SUBSCRIBER, f"two nodes use {', '.join(self._doubled())}; end one of them"),
            )
            # a further node may have appeared beside its dead predecessor
            await self._await_quiet_graph(step, time.monotonic(), end)
        await self._frames.await_responses(step, parameters)
        await self.reach_readers(step.goal, step.nodes, timeout, witness)
        self._known_endpoints = self._endpoints()

    def _reason(self, topic: str) -> str:
        """Return why a publisher of a topic is not connected."""
        return unconnected(self._node, self._kinds[topic], topic) or f"the publisher of {topic} is not connected yet"

    def _doubled(self) -> list[str]:
        """Return what a node and its killed predecessor, which is listed until its lease ends, have in common."""
        doubled = [name for name, count in zip(_SERVICES, self._frames.servers(), strict=True) if count > 1]
        for topic in self._connected:
            publishers = [each.node_name for each in self._node.get_publishers_info_by_topic(topic)]
            doubled += [f"{topic} as {name}" for name in set(publishers) if publishers.count(name) > 1]
        for topic in _QUIET_TOPICS:
            readers = [each.node_name for each in self._node.get_subscriptions_info_by_topic(topic)]
            doubled += [f"{topic} as {name}" for name in READERS if readers.count(name) > 1]
        return doubled

    def is_outdated(self, step: RunningStep) -> bool:
        """Return whether the connections must be checked before this step."""
        if self._graph_changed or self._endpoints() != self._known_endpoints:
            self._graph_changed = step.experiment.ready = False
        return not step.experiment.ready

    def _endpoints(self) -> list[int]:
        """Return how many readers of the camera's topics and servers of frames are listed."""
        return [self._node.count_subscribers(topic) for topic in _QUIET_TOPICS] + self._frames.servers()

    async def reach_readers(
        self, goal: ActiveGoal, nodes: Collection[str], timeout_s: float, witness: Callable[[], str] = lambda: ""
    ) -> None:
        """Wait until the publishers of these nodes are connected to all readers of their topics, see `Matching`.

        Raises
        ------
        StepFailure
            NO_SUBSCRIBER.
        """
        self._matching.forget(witness)
        await goal.wait_polling(
            lambda: not self._matching.unmatched(nodes),
            timeout_s,
            lambda: (
                Result.NO_SUBSCRIBER,
                self._unmatched(self._matching.unmatched(nodes)),
            ),
        )

    def _unmatched(self, topics: Collection[str]) -> str:
        found = [reason for topic in topics if (reason := mismatches(self._node, topic))]
        return "; ".join(found) or f"{', '.join(topics)}: not all subscribers are connected; restart the nodes"

    async def _await_quiet_graph(self, step: RunningStep, since: float, end: float) -> None:
        """Wait until no further node has connected for a time: nodes discover each other one by one.

        The time counts from `since`, on the monotonic clock [s], or from the latest change, and ends at `end`.
        """
        found = self._endpoints()
        while (left := min(since + CONNECTING_TIME, end) - time.monotonic()) > 0:
            await step.goal.pause(min(left, 0.1))
            if found != (found := self._endpoints()):
                since = time.monotonic()
