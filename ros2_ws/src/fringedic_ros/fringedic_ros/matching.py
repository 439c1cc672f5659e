"""Whether nodes have found each other: of what is published before, a reader gets nothing.

Discovery is between each two processes. That this one has found both ends of a topic does not say that they have found
each other; the one who publishes knows, and is asked.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Mapping

from rclpy.node import Node
from rclpy.task import Future

from fringedic_msgs.srv import CountReaders

ASK_AGAIN_S = 0.05  # [s] after an answer that says that somebody is missing
UNANSWERED_S = 1.0  # [s] after which a question may have been lost, or have gone to a node that is dead


def offer_reader_counts(node: Node, name: str) -> None:
    """Let others ask the node that publishes as `name` how many readers its publishers have matched."""

    def count(request: CountReaders.Request, response: CountReaders.Response) -> CountReaders.Response:
        matched = {publisher.topic_name: publisher.get_subscription_count() for publisher in node.publishers}
        response.counts = [matched.get(topic, 0) for topic in request.topics]
        return response

    node.create_service(CountReaders, f"{name}/count_readers", count)


class Matching:
    """Asks nodes that publish until each has matched all the readers that this node knows.

    Parameters
    ----------
    node
        Who asks; it is spun by the caller.
    topics
        Names of topics by the name of the node that publishes them.
    readers
        Names of the nodes whose subscriptions count; strangers may have settings that never match.
    """

    def __init__(self, node: Node, topics: Mapping[str, Iterable[str]], readers: Collection[str]) -> None:
        self._node = node
        self._topics = {name: [node.resolve_topic_name(topic) for topic in of] for name, of in topics.items()}
        self._readers = frozenset(readers)
        self._clients = {name: node.create_client(CountReaders, f"{name}/count_readers") for name in self._topics}
        self._asked: dict[str, tuple[Future | None, float]] = {}
        self._missing: dict[str, list[str]] = {}
        self.forget()

    def forget(self) -> None:
        """Begin anew: somebody has come or gone."""
        for name, (future, _) in self._asked.items():
            if future is not None:
                self._clients[name].remove_pending_request(future)
        self._asked.clear()
        self._missing = {name: list(topics) for name, topics in self._topics.items()}

    def unmatched(self, names: Collection[str]) -> list[str]:
        """Full names of topics of these nodes that do not reach everybody yet; to be called until there are none."""
        for name in names:
            if self._missing[name]:
                self._ask(name)
        return [topic for name in names for topic in self._missing[name]]

    def _ask(self, name: str) -> None:
        client, topics = self._clients[name], self._topics[name]
        future, since = self._asked.get(name, (None, 0.0))
        if future is not None and future.done() and future.result() is not None:
            answered = zip(topics, future.result().counts, strict=True)
            self._missing[name] = [topic for topic, count in answered if count < self._known_readers(topic)]
            self._asked[name] = (None, time.monotonic())
            return
        if time.monotonic() - since < (ASK_AGAIN_S if future is None else UNANSWERED_S):
            return
        if future is not None:
            client.remove_pending_request(future)
        if client.service_is_ready():
            self._asked[name] = (client.call_async(CountReaders.Request(topics=topics)), time.monotonic())

    def _known_readers(self, topic: str) -> int:
        return sum(each.node_name in self._readers for each in self._node.get_subscriptions_info_by_topic(topic))
