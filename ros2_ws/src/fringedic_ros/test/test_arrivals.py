"""Why a wait for messages ended without one that can be used: every reason by a message over real DDS."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64, String

from fringedic_ros.arrivals import Arrivals, mismatches, stamp_problem, unconnected
from fringedic_ros.qos import STATE
from fringedic_ros.testing import Peer

NOW_NS = 1_790_000_000_000_000_000
S = 1_000_000_000
UNRELIABLE = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.mark.parametrize(
    ("stamp_ns", "before_ns", "what", "latest"),
    [
        (0, 0, "with a stamp of 0 s, which the publisher has not set", ""),
        (0, NOW_NS, "with a stamp of 0 s, which the publisher has not set", ""),
        (NOW_NS, NOW_NS, "with the stamp of the message before", ""),
        (NOW_NS - S // 2, NOW_NS - S // 4, "with a stamp before that of the previous message", "by 0.25 s"),
        (NOW_NS - 3 * S, 0, "with a stamp behind the clock of this computer", "by 3 s"),
        (57 * S, 0, "with a stamp behind the clock of this computer", "by 20718 days"),
        (NOW_NS + S, 0, "with a stamp ahead of the clock of this computer", "by 1 s"),
    ],
)
def test_a_stamp_that_does_not_tell_the_time_has_a_reason(
    stamp_ns: int, before_ns: int, what: str, latest: str
) -> None:
    problem = stamp_problem(stamp_ns, before_ns, NOW_NS)
    assert problem is not None
    assert (problem.what, problem.latest) == (what, latest)


@pytest.mark.parametrize("stamp_ns", [NOW_NS, NOW_NS - S // 2, NOW_NS + S // 20])
def test_a_stamp_of_the_present_has_none(stamp_ns: int) -> None:
    assert stamp_problem(stamp_ns, stamp_ns - 1, NOW_NS) is None


@pytest.fixture
def peer() -> Iterator[Peer]:
    rclpy.init()
    peer = Peer("here")
    yield peer
    peer.destroy_node()
    rclpy.try_shutdown()


def test_messages_are_counted_by_reason(peer: Peer) -> None:
    arrivals = Arrivals(peer, Float64, "force")
    for _ in range(3):
        arrivals.take_stamped(0)
    arrivals.take_stamped(57 * S)
    told = str(arrivals)
    assert told.startswith("/force: 4 messages came in "), told
    assert "none usable: 3 with a stamp of 0 s, which the publisher has not set, 1 with a stamp behind" in told
    assert told.endswith("; set header.stamp to the time of acquisition"), told
    assert arrivals.take_stamped(time.time_ns()) is None
    assert "5 messages came in " in str(arrivals)
    assert re.search(r", the latest usable one \S+ s ago, not usable: 3 with a stamp of 0 s", str(arrivals))
    arrivals.renew()
    assert str(arrivals).startswith("no node publishes /force; start its node")


@pytest.fixture
def other() -> Iterator[Node]:
    """A node of another participant: one has a single type of each topic."""
    context = Context()
    rclpy.init(context=context)
    node = Node("there", context=context)
    yield node
    node.destroy_node()
    rclpy.try_shutdown(context=context)


def test_publishers_that_do_not_reach_a_subscription_are_described(peer: Peer, other: Node) -> None:
    arrivals = Arrivals(peer, Float64, "force")
    peer.listen(Float64, "force", STATE)
    for kind, qos, words in (
        (String, STATE, "/there publishes /force with the type std_msgs/msg/String; std_msgs/msg/Float64 is needed"),
        (Float64, UNRELIABLE, "/there publishes /force, but its QoS does not reach the subscription of /here (best"),
        (Float64, STATE, "/there publishes /force, but no message came in "),
    ):
        publisher = other.create_publisher(kind, "force", qos)
        peer.wait(lambda expected=words: str(arrivals).startswith(expected), words)
        assert (
            bool(unconnected(peer, Float64, "force")) == bool(mismatches(peer, "force")) == ("no message" not in words)
        )
        other.destroy_publisher(publisher)
        peer.wait(lambda: str(arrivals).startswith("no node publishes /force"), "its end")
