"""Which nodes of a rig are ready, from what the middleware has discovered."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping

from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.node import Node

from experiment_node.topics import DERIVED_TOPICS, RAW_TOPICS
from fringedic.errors import StepFailedError
from fringedic_msgs.msg import NodeParameters, RecorderStatus
from fringedic_ros.qos import LATCHED, LATCHED_BY_MANY
from fringedic_ros.stamps import to_nanoseconds

# The service of a node that was killed stays listed for 20 s, beside that of the node that replaces it.
LISTED_S = 20.0
SERVICES = {"camera": "camera/capture", "projector": "projector/show", "load_frame": "load_frame/hold"}


class Readiness:
    """Finds out which nodes, actions and recorder subscriptions are missing.

    Parameters
    ----------
    node
        The client's node.
    actions
        Action clients by the name of their action, for each node that serves them.
    place
        Client of the service that places the reference plane.
    """

    def __init__(self, node: Node, actions: Mapping[str, Mapping[str, ActionClient]], place: Client) -> None:
        self._node = node
        self._actions = actions
        self._place = place
        self._known_servers: dict[str, set[bytes]] = {}
        self._known_readers: set[bytes] = set()  # of the recorder
        self._stale_readers: set[bytes] = set()  # of a recorder that has ended
        self._started: dict[str, int] = {}  # when each node published its parameters last [ns]
        self._recorder: RecorderStatus | None = None
        node.create_subscription(NodeParameters, "node_parameters", self._take_parameters, LATCHED_BY_MANY)
        node.create_subscription(RecorderStatus, "recorder/status", self._take_recorder, LATCHED)

    @property
    def recorder(self) -> RecorderStatus | None:
        """Latest status of the recorder; None before the first."""
        return self._recorder

    def missing(self, expected: set[str]) -> list[str]:
        """Return the nodes, actions, services and recorder subscriptions that are not there yet.

        Raises
        ------
        StepFailedError
            The recorder cannot record.
        """
        absent = sorted(expected - {name for name, _ in self._node.get_node_names_and_namespaces()})
        for node in sorted(expected & self._actions.keys()):
            absent += [f"action {name}" for name, client in self._actions[node].items() if not client.server_is_ready()]
        if "stage" in expected and not self._place.service_is_ready():
            absent.append("service reference_plane/place")
        if "recorder" in expected:
            absent += [f"recorder on {topic}" for topic in self._unrecorded()]
        return absent

    def remember(self, expected: set[str]) -> None:
        """Remember the servers and subscriptions that are listed now, to distinguish them from their successors."""
        self._known_servers = self._servers(expected)
        self._known_readers = {gid for topic in self._topics() for gid in self._recorder_readers(topic)}

    def missing_since(self, expected: set[str], since_ns: int) -> Callable[[], set[str]]:
        """Return a function that lists the nodes that were started again and are not there yet.

        Parameters
        ----------
        expected
            Their names.
        since_ns
            Time on this computer's clock [ns] after which they publish their parameters.
        """
        if "recorder" in expected:
            self._recorder = None  # the latest status is that of the recorder that has ended
            self._stale_readers |= self._known_readers
        listed_until = time.monotonic() + LISTED_S

        def missing() -> set[str]:
            absent = {name for name in expected if self._started.get(name, 0) < since_ns}
            known = self._known_servers
            absent |= {name for name, gids in self._servers(expected).items() if gids <= known.get(name, set())}
            if time.monotonic() < listed_until:
                absent |= {name for name in expected & SERVICES.keys() if self._count_services(name) < 2}
            return absent

        return missing

    def _topics(self, names: Iterable[str] = (*RAW_TOPICS, *DERIVED_TOPICS)) -> list[str]:
        return [self._node.resolve_topic_name(name) for name in names]

    def _servers(self, nodes: set[str]) -> dict[str, set[bytes]]:
        """Return the identities of the listed action servers; a killed server stays listed for some seconds."""
        servers = {}
        for node in nodes & self._actions.keys():
            name = self._node.resolve_topic_name(next(iter(self._actions[node])))
            found = self._node.get_publishers_info_by_topic(f"{name}/_action/status")
            servers[node] = {bytes(each.endpoint_gid) for each in found}
        return servers

    def _recorder_readers(self, topic: str) -> set[bytes]:
        found = self._node.get_subscriptions_info_by_topic(topic)
        return {bytes(each.endpoint_gid) for each in found if each.node_name == "recorder"}

    def _count_services(self, node: str) -> int:
        return self._node.count_services(self._node.resolve_service_name(SERVICES[node]))

    def _unrecorded(self) -> list[str]:
        """Return the topics that have a publisher and that the recorder has not subscribed to yet."""
        if self._recorder is not None and self._recorder.state == RecorderStatus.FAILED:
            raise StepFailedError(f"the recorder failed: {self._recorder.error_message}")
        if self._recorder is None or self._recorder.state != RecorderStatus.RECORDING:
            return ["everything"]
        topics = self._topics()
        heard = [topic for topic in topics if self._recorder_readers(topic) - self._stale_readers]
        derived = set(self._topics(DERIVED_TOPICS))
        wanted = topics if derived & set(heard) else [topic for topic in topics if topic not in derived]
        return [topic for topic in wanted if topic not in heard and self._node.count_publishers(topic)]

    def _take_recorder(self, message: RecorderStatus) -> None:
        self._recorder = message

    def _take_parameters(self, message: NodeParameters) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        self._started[message.node] = max(stamp, self._started.get(message.node, 0))
