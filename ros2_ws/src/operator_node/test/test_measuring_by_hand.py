"""A step that is measured by hand, with an experiment node that answers late; no browser."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from unittest.mock import MagicMock

import pytest
import rclpy
from rclpy.action.server import ActionServer, GoalResponse, ServerGoalHandle

from fringedic.errors import OperatorError
from fringedic.report.page_server.app import Measure
from fringedic_msgs.action import MeasureStep
from fringedic_ros.testing import Peer
from operator_node import operator_node
from operator_node.operator_node import TOKEN, OperatorNode


class Experiment(Peer):
    """An experiment node; it does not answer before it is spun."""

    operator: OperatorNode

    def __init__(self) -> None:
        super().__init__("experiment")
        self.answer = GoalResponse.ACCEPT
        self.shown: list[str] = []  # by the page at the begin of each step
        self._server = ActionServer(self, MeasureStep, "measure_step", self._measure, goal_callback=self._respond)

    def _respond(self, _: MeasureStep.Goal) -> GoalResponse:
        return self.answer

    async def _measure(self, goal: ServerGoalHandle) -> MeasureStep.Result:
        while not (shown := hand(self.operator)):
            await asyncio.sleep(0)  # one turn of the executor
        self.shown.append(shown)
        goal.succeed()
        return MeasureStep.Result(step=len(self.shown))

    def destroy_node(self) -> None:
        self._server.destroy()
        super().destroy_node()


@pytest.fixture
def experiment() -> Iterator[Experiment]:
    rclpy.init()
    experiment = Experiment()
    yield experiment
    experiment.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def operator(experiment: Experiment, monkeypatch: pytest.MonkeyPatch) -> Iterator[OperatorNode]:
    """The node without its server; a request has to be answered at once."""
    monkeypatch.setenv(TOKEN, "0123456789abcdef")
    monkeypatch.setattr(operator_node, "PageServer", MagicMock())
    monkeypatch.setattr(operator_node, "ANSWER_S", 0.0)
    operator = OperatorNode()
    experiment.operator = operator
    yield operator
    operator.destroy_node()


@pytest.fixture
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    """The event loop of the page's server."""
    loop = asyncio.new_event_loop()
    yield loop
    loop.close()


def hand(operator: OperatorNode) -> str:
    """Return the sentence of the page about the step that is measured by hand."""
    return str(operator.snapshot()["hand"])


def measure_without_answer(loop: asyncio.AbstractEventLoop, experiment: Experiment, operator: OperatorNode) -> None:
    experiment.wait(lambda: operator.snapshot()["rig"]["measures"], "the action server")
    with pytest.raises(OperatorError, match="the request may still be carried out"):
        loop.run_until_complete(operator.do(Measure()))
    assert not hand(operator)
    experiment.serve_also(operator)


def test_a_step_that_is_accepted_late_is_shown_until_its_result(
    loop: asyncio.AbstractEventLoop, experiment: Experiment, operator: OperatorNode
) -> None:
    measure_without_answer(loop, experiment, operator)
    experiment.wait(lambda: hand(operator) == "step 1 is measured", "the result of the step")
    assert experiment.shown == ["measuring"]


def test_a_step_that_is_refused_late_is_shown(
    loop: asyncio.AbstractEventLoop, experiment: Experiment, operator: OperatorNode
) -> None:
    experiment.answer = GoalResponse.REJECT
    measure_without_answer(loop, experiment, operator)
    experiment.wait(lambda: hand(operator), "the refusal")
    assert hand(operator).startswith("not measured: the experiment node refuses the step")
