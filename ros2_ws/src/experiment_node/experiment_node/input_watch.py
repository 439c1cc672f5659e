"""Asks a processing node whose result is late whether it has received what it needs for the step."""

from __future__ import annotations

import time

from rclpy.node import Node

from experiment_node.active_goal import StepFailure
from experiment_node.running_step import RunningStep
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.srv import QueryStep
from fringedic_ros.topics import PROCESSING_INPUTS

ANSWER_S = 5.0  # longest wait for the answer of a node
AGAIN_S = 5.0  # at most, after which a node without inputs is asked once more


class InputWatch:
    """Finds lost messages between processing nodes.

    A message that is published before its reader is connected never arrives. Which readers are connected is known
    before the first frame as far as processes can know it of each other; this is the proof afterwards.

    Parameters
    ----------
    node
        Owner of the clients.
    """

    def __init__(self, node: Node) -> None:
        self._clients = {name: node.create_client(QueryStep, f"{name}/query_step") for name in PROCESSING_INPUTS}

    async def check(self, step: RunningStep, name: str, patience_s: float) -> None:
        """End the step if a node lacks inputs, `patience_s` after the last frame or the result of the node before it.

        A node that stood still takes one message of each topic before the request, and the others after it. It is
        therefore asked a second time, unless a result arrives in between.

        Raises
        ------
        StepFailure
            PROCESSING_TIMEOUT.
        """
        client = self._clients[name]
        if time.monotonic() - max(step.exposed, step.answered) < patience_s or not client.service_is_ready():
            return
        missing = await self._missing(step, name)
        if missing is None:
            return
        lost = (MeasureStep.Result.PROCESSING_TIMEOUT, f"{name} has not received the inputs of the step{missing}")
        answered = step.answered
        try:
            await step.goal.wait(lambda: step.answered != answered, min(patience_s, AGAIN_S), lambda: lost)
        except StepFailure:
            step.goal.check()
            if await self._missing(step, name) is not None:
                raise

    async def _missing(self, step: RunningStep, name: str) -> str | None:
        """Return what a node reports about inputs that it lacks, None when it lacks none.

        One without processor time has the time that is left.
        """
        request = QueryStep.Request(experiment=step.experiment.name, step=step.number)
        try:
            response = await step.goal.call(
                self._clients[name], request, ANSWER_S, MeasureStep.Result.PROCESSING_TIMEOUT, name
            )
        except StepFailure:
            step.goal.check()
            return None
        if response.received or name in step.statuses:
            return None
        return f": {response.missing}" if response.missing else ""
