"""Steps and moves of a client whose servers fail, take long, or measure for others."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
import rclpy
from rclpy.action.server import ActionServer, CancelResponse, ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from fringedic.errors import NodeDiedError, StepFailedError, WaitTimeoutError
from fringedic_bringup import client
from fringedic_bringup.client import RigClient
from fringedic_msgs.action import MeasureStep, MoveCrosshead
from fringedic_msgs.msg import StepStatus
from fringedic_ros.qos import EVENTS
from fringedic_ros.spinning import Spinning
from fringedic_ros.waiting import sleep

SLOW, SILENT, FAILING = 1e-3, 2e-3, 3e-3  # positions, for moves of these kinds
SILENCE_S = 1.5


class Rig(Node):
    """Serves steps that last until they are cancelled, and moves whose kind is their position."""

    def __init__(self) -> None:
        super().__init__("rig", namespace="rig")
        self.steps = self.create_publisher(StepStatus, "experiment/step", EVENTS)
        group = ReentrantCallbackGroup()
        options = {"callback_group": group, "cancel_callback": lambda _: CancelResponse.ACCEPT}
        ActionServer(self, MeasureStep, "measure_step", self._measure, **options)
        ActionServer(self, MoveCrosshead, "move_crosshead", self._move, **options)

    async def _measure(self, goal: ServerGoalHandle) -> MeasureStep.Result:
        while not goal.is_cancel_requested:
            goal.publish_feedback(MeasureStep.Feedback())
            await sleep(self, 0.05)
        goal.canceled()
        return MeasureStep.Result(error_code=MeasureStep.Result.CANCELLED, step=5)

    async def _move(self, goal: ServerGoalHandle) -> MoveCrosshead.Result:
        if goal.request.position == FAILING:
            raise RuntimeError("the register does not hold this number")
        end = time.monotonic() + 2.5 * SILENCE_S
        while time.monotonic() < end:
            if goal.request.position == SLOW:
                goal.publish_feedback(MoveCrosshead.Feedback())
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


@pytest.mark.usefixtures("rig")
def test_a_move_may_take_as_long_as_it_reports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "STEP_TIMEOUT_S", SILENCE_S)
    with RigClient() as controller:
        assert controller.move(SLOW).position == SLOW
        with pytest.raises(WaitTimeoutError, match=f"crosshead to 2.0000 mm: no answer after {SILENCE_S:g} s"):
            controller.move(SILENT)


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
