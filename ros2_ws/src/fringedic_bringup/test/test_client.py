"""Steps and moves of a client whose servers fail, take long, or measure for others."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import pytest
import rclpy
from builtin_interfaces.msg import Time
from rclpy.action import ActionClient
from rclpy.action.server import ActionServer, CancelResponse, ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from fringedic.configuration.conditions import Reading
from fringedic.errors import MoveStoppedError, NodeDiedError, StepFailedError, WaitTimeoutError
from fringedic_bringup import client
from fringedic_bringup.client import RigClient
from fringedic_msgs.action import MeasureStep, MoveCrosshead
from fringedic_msgs.msg import LoadState, Signal, StepStatus
from fringedic_ros.qos import EVENTS, STATE
from fringedic_ros.spinning import Spinning
from fringedic_ros.waiting import AGAIN_S, sleep

SLOW, SILENT, FAILING, CANCELLED = 1e-3, 2e-3, 3e-3, 7e-3  # positions, for moves of these kinds
STOPS = {  # and for those that end with these codes
    4e-3: MoveCrosshead.Result.CANCELLED,
    5e-3: MoveCrosshead.Result.MACHINE_FAULT,
    6e-3: MoveCrosshead.Result.STOPPED_ELSEWHERE,
}
SILENCE_S = 1.5


class Rig(Node):
    """Serves steps that last until they are cancelled, and moves whose kind is their position."""

    def __init__(self) -> None:
        super().__init__("rig", namespace="rig")
        self.steps = self.create_publisher(StepStatus, "experiment/step", EVENTS)
        self.loads = self.create_publisher(LoadState, "load_frame/state", STATE)
        self.strains = self.create_publisher(Float64, "extensometer/strain", STATE)
        self.signals = self.create_publisher(Signal, "signals", STATE)
        group = ReentrantCallbackGroup()
        options = {"callback_group": group, "cancel_callback": lambda _: CancelResponse.ACCEPT}
        ActionServer(self, MeasureStep, "measure_step", self._measure, **options)
        ActionServer(self, MoveCrosshead, "move_crosshead", self._move, **options)
        self.step_s = math.inf
        self.holds, self.holds_before_move = 0, -1
        self.create_service(Trigger, "load_frame/hold", self._hold, callback_group=MutuallyExclusiveCallbackGroup())

    async def _hold(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        await sleep(self, 1.5 * AGAIN_S)
        self.holds, response.success = self.holds + 1, True
        return response

    async def _measure(self, goal: ServerGoalHandle) -> MeasureStep.Result:
        end = time.monotonic() + self.step_s
        while not goal.is_cancel_requested:
            goal.publish_feedback(MeasureStep.Feedback())
            await sleep(self, 0.05)
            if time.monotonic() > end:
                goal.succeed()
                return MeasureStep.Result(step=5)
        goal.canceled()
        return MeasureStep.Result(error_code=MeasureStep.Result.CANCELLED, step=5)

    async def _move(self, goal: ServerGoalHandle) -> MoveCrosshead.Result:
        if goal.request.position == FAILING:
            raise RuntimeError("the register does not hold this number")
        self.holds_before_move = self.holds
        if goal.request.position in STOPS:
            goal.abort()
            return MoveCrosshead.Result(error_code=STOPS[goal.request.position], error_message="stopped")
        end = time.monotonic() + 2.5 * SILENCE_S
        while time.monotonic() < end:
            if goal.request.position == SLOW:
                goal.publish_feedback(MoveCrosshead.Feedback())
            if goal.request.position == CANCELLED and goal.is_cancel_requested:
                goal.canceled()
                return MoveCrosshead.Result(error_code=MoveCrosshead.Result.CANCELLED)
            await sleep(self, 0.1)
        goal.succeed()
        return MoveCrosshead.Result(position=goal.request.position)


@pytest.fixture
def rig() -> Iterator[Rig]:
    rclpy.init()
    with Spinning() as loop:
        rig = Rig()
        loop.add(rig)
        yield rig
    rclpy.try_shutdown()


@pytest.mark.usefixtures("rig")
def test_a_server_that_fails_during_a_move_has_not_moved() -> None:
    with RigClient() as controller, pytest.raises(StepFailedError, match="MoveCrosshead: its server failed"):
        controller.move(FAILING)


@pytest.mark.parametrize("position", STOPS)
def test_a_stop_by_something_else_in_a_move_is_told_from_a_failure(position: float, rig: Rig) -> None:
    rig.loads.publish(LoadState())
    with RigClient() as controller:
        for until in (None, lambda _: False):
            controller.wait_for(rig.loads.get_subscription_count, 30, lambda: "the subscription of the client")
            rig.loads.publish(LoadState())
            with pytest.raises(MoveStoppedError, match="stopped") as stopped:
                controller.move(position, until=until)
            assert stopped.value.error_code == STOPS[position]


def test_no_hold_of_the_client_itself_comes_after_its_next_move(rig: Rig) -> None:
    """It was requested again before the late answer, stopped the next move, and looked like a hold of somebody else."""
    with RigClient() as controller:
        controller.wait_for(lambda: controller.node.count_services("/rig/load_frame/hold"), 30, lambda: "the service")
        controller.sleep(0.5)
        controller.hold()
        assert rig.holds == 1
        with pytest.raises(MoveStoppedError):
            controller.move(next(iter(STOPS)))
    assert rig.holds_before_move == rig.holds == 2


@pytest.mark.usefixtures("rig")
def test_a_move_may_take_as_long_as_it_reports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "STEP_TIMEOUT_S", SILENCE_S)
    with RigClient() as controller:
        assert controller.move(SLOW).position == SLOW
        with pytest.raises(WaitTimeoutError, match=f"crosshead to 2.0000 mm: no answer after {SILENCE_S:g} s"):
            controller.move(SILENT)


def test_what_came_while_the_client_stood_still_is_not_missing(rig: Rig) -> None:
    """A busy computer, or Ctrl-Z: a turn takes longer than the whole wait; each of the next ones takes one message."""
    stops: list[float] = []

    def stand_still() -> None:
        if stops:
            for number in range(3):
                rig.steps.publish(StepStatus(experiment="plate", step=number))
            assert rig.steps.wait_for_all_acked(Duration(seconds=60))
            time.sleep(stops.pop())

    with RigClient(watch=stand_still) as controller:
        controller.wait_for(rig.steps.get_subscription_count, 30, lambda: "the subscription of the client")
        stops.append(1.5)
        controller.wait_for(lambda: controller.highest_step("plate") == 2, 1.0, lambda: "the steps")


@pytest.mark.usefixtures("rig")
def test_a_wait_ends_also_when_every_turn_is_long() -> None:
    with (
        RigClient(watch=lambda: time.sleep(0.2)) as controller,
        pytest.raises(WaitTimeoutError, match=r"the answer after 0.1 s"),
    ):
        controller.wait_for(lambda: False, 0.1, lambda: "the answer")


@pytest.mark.usefixtures("rig")
@pytest.mark.parametrize("is_absent", [True, False], ids=["node", "feedback"])
def test_a_step_goes_on_after_its_client_stood_still(is_absent: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its feedback waits in the queue, and the middleware may have to discover its node again."""
    monkeypatch.setattr(client, "STEP_TIMEOUT_S", 3.0)
    monkeypatch.setattr(client, "LOST_S", 3.0)
    begun, stops = list[MeasureStep.Feedback](), [4.5]

    def stand_still() -> None:
        if len(begun) > 5 and stops:  # the goal is accepted
            time.sleep(stops.pop())
            if is_absent:
                looks = iter([False])
                monkeypatch.setattr(ActionClient, "server_is_ready", lambda _: next(looks, True))

    def cancel_after_stop(feedback: MeasureStep.Feedback) -> None:
        begun.append(feedback)
        if not stops:
            controller.request_cancel()

    with (
        RigClient(watch=stand_still) as controller,
        pytest.raises(StepFailedError, match=f"error {MeasureStep.Result.CANCELLED}"),
    ):
        controller.measure(feedback=cancel_after_stop)


