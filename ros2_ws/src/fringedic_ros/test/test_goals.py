"""Goals whose requests, responses or results are lost."""

from __future__ import annotations

import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.action.server import ActionServer, GoalResponse, ServerGoalHandle
from rclpy.node import Node
from rclpy.task import Future

from fringedic.errors import StepFailedError
from fringedic_msgs.action import MoveCrosshead
from fringedic_ros import goals
from fringedic_ros.goals import RepeatedGoal
from fringedic_ros.testing import Peer
from fringedic_ros.waiting import sleep


class LossyClient(ActionClient):
    """Loses the first request, or only the response to it: as between processes that have not discovered each other."""

    def __init__(self, node: Node, *, requests: bool) -> None:
        super().__init__(node, MoveCrosshead, "move_crosshead")
        self.requests, self.lost = requests, False

    def send_goal_async(self, *arguments: Any) -> Future:
        lost, self.lost = not self.lost, True
        sent = Future() if lost and self.requests else super().send_goal_async(*arguments)
        return Future() if lost else sent


class Machine:
    """An action server that counts its moves."""

    def __init__(self, node: Node, answer: GoalResponse = GoalResponse.ACCEPT) -> None:
        self.positions: list[float] = []
        self.server = ActionServer(node, MoveCrosshead, "move_crosshead", self._move, goal_callback=lambda _: answer)

    def _move(self, goal: ServerGoalHandle) -> MoveCrosshead.Result:
        self.positions.append(goal.request.position)
        goal.succeed()
        return MoveCrosshead.Result(position=goal.request.position)


@pytest.fixture
def peer() -> Iterator[Peer]:
    rclpy.init()
    peer = Peer("load_frame")
    yield peer
    peer.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def controller(peer: Peer) -> Iterator[Node]:
    node = Node("controller")
    peer.serve_also(node)
    yield node
    node.destroy_node()


@pytest.mark.parametrize("requests", [True, False], ids=["request", "response"])
def test_a_goal_runs_once_after_its_request_or_its_response_was_lost(
    peer: Peer, controller: Node, *, requests: bool
) -> None:
    client = LossyClient(controller, requests=requests)
    goal = RepeatedGoal(client, MoveCrosshead.Goal(position=1e-3), lambda _: None)
    assert not goal.send(), "there is no server"
    machine = Machine(peer)
    peer.wait(goal.send, "the answer to the goal", 30)
    assert client.lost
    assert goal.is_accepted
    peer.wait(goal.request_result, "the result", 30)
    assert goal.result.position == 1e-3
    assert machine.positions == [1e-3]
    assert goal.send(), "an answered goal is not sent again"
    client.destroy()
    machine.server.destroy()


def test_a_refused_goal_is_not_accepted(peer: Peer, controller: Node) -> None:
    client, machine = ActionClient(controller, MoveCrosshead, "move_crosshead"), Machine(peer, GoalResponse.REJECT)
    goal = RepeatedGoal(client, MoveCrosshead.Goal(), lambda _: None)
    peer.wait(goal.send, "the answer to the goal", 30)
    assert not goal.is_accepted
    assert not machine.positions
    client.destroy()
    machine.server.destroy()


def test_a_server_that_was_started_again_proves_nothing(peer: Peer, controller: Node) -> None:
    """The result of an unknown goal is an empty message without an error code."""
    client, machine = ActionClient(controller, MoveCrosshead, "move_crosshead"), Machine(peer)
    goal = RepeatedGoal(client, MoveCrosshead.Goal(position=1e-3), lambda _: None)
    peer.wait(goal.send, "the answer to the goal", 30)
    peer.wait(lambda: machine.positions, "the move", 30)
    machine.server.destroy()
    successor = Machine(peer)
    peer.wait(goal.request_result, "the response to the request of the result", 30)
    assert goal.is_accepted
    assert goal.result is None
    assert not successor.positions
    client.destroy()
    successor.server.destroy()


class FailingMachine(Machine):
    """Fails in the middle of a move."""

    def _move(self, _: ServerGoalHandle) -> MoveCrosshead.Result:
        raise RuntimeError("the register does not hold this number")


def test_a_server_that_fails_during_a_goal_has_no_success(peer: Peer, controller: Node) -> None:
    """The result of an aborted goal is an empty message without an error code, too."""
    client, machine = ActionClient(controller, MoveCrosshead, "move_crosshead"), FailingMachine(peer)
    goal = RepeatedGoal(client, MoveCrosshead.Goal(position=1e-3), lambda _: None)
    peer.wait(goal.send, "the answer to the goal", 30)
    peer.wait(goal.request_result, "the result", 30)
    with pytest.raises(StepFailedError, match="MoveCrosshead: its server failed; the log of the server"):
        _ = goal.result
    client.destroy()
    machine.server.destroy()


class SlowMachine:
    """Reports for a while where it is."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.server = ActionServer(node, MoveCrosshead, "move_crosshead", self._move)

    async def _move(self, goal: ServerGoalHandle) -> MoveCrosshead.Result:
        end = time.monotonic() + 2.0
        while time.monotonic() < end:
            goal.publish_feedback(MoveCrosshead.Feedback())
            await sleep(self._node, 0.05)
        goal.succeed()
        return MoveCrosshead.Result(position=goal.request.position)


def test_a_long_move_does_not_collect_requests_of_its_result(
    peer: Peer, controller: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    requested = []
    request = ClientGoalHandle.get_result_async
    monkeypatch.setattr(ClientGoalHandle, "get_result_async", lambda it: requested.append(it) or request(it))
    monkeypatch.setattr(goals, "AGAIN_S", 0.5)
    clock = SimpleNamespace(now=0.0, monotonic=lambda: clock.now)
    monkeypatch.setattr(goals, "time", clock)

    def pass_time(_: MoveCrosshead.Feedback) -> None:
        clock.now += 0.4

    client, machine = ActionClient(controller, MoveCrosshead, "move_crosshead"), SlowMachine(peer)
    goal = RepeatedGoal(client, MoveCrosshead.Goal(position=1e-3), pass_time)
    peer.wait(goal.send, "the answer to the goal", 30)
    peer.wait(goal.request_result, "the result", 30)
    assert goal.result.position == 1e-3
    assert clock.now > 2.0
    assert len(requested) == 1
    client.destroy()
    machine.server.destroy()
