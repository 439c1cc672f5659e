"""Nodes that run on this computer, known at once and without discovery: each binds an abstract Unix socket."""

from __future__ import annotations

import socket
from contextlib import suppress

from rclpy.node import Node

_NAME_LENGTH = 80  # of the 107 bytes of an address


def announce(node: Node) -> None:
    """Announce a node until the end of its process; a second one of its name is not announced."""
    announced = _datagram_socket()
    with suppress(OSError):
        announced.bind(_address(node.context.get_domain_id(), node.get_fully_qualified_name()))
    announced.detach()


def is_announced(domain: int, name: str) -> bool:
    """Return whether a node with this name, which contains its namespace, runs on this computer in a ROS domain."""
    with _datagram_socket() as asking:
        return asking.connect_ex(_address(domain, name)) == 0


def _datagram_socket() -> socket.socket:
    return socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)


def _address(domain: int, name: str) -> bytes:
    return f"\0fringedic-node-{domain}{name[-_NAME_LENGTH:]}".encode()
