"""Requests of the active goal."""

from __future__ import annotations

import threading
import time
from unittest.mock import MagicMock

import pytest
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from experiment_node.active_goal import ActiveGoal, StepFailure
from fringedic_ros.spinning import Spinning, end_node
from fringedic_ros.waiting import Condition

LIMIT_S = 0.4


class Server(Node):
    """Counts the requests that it answers."""

    def __init__(self) -> None:
        super().__init__("server")
        self.served = 0
        self.create_service(Trigger, "serve", self._serve)

    def _serve(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.served += 1
        return response


def test_a_response_that_came_while_the_caller_stood_still_is_taken(spinning: Spinning) -> None:
    """The responses to two other requests wait before it, and the executor takes one per turn."""
    node = spinning.add(Node("caller"))
    goal = ActiveGoal(node, Condition(node), MagicMock(spec=ServerGoalHandle), "step 0")
    client, server = node.create_client(Trigger, "serve"), Server()

    def stand_still() -> None:
        stop.cancel()
        while server.served < 4:
            time.sleep(0.01)
        time.sleep(1.5 * LIMIT_S)

    async def calls() -> None:
        nonlocal stop
        await goal.call(client, Trigger.Request(), 60.0, 1, "the first", again_s=1.0)
        for _ in range(2):
            client.call_async(Trigger.Request())
        stop = node.create_timer(0.0, stand_still, callback_group=ReentrantCallbackGroup())
        await goal.call(client, Trigger.Request(), LIMIT_S, 1, "the second")

    stop = node.create_timer(60.0, lambda: None)
    with Spinning() as beside:
        beside.add(server)
        spinning.run(calls, timeout_s=120.0)


def test_a_request_to_a_node_that_has_ended_fails_at_once(spinning: Spinning) -> None:
    """The successor, discovered before the end of the first server is known or after it, has not received it."""
    node = spinning.add(Node("caller"))
    goal = ActiveGoal(node, Condition(node), MagicMock(spec=ServerGoalHandle), "step 0")
    client = node.create_client(Trigger, "serve")
    received = threading.Event()

    async def never(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        received.set()
        await Future()
        return response

    async def call_in_vain() -> None:
        with pytest.raises(StepFailure, match="frame 0: serve did not answer: its node has ended"):
            await goal.call(client, Trigger.Request(), 60.0, 1, "frame 0")

    def replace() -> None:
        received.wait(60.0)
        successor.add(Node("server")).create_service(Trigger, "serve", lambda _, response: response)
        end_node(first)

    with Spinning() as beside, Spinning() as successor:
        first = beside.add(Node("server"))
        first.create_service(Trigger, "serve", never)
        replacing = threading.Thread(target=replace)
        replacing.start()
        spinning.run(call_in_vain, timeout_s=120.0)
        replacing.join()


def test_a_request_is_sent_again_until_its_limit(spinning: Spinning) -> None:
    node = spinning.add(Node("caller"))
    goal = ActiveGoal(node, Condition(node), MagicMock(spec=ServerGoalHandle), "step 0")
    client = MagicMock(wraps=node.create_client(Trigger, "serve"), srv_name="serve")
    client.service_is_ready.return_value = True

    async def call_in_vain() -> None:
        with pytest.raises(StepFailure, match=r"frame 0: serve did not answer in 0\.4 s"):
            await goal.call(client, Trigger.Request(), LIMIT_S, 1, "frame 0", again_s=0.15)

    spinning.run(call_in_vain, timeout_s=120.0)
    assert client.call_async.call_count == 3
    assert client.remove_pending_request.call_count == 3
