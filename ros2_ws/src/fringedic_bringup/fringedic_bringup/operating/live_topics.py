"""The topics of the running nodes for Foxglove; only those that a viewer watches are subscribed to."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription

from fringedic.errors import RecordingError
from fringedic.export.foxglove import TopicServer
from fringedic.recording.definitions import interface_definition
from fringedic_bringup.participant import Participant
from fringedic_ros.middleware import Endpoint
from fringedic_ros.qos import LATCHED_BY_MANY, PREVIEWS
from fringedic_ros.serialized import message_type

DISCOVERY_PERIOD_S = 1.0
PERIOD_S = 0.05


class LiveTopics:
    """Offers every topic of a ROS domain to the viewers of a server.

    Parameters
    ----------
    port
        As of `TopicServer`.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    FringedicError
        websockets is not installed, or the port is in use.
    """

    def __init__(self, port: int, *, domain: int | None = None) -> None:
        self.server = TopicServer(port, "fringedic")
        self._participant = Participant("foxglove", "/", domain=domain)
        self._subscriptions: dict[str, Subscription] = {}
        self._refused: set[str] = set()
        self._discovered = 0.0

    def close(self) -> None:
        """End server and node."""
        self.server.close()
        self._participant.close()

    def spin_once(self) -> None:
        """Offer new topics, answer the viewers, and pass on a message."""
        if time.monotonic() - self._discovered > DISCOVERY_PERIOD_S:
            self._discovered = time.monotonic()
            self._discover()
        while not self.server.requests.empty():
            kind, topic = self.server.requests.get()
            if kind == "watch" and topic not in self._subscriptions:
                self._subscribe(topic)
            elif kind == "leave" and topic in self._subscriptions and not self.server.is_watched(topic):
                self._participant.node.destroy_subscription(self._subscriptions.pop(topic))
        self._participant.spin_once(PERIOD_S)

    def _discover(self) -> None:
        node = self._participant.node
        for topic, (type_name, *_) in node.get_topic_names_and_types():
            if topic in self.server.topics | self._refused or not node.count_publishers(topic):
                continue
            try:
                message_type(type_name)
                self.server.offer(topic, type_name, interface_definition(type_name))
            except (ImportError, AttributeError, RecordingError):  # of another package, which is not installed here
                self._refused.add(topic)

    def _subscribe(self, topic: str) -> None:
        node = self._participant.node
        publishers = node.get_publishers_info_by_topic(topic)
        kind = dict(node.get_topic_names_and_types())[topic][0]
        self._subscriptions[topic] = node.create_subscription(
            message_type(kind), topic, partial(self._pass_on, topic), _profile(publishers), raw=True
        )

    def _pass_on(self, topic: str, data: bytes) -> None:
        self.server.send(topic, data, time.time_ns())


def _profile(publishers: Sequence[Endpoint]) -> QoSProfile:
    """Return a QoS that every publisher offers; a viewer that is slow has no effect on a node."""
    durable = all(each.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in publishers)
    return LATCHED_BY_MANY if publishers and durable else PREVIEWS
