"""What came on a topic, and why it could not be used: the sentence with which a wait for its messages ends."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible

from fringedic.wording.numbers import number_text
from fringedic_ros.middleware import Endpoint

MOST_AHEAD_S = 0.1  # by which a stamp may be later than the arrival of its message: synchronised clocks differ by less
MOST_BEHIND_S = 1.0  # by which it may be earlier
_DAY_S = 86_400.0
_UNIX_TIME = (
    "stamp each message with the system's time, not with simulated time (use_sim_time) or the time since a start"
)


class Problem(NamedTuple):
    """Why a message cannot be used.

    Attributes
    ----------
    what
        The same words for all messages with this problem; they follow the number of messages: "with a stamp of 0 s".
    cure
        What to do.
    latest
        What differs from message to message, in words; of the latest message.
    """

    what: str
    cure: str
    latest: str = ""


def stamp_problem(stamp_ns: int, before_ns: int, now_ns: int, most_behind_s: float = MOST_BEHIND_S) -> Problem | None:
    """Return why a stamp does not tell when its message was acquired; None when it does.

    Parameters
    ----------
    stamp_ns, before_ns
        Stamp of a message, and of the message before; 0 when there was none [ns].
    now_ns
        Time of arrival on the clock of this computer [ns].
    most_behind_s
        Longest time from the stamp to the arrival [s].
    """
    if stamp_ns == 0:
        return Problem(
            "with a stamp of 0 s, which the publisher has not set", "set header.stamp to the time of acquisition"
        )
    if stamp_ns == before_ns:
        return Problem(
            "with the stamp of the message before",
            "give each message the time of its own acquisition; one that is repeated tells nothing about the present",
        )
    behind_s = 1e-9 * (now_ns - stamp_ns)
    if -MOST_AHEAD_S <= behind_s <= most_behind_s:
        if stamp_ns > before_ns:
            return None
        return Problem(
            "with a stamp before that of the previous message",
            "let one node publish the topic, and do not set its clock during a test",
            f"by {_duration(1e-9 * (before_ns - stamp_ns))}",
        )
    side = "behind" if behind_s > 0 else "ahead of"
    near = "synchronise the clocks of the computers (chrony)" + (", and publish each message at once" * (behind_s > 0))
    cure = _UNIX_TIME if abs(behind_s) > _DAY_S else near
    return Problem(f"with a stamp {side} the clock of this computer", cure, f"by {_duration(abs(behind_s))}")


class Arrivals:
    """Tally of the messages of a topic: how many came, how many could not be used and why.

    As text it is a sentence that names the topic, what came, and what to do.

    Parameters
    ----------
    node
        Owner of the subscription.
    kind
        Type of the messages.
    topic
        Name of the topic.

    Attributes
    ----------
    received
        Messages that came since the counting began.
    """

    def __init__(self, node: Node, kind: type[Any], topic: str) -> None:
        self._node, self._kind, self._topic = node, kind, node.resolve_topic_name(topic)
        self._stamp_ns = 0
        self._came_s = self._usable_s = -math.inf
        self.renew()

    def renew(self) -> None:
        """Begin to count again: a wait begins, or a message was usable."""
        self._since_s = time.monotonic()
        self.received = 0
        self._problems = Counter[str]()
        self._latest: dict[str, Problem] = {}

    def take(self, problem: Problem | None = None) -> None:
        """Count a message, which cannot be used when it has a problem."""
        self._came_s = time.monotonic()
        self.received += 1
        if problem is None:
            self._usable_s = self._came_s
        else:
            self._problems[problem.what] += 1
            self._latest[problem.what] = problem

    def take_stamped(self, stamp_ns: int, most_behind_s: float = MOST_BEHIND_S) -> Problem | None:
        """Count a message that has arrived now, and return what is wrong with its stamp [ns], as `stamp_problem`."""
        problem = stamp_problem(stamp_ns, self._stamp_ns, time.time_ns(), most_behind_s)
        self._stamp_ns = stamp_ns
        self.take(problem)
        return problem

    def __str__(self) -> str:
        now = time.monotonic()
        if not self.received:
            earlier = "" if self._came_s == -math.inf else f" (the latest one {_duration(now - self._came_s)} ago)"
            return unconnected(self._node, self._kind, self._topic) or (
                f"{_names(_publishers(self._node, self._kind, self._topic))} publishes {self._topic}, but no message "
                f"came in {_duration(now - self._since_s)}{earlier}; check that node"
            )
        came = _messages(self.received) + f" came in {_duration(now - self._since_s)}"
        unusable = self._problems.total()
        if unusable < self.received:
            came += f", the latest usable one {_duration(now - self._usable_s)} ago"
        if not unusable:
            return f"{self._topic}: {came}; check the node that publishes it"
        groups = self._problems.most_common()
        found = ", ".join(
            f"{count} {what}" + f" (the latest {self._latest[what].latest})" * bool(self._latest[what].latest)
            for what, count in groups
        )
        none = "none usable" if unusable == self.received else "not usable"
        return f"{self._topic}: {came}, {none}: {found}; {self._latest[groups[0][0]].cure}"


def unconnected(node: Node, kind: type[Any], topic: str) -> str:
    """Return why the subscription of a node receives nothing from any publisher; empty when it could.

    Parameters
    ----------
    node
        Owner of the subscription.
    kind
        Type of the messages.
    topic
        Name of the topic.
    """
    topic = node.resolve_topic_name(topic)
    found = node.get_publishers_info_by_topic(topic)
    if not found:
        return f"no node publishes {topic}; start its node, in this namespace and ROS domain"
    publishers = _publishers(node, kind, topic)
    if not publishers:
        return f"{_names(found)} publishes {topic} with the type {found[0].topic_type}; {_type_name(kind)} is needed"
    here = (node.get_name(), node.get_namespace())
    readers = [
        each
        for each in node.get_subscriptions_info_by_topic(topic)
        if (each.node_name, each.node_namespace) == here and each.topic_type == _type_name(kind)
    ]
    if not readers or any(_incompatibility(each, reader) == "" for each in publishers for reader in readers):
        return ""
    return _mismatch(topic, publishers[0], readers[0])


def mismatches(node: Node, topic: str) -> str:
    """Return which publisher and subscription of a topic do not match, and why; empty when all do."""
    topic = node.resolve_topic_name(topic)
    readers = node.get_subscriptions_info_by_topic(topic)
    for publisher in node.get_publishers_info_by_topic(topic):
        for reader in readers:
            if publisher.topic_type != reader.topic_type or _incompatibility(publisher, reader):
                return _mismatch(topic, publisher, reader)
    return ""


def _mismatch(topic: str, publisher: Endpoint, reader: Endpoint) -> str:
    here, there = _names([publisher]), _names([reader])
    if publisher.topic_type != reader.topic_type:
        return f"{here} publishes {topic} with the type {publisher.topic_type}; {there} needs {reader.topic_type}"
    if _defined_otherwise(publisher, reader):
        return (
            f"{here} publishes {topic} with another definition of {publisher.topic_type} than {there} has; build both "
            "with the same version of its package"
        )
    wanted = reader.qos_profile
    return (
        f"{here} publishes {topic}, but its QoS does not reach the subscription of {there} "
        f"({_incompatibility(publisher, reader)}); set its publisher to {wanted.reliability.name} and "
        f"{wanted.durability.name}"
    )


def _incompatibility(publisher: Endpoint, reader: Endpoint) -> str:
    """Return why two endpoints of one type do not match; empty when they do."""
    if _defined_otherwise(publisher, reader):
        return "another definition"
    return _qos_incompatibility(publisher.qos_profile, reader.qos_profile)


def _defined_otherwise(publisher: Endpoint, reader: Endpoint) -> bool:
    hashes = publisher.topic_type_hash, reader.topic_type_hash
    return all(each.version > 0 for each in hashes) and hashes[0] != hashes[1]  # older versions of ROS 2 have none


def _qos_incompatibility(offered: QoSProfile, wanted: QoSProfile) -> str:
    verdict, reason = qos_check_compatible(offered, wanted)
    if verdict != QoSCompatibility.ERROR:
        return ""
    each = [part.split(":", 1)[-1].strip() for part in reason.split(";") if part.strip()]
    return ", ".join(part[:1].lower() + part[1:] for part in each)


def _publishers(node: Node, kind: type[Any], topic: str) -> Sequence[Endpoint]:
    return [each for each in node.get_publishers_info_by_topic(topic) if each.topic_type == _type_name(kind)]


def _type_name(kind: type[Any]) -> str:
    return f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"


def _names(endpoints: Sequence[Endpoint]) -> str:
    return ", ".join(sorted({f"{each.node_namespace.rstrip('/')}/{each.node_name}" for each in endpoints}))


def _messages(count: int) -> str:
    return "1 message" if count == 1 else f"{count} messages"


def _duration(seconds: float) -> str:
    return f"{number_text(seconds / _DAY_S, 3)} days" if seconds > 2 * _DAY_S else f"{number_text(seconds, 2)} s"
