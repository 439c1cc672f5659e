"""Identity of the processes and servers behind the endpoints of a graph."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, Protocol

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.utilities import get_rmw_implementation_identifier

from fringedic_ros.rmw import DDS

_PREFIX = 12  # bytes of an identifier that all endpoints of a process share (DDS-RTPS 2.5, 9.3.1.1)


class Endpoint(Protocol):
    """Publisher or subscription of a topic as `Node.get_publishers_info_by_topic` lists it.

    Its class is in ``rclpy.topic_endpoint_info`` of Jazzy and Kilted, and in ``rclpy.endpoint_info`` of Lyrical.
    """

    node_name: str
    node_namespace: str
    topic_type: str
    topic_type_hash: Any
    endpoint_gid: list[int]
    qos_profile: QoSProfile


def process_of(endpoint: Endpoint) -> Hashable:
    """Return the identity of the process of an endpoint: equal for endpoints of one process.

    Processes are known earlier than the names of their nodes. Without DDS an identifier states nothing about its
    process, and names come with the endpoints: then it is the identity of the node.
    """
    if get_rmw_implementation_identifier() in DDS:
        return bytes(endpoint.endpoint_gid[:_PREFIX])
    return endpoint.node_namespace, endpoint.node_name


def servers_of(node: Node, service: str) -> frozenset[Hashable]:
    """Return the identities of the servers of a service that a node has discovered.

    Neither the number of servers nor their names change when a node is replaced by its successor. With DDS, responses
    have a topic of their own, whose writers are listed (design.ros2.org, "Topic and Service name mapping to DDS").
    """
    name = node.resolve_service_name(service)
    if get_rmw_implementation_identifier() in DDS:
        writers = node.get_publishers_info_by_topic(f"rr{name}Reply", no_mangle=True)
        return frozenset(bytes(each.endpoint_gid) for each in writers)
    if hasattr(node, "get_servers_info_by_service"):  # Lyrical
        servers = node.get_servers_info_by_service(name)
        return frozenset(bytes(gid) for each in servers for gid in each.endpoint_gids)
    return frozenset(range(node.count_services(name)))
