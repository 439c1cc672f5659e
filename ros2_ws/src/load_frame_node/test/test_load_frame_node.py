"""The load frame node in a process of its own: moves, holds, samples and refused goals."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import WrenchStamped
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from fringedic_msgs.action import MoveCrosshead
from fringedic_msgs.msg import LoadState
from fringedic_ros.qos import STATE
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.testing import NodeProcess, Peer

MM = 1e-3
Result = MoveCrosshead.Result


class Operator(Peer):
    """Moves the crosshead and watches."""

    def __init__(self) -> None:
        super().__init__()
        self.states = self.listen(LoadState, "load_frame/state", STATE)
        self.wrenches = self.listen(WrenchStamped, "load_frame/wrench", STATE)
        self.joints = self.listen(JointState, "load_frame/joint_states", STATE)
        self.feedback: list[MoveCrosshead.Feedback] = []
        self._move = ActionClient(self, MoveCrosshead, "move_crosshead")
        self._hold = self.create_client(Trigger, "load_frame/hold")

    def start(self, position: float, speed: float, controller: str = "", **limits: list[float]) -> ClientGoalHandle:
        self.wait(self._move.server_is_ready, "the action server")
        self.meet("load_frame")
        goal = MoveCrosshead.Goal(position=position, speed=speed, controller=controller, **limits)
        future = self._move.send_goal_async(goal, lambda message: self.feedback.append(message.feedback))
        self.wait(future.done, "the answer to the goal")
        return future.result()

    def end(self, goal: ClientGoalHandle) -> Any:
        future = goal.get_result_async()
        self.wait(future.done, "the result")
        return future.result()

    def move(self, position: float, speed: float, controller: str = "") -> Any:
        return self.end(self.start(position, speed, controller))

    def hold(self) -> Trigger.Response:
        return self.ask(self._hold, Trigger.Request(), "the hold")

    def now(self) -> LoadState:
        """Return a sample that was taken from now on; earlier ones may still be on their way."""
        begin = time.time_ns()
        self.wait(lambda: self.states and to_nanoseconds(self.states[-1].header.stamp) > begin, "samples")
        return self.states[-1]

    def forget_states(self) -> None:
        """Forget the samples up to now, those on their way too: a topic keeps their order."""
        self.now()
        self.states.clear()


@pytest.fixture(scope="module")
def operator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Operator]:
    rclpy.init()
    operator = Operator()
    with NodeProcess("load_frame_node.load_frame_node", tmp_path_factory.mktemp("load_frame")):
        yield operator
    operator.destroy_node()
    rclpy.shutdown()


def test_reaches_the_position_and_holds_in_tension(operator: Operator) -> None:
    operator.feedback.clear()
    answer = operator.move(0.5 * MM, 0.2 * MM)
    assert (answer.status, answer.result.error_code) == (GoalStatus.STATUS_SUCCEEDED, Result.NONE)
    assert answer.result.position == pytest.approx(0.5 * MM, abs=1e-9)
    state = operator.now()
    assert (state.mode, state.position) == (LoadState.HOLD, pytest.approx(0.5 * MM, abs=1e-9))
    assert state.force > 500  # tension positive: 2000 N/mm, little relaxed
    positions = [feedback.position for feedback in operator.feedback]
    assert len(positions) >= 3
    assert positions == sorted(positions)


def test_three_topics_say_the_same(operator: Operator) -> None:
    def told_by_all() -> list[tuple[LoadState, WrenchStamped, JointState]]:
        states, wrenches, joints = ({to_nanoseconds(each.header.stamp): each for each in heard} for heard in topics)
        return [(states[k], wrenches[k], joints[k]) for k in states.keys() & wrenches.keys() & joints.keys()]

    topics = (operator.states, operator.wrenches, operator.joints)
    operator.forget()
    operator.wait(lambda: len(told_by_all()) > 15, "samples")
    for state, wrench, joint in told_by_all():
        assert wrench.wrench.force.z == state.force == joint.effort[0]
        assert joint.position[0] == state.position
        assert (joint.name, wrench.header.frame_id) == (["crosshead"], "load_frame")


def test_move_until_a_force(operator: Operator) -> None:
    """The node stops the machine by itself: 0.4 N per sample at 0.02 mm/s, 2000 N/mm and 100 Hz."""
    operator.move(0.1 * MM, 5.0 * MM)
    operator.forget_states()
    goal = operator.start(1.0 * MM, 0.02 * MM, force_above=[300.0])
    ended = operator.end(goal)
    assert (ended.status, ended.result.error_code) == (GoalStatus.STATUS_SUCCEEDED, Result.NONE)
    assert ended.result.force_reached
    assert operator.now().mode == LoadState.HOLD
    first = next(index for index, each in enumerate(operator.states) if each.force >= 300.0)
    reached = operator.states[first]
    held = next(each for each in operator.states[first:] if each.mode == LoadState.HOLD)
    assert ended.result.reached_force == reached.force
    passed_s = 1e-9 * (to_nanoseconds(held.header.stamp) - to_nanoseconds(reached.header.stamp))
    assert held.force < reached.force + 40.0 * passed_s + 1.0
    operator.forget_states()
    unloaded = operator.end(operator.start(0.0, 0.1 * MM, force_above=[900.0], force_below=[100.0]))
    assert operator.now().mode == LoadState.HOLD
    assert unloaded.result.reached_force == next(each.force for each in operator.states if each.force <= 100.0)
    assert not operator.move(0.05 * MM, 1.0 * MM).result.force_reached, "limits belong to one move"


def test_second_goal_is_busy_and_the_first_goes_on(operator: Operator) -> None:
    operator.move(0.0, 5.0 * MM)
    first = operator.start(0.4 * MM, 0.1 * MM, "tension")
    second = operator.move(0.1 * MM, 1.0 * MM, "fatigue")
    assert (second.status, second.result.error_code) == (GoalStatus.STATUS_ABORTED, Result.BUSY)
    assert "another goal, of tension to 0.4 mm; fatigue has to wait" in second.result.error_message
    assert operator.end(first).result.position == pytest.approx(0.4 * MM, abs=1e-9)


def test_cancelling_holds_where_it_is(operator: Operator) -> None:
    operator.move(0.0, 5.0 * MM)
    goal = operator.start(0.9 * MM, 0.2 * MM)
    operator.wait(lambda: operator.now().position > 0.05 * MM, "a start")
    cancelling = goal.cancel_goal_async()
    operator.wait(cancelling.done, "the cancelling")
    answer = operator.end(goal)
    assert (answer.status, answer.result.error_code) == (GoalStatus.STATUS_CANCELED, Result.CANCELLED)
    first, second = operator.now(), operator.now()
    assert first.mode == second.mode == LoadState.HOLD
    assert first.position == second.position == answer.result.position
    assert 0.05 * MM < first.position < 0.9 * MM


def test_hold_service_stops_a_move(operator: Operator) -> None:
    operator.move(0.0, 5.0 * MM)
    goal = operator.start(0.9 * MM, 0.2 * MM)
    operator.wait(lambda: operator.now().position > 0.05 * MM, "a start")
    assert operator.hold().success
    answer = operator.end(goal)
    assert (answer.status, answer.result.error_code) == (GoalStatus.STATUS_ABORTED, Result.CANCELLED)
    assert "load_frame/hold" in answer.result.error_message
    assert operator.now().mode == LoadState.HOLD
    assert operator.move(0.2 * MM, 5.0 * MM).result.error_code == Result.NONE


@pytest.mark.parametrize(
    ("position", "speed", "words"),
    [
        (1.5 * MM, 1.0 * MM, "1.5 mm is outside 0 to 1 mm"),
        (-0.1 * MM, 1.0 * MM, "-0.1 mm"),
        (float("nan"), 1.0 * MM, "nan mm"),
        (0.5 * MM, 0.0, "0 mm/s"),
        (0.5 * MM, -1.0 * MM, "-1 mm/s"),
        (0.5 * MM, 1.0, "1000 mm/s"),
    ],
)
def test_impossible_goal_is_refused_in_words(operator: Operator, position: float, speed: float, words: str) -> None:
    before = operator.now().position
    answer = operator.move(position, speed)
    assert (answer.status, answer.result.error_code) == (GoalStatus.STATUS_ABORTED, Result.INVALID_GOAL)
    assert words in answer.result.error_message
    assert operator.now().position == before


@pytest.mark.parametrize("limit", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("kind", ["force_above", "force_below"])
def test_limit_that_is_no_number_is_refused(operator: Operator, kind: str, limit: float) -> None:
    """A comparison with NaN is always false: the move had no limit."""
    before = operator.now().position
    answer = operator.end(operator.start(before + 0.01 * MM, 1.0 * MM, **{kind: [limit]}))
    assert (answer.status, answer.result.error_code) == (GoalStatus.STATUS_ABORTED, Result.INVALID_GOAL)
    assert f"a limit of the force is {limit:g} N; give a finite number" in answer.result.error_message
    assert operator.now().position == before
