"""A topic that is read when its reader has time."""

from __future__ import annotations

import pytest
from std_msgs.msg import Float64

from fringedic_ros.polled import PolledTopic
from fringedic_ros.qos import LATEST
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