def test_a_strain_is_known_after_its_client_stood_still(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A strain that is not known ends a move."""
    monkeypatch.setattr(client, "SILENT_S", 0.5)
    seen: list[float] = []

    def stand_still(reading: Reading) -> bool:
        seen.append(reading.strain)
        if len(seen) == 1:
            time.sleep(0.8)
        return False

    with RigClient() as controller:
        for publisher in (rig.strains, rig.loads):
            controller.wait_for(publisher.get_subscription_count, 30, lambda: "the subscription of the client")
        rig.loads.publish(LoadState())
        rig.strains.publish(Float64(data=0.01))
        controller.wait_for(lambda: controller.reading.strain == 0.01, 30, lambda: "the strain")
        controller.move(SLOW, until=stand_still)
    assert seen[1] == 0.01


@pytest.mark.usefixtures("rig")
def test_a_cancel_that_is_requested_before_the_goal_is_answered_is_sent_with_the_answer() -> None:
    """Feedback may come before the answer, and is where a script asks for the end of its step."""
    asked: list[int] = []

    def watch() -> None:
        if measuring and not asked:  # the answer, if it is there, is taken after this
            asked.append(1)
            controller.request_cancel()

    measuring = False
    with RigClient(watch=watch) as controller:
        controller.sleep(0.2)
        measuring = True
        with pytest.raises(StepFailedError, match=f"error {MeasureStep.Result.CANCELLED}"):
            controller.measure()


@pytest.mark.usefixtures("rig")
def test_a_cancelled_step_has_a_number() -> None:
    begun, deaths = list[MeasureStep.Feedback](), [NodeDiedError("dic has ended")]

    def watch() -> None:
        if begun and deaths:
            raise deaths.pop()

    with RigClient(watch=watch) as controller:
        with pytest.raises(NodeDiedError):
            controller.measure(feedback=begun.append)
        controller.cancel()
        assert controller.last_step == 5


def test_the_steps_of_all_controllers_are_counted(rig: Rig) -> None:
    with RigClient() as controller:
        assert controller.highest_step("plate") == -1
        controller.wait_for(rig.steps.get_subscription_count, 30, lambda: "the subscription of the client")
        for experiment, number in (("plate", 7), ("plate", 6), ("calibration", 9)):
            rig.steps.publish(StepStatus(experiment=experiment, step=number, stage=StepStatus.BEGIN))
        controller.wait_for(lambda: controller.highest_step("calibration") == 9, 30, lambda: "the steps")
        assert controller.highest_step("plate") == 7
        assert controller.last_step == -1, "no step of this client"


def test_a_strain_or_a_signal_that_no_longer_comes_is_not_known(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its publisher stands still in a move until a strain: the machine went on to the position."""
    monkeypatch.setattr(client, "SILENT_S", 0.3)
    seen: list[float] = []
    grip = Signal(name="grip", quantity="temperature", unit="K", stamps=[Time()], values=[295.0], sigmas=[0.5])
    with RigClient() as controller:
        for publisher in (rig.strains, rig.loads, rig.signals):
            controller.wait_for(publisher.get_subscription_count, 30, lambda: "the subscription of the client")
        rig.signals.publish(Signal(name="grip", values=[290.0]))  # incomplete, and ignored
        for _ in range(9):
            rig.strains.publish(Float64(data=0.01))
            rig.signals.publish(grip)
            controller.sleep(0.01)
        rig.loads.publish(LoadState())
        controller.wait_for(lambda: controller.reading.strain == 0.01, 30, lambda: "the strain")

        def unknown(reading: Reading) -> bool:
            seen.append(reading.strain)
            temperatures.append(reading.signals["grip"])
            return math.isnan(reading.strain) and math.isnan(reading.signals["grip"])

        temperatures: list[float] = []
        controller.wait_for_signals({"force", "grip"})
        with pytest.raises(
            WaitTimeoutError, match=r"no sample of girp has come on signals; .*: force, grip, position\."
        ):
            controller.wait_for_signals({"girp"}, 0.1)
        controller.move(SLOW, until=unknown)
    assert (seen[0], temperatures[0]) == (0.01, 295.0)
    assert math.isnan(seen[-1] + temperatures[-1])


def test_a_signal_that_no_longer_comes_is_not_known_while_stacks_are_measured(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each stack is shorter than the silence, and the move was to end at a temperature."""
    monkeypatch.setattr(client, "SILENT_S", 0.8)
    rig.step_s = 0.3
    readings, stacks = list[Reading](), list[int]()
    grip = Signal(name="grip", quantity="temperature", unit="K", stamps=[Time()], values=[295.0], sigmas=[0.5])
    with RigClient() as controller:
        for publisher in (rig.loads, rig.signals):
            controller.wait_for(publisher.get_subscription_count, 30, lambda: "the subscription of the client")
        for _ in range(9):
            rig.signals.publish(grip)
            controller.sleep(0.01)
        rig.loads.publish(LoadState(mode=LoadState.MOVING))
        controller.wait_for_signals({"force", "grip"})

        def unknown(reading: Reading) -> bool:
            readings.append(reading)
            return math.isnan(reading.signals["grip"])

        controller.measure_while_moving(
            SLOW, 1e-3, until=unknown, measured=lambda result, _: stacks.append(result.step)
        )
    assert readings[0].signals["grip"] == 295.0
    assert len(stacks) >= 2
    assert math.isnan(readings[-1].signals["grip"])
    assert 0 <= readings[0].duration < readings[-1].duration


def test_a_cancel_between_two_stacks_ends_the_move(rig: Rig) -> None:
    """No stack was running, so that nothing was cancelled, and the machine went on."""
    rig.step_s = 0.1
    stacks: list[int] = []
    with RigClient() as controller:
        controller.wait_for(rig.loads.get_subscription_count, 30, lambda: "the subscription of the client")
        rig.loads.publish(LoadState(mode=LoadState.MOVING))

        def measured(result: MeasureStep.Result, _: bool) -> None:
            stacks.append(result.step)
            controller.request_cancel()

        with pytest.raises(MoveStoppedError):
            controller.measure_while_moving(CANCELLED, 1e-3, every_s=0.5, measured=measured)
    assert len(stacks) == 1


@pytest.mark.parametrize("position", [CANCELLED, SILENT])
def test_a_move_without_a_result_ends_with_the_samples(
    position: float, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The machine held at its force, the result did not come, and the wait lasted an hour."""
    monkeypatch.setattr(client, "LATE_RESULT_S", 1.0)
    rig.step_s = 0.1
    stacks: list[int] = []
    with RigClient() as controller:
        controller.wait_for(rig.loads.get_subscription_count, 30, lambda: "the subscription of the client")
        rig.loads.publish(LoadState(mode=LoadState.MOVING))

        def measured(result: MeasureStep.Result, _: bool) -> None:
            stacks.append(result.step)
            rig.loads.publish(LoadState(mode=LoadState.HOLD, position=1.2e-4, force=200.0))

        if position == SILENT:
            with pytest.raises(StepFailedError, match=r"stands still at 0.1200 mm, 200.0 N, but its node load_frame"):
                controller.measure_while_moving(position, 1e-3, measured=measured)
        else:  # ends when it is cancelled
            controller.measure_while_moving(position, 1e-3, measured=measured)
    assert stacks
