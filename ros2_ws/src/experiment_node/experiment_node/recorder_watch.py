"""Recorder as a step observes it: no step without a recording, when one is required."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node

from experiment_node.active_goal import StepFailure
from experiment_node.running_step import RunningStep
from fringedic.settings.experiment import ExperimentNodeSettings
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import RecorderStatus
from fringedic_ros.qos import LATCHED
from fringedic_ros.serialized import step_crc

Result = MeasureStep.Result
RECORDER = "recorder/status"
CONFIRM_TIMEOUT = 15.0  # [s] from the last frame; a recorder that was started again is not heard for some seconds


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
        node.create_subscription(RecorderStatus, RECORDER, self._take, LATCHED)

    def _take(self, message: RecorderStatus) -> None:
        self._latest = message
        self._on_status(message)

    @property
    def state(self) -> int:
        """State of the recorder; IDLE when there is none."""
        if self._latest is None or not self._node.count_publishers(RECORDER):
            return RecorderStatus.IDLE
        return self._latest.state

    @property
    def records_results(self) -> bool:
        """Whether a recorder records the results of the processing nodes."""
        return self.state == RecorderStatus.RECORDING and self._latest is not None and self._latest.derived

    async def await_start(self, step: RunningStep, parameters: ExperimentNodeSettings) -> None:
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

    async def await_confirmation(self, step: RunningStep, parameters: ExperimentNodeSettings) -> None:
        """Wait until the required recorder confirms every frame of the step, with the CRCs that the camera sent.

        Raises
        ------
        StepFailure
            RECORDER_FAILED, DISK_FULL.
        """
        if parameters.recording_required:
            await step.goal.wait(
                lambda: self._has_confirmed(step) or self.state != RecorderStatus.RECORDING,
                CONFIRM_TIMEOUT,
                lambda: (Result.RECORDER_FAILED, self._unconfirmed(step)),
            )
            self.check(parameters)
            step.recorded_frames, step.recorded_crc = len(step.patterns), step_crc(step.image_crcs())

    def _has_confirmed(self, step: RunningStep) -> bool:
        latest = self._latest
        if latest is None or not step.is_named(latest.experiment, latest.step) or len(step.crcs) < len(step.patterns):
            return False
        return latest.step_frames == len(step.patterns) and latest.step_crc == step_crc(step.image_crcs())

    def _unconfirmed(self, step: RunningStep) -> str:
        latest, frames = self._latest, len(step.patterns)
        if latest is None or not step.is_named(latest.experiment, latest.step):
            return "the recorder does not answer; the messages that it has written remain readable"
        if latest.step_frames < frames:
            return f"the recorder has {latest.step_frames} of the {frames} frames; measure the step again"
        return "the recorder has frames with another checksum than the camera sent; measure the step again"

    def check(self, parameters: ExperimentNodeSettings) -> None:
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
