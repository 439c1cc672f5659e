"""What is known of the step that is being measured."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from rclpy.action.server import ServerGoalHandle

from fringedic.sequence import Projection
from fringedic_msgs.msg import LoadState, NodeStatus
from fringedic_ros.stamps import to_nanoseconds

LOAD_SAMPLES = 200_000  # kept, over three minutes at 1 kHz


class StepFailure(Exception):
    """Ends the running step with one of the error codes of MeasureStep."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass
class RunningStep:
    """What is known of the step that is being measured."""

    goal: ServerGoalHandle
    number: int
    projections: tuple[Projection, ...]
    is_reference: bool
    cancelled: bool = False
    started: float = field(default_factory=time.monotonic)
    taken: int = 0
    stamp: int = 0  # of the last exposure [ns]
    exposed: float = 0.0  # when the last frame was reported [s], monotonic
    answered: float = 0.0  # when the last result came [s], monotonic
    recorder_answered: bool = False  # to the stage PROCESS
    exposures: dict[int, tuple[int, int]] = field(default_factory=dict)  # start and end of each frame [ns]
    statuses: dict[str, NodeStatus] = field(default_factory=dict)
    load: deque[LoadState] = field(default_factory=lambda: deque(maxlen=LOAD_SAMPLES))

    def failed_node(self, nodes: Sequence[str]) -> str | None:
        """Return the first node of the chain that answered with an error."""
        for name in nodes:
            if name in self.statuses and self.statuses[name].error_code != NodeStatus.NONE:
                return name
        return None

    def load_during_exposures(self) -> list[LoadState]:
        """Return the samples from the start of the first exposure to the end of the last one."""
        start, end = self.exposures[0][0], self.exposures[len(self.projections) - 1][1]
        return [sample for sample in self.load if start <= to_nanoseconds(sample.header.stamp) <= end]
