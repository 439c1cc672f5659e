"""Asks a processing node whose result is late whether it has received what it needs for the step."""

from __future__ import annotations

import time

from rclpy.node import Node

from experiment_node.active_goal import StepFailure
from experiment_node.running_step import RunningStep
from experiment_node.topics import PROCESSING_INPUTS
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.srv import QueryStep

ANSWER_S = 5.0  # longest wait for the answer of a node


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

        Raises
        ------
        StepFailure
            PROCESSING_TIMEOUT.
        """
        client = self._clients[name]
        if time.monotonic() - max(step.exposed, step.answered) < patience_s or not client.service_is_ready():
            return
        request = QueryStep.Request(experiment=step.experiment.name, step=step.number)
        lost = (MeasureStep.Result.PROCESSING_TIMEOUT, f"{name} has not received the inputs of the step")
        try:
            response = await step.goal.call(client, request, ANSWER_S, *lost)
        except StepFailure:
            step.goal.check()
            return  # a node without processor time: it has the time that is left
        if not response.received and name not in step.statuses:
            raise StepFailure(*lost)
