"""Which nodes of a rig are ready, from what the middleware has discovered."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.node import Node

from fringedic.errors import StepFailedError
from fringedic_msgs.msg import NodeParameters, RecorderStatus
from fringedic_ros.arrivals import unconnected
from fringedic_ros.matching import is_read_by
from fringedic_ros.qos import LATCHED, LATCHED_BY_MANY
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.topics import DERIVED_TOPICS, RAW_TOPICS

RECORDER = "recorder"
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
    recorder
        Name of the recorder node, relative to the namespace of the client or with its own.
    """

    def __init__(
        self,
        node: Node,
        actions: Mapping[str, Mapping[str, ActionClient]],
        place: Client,
        recorder: str = RECORDER,
    ) -> None:
        self._recorder_name = recorder
        self._node = node
        self._actions = actions
        self._place = place
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
        absent = sorted(name for name in expected if self._listed(name) != 1)
        absent += [
            f"service {service}"
            for node, service in SERVICES.items()
            if node in expected and self._node.count_services(self._node.resolve_service_name(service)) != 1
        ]
        for node in sorted(expected & self._actions.keys()):
            absent += [f"action {name}" for name, client in self._actions[node].items() if not client.server_is_ready()]
        if "stage" in expected and not self._place.service_is_ready():
            absent.append("service reference_plane/place")
        if self._recorder_name in expected:
            absent += self._unrecorded()
        return absent

    def missing_since(self, since_ns: Mapping[str, int]) -> Callable[[], set[str]]:
        """Return a function that lists the nodes that were started again and are not there yet.

        A killed node stays listed until its lease ends. Until then messages and requests for it and for its successor
        cannot be distinguished, so that a node is there when it is listed once.

        Parameters
        ----------
        since_ns
            When each was started, by its name, on this computer's clock [ns]; it publishes its parameters later.
        """
        if self._recorder_name in since_ns:
            self._recorder = None  # the latest status is that of the recorder that has ended

        def missing() -> set[str]:
            return {
                name
                for name, since in since_ns.items()
                if self._started.get(name, 0) < since or self._listed(name) != 1
            }

        return missing

    def _listed(self, name: str) -> int:
        """Return how many nodes of a name are listed in this namespace, from a service that every node has.

        The names of nodes come with a message of their own, which is not received again after a cut (decision 0032).
        """
        return int(self._node.count_services(self._node.resolve_service_name(f"{name}/get_parameters")))

    def _unrecorded(self) -> list[str]:
        """Return why the recorder does not record, or which published topics it has not subscribed to yet."""
        if self._recorder is not None and self._recorder.state == RecorderStatus.FAILED:
            raise StepFailedError(f"the recorder failed: {self._recorder.error_message}")
        if self._recorder is None:
            return [f"recorder ({unconnected(self._node, RecorderStatus, 'recorder/status') or 'no status yet'})"]
        if self._recorder.state != RecorderStatus.RECORDING:
            return ["recorder (it does not record yet)"]
        names = (*RAW_TOPICS, *(DERIVED_TOPICS if self._recorder.derived else ()))
        recorder, *topics = (self._node.resolve_topic_name(name) for name in ("recorder/status", *names))
        published = (topic for topic in topics if self._node.count_publishers(topic))
        return [f"recorder on {topic}" for topic in published if not is_read_by(self._node, topic, recorder)]

    def _take_recorder(self, message: RecorderStatus) -> None:
        self._recorder = message

    def _take_parameters(self, message: NodeParameters) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        self._started[message.node] = max(stamp, self._started.get(message.node, 0))
