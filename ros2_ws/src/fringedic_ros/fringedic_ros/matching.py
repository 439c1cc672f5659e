"""Connection of publishers and readers: a reader does not receive messages published before it is connected.

Each two processes discover each other. When this process has discovered both ends of a topic, these two may not yet be
connected; the node that publishes reports it on request.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Mapping

from rclpy.node import Node
from rclpy.task import Future

from fringedic_msgs.srv import CountReaders
from fringedic_ros.middleware import process_of

ASK_AGAIN_S = 0.05  # [s] after a response with missing readers
UNANSWERED_S = 1.0  # [s] after which a request may be lost, or its server has ended


def offer_reader_counts(node: Node, name: str) -> None:
    """Serve the number of connected readers of each publisher of the node `name`."""

    def count(request: CountReaders.Request, response: CountReaders.Response) -> CountReaders.Response:
        matched = {publisher.topic_name: publisher.get_subscription_count() for publisher in node.publishers}
        response.counts = [matched.get(topic, 0) for topic in request.topics]
        response.readers = [discovered_readers(node, topic) for topic in request.topics]
        return response

    node.create_service(CountReaders, f"{name}/count_readers", count)


def discovered_readers(node: Node, topic: str) -> str:
    """Return the GIDs of the subscriptions of a topic that a node has discovered, in hexadecimal digits."""
    found = node.get_subscriptions_info_by_topic(topic)
    return " ".join(sorted(bytes(each.endpoint_gid).hex() for each in found))


def shares_process(node: Node, topic: str, witness: str) -> bool:
    """Return whether all publishers of `topic` are in a process that publishes the topic `witness`; see `is_read_by`.

    Nodes of one process pass results to each other without messages.
    """
    witnesses = {process_of(each) for each in node.get_publishers_info_by_topic(witness)}
    publishers = {process_of(each) for each in node.get_publishers_info_by_topic(topic)}
    return bool(publishers) and publishers <= witnesses


def is_read_by(node: Node, topic: str, witness: str) -> bool:
    """Return whether a process that publishes `witness` subscribes to `topic`, as `node` has discovered them."""
    witnesses = {process_of(each) for each in node.get_publishers_info_by_topic(witness)}
    return any(process_of(each) in witnesses for each in node.get_subscriptions_info_by_topic(topic))


class Matching:
    """Requests the connections of nodes until all readers known to this node are connected to their publishers.

    The number of connected readers may contain a killed one instead of its successor, until its lease ends; then the
    two nodes do not know the same readers.

    Parameters
    ----------
    node
        Owner of the clients; the caller spins it.
    topics
        Names of topics, by the name of the node that publishes them.
    readers
        Names of the nodes whose subscriptions count; the settings of other nodes may never match.
    """

    def __init__(self, node: Node, topics: Mapping[str, Iterable[str]], readers: Collection[str]) -> None:
        self._node = node
        self._topics = {name: [node.resolve_topic_name(topic) for topic in of] for name, of in topics.items()}
        self._readers = frozenset(readers)
        self._clients = {name: node.create_client(CountReaders, f"{name}/count_readers") for name in self._topics}
        self._asked: dict[str, tuple[Future | None, float]] = {}
        self._missing: dict[str, list[str]] = {}
        self.forget()

    def forget(self, witness: Callable[[], str] = lambda: "") -> None:
        """Start again: the graph has changed.

        Parameters
        ----------
        witness
            Returns the name of a topic whose publisher has to read all topics, such as that of a recorder; empty when
            none has to, or no longer.
        """
        self._witness = witness
        for name, (future, _) in self._asked.items():
            if future is not None:
                self._clients[name].remove_pending_request(future)
        self._asked.clear()
        self._missing = {name: list(topics) for name, topics in self._topics.items()}

    def unmatched(self, names: Collection[str]) -> list[str]:
        """Return the full names of topics of these nodes with missing readers; call until there are none."""
        for name in names:
            if self._missing[name]:
                self._ask(name)
        return [topic for name in names for topic in self._missing[name]]

    def _ask(self, name: str) -> None:
        client, topics = self._clients[name], self._topics[name]
        future, since = self._asked.get(name, (None, 0.0))
        if future is not None and future.done() and future.result() is not None:
            witness = self._witness()
            answered = zip(topics, future.result().counts, future.result().readers, strict=True)
            self._missing[name] = [
                topic
                for topic, count, readers in answered
                if count < self._known_readers(topic)
                or readers != discovered_readers(self._node, topic)
                or (witness and not is_read_by(self._node, topic, witness))
            ]
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
