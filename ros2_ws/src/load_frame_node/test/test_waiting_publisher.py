"""A load frame node whose middleware keeps a publisher waiting, as when it opens the port of another process."""

from __future__ import annotations

import threading
from typing import Any

import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.action import ActionClient
from rclpy.publisher import Publisher

from fringedic_msgs.action import MoveCrosshead
from fringedic_ros.qos import STATE
from fringedic_ros.spinning import Spinning
from fringedic_ros.testing import Peer
from load_frame_node.load_frame_node import LoadFrameNode


@pytest.mark.usefixtures("ros")
def test_a_move_until_a_force_does_not_wait_for_the_publisher(monkeypatch: pytest.MonkeyPatch) -> None:
    over = threading.Event()
    publish = Publisher.publish

    def wait_and_publish(publisher: Publisher, message: Any) -> None:
        if isinstance(message, WrenchStamped):
            over.wait(60.0)
        publish(publisher, message)

    monkeypatch.setattr(Publisher, "publish", wait_and_publish)
    with Spinning() as spinning:
        spinning.add(LoadFrameNode.started())
        operator = Peer()
        samples = operator.listen(WrenchStamped, "load_frame/wrench", STATE)

        def beyond() -> list[float]:
            return [each.wrench.force.z for each in samples if each.wrench.force.z >= 50.0]

        move = ActionClient(operator, MoveCrosshead, "move_crosshead")
        operator.wait(move.server_is_ready, "the action server")
        operator.meet("load_frame")
        goal = move.send_goal_async(MoveCrosshead.Goal(position=1e-3, speed=2e-5, force_above=[50.0]))
        operator.wait(goal.done, "the answer to the goal")
        ended = goal.result().get_result_async()
        operator.wait(ended.done, "the end of the move", 40.0)
        over.set()
        operator.wait(beyond, "the samples that waited")
        reached = beyond()[0]
        operator.destroy_node()
    result = ended.result().result
    assert result.error_code == MoveCrosshead.Result.NONE, result.error_message
    assert result.reached_force == reached, "the first sample beyond the limit"
