"""Other users of this computer whose commands can arrive: the kernel records the user of every port and memory.

Fast DDS sends to a participant of the same computer through shared memory where both have it, and another user cannot
open ours: such a participant sees the graph alone. One that has a UDP port and no shared memory reaches every node, and
so does each with a UDP port when our own nodes use another DDS. Zenoh has one router for all users and domains: nothing
can be seen there, and nothing is refused.
"""

from __future__ import annotations

import os
import pwd
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from rclpy.node import Node
from rclpy.utilities import get_rmw_implementation_identifier

from fringedic_ros.middleware.fast_dds import domain_of_port, memory_of_port, number_of_port
from fringedic_ros.rmw import DDS, FAST_DDS

TABLES = (Path("/proc/net/udp"), Path("/proc/net/udp6"))
LOCKS = Path("/proc/locks")
REMEMBERED_S = 30.0  # a command may arrive after its sender has ended
_PERIOD_S = 0.5
_ROOT = 0  # may do everything anyway


class OtherUsers:
    """Looks for participants of other users that reach the nodes of the ROS domain of a node.

    ROS 2 does not tell a node which participant has sent a command, and a participant can state anything about itself.
    The kernel tells the user of a port, and every participant that follows the standard has one of its domain
    (DDS-RTPS 2.5, 9.6.2.3). A program that was written to evade this check is not found.

    Parameters
    ----------
    node
        Its timer looks twice a second, and logs an error when another user appears.
    """

    def __init__(self, node: Node) -> None:
        self._domain = node.context.get_domain_id()
        self._log = node.get_logger()
        self._seen: dict[tuple[int, int], float] = {}  # (user, port): when it was seen last
        self._can_see = get_rmw_implementation_identifier() in DDS
        node.create_timer(_PERIOD_S, self.look)

    @property
    def reason_to_refuse(self) -> str:
        """Why a command that moves a machine is not carried out, and what to do; empty when no other user is there."""
        self.look()
        return _sentence(self._domain, self._seen) if self._seen else ""

    def look(self) -> None:
        """Look at the ports of this computer."""
        now = time.monotonic()
        found = participants_of_others(self._domain) if self._can_see else set()
        if new := found - self._seen.keys():
            self._log.error(f"moves are refused: {_sentence(self._domain, new)}")
        recent = {each: seen for each, seen in self._seen.items() if now - seen < REMEMBERED_S}
        self._seen = recent | dict.fromkeys(found, now)


def participants_of_others(domain: int) -> set[tuple[int, int]]:
    """Return user and UDP port of each participant that is neither this user's nor root's and reaches our nodes."""
    ports = {each for each in _ports_of_others() if domain_of_port(each[1]) == domain}
    own = {
        each for each in ports if number_of_port(each[1]) >= 0
    }  # the others belong to all participants of the domain
    users = {user for user, _ in own}
    avoiding = {(user, port) for user, port in own if not _has_memory(user, domain, port)}
    return avoiding | {(user, port) for user, port in ports - own if user not in users}


def _ports_of_others() -> Iterator[tuple[int, int]]:
    for table in TABLES:
        with suppress(OSError):  # not Linux, or without IPv6
            for line in table.read_text().splitlines()[1:]:
                fields = line.split()
                if (user := int(fields[7])) not in (_ROOT, os.getuid()):
                    yield user, int(fields[1].rpartition(":")[2], 16)


def _has_memory(user: int, domain: int, port: int) -> bool:
    """Return whether a participant receives from us in shared memory: it locks a file of its user while it runs.

    Programs that were killed leave such files without a lock.
    """
    if not _uses_shared_memory():
        return False
    memory = memory_of_port(domain, number_of_port(port))
    try:
        file = memory.with_name(f"{memory.name}_el").stat()
        locked = {line.split()[-3].rpartition(":")[2] for line in LOCKS.read_text().splitlines() if "->" not in line}
    except OSError:
        return False
    return file.st_uid == user and str(file.st_ino) in locked


def _uses_shared_memory() -> bool:
    """Return whether our nodes send through shared memory."""
    return get_rmw_implementation_identifier() in FAST_DDS


def _sentence(domain: int, found: set[tuple[int, int]] | dict[tuple[int, int], float]) -> str:
    user, port = min(found)
    which = " without shared memory" if _uses_shared_memory() else ""
    return (
        f"{_name(user)} has a program{which} in ROS domain {domain} on this computer (UDP port {port}), "
        "which could have sent the command; end that program and wait half a minute, or choose another "
        "ROS_DOMAIN_ID for the rig"
    )


def _name(user: int) -> str:
    try:
        return f"user {pwd.getpwuid(user).pw_name}"
    except KeyError:
        return f"user {user}"
