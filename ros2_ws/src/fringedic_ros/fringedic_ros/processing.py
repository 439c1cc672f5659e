"""What the phase, dic and coupling nodes share: work off the executor's thread, and exactly one status per step."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import nan
from typing import Any, Generic

from rclpy.node import Node

from fringedic.errors import (
    CalibrationMissingError,
    FrameDoubledError,
    FrameLateError,
    FrameMismatchError,
    FrameMissingError,
    FramesOutOfOrderError,
    ImageMessageError,
    ImageSizeError,
    InvalidSequenceError,
    NoCorrelationError,
    ReferenceMissingError,
    ShapeMismatchError,
    TexturelessImageError,
    TooFewValidError,
    WrongPatternError,
)
from fringedic_msgs.msg import NodeStatus, StepStatus
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.matching import offer_reader_counts
from fringedic_ros.parameters import ModelT, declare
from fringedic_ros.qos import EVENTS
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.work import Worker

ERROR_CODES: dict[type[Exception], int] = {  # the first that fits counts
    FrameMissingError: NodeStatus.FRAME_MISSING,
    FrameDoubledError: NodeStatus.FRAME_DOUBLED,
    WrongPatternError: NodeStatus.PATTERN_NOT_SEEN,
    FramesOutOfOrderError: NodeStatus.PATTERN_NOT_SEEN,
    FrameMismatchError: NodeStatus.FRAME_MISMATCH,
    ImageMessageError: NodeStatus.FRAME_MISMATCH,
    InvalidSequenceError: NodeStatus.FRAME_MISMATCH,
    ImageSizeError: NodeStatus.FRAME_MISMATCH,
    ShapeMismatchError: NodeStatus.FRAME_MISMATCH,
    FrameLateError: NodeStatus.FRAME_LATE,
    NoCorrelationError: NodeStatus.NO_CORRELATION,
    TexturelessImageError: NodeStatus.NO_CORRELATION,
    ReferenceMissingError: NodeStatus.NO_REFERENCE,
    TooFewValidError: NodeStatus.TOO_FEW_VALID,
    CalibrationMissingError: NodeStatus.NO_CALIBRATION,
}
REMEMBERED_STEPS = 1000
JOINED_STEPS = 4  # incomplete ones, kept until their last message comes
QUEUED_STEPS = 16  # complete ones, waiting for the worker


@dataclass(frozen=True)
class Outcome:
    """What the status of a measured step says.

    Attributes
    ----------
    valid_fraction
        Valid pixels over all pixels.
    rms
        Median 1-sigma of the phase [rad], or rms displacement [px] or [m].
    frames
        Frames used.
    remark
        What should be known about a good result; the status' message, and a warning in the log.
    relative
        The phase is true up to whole fringes only.
    correlated_step
        The step whose images this step's were compared with, for a displacement.
    """

    valid_fraction: float = nan
    rms: float = nan
    frames: int = 0
    remark: str = ""
    relative: bool = False
    correlated_step: int = 0


class StampJoin:
    """Joins messages of several topics that carry exactly the same stamp, in whatever order they arrive.

    Parameters
    ----------
    topics
        One message of each makes a whole.
    capacity
        Incomplete stamps that are kept; the oldest goes when another begins.

    Attributes
    ----------
    unjoined
        Messages that were given up.
    """

    def __init__(self, topics: Iterable[str], capacity: int = JOINED_STEPS) -> None:
        self._topics = frozenset(topics)
        self._capacity = capacity
        self._waiting: OrderedDict[int, dict[str, Any]] = OrderedDict()
        self.unjoined = 0

    def add(self, topic: str, stamp: int, message: Any) -> dict[str, Any] | None:
        """Take one message and return all of its stamp, by topic, when it was the last one."""
        parts = self._waiting.setdefault(stamp, {})
        parts[topic] = message
        if parts.keys() == self._topics:
            return self._waiting.pop(stamp)
        while len(self._waiting) > self._capacity:
            self.unjoined += len(self._waiting.popitem(last=False)[1])
        return None

    def waiting(self, stamp: int, topics: Iterable[str]) -> dict[str, Any]:
        """Return what has arrived with this stamp once all of these topics have, else nothing."""
        parts = self._waiting.get(stamp, {})
        return {topic: parts[topic] for topic in topics} if parts.keys() >= set(topics) else {}

    def discard(self, stamp: int) -> str:
        """Give up what has arrived with this stamp, and say what has not; empty when nothing has."""
        parts = self._waiting.pop(stamp, {})
        self.unjoined += len(parts)
        return f"waiting for {', '.join(sorted(self._topics - parts.keys()))}" if parts else ""


class ProcessingNode(Node, Generic[ModelT]):
    """A node that answers every step of an experiment with one status, last of everything it publishes of the step.

    Heavy work runs in one background thread, step after step. A step that is in its queue is finished whatever the
    experiment decides; one that still waits for messages when the experiment ends it is answered STEP_ABORTED.

    Subscriptions are served in the order of their creation. So a subclass creates those that say how to measure
    (reference, calibration) before those that bring what is measured, and calls `subscribe_to_steps` in between.

    Parameters
    ----------
    name
        Name of the node and first part of its topics.
    model
        Declares its parameters.
    """

    def __init__(self, name: str, model: type[ModelT]) -> None:
        super().__init__(name)
        self.parameters = declare(self, model)
        self.diagnostics = NodeDiagnostics(self)
        self.worker = Worker(self)
        self._answered: OrderedDict[tuple[str, int], None] = OrderedDict()
        self._unjoined = 0
        self._statuses = self.create_publisher(NodeStatus, f"{name}/status", EVENTS)
        offer_reader_counts(self, name)

    def subscribe_to_steps(self) -> None:
        """Begin to hear how the experiment's steps end."""
        self.create_subscription(StepStatus, "experiment/step", self._take_step, EVENTS)

    def answered(self, experiment: str, step: int) -> bool:
        """Whether this step has its status, or will get it from the worker."""
        return (experiment, step) in self._answered

    def measure(self, experiment: str, step: int, stamp: int, work: Callable[[], Outcome]) -> None:
        """Queue the work of a step, which publishes what it measures; the status follows."""
        if self.worker.pending >= QUEUED_STEPS:
            behind = f"{QUEUED_STEPS} steps are waiting already; give this node more time between steps"
            self.answer(experiment, step, stamp, NodeStatus.FAILED, behind)
        elif self._close(experiment, step):
            self.worker.submit(self._measure, experiment, step, stamp, work, time.monotonic())

    def answer(self, experiment: str, step: int, stamp: int, error_code: int, error_message: str = "") -> None:
        """End a step without any work, unless it has been answered."""
        if self._close(experiment, step):
            self._publish(experiment, step, stamp, Outcome(), 0.0, error_code, error_message)

    def fail(self, experiment: str, step: int, stamp: int, error: Exception) -> None:
        """End a step with the code of an exception, unless it has been answered."""
        self.answer(experiment, step, stamp, *_code_and_message(error))

    def refuse_input(self, name: str, status: NodeStatus) -> None:
        """End a step whose input the node `name` could not measure."""
        aborted = status.error_code == NodeStatus.STEP_ABORTED
        self.answer(
            status.experiment,
            status.step,
            to_nanoseconds(status.header.stamp),
            NodeStatus.STEP_ABORTED if aborted else NodeStatus.INPUT_FAILED,
            f"{name}: {status.error_message}",
        )

    def report_unjoined(self, total: int) -> None:
        """Count in the diagnostics what could not be joined, `total` since the start."""
        self.diagnostics.drop(total - self._unjoined)
        self._unjoined = total

    def destroy_node(self) -> None:
        """Stop the worker before the publishers go."""
        self.worker.stop()
        super().destroy_node()

    def _take_step(self, message: StepStatus) -> None:
        if message.stage == StepStatus.ERROR:
            stamp = to_nanoseconds(message.header.stamp)
            missing = self.abandon(message.experiment, message.step, stamp)
            reason = f"the experiment ended the step: {message.error_message}"
            if missing:
                reason += f" (here: {missing})"
            self.answer(message.experiment, message.step, stamp, NodeStatus.STEP_ABORTED, reason)

    def abandon(self, experiment: str, step: int, stamp: int) -> str:
        """Forget what has arrived of a step that the experiment ended, and say what has not; for subclasses."""
        return ""

    def _close(self, experiment: str, step: int) -> bool:
        key = (experiment, step)
        if key in self._answered:
            return False
        self._answered[key] = None
        while len(self._answered) > REMEMBERED_STEPS:
            self._answered.popitem(last=False)
        return True

    def _measure(self, experiment: str, step: int, stamp: int, work: Callable[[], Outcome], began: float) -> None:
        outcome, code, message = Outcome(), NodeStatus.NONE, ""
        try:
            outcome = work()
            message = outcome.remark
        except Exception as error:
            code, message = _code_and_message(error)
        self._publish(experiment, step, stamp, outcome, time.monotonic() - began, code, message)

    def _publish(
        self, experiment: str, step: int, stamp: int, outcome: Outcome, duration: float, code: int, message: str
    ) -> None:
        status = NodeStatus(
            node=self.get_name(),
            experiment=experiment,
            step=step,
            error_code=code,
            error_message=message,
            valid_fraction=outcome.valid_fraction,
            relative=outcome.relative,
            correlated_step=outcome.correlated_step,
            rms=outcome.rms,
            frames=outcome.frames,
            duration=duration,
        )
        status.header.stamp = to_msg(stamp)
        if code == NodeStatus.NONE:
            self.diagnostics.success(duration)
            if message:
                self.get_logger().warning(f"experiment '{experiment}', step {step}: {message}")
        else:
            self.get_logger().error(f"experiment '{experiment}', step {step}: {message}")
            self.diagnostics.failure(message)
        self._statuses.publish(status)


def _code_and_message(error: Exception) -> tuple[int, str]:
    for kind, code in ERROR_CODES.items():
        if isinstance(error, kind):
            return code, str(error)
    return NodeStatus.FAILED, f"{type(error).__name__}: {error}"
