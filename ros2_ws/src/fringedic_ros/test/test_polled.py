"""A topic that is read when its reader has time."""

from __future__ import annotations

import time

import pytest
from std_msgs.msg import Float64

from fringedic_ros.polled import PolledTopic
from fringedic_ros.qos import LATEST, STATE
from fringedic_ros.testing import Peer


@pytest.mark.usefixtures("ros")
def test_the_newest_message_is_there_when_it_is_asked_for() -> None:
    peer = Peer()
    try:
        polled = PolledTopic[Float64](peer, Float64, "samples", LATEST)
        called = peer.listen(Float64, "samples", LATEST)
        sender = peer.create_publisher(Float64, "samples", LATEST)
        peer.wait(lambda: sender.get_subscription_count() == 2, "both subscriptions")
        assert polled.take() is None
        for value in range(5):
            sender.publish(Float64(data=float(value)))
            peer.wait(lambda value=value: called and called[-1].data == value, "the message")  # type: ignore[misc]
        peer.wait(lambda: (found := polled.take()) is not None and found.data == 4.0, "the newest message")
        assert polled.take() is None
    finally:
        peer.destroy_node()


@pytest.mark.usefixtures("ros")
def test_the_callback_is_called_by_a_reader_and_while_somebody_listens() -> None:
    peer = Peer()
    received: list[float] = []
    try:
        polled = PolledTopic[Float64](peer, Float64, "samples", STATE, callback=lambda each: received.append(each.data))
        arrived = peer.listen(Float64, "samples", STATE)
        sender = peer.create_publisher(Float64, "samples", STATE)
        peer.wait(lambda: sender.get_subscription_count() == 2, "both subscriptions")
        for value in (1.0, 2.0):
            sender.publish(Float64(data=value))
        peer.wait(lambda: len(arrived) == 2, "the messages")
        assert not received
        deadline = time.monotonic() + 180
        while len(received) < 2 and time.monotonic() < deadline:
            polled.read()
        assert received == [1.0, 2.0]
        with polled.listening():
            sender.publish(Float64(data=3.0))
            peer.wait(lambda: len(received) == 3, "the message")
        sender.publish(Float64(data=4.0))
        peer.wait(lambda: len(arrived) == 4, "the message after the end")
        assert received == [1.0, 2.0, 3.0]
    finally:
        peer.destroy_node()
