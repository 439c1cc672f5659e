"""Measures one step: shows the patterns, has them photographed, waits for results, recorder and load samples."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node

from experiment_node.experiment_parameters import ExperimentParameters
from experiment_node.running_step import Experiment, RunningStep
from experiment_node.topics import PUBLISHED, READERS
from experiment_node.turn import StepFailure, Turn
from fringedic.errors import WaitTimeoutError
from fringedic.load_samples import summarise_load
from fringedic.sequence import PatternKind, Projection
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import Exposure, LoadState, NodeStatus, RecorderStatus, Reference, StepStatus
from fringedic_msgs.srv import CaptureFrame, ShowPattern
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.matching import Matching
from fringedic_ros.qos import EVENTS, LATCHED, STATE
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.waiting import Condition

Result = MeasureStep.Result
HELD = (LoadState.HOLD, LoadState.IDLE)
FAILED_NODE = {
    "phase": Result.PHASE_FAILED,
    "dic": Result.DIC_FAILED,
    "coupling": Result.COUPLING_FAILED,
}
FAILED_STATUS = {NodeStatus.PATTERN_NOT_SEEN: Result.PATTERN_NOT_SEEN}  # of any node; other codes name the node
CAPTURE_ERRORS = {
    CaptureFrame.Request.CAMERA_TIMEOUT: Result.CAMERA_TIMEOUT,
    CaptureFrame.Request.CAMERA_FAILED: Result.CAMERA_FAILED,
    CaptureFrame.Request.NO_SUBSCRIBER: Result.NO_SUBSCRIBER,
}
CONNECTING_TIME = 1.0  # [s] from the last node that connects to the first exposure
RECORDER_TIMEOUT = 5.0  # [s] for the recorder's answer to the stage PROCESS; it speaks every second anyway
LOAD_TIMEOUT = 0.5  # [s] for a load sample of now, or of the last exposure, to come in


class StepRunner:
    """Everything that a load step and a step of a calibration have in common.

    Parameters
    ----------
    node
        Owner of clients, publishers and subscriptions.
    changed
        Notified by every callback; what runs waits for it.
    diagnostics
        Told how each step ended.

    Attributes
    ----------
    placed
        Stamp with which a stage said what stands in front of the camera; frames are not taken before the camera knows.
    """

    def __init__(self, node: Node, changed: Condition, diagnostics: NodeDiagnostics) -> None:
        self._node = node
        self._changed = changed
        self._diagnostics = diagnostics
        self._running: RunningStep | None = None
        self._recorder: RecorderStatus | None = None
        self._load: LoadState | None = None
        self.placed = Time()  # stamp of what stands in front of the camera, where a stage says so
        self._steps = node.create_publisher(StepStatus, "experiment/step", EVENTS)
        self._references = node.create_publisher(Reference, "experiment/reference", LATCHED)
        self._show = node.create_client(ShowPattern, "projector/show")
        self._capture = node.create_client(CaptureFrame, "camera/capture")
        self._connected = dict.fromkeys(("camera/exposure", *(f"{name}/status" for name in FAILED_NODE)), False)
        self._connected_at = time.monotonic()
        self._newcomer = True  # somebody whom not everybody may know yet
        self._matching = Matching(node, PUBLISHED, READERS)
        self._subscribe_connected(Exposure, "camera/exposure", self._take_exposure)
        for name in FAILED_NODE:
            self._subscribe_connected(NodeStatus, f"{name}/status", self._result_taker(name))
        node.create_subscription(LoadState, "load_frame/state", self._take_load, STATE)
        node.create_subscription(RecorderStatus, "recorder/status", self._take_recorder, LATCHED)

    def publish_reference(self, experiment: Experiment, step: int) -> None:
        """Tell everybody which step the following ones are measured against."""
        message = Reference(experiment=experiment.name, step=step)
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._references.publish(message)

    async def measure(self, step: RunningStep, parameters: ExperimentParameters) -> StepFailure | None:
        """Measure one step, from the stage BEGIN to END or ERROR; return why it failed, None when it did not."""
        experiment = step.experiment
        self._running = step
        failure: StepFailure | None = None
        try:
            try:
                await self._become_ready(step, parameters)
            finally:
                self._begin_step(step)
            await self._check_hold(step, parameters)
            await self._take_frames(step, parameters)
            if not step.failed_node:
                await self._check_load(step, parameters)
            await self._await_results(step, parameters)
        except StepFailure as error:
            failure = error
        except Exception as error:
            failure = StepFailure(Result.CAMERA_FAILED, f"{type(error).__name__}: {error}")
        finally:
            self._running = None
        if failure is None:
            experiment.measured.add(step.number)
            if step.is_reference:
                experiment.reference, experiment.next_is_reference = step.number, False
            self._diagnostics.success(step.processing_time)
        else:
            failure = StepFailure(failure.code, f"experiment '{experiment.name}', step {step.number}: {failure}")
            if step.is_reference and experiment.reference is not None:
                self.publish_reference(experiment, experiment.reference)
            self._node.get_logger().error(str(failure))
            self._diagnostics.failure(str(failure))
        self._announce(step, StepStatus.END if failure is None else StepStatus.ERROR, failure)
        return failure

    async def reach_readers(self, turn: Turn, nodes: Collection[str], timeout_s: float) -> None:
        """Wait until what these nodes publish reaches everybody who listens.

        Raises
        ------
        StepFailure
            NO_SUBSCRIBER.
        """
        self._matching.forget()
        await turn.wait_polling(
            lambda: not self._matching.unmatched(nodes),
            timeout_s,
            lambda: (
                Result.NO_SUBSCRIBER,
                f"{', '.join(self._matching.unmatched(nodes))}: not all who listen are reached; start the nodes anew",
            ),
        )

    # what the others say

    def _take_exposure(self, message: Exposure) -> None:
        step = self._running
        if step is not None and step.is_named(message.experiment, message.step):
            middle, half = to_nanoseconds(message.header.stamp), round(message.exposure_time * 1e9 / 2)
            step.exposures[message.index] = (middle - half, middle + half)
            self._changed.notify()

    def _take_load(self, message: LoadState) -> None:
        self._load = message
        if self._running is not None:
            self._running.load.append(message)
            self._changed.notify()

    def _take_recorder(self, message: RecorderStatus) -> None:
        self._recorder = message
        if message.state == RecorderStatus.STARTING:
            self._newcomer, self._connected_at = True, time.monotonic()
        step = self._running
        if step is not None and step.taken == len(step.projections):
            step.recorder_answered = True
        self._changed.notify()

    def _result_taker(self, name: str) -> Callable[[NodeStatus], None]:
        def take(message: NodeStatus) -> None:
            step = self._running
            if step is not None and step.is_named(message.experiment, message.step):
                step.statuses[name] = message
                step.answered = time.monotonic()
                self._changed.notify()

        return take

    def _subscribe_connected(self, kind: type[Any], topic: str, callback: Callable[[Any], None]) -> None:
        """Subscribe to what every step needs, and keep in mind whether its publisher is connected."""

        def matched(event: Any) -> None:
            self._connected[topic] = event.current_count > 0
            if event.current_count_change > 0:
                self._newcomer = True
            self._connected_at = time.monotonic()
            self._changed.notify()

        events = SubscriptionEventCallbacks(matched=matched)
        self._node.create_subscription(kind, topic, callback, EVENTS, event_callbacks=events)

    # before the first frame

    async def _become_ready(self, step: RunningStep, parameters: ExperimentParameters) -> None:
        """Before the first frame of an experiment: whoever is there has to be connected, or would miss it.

        So has a node that was started again meanwhile.
        """
        if self._newcomer:
            self._newcomer = step.experiment.ready = False
        if step.experiment.ready:
            return

        def absent() -> list[str]:
            needed = ("camera/exposure", *(f"{name}/status" for name in step.nodes))
            return [topic for topic in needed if not self._connected[topic]]

        timeout = parameters.start_timeout_s
        await step.turn.wait(
            lambda: not absent(),
            timeout,
            lambda: (Result.NO_SUBSCRIBER, f"nobody publishes {', '.join(absent())}; start the nodes they belong to"),
        )
        await self._await_quiet_graph(step)
        await self.reach_readers(step.turn, step.nodes, timeout)
        await step.turn.wait_polling(
            lambda: self._steps.get_subscription_count() >= self._node.count_subscribers("experiment/step"),
            timeout,
            lambda: (Result.NO_SUBSCRIBER, "a subscriber of experiment/step does not match; compare its QoS"),
        )
        if parameters.recording_required:
            await step.turn.wait(
                lambda: self._recorder_state() in (RecorderStatus.RECORDING, RecorderStatus.FAILED),
                timeout,
                lambda: (Result.RECORDER_FAILED, "recording is required and no recorder is recording; start it"),
            )
            self._check_recorder(parameters)

    async def _await_quiet_graph(self, step: RunningStep) -> None:
        """Wait for who may still be on their way: nodes find each other while this one finds them."""

        def listeners() -> list[int]:
            readers = [self._node.count_subscribers(topic) for topic in ("camera/image_raw", "camera/exposure")]
            services = [self._node.count_services(client.srv_name) for client in (self._show, self._capture)]
            return readers + services

        found, since = listeners(), self._connected_at
        while (left := since + CONNECTING_TIME - time.monotonic()) > 0:
            await step.turn.pause(min(left, 0.1))
            if found != (found := listeners()):
                since = time.monotonic()

    def _begin_step(self, step: RunningStep) -> None:
        if step.is_reference:
            self.publish_reference(step.experiment, step.number)
        self._announce(step, StepStatus.BEGIN)
        step.feed_back("begin", step)

    async def _check_hold(self, step: RunningStep, parameters: ExperimentParameters) -> None:
        if not parameters.hold_required or not self._node.count_publishers("load_frame/state"):
            return
        # the machine may have reached its hold just before it was told here: only a sample of now counts
        begin = self._node.get_clock().now().nanoseconds
        with suppress(WaitTimeoutError):
            await self._changed.wait(
                lambda: self._load is not None and to_nanoseconds(self._load.header.stamp) >= begin, LOAD_TIMEOUT
            )
        await step.turn.wait(
            lambda: self._load is not None,
            parameters.start_timeout_s,
            lambda: (Result.LOAD_NOT_HELD, "the load frame is there but says nothing on load_frame/state"),
        )
        _refuse_unheld([self._load])

    # frames and results

    async def _take_frames(self, step: RunningStep, parameters: ExperimentParameters) -> None:
        await step.turn.pause(parameters.settle_time_s)
        step.feed_back("capture", step)
        shown, on_screen = Time(), None
        for index, projection in enumerate(step.projections):
            if parameters.projector and projection != on_screen:  # the next exposure of a pattern finds it there
                shown, on_screen = await self._show_pattern(step, projection, parameters), projection
            await self._capture_frame(step, index, projection, shown, parameters)
            self._announce(step, StepStatus.CAPTURE)
            step.feed_back("capture", step)
            if parameters.hold_required:
                _refuse_unheld([self._load])
            self._check_recorder(parameters)
            if step.failed_node:
                return  # the rest of the sequence cannot help any more
        if parameters.projector and parameters.white_between_steps:
            await self._show_pattern(step, Projection(PatternKind.WHITE), parameters)
        step.experiment.ready = True

    async def _show_pattern(self, step: RunningStep, projection: Projection, parameters: ExperimentParameters) -> Time:
        request = ShowPattern.Request(
            kind=int(projection.kind),
            pitch=projection.pitch,
            shift=projection.shift,
            shifts=projection.shifts,
            orientation=int(projection.orientation),
        )
        response = await step.turn.call(
            self._show, request, parameters.projector_timeout_s, Result.PROJECTOR_TIMEOUT, str(projection)
        )
        if response.error_code != ShowPattern.Request.NONE:
            raise StepFailure(Result.PROJECTOR_FAILED, f"{projection}: {response.error_message}")
        return response.shown

    async def _capture_frame(
        self, step: RunningStep, index: int, projection: Projection, shown: Time, parameters: ExperimentParameters
    ) -> None:
        first = index == 0  # whoever reads frames must be connected before: a camera may have been started anew
        count = self._node.count_subscribers
        request = CaptureFrame.Request(
            experiment=step.experiment.name,
            step=step.number,
            index=index,
            count=len(step.projections),
            kind=int(projection.kind),
            orientation=int(projection.orientation),
            pitch=projection.pitch,
            shift=projection.shift,
            shifts=projection.shifts,
            exposure_time=parameters.exposure_time(index, projection),
            shown=shown,
            placed=self.placed,
            image_subscribers=count("camera/image_raw") if first else 0,
            exposure_subscribers=count("camera/exposure") if first else 0,
        )
        # a first frame waits for subscribers, and the camera knows better than a time-out which are not there
        timeout = parameters.camera_timeout_s + (parameters.start_timeout_s if first else 0.0)
        response = await step.turn.call(self._capture, request, timeout, Result.CAMERA_TIMEOUT, f"frame {index}")
        if response.error_code != CaptureFrame.Request.NONE:
            if parameters.hold_required:
                _refuse_unheld([self._load])  # a camera that looks at the machine cannot do without it
            code = CAPTURE_ERRORS.get(response.error_code, Result.CAMERA_FAILED)
            raise StepFailure(code, f"frame {index}: {response.error_message}")
        stamp = to_nanoseconds(response.stamp)
        if not first and stamp <= step.stamp:
            raise StepFailure(
                Result.CAMERA_FAILED,
                f"frame {index} is stamped {1e-9 * (step.stamp - stamp):.3f} s before frame {index - 1}: the clock "
                "jumped back; measure the step again, and let nothing set the clock during a test",
            )
        step.stamps.append(stamp)
        step.exposed = time.monotonic()

    async def _await_results(self, step: RunningStep, parameters: ExperimentParameters) -> None:
        self._announce(step, StepStatus.PROCESS)
        step.feed_back("process", step)

        def open_nodes() -> list[str]:
            return [name for name in step.nodes if name not in step.statuses]

        await step.turn.wait(
            lambda: not open_nodes(),
            parameters.processing_timeout_s,
            lambda: (Result.PROCESSING_TIMEOUT, f"no result from {', '.join(open_nodes())}"),
        )
        failed = step.failed_node
        if failed is not None:
            status = step.statuses[failed]
            code = FAILED_STATUS.get(status.error_code, FAILED_NODE[failed])
            raise StepFailure(code, f"{failed}: {status.error_message}")
        if parameters.recording_required:
            await step.turn.wait(
                lambda: step.recorder_answered or self._recorder_state() != RecorderStatus.RECORDING,
                RECORDER_TIMEOUT,
                lambda: (
                    Result.RECORDER_FAILED,
                    "the recorder does not answer; what it has recorded is readable",
                ),
            )
            self._check_recorder(parameters)

    async def _check_load(self, step: RunningStep, parameters: ExperimentParameters) -> None:
        """Look at what the load frame did while the frames were exposed; before the results, which take longer."""
        await step.turn.wait(
            lambda: {0, len(step.projections) - 1} <= step.exposures.keys(),
            parameters.camera_timeout_s,
            lambda: (Result.CAMERA_FAILED, "the camera published no exposure record of the first or last frame"),
        )
        if self._load is None or not self._node.count_publishers("load_frame/state"):
            return
        await self._wait_for_load(step)
        samples = step.load_during_exposures()
        if parameters.hold_required:
            _refuse_unheld(samples)
        _refuse_drift(samples, parameters)

    async def _wait_for_load(self, step: RunningStep) -> None:
        """Wait a moment for the sample after the last exposure; a machine that went silent is told by the result."""
        end = step.exposures[len(step.projections) - 1][1]
        with suppress(WaitTimeoutError):
            await self._changed.wait(
                lambda: bool(step.load) and to_nanoseconds(step.load[-1].header.stamp) >= end, LOAD_TIMEOUT
            )

    def _recorder_state(self) -> int:
        if self._recorder is None or not self._node.count_publishers("recorder/status"):
            return RecorderStatus.IDLE
        return self._recorder.state

    def _check_recorder(self, parameters: ExperimentParameters) -> None:
        if parameters.recording_required and self._recorder_state() != RecorderStatus.RECORDING:
            told = self._recorder or RecorderStatus()
            code = Result.DISK_FULL if told.error_code == RecorderStatus.DISK_FULL else Result.RECORDER_FAILED
            raise StepFailure(code, f"the recorder stopped recording: {told.error_message or 'it is gone or idle'}")

    def _announce(self, step: RunningStep, stage: int, failure: StepFailure | None = None) -> None:
        message = StepStatus(
            experiment=step.experiment.name,
            step=step.number,
            stage=stage,
            frame=step.taken,
            frames=len(step.projections),
            reference=step.is_reference,
        )
        if stage in (StepStatus.BEGIN, StepStatus.CAPTURE) or not step.stamp:
            message.header.stamp = self._node.get_clock().now().to_msg()
        else:
            message.header.stamp = to_msg(step.stamp)
        if failure is not None:
            message.error_code, message.error_message = failure.code, str(failure)
        self._steps.publish(message)


def _refuse_unheld(samples: Iterable[LoadState | None]) -> None:
    for sample in samples:
        if sample is None or sample.mode in HELD:
            continue
        if sample.mode == LoadState.UNKNOWN:
            words = "the load frame does not tell what it does; look at its connection and at the log of load_frame"
        else:
            doing = "was moving" if sample.mode == LoadState.MOVING else "reported a fault"
            words = (
                f"the load frame {doing} at position {sample.position * 1e3:.4f} mm, {sample.force:.1f} N; "
                "it has to hold from before the first exposure until after the last one"
            )
        raise StepFailure(Result.LOAD_NOT_HELD, words)


def _refuse_drift(samples: Sequence[LoadState], parameters: ExperimentParameters) -> None:
    """End the step when force or position went further during the exposures than the parameters allow."""
    stamps = [to_nanoseconds(sample.header.stamp) for sample in samples]
    for what, values, factor, unit, limit in (
        ("force", [sample.force for sample in samples], 1.0, "N", parameters.load_drift_n),
        ("crosshead", [sample.position for sample in samples], 1e6, "µm", parameters.position_drift_um),
    ):
        summary = summarise_load(stamps, values)
        if limit and not summary.samples:
            raise StepFailure(
                Result.LOAD_DRIFT,
                f"no sample of the {what} came during the exposures, so that nobody knows its drift; sample faster, or "
                "set its limit to 0",
            )
        drift = factor * summary.drift
        if limit and abs(drift) > limit:
            raise StepFailure(
                Result.LOAD_DRIFT,
                f"the {what} drifted by {drift:+.3g} {unit} during the exposures, {limit:g} {unit} are allowed; "
                "hold longer before the step",
            )
