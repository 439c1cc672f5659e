"""Who publishes says whom it has reached."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import Empty

from fringedic_msgs.srv import CountReaders
from fringedic_ros.matching import Matching, discovered_readers, offer_reader_counts
from fringedic_ros.qos import EVENTS, LATCHED
from fringedic_ros.testing import Peer


@pytest.fixture
def peer() -> Iterator[Peer]:
    rclpy.init()
    peer = Peer("experiment")
    yield peer
    peer.destroy_node()
    rclpy.try_shutdown()


def node(peer: Peer, name: str) -> Node:
    made = Node(name)
    peer.serve_also(made)
    return made


def test_a_known_reader_that_is_not_reached_is_waited_for(peer: Peer) -> None:
    phase = node(peer, "phase")
    phase.create_publisher(Empty, "phase/map", EVENTS)
    phase.create_publisher(Empty, "phase/status", EVENTS)
    offer_reader_counts(phase, "phase")
    matching = Matching(peer, {"phase": ["phase/map", "phase/status"], "dic": ["dic/status"]}, ("dic", "recorder"))
    assert matching.unmatched(["phase", "dic"]) == ["/phase/map", "/phase/status", "/dic/status"], "before any answer"
    peer.wait(lambda: not matching.unmatched(["phase"]), "the answer about topics without readers")

    reader, late = node(peer, "dic"), node(peer, "recorder")
    reader.create_subscription(Empty, "phase/status", lambda _: None, EVENTS)
    # never matches: what it asks for is not offered
    unreached = late.create_subscription(Empty, "phase/map", lambda _: None, LATCHED)
    stranger = node(peer, "viewer")
    stranger.create_subscription(Empty, "phase/status", lambda _: None, LATCHED)
    matching.forget()
    peer.wait(lambda: matching.unmatched(["phase"]) == ["/phase/map"], "the reader that is reached")
    peer.serve(0.3)
    assert matching.unmatched(["phase"]) == ["/phase/map"]
    late.destroy_subscription(unreached)
    peer.wait(lambda: not matching.unmatched(["phase"]), "the end of the reader that was not")
    assert matching.unmatched(["phase", "dic"]) == ["/dic/status"], "a node that is not there has reached nobody"
    for each in (phase, reader, late, stranger):
        each.destroy_node()


def test_a_reader_that_only_one_of_both_knows_is_waited_for(peer: Peer) -> None:
    """A killed reader is counted by the publisher's node, whose lease of it has not ended, instead of its successor."""
    phase = node(peer, "phase")
    reader = node(peer, "dic")
    killed = "00" * 16
    reader.create_subscription(Empty, "phase/status", lambda _: None, EVENTS)

    def count(request: CountReaders.Request, response: CountReaders.Response) -> CountReaders.Response:
        response.counts = [1]
        response.readers = [killed or discovered_readers(phase, request.topics[0])]
        return response

    phase.create_service(CountReaders, "phase/count_readers", count)
    matching = Matching(peer, {"phase": ["phase/status"]}, ("dic",))
    peer.wait(lambda: peer.count_subscribers("phase/status") == 1, "the successor")
    deadline = time.monotonic() + 1.0
    while time.monotonic() < deadline:
        assert matching.unmatched(["phase"]) == ["/phase/status"]
        peer.serve(0.05)
    killed = ""
    peer.wait(lambda: not matching.unmatched(["phase"]), "the end of the lease")
    for each in (phase, reader):
        each.destroy_node()


def test_a_recorder_of_results_that_does_not_read_them_yet_is_waited_for(peer: Peer) -> None:
    phase = node(peer, "phase")
    phase.create_publisher(Empty, "phase/map", EVENTS)
    offer_reader_counts(phase, "phase")
    context = Context()  # a process of its own, for the middleware
    rclpy.init(context=context)
    recorder = Node("recorder", context=context)
    recorder.create_publisher(Empty, "recorder/status", LATCHED)
    matching = Matching(peer, {"phase": ["phase/map"]}, ("recorder",))
    peer.wait(lambda: peer.count_publishers("recorder/status"), "the recorder")
    peer.wait(lambda: not matching.unmatched(["phase"]), "the answer about a topic without readers")
    witness = ["recorder/status"]
    matching.forget(lambda: "".join(witness))
    deadline = time.monotonic() + 1.0
    while time.monotonic() < deadline:
        assert matching.unmatched(["phase"]) == ["/phase/map"]
        peer.serve(0.05)
    recorder.create_subscription(Empty, "phase/map", lambda _: None, EVENTS)
    peer.wait(lambda: not matching.unmatched(["phase"]), "the recorder, which reads the topic now")
    recorder.destroy_subscription(next(iter(recorder.subscriptions)))
    matching.forget(lambda: "".join(witness))
    peer.wait(lambda: not peer.count_subscribers("phase/map"), "the end of the subscription")
    matching.unmatched(["phase"])
    peer.serve(0.3)
    assert matching.unmatched(["phase"]) == ["/phase/map"]
    witness.clear()
    peer.wait(lambda: not matching.unmatched(["phase"]), "the end of the wait for a recorder that has stopped")
    recorder.destroy_node()
    rclpy.try_shutdown(context=context)
    phase.destroy_node()
