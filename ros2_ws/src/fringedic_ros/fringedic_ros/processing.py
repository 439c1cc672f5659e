"""Base of the phase, dic and coupling nodes: work outside the executor's thread, exactly one status per step."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from math import nan
from typing import Any, Generic, NamedTuple

from rclpy.logging import get_logger
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription

from fringedic.errors import ErrorCode, FringedicError, ImageError, reason_of
from fringedic.steps.remarks import Correction, Remark
from fringedic.steps.sentences import remark_sentence
from fringedic.warm_up import require_kernels
from fringedic_msgs.msg import Correction as CorrectionMessage
from fringedic_msgs.msg import NodeStatus, StepStatus
from fringedic_msgs.msg import Remark as RemarkMessage
from fringedic_msgs.srv import QueryStep
from fringedic_ros.arrivals import Arrivals
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.exchange import Exchange
from fringedic_ros.matching import offer_reader_counts
from fringedic_ros.parameters import ModelT, declare
from fringedic_ros.qos import EVENTS
from fringedic_ros.rig_node import RigNode
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.work import Worker

STATUS_CODES: dict[ErrorCode, int] = {
    ErrorCode.FRAME_MISSING: NodeStatus.FRAME_MISSING,
    ErrorCode.FRAME_DOUBLED: NodeStatus.FRAME_DOUBLED,
    ErrorCode.FRAME_LATE: NodeStatus.FRAME_LATE,
    ErrorCode.FRAME_MISMATCH: NodeStatus.FRAME_MISMATCH,
    ErrorCode.FLICKER: NodeStatus.FRAME_MISMATCH,
    ErrorCode.SURFACE_MOVED: NodeStatus.FRAME_MISMATCH,
    ErrorCode.INVALID_SEQUENCE: NodeStatus.FRAME_MISMATCH,
    ErrorCode.WRONG_PATTERN: NodeStatus.PATTERN_NOT_SEEN,
    ErrorCode.FRAMES_OUT_OF_ORDER: NodeStatus.PATTERN_NOT_SEEN,
    ErrorCode.NO_CORRELATION: NodeStatus.NO_CORRELATION,
    ErrorCode.NO_TEXTURE: NodeStatus.NO_CORRELATION,
    ErrorCode.NO_REFERENCE: NodeStatus.NO_REFERENCE,
    ErrorCode.TOO_FEW_VALID: NodeStatus.TOO_FEW_VALID,
    ErrorCode.SATURATED: NodeStatus.TOO_FEW_VALID,
    ErrorCode.DARK: NodeStatus.TOO_FEW_VALID,
    ErrorCode.NO_CALIBRATION: NodeStatus.NO_CALIBRATION,
    ErrorCode.OTHER_RIG: NodeStatus.NO_CALIBRATION,
}
REMEMBERED_STEPS = 1000
JOINED_STEPS = 4  # incomplete steps that are kept until their last message arrives
QUEUED_STEPS = 16  # complete steps that wait for the worker


@dataclass(frozen=True)
class Outcome:
    """Contents of the status of a measured step.

    Attributes
    ----------
    valid_fraction
        Valid pixels over all pixels.
    frames
        Number of frames used.
    phase_sigma, rms_displacement_px, rms_displacement
        Median standard deviation of the phase [rad], RMS of (d_x, d_y) [px], RMS of (u, v, w) [m].
    remarks
        What needs attention although the result is valid; each becomes a warning in the log, too.
    corrections
        Of the phase.
    relative
        The phase is known up to whole fringes only.
    reference_step, correlated_step
        The step from whose configuration a displacement counts, and the step whose texture was compared.
    window, method
        How an in-plane displacement was measured.
    """

    valid_fraction: float = nan
    frames: int = 0
    phase_sigma: float = nan
    rms_displacement_px: float = nan
    rms_displacement: float = nan
    remarks: tuple[Remark, ...] = ()
    corrections: tuple[Correction, ...] = ()
    relative: bool = False
    reference_step: int = 0
    correlated_step: int = 0
    window: int = 0
    method: str = ""


class StampJoin:
    """Joins messages of several topics with exactly equal stamps, in any order of arrival.

    Parameters
    ----------
    topics
        A stamp is complete with one message of each.
    capacity
        Incomplete stamps that are kept; the oldest is dropped when another begins.

    Attributes
    ----------
    unjoined
        Messages that were dropped.
    """

    def __init__(self, topics: Iterable[str], capacity: int = JOINED_STEPS) -> None:
        self._topics = frozenset(topics)
        self._capacity = capacity
        self._waiting: OrderedDict[int, dict[str, Any]] = OrderedDict()
        self.unjoined = 0

    def add(self, topic: str, stamp: int, message: Any) -> dict[str, Any] | None:
        """Add a message; return all messages of its stamp, by topic, when they are complete."""
        parts = self._waiting.setdefault(stamp, {})
        parts[topic] = message
        if parts.keys() == self._topics:
            return self._waiting.pop(stamp)
        while len(self._waiting) > self._capacity:
            self.unjoined += len(self._waiting.popitem(last=False)[1])
        return None

    def waiting(self, stamp: int, topics: Iterable[str]) -> dict[str, Any]:
        """Return the messages of these topics with this stamp when all have arrived, else nothing."""
        parts = self._waiting.get(stamp, {})
        return {topic: parts[topic] for topic in topics} if parts.keys() >= set(topics) else {}

    def discard(self, stamp: int) -> str:
        """Drop the messages with this stamp, and return which are missing; empty when none had arrived."""
        parts = self._waiting.pop(stamp, {})
        self.unjoined += len(parts)
        return f"waiting for {', '.join(sorted(self._topics - parts.keys()))}" if parts else ""


class StepId(NamedTuple):
    """A step that is being processed: its experiment, its number, and the stamp of its last exposure [ns]."""

    experiment: str
    step: int
    stamp: int

    @classmethod
    def of(cls, message: Any) -> StepId:
        """Return the step that a message with ``header``, ``experiment`` and ``step`` belongs to."""
        return cls(message.experiment, message.step, to_nanoseconds(message.header.stamp))

    def __str__(self) -> str:
        return f"experiment '{self.experiment}', step {self.step}"


class ProcessingNode(RigNode, Generic[ModelT]):
    """A node that publishes exactly one status per step, after every other message of the step.

    Heavy work runs in one background thread, step after step. A step in its queue is finished even when the experiment
    ends it; a step that still waits for messages then gets the status STEP_ABORTED.

    Subscriptions are served in the order of their creation. A subclass therefore creates those for the settings
    (reference, calibration) before those for the data, and calls `subscribe_to_steps` in between.

    Parameters
    ----------
    name
        Name of the node and first part of its topics.
    model
        Declares its parameters.
    rehearse
        Loads the machine code of its kernels, in the background thread, before the first step.
    exchange
        Of the nodes in the same process, which pass whole results to each other; None for a node alone in its process.
    """

    def __init__(
        self, name: str, model: type[ModelT], rehearse: Callable[[], None], exchange: Exchange | None = None
    ) -> None:
        require_kernels(get_logger(name).warning)
        super().__init__(name)
        self.exchange = exchange
        self.parameters = declare(self, model)
        self.diagnostics = NodeDiagnostics(self)
        self.worker = Worker(self)
        self.worker.submit(rehearse)
        self._answered: OrderedDict[tuple[str, int], None] = OrderedDict()
        self._unjoined = 0
        self._inputs: dict[str, Arrivals] = {}
        self._statuses = self.create_publisher(NodeStatus, f"{name}/status", EVENTS)
        self.create_service(QueryStep, f"{name}/query_step", self._tell_received)
        offer_reader_counts(self, name)

    def subscribe_to_steps(self) -> None:
        """Subscribe to the stages of the experiment's steps."""
        super().create_subscription(StepStatus, "experiment/step", self._take_step, EVENTS)

    def create_subscription(  # type: ignore[override]
        self, kind: Any, topic: str, callback: Callable[..., None], qos_profile: QoSProfile, **options: Any
    ) -> Subscription:
        """Create a subscription as a `RigNode` does; the messages of an input of the steps are counted."""
        of_rclpy = topic.startswith("/")
        if of_rclpy or qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:  # a setting: comes when it changes
            return super().create_subscription(kind, topic, callback, qos_profile, **options)
        arrivals = self._inputs[topic] = Arrivals(self, kind, topic)

        def take(message: Any) -> None:
            arrivals.take()
            callback(message)

        return super().create_subscription(kind, topic, take, qos_profile, **options)

    def answered(self, experiment: str, step: int) -> bool:
        """Return whether this step has its status, or the worker will publish it."""
        return (experiment, step) in self._answered

    def _tell_received(self, request: QueryStep.Request, response: QueryStep.Response) -> QueryStep.Response:
        response.received = self.answered(request.experiment, request.step)
        if not response.received:
            silent = [str(arrivals) for arrivals in self._inputs.values() if not arrivals.received]
            came = [f"{arrivals.received} of {topic}" for topic, arrivals in self._inputs.items()]
            response.missing = "; ".join(silent) or f"messages that came since the step before: {', '.join(came)}"
        return response

    def measure(self, step: StepId, work: Callable[[], Outcome]) -> None:
        """Queue the work of a step, which publishes its results; the status follows."""
        if self.worker.pending >= QUEUED_STEPS:
            behind = f"{QUEUED_STEPS} steps are waiting already; give this node more time between steps"
            self.answer(step, NodeStatus.FAILED, behind)
        elif self._close(step):
            self.worker.submit(self._measure, step, work, time.monotonic())

    def answer(self, step: StepId, error_code: int, error_message: str) -> None:
        """Publish the status of a step that is not measured, unless it has one."""
        if self._close(step):
            self._publish(step, NodeStatus(error_code=error_code, error_message=error_message))

    def skip(self, step: StepId) -> None:
        """Publish the status of a step that contains nothing for this node, unless it has one."""
        if self._close(step):
            self._publish(step, NodeStatus(skipped=True))

    def fail(self, step: StepId, error: Exception) -> None:
        """Publish the status of a step that failed with an exception, unless it has one."""
        self.answer(step, *_code_and_reason(error))

    def refuse_input(self, name: str, status: NodeStatus) -> None:
        """Publish the status of a step whose input the node `name` could not measure."""
        aborted = status.error_code == NodeStatus.STEP_ABORTED
        code = NodeStatus.STEP_ABORTED if aborted else NodeStatus.INPUT_FAILED
        self.answer(StepId.of(status), code, f"{name}: {status.error_message}")

    def report_unjoined(self, total: int) -> None:
        """Count the messages that could not be joined in the diagnostics; `total` since the start."""
        self.diagnostics.drop(total - self._unjoined)
        self._unjoined = total

    def destroy_node(self) -> None:
        """Stop the worker before the publishers are destroyed."""
        self.worker.stop()
        super().destroy_node()

    def _take_step(self, message: StepStatus) -> None:
        if message.stage == StepStatus.ERROR:
            step = StepId.of(message)
            missing = self.abandon(step)
            reason = f"the experiment ended the step: {message.error_message}"
            if missing:
                reason += f" (here: {missing})"
            self.answer(step, NodeStatus.STEP_ABORTED, reason)

    def abandon(self, step: StepId) -> str:
        """Drop the messages of a step that the experiment ended, and return which are missing; for subclasses."""
        raise NotImplementedError

    def _close(self, step: StepId) -> bool:
        key = (step.experiment, step.step)
        if key in self._answered:
            return False
        self._answered[key] = None
        for arrivals in self._inputs.values():
            arrivals.renew()
        while len(self._answered) > REMEMBERED_STEPS:
            self._answered.popitem(last=False)
        return True

    def _measure(self, step: StepId, work: Callable[[], Outcome], began: float) -> None:
        status = NodeStatus()
        try:
            outcome = work()
            _fill_in(status, outcome)
            for remark in outcome.remarks:
                self.get_logger().warning(f"{step}: {remark_sentence(remark)}")
        except Exception as error:
            status = NodeStatus()
            status.error_code, status.error_message = _code_and_reason(error)
        status.duration = time.monotonic() - began
        self._publish(step, status)

    def _publish(self, step: StepId, status: NodeStatus) -> None:
        status.node, status.sensor = self.get_name(), self.sensor
        status.experiment, status.step = step.experiment, step.step
        status.header.stamp = to_msg(step.stamp)
        if status.skipped or status.error_code:
            _fill_in(status, Outcome())
        if status.error_code == NodeStatus.NONE:
            self.diagnostics.success(status.duration)
        else:
            self.get_logger().error(f"{step}: {status.error_message}")
            self.diagnostics.failure(f"{step}: {status.error_message}")
        self._statuses.publish(status)


def _fill_in(status: NodeStatus, outcome: Outcome) -> None:
    """Enter the figures of a step that was measured."""
    for each in fields(outcome):
        if each.name not in ("remarks", "corrections"):
            setattr(status, each.name, getattr(outcome, each.name))
    status.remarks = [
        RemarkMessage(code=each.code, names=list(each.values), values=list(each.values.values()))
        for each in outcome.remarks
    ]
    status.corrections = [CorrectionMessage(kind=str(each.kind), size=each.size) for each in outcome.corrections]


def _code_and_reason(error: Exception) -> tuple[int, str]:
    code = error.code if isinstance(error, FringedicError) else None
    reason = reason_of(error)
    if code in STATUS_CODES:
        return STATUS_CODES[code], reason
    if isinstance(error, ImageError):
        return NodeStatus.FRAME_MISMATCH, reason
    return NodeStatus.FAILED, f"{type(error).__name__}: {reason}"
