"""Recorder as a step observes it: no step without a recording, when one is required."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node

from experiment_node.active_goal import StepFailure
from experiment_node.experiment_parameters import ExperimentParameters
from experiment_node.running_step import RunningStep
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import RecorderStatus
from fringedic_ros.qos import LATCHED

Result = MeasureStep.Result
RECORDER_TIMEOUT = 5.0  # [s] for the answer to the stage PROCESS; the recorder publishes its status every second anyway


class RecorderWatch:
    """Keeps the latest `recorder/status`.

    Parameters
    ----------
    node
        Owner of the subscription.
    on_status
        Called with each status.
    """

    def __init__(self, node: Node, on_status: Callable[[RecorderStatus], None]) -> None:
        self._node = node
        self._on_status = on_status
        self._latest: RecorderStatus | None = None
        node.create_subscription(RecorderStatus, "recorder/status", self._take, LATCHED)

    def _take(self, message: RecorderStatus) -> None:
        self._latest = message
        self._on_status(message)

    @property
    def state(self) -> int:
        """State of the recorder; IDLE when there is none."""
        if self._latest is None or not self._node.count_publishers("recorder/status"):
            return RecorderStatus.IDLE
        return self._latest.state

    async def await_start(self, step: RunningStep, parameters: ExperimentParameters) -> None:
        """Wait until the required recorder records.

        Raises
        ------
        StepFailure
            RECORDER_FAILED, DISK_FULL.
        """
        if parameters.recording_required:
            await step.goal.wait(
                lambda: self.state in (RecorderStatus.RECORDING, RecorderStatus.FAILED),
                parameters.start_timeout_s,
                lambda: (Result.RECORDER_FAILED, "recording is required and no recorder is recording; start it"),
            )
            self.check(parameters)

    async def await_answer(self, step: RunningStep, parameters: ExperimentParameters) -> None:
        """Wait until the required recorder answers the stage PROCESS, which it does after the last frame.

        Raises
        ------
        StepFailure
            RECORDER_FAILED, DISK_FULL.
        """
        if parameters.recording_required:
            await step.goal.wait(
                lambda: step.recorder_answered or self.state != RecorderStatus.RECORDING,
                RECORDER_TIMEOUT,
                lambda: (
                    Result.RECORDER_FAILED,
                    "the recorder does not answer; the messages that it has written remain readable",
                ),
            )
            self.check(parameters)

    def check(self, parameters: ExperimentParameters) -> None:
        """Check that the required recorder records.

        Raises
        ------
        StepFailure
            RECORDER_FAILED, DISK_FULL.
        """
        if parameters.recording_required and self.state != RecorderStatus.RECORDING:
            status = self._latest or RecorderStatus()
            code = Result.DISK_FULL if status.error_code == RecorderStatus.DISK_FULL else Result.RECORDER_FAILED
            reason = status.error_message or "it is absent or idle"
            raise StepFailure(code, f"the recorder stopped recording: {reason}")
