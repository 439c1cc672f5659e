"""Runs load steps: shows the patterns, has them photographed, waits for the results, and answers the load frame.

The caller of the action ``measure_step`` holds the machine; this node only observes it, and asks for a hold when a
step fails.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from math import nan
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.client import Client
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from experiment_node.experiment_parameters import ExperimentParameters
from experiment_node.running_step import RunningStep, StepFailure
from fringedic.errors import WaitTimeoutError
from fringedic.rig import RigModel
from fringedic.sequence import PatternKind, Projection
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import (
    Exposure,
    LoadState,
    NodeStatus,
    RecorderStatus,
    Reference,
    RigCalibration,
    StepStatus,
)
from fringedic_msgs.srv import CaptureFrame, SetReference, ShowPattern, StartExperiment
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.main import run
from fringedic_ros.parameters import declare
from fringedic_ros.qos import EVENTS, LATCHED, STATE
from fringedic_ros.records import calibration_message
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.waiting import Condition, until

Result = MeasureStep.Result
HELD = (LoadState.HOLD, LoadState.IDLE)
FAILED_NODE = {
    "phase": Result.PHASE_FAILED,
    "dic": Result.DIC_FAILED,
    "coupling": Result.COUPLING_FAILED,
}
CAPTURE_ERRORS = {
    CaptureFrame.Request.CAMERA_TIMEOUT: Result.CAMERA_TIMEOUT,
    CaptureFrame.Request.CAMERA_FAILED: Result.CAMERA_FAILED,
    CaptureFrame.Request.NO_SUBSCRIBER: Result.NO_SUBSCRIBER,
}
CONNECTING_TIME = 1.0  # [s] from the last node that connects to the first exposure
RECORDER_TIMEOUT = 5.0  # [s] for the recorder's answer to the stage PROCESS; it speaks every second anyway
LOAD_TIMEOUT = 0.5  # [s] for the load samples of the last exposure to come in


class ExperimentNode(Node):
    """Action server ``measure_step`` and the book-keeping of one experiment after the other."""

    def __init__(self) -> None:
        super().__init__("experiment")
        self.parameters = declare(self, ExperimentParameters)
        self.diagnostics = NodeDiagnostics(self)
        self._changed = Condition(self)
        self._steps = self.create_publisher(StepStatus, "experiment/step", EVENTS)
        self._references = self.create_publisher(Reference, "experiment/reference", LATCHED)
        self._calibrations = self.create_publisher(RigCalibration, "calibration", LATCHED)
        self._show = self.create_client(ShowPattern, "projector/show")
        self._capture = self.create_client(CaptureFrame, "camera/capture")
        self._hold = self.create_client(Trigger, "load_frame/hold")
        self._connected = dict.fromkeys(("camera/exposure", *(f"{name}/status" for name in FAILED_NODE)), False)
        self._connected_at = time.monotonic()
        self._subscribe_connected(Exposure, "camera/exposure", self._take_exposure)
        for name in FAILED_NODE:
            self._subscribe_connected(NodeStatus, f"{name}/status", self._result_taker(name))
        self.create_subscription(LoadState, "load_frame/state", self._take_load, STATE)
        self.create_subscription(RecorderStatus, "recorder/status", self._take_recorder, LATCHED)
        self.create_service(StartExperiment, "experiment/start", self._start_experiment)
        self.create_service(SetReference, "experiment/set_reference", self._set_reference)
        ActionServer(self, MeasureStep, "measure_step", self._measure_step, cancel_callback=self._cancel)
        self._running: RunningStep | None = None
        self._recorder: RecorderStatus | None = None
        self._load: LoadState | None = None
        self._names: set[str] = set()
        self._begin_experiment(self.parameters.value.experiment)
        if self.parameters.value.calibration_file:
            self._publish_calibration(Path(self.parameters.value.calibration_file))

    # experiments and references

    def _begin_experiment(self, name: str) -> None:
        self._experiment = name or datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%S.%f")
        self._names.add(self._experiment)
        self._next_step = 0
        self._measured: set[int] = set()
        self._reference: int | None = None
        self._next_is_reference = True
        self._ready = False

    def _publish_calibration(self, file: Path) -> None:
        message = calibration_message(RigModel.from_yaml(file), stamp_ns=self.get_clock().now().nanoseconds)
        message.source = message.source or file.name
        self._calibrations.publish(message)

    def _publish_reference(self, step: int) -> None:
        message = Reference(experiment=self._experiment, step=step)
        message.header.stamp = self.get_clock().now().to_msg()
        self._references.publish(message)

    def _start_experiment(
        self, request: StartExperiment.Request, response: StartExperiment.Response
    ) -> StartExperiment.Response:
        if self._running is not None:
            response.message = f"step {self._running.number} is being measured; start an experiment between steps"
        elif request.experiment in self._names:
            response.message = (
                f"experiment '{request.experiment}' exists already; its steps would be mixed up with these"
            )
        else:
            self._begin_experiment(request.experiment)
            response.success = True
            response.message = f"experiment '{self._experiment}'"
        return response

    def _set_reference(self, request: SetReference.Request, response: SetReference.Response) -> SetReference.Response:
        if self._running is not None:
            response.message = f"step {self._running.number} is being measured; set the reference between steps"
        elif request.next:
            self._next_is_reference = True
            response.success = True
            response.message = "the next step becomes the reference"
        elif request.step not in self._measured:
            response.message = f"step {request.step} of experiment '{self._experiment}' has not been measured"
        else:
            self._reference, self._next_is_reference = request.step, False
            self._publish_reference(request.step)
            response.success = True
            response.message = f"step {request.step} is the reference"
        return response

    # what the others say

    def _take_exposure(self, message: Exposure) -> None:
        step = self._running
        if step is not None and (message.experiment, message.step) == (self._experiment, step.number):
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
        step = self._running
        if step is not None and step.taken == len(step.projections):
            step.recorder_answered = True
        self._changed.notify()

    def _result_taker(self, name: str) -> Callable[[NodeStatus], None]:
        def take(message: NodeStatus) -> None:
            step = self._running
            if step is not None and (message.experiment, message.step) == (self._experiment, step.number):
                step.statuses[name] = message
                step.answered = time.monotonic()
                self._changed.notify()

        return take

    def _subscribe_connected(self, kind: type[Any], topic: str, callback: Callable[[Any], None]) -> None:
        """Subscribe to what every step needs, and keep in mind whether its publisher is connected."""

        def matched(event: Any) -> None:
            self._connected[topic] = event.current_count > 0
            self._connected_at = time.monotonic()
            self._changed.notify()

        events = SubscriptionEventCallbacks(matched=matched)
        self.create_subscription(kind, topic, callback, EVENTS, event_callbacks=events)

    def _cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        if self._running is None or goal.goal_id != self._running.goal.goal_id:
            return CancelResponse.REJECT
        self._running.cancelled = True
        self._changed.notify()
        return CancelResponse.ACCEPT

    # one step

    async def _measure_step(self, goal: ServerGoalHandle) -> MeasureStep.Result:
        parameters = self.parameters.value
        try:
            self._check_goal(goal.request, parameters)
        except StepFailure as refusal:
            self.get_logger().warning(f"goal refused: {refusal}")
            goal.abort()
            return _unmeasured(self._experiment, self._running.number if self._running else self._next_step, refusal)
        fringes = goal.request.mode == MeasureStep.Goal.FRINGES
        step = RunningStep(
            goal=goal,
            number=self._next_step,
            projections=parameters.projections() if fringes else (Projection(PatternKind.WHITE),),
            is_reference=goal.request.set_reference or self._next_is_reference,
        )
        self._running = step
        self._next_step += 1
        failure: Exception | None = None
        try:
            try:
                await self._become_ready(step, parameters)
            finally:
                self._begin_step(step)
            await self._check_hold(step, parameters)
            await self._take_frames(step, parameters)
            await self._await_results(step, parameters)
        except Exception as error:
            failure = error
        finally:
            self._running = None
        return self._end_step(step, parameters, failure)

    def _check_goal(self, request: MeasureStep.Goal, parameters: ExperimentParameters) -> None:
        if self._running is not None:
            raise StepFailure(
                Result.BUSY, f"step {self._running.number} is being measured; ask again when it has ended"
            )
        if request.mode not in (MeasureStep.Goal.FRINGES, MeasureStep.Goal.WHITE):
            raise StepFailure(Result.INVALID_GOAL, f"mode {request.mode} is unknown; use FRINGES or WHITE")
        if request.mode == MeasureStep.Goal.FRINGES and not parameters.projector:
            raise StepFailure(Result.INVALID_GOAL, "fringes need a projector; set projector to true or measure WHITE")

    async def _become_ready(self, step: RunningStep, parameters: ExperimentParameters) -> None:
        """Before the first frame of an experiment: whoever is there has to be connected, or would miss it."""
        if self._ready:
            return

        def absent() -> list[str]:
            needed = ("camera/exposure", *(f"{name}/status" for name in parameters.nodes))
            return [topic for topic in needed if not self._connected[topic]]

        timeout = parameters.start_timeout_s
        await self._wait(
            step,
            lambda: not absent(),
            timeout,
            lambda: (Result.NO_SUBSCRIBER, f"nobody publishes {', '.join(absent())}; start the nodes they belong to"),
        )
        await self._await_quiet_graph(step)
        await self._wait_polling(
            step,
            lambda: self._steps.get_subscription_count() >= self.count_subscribers("experiment/step"),
            timeout,
            lambda: (Result.NO_SUBSCRIBER, "a subscriber of experiment/step does not match; compare its QoS"),
        )
        if parameters.recording_required:
            await self._wait(
                step,
                lambda: self._recorder_state() in (RecorderStatus.RECORDING, RecorderStatus.FAILED),
                timeout,
                lambda: (Result.RECORDER_FAILED, "recording is required and no recorder is recording; start it"),
            )
            self._check_recorder(parameters)

    async def _await_quiet_graph(self, step: RunningStep) -> None:
        """Wait for subscribers that may still be on their way: nodes find each other while this one finds them."""

        def listeners() -> list[int]:
            return [self.count_subscribers(topic) for topic in ("camera/image_raw", "camera/exposure")]

        found, since = listeners(), self._connected_at
        while (left := since + CONNECTING_TIME - time.monotonic()) > 0:
            await self._pause(step, min(left, 0.1))
            if found != (found := listeners()):
                since = time.monotonic()

    def _begin_step(self, step: RunningStep) -> None:
        if step.is_reference:
            self._publish_reference(step.number)
        self._announce(step, StepStatus.BEGIN)
        self._feed_back(step, "begin")

    async def _check_hold(self, step: RunningStep, parameters: ExperimentParameters) -> None:
        if not parameters.hold_required or not self.count_publishers("load_frame/state"):
            return
        await self._wait(
            step,
            lambda: self._load is not None,
            parameters.start_timeout_s,
            lambda: (Result.LOAD_NOT_HELD, "the load frame is there but says nothing on load_frame/state"),
        )
        self._refuse_unheld(self._load)

    def _refuse_unheld(self, sample: LoadState | None) -> None:
        if sample is not None and sample.mode not in HELD:
            raise StepFailure(
                Result.LOAD_NOT_HELD,
                f"the load frame was not holding at position {sample.position * 1e3:.4f} mm, "
                f"{sample.force:.1f} N (mode {sample.mode}); hold it before the step",
            )

    async def _take_frames(self, step: RunningStep, parameters: ExperimentParameters) -> None:
        await self._pause(step, parameters.settle_time_s)
        self._feed_back(step, "capture")
        for index, projection in enumerate(step.projections):
            shown = await self._show_pattern(step, projection, parameters) if parameters.projector else Time()
            await self._capture_frame(step, index, projection, shown, parameters)
            self._announce(step, StepStatus.CAPTURE)
            self._feed_back(step, "capture")
            if parameters.hold_required:
                self._refuse_unheld(self._load)
            if step.failed_node(parameters.nodes):
                return  # the rest of the sequence cannot help any more
        self._ready = True

    async def _show_pattern(self, step: RunningStep, projection: Projection, parameters: ExperimentParameters) -> Time:
        request = ShowPattern.Request(
            kind=int(projection.kind),
            pitch=projection.pitch,
            shift=projection.shift,
            shifts=projection.shifts,
            orientation=int(projection.orientation),
        )
        response = await self._call(
            step, self._show, request, parameters.projector_timeout_s, Result.PROJECTOR_TIMEOUT, str(projection)
        )
        if response.error_code != ShowPattern.Request.NONE:
            raise StepFailure(Result.PROJECTOR_FAILED, f"{projection}: {response.error_message}")
        return response.shown

    async def _capture_frame(
        self, step: RunningStep, index: int, projection: Projection, shown: Time, parameters: ExperimentParameters
    ) -> None:
        first = index == 0  # whoever reads frames must be connected before: a camera may have been started anew
        request = CaptureFrame.Request(
            experiment=self._experiment,
            step=step.number,
            index=index,
            count=len(step.projections),
            kind=int(projection.kind),
            orientation=int(projection.orientation),
            pitch=projection.pitch,
            shift=projection.shift,
            shifts=projection.shifts,
            shown=shown,
            image_subscribers=self.count_subscribers("camera/image_raw") if first else 0,
            exposure_subscribers=self.count_subscribers("camera/exposure") if first else 0,
        )
        # a first frame waits for subscribers, and the camera knows better than a time-out which are not there
        timeout = parameters.camera_timeout_s + (parameters.start_timeout_s if first else 0.0)
        response = await self._call(step, self._capture, request, timeout, Result.CAMERA_TIMEOUT, f"frame {index}")
        if response.error_code != CaptureFrame.Request.NONE:
            code = CAPTURE_ERRORS.get(response.error_code, Result.CAMERA_FAILED)
            raise StepFailure(code, f"frame {index}: {response.error_message}")
        step.taken = index + 1
        step.stamp = to_nanoseconds(response.stamp)
        step.exposed = time.monotonic()

    async def _await_results(self, step: RunningStep, parameters: ExperimentParameters) -> None:
        self._announce(step, StepStatus.PROCESS)
        self._feed_back(step, "process")

        def open_nodes() -> list[str]:
            return [name for name in parameters.nodes if name not in step.statuses]

        await self._wait(
            step,
            lambda: not open_nodes(),
            parameters.processing_timeout_s,
            lambda: (Result.PROCESSING_TIMEOUT, f"no result from {', '.join(open_nodes())}"),
        )
        failed = step.failed_node(parameters.nodes)
        if failed is not None:
            raise StepFailure(FAILED_NODE[failed], f"{failed}: {step.statuses[failed].error_message}")
        await self._wait(
            step,
            lambda: {0, len(step.projections) - 1} <= step.exposures.keys(),
            parameters.camera_timeout_s,
            lambda: (Result.CAMERA_FAILED, "the camera published no exposure record of the first or last frame"),
        )
        if self._load is not None and self.count_publishers("load_frame/state"):
            await self._wait_for_load(step)
            if parameters.hold_required:
                for sample in step.load_during_exposures():
                    self._refuse_unheld(sample)
        if parameters.recording_required:
            await self._wait(
                step,
                lambda: step.recorder_answered or self._recorder_state() != RecorderStatus.RECORDING,
                RECORDER_TIMEOUT,
                lambda: (
                    Result.RECORDER_FAILED,
                    "the recorder does not answer; what it has recorded is readable",
                ),
            )
            self._check_recorder(parameters)

    async def _wait_for_load(self, step: RunningStep) -> None:
        """Wait a moment for the sample after the last exposure; a machine that went silent is told by the result."""
        end = step.exposures[len(step.projections) - 1][1]
        with suppress(WaitTimeoutError):
            await self._changed.wait(
                lambda: bool(step.load) and to_nanoseconds(step.load[-1].header.stamp) >= end, LOAD_TIMEOUT
            )

    def _recorder_state(self) -> int:
        if self._recorder is None or not self.count_publishers("recorder/status"):
            return RecorderStatus.IDLE
        return self._recorder.state

    def _check_recorder(self, parameters: ExperimentParameters) -> None:
        if parameters.recording_required and self._recorder_state() != RecorderStatus.RECORDING:
            said = self._recorder.error_message if self._recorder else ""
            raise StepFailure(Result.RECORDER_FAILED, f"the recorder stopped recording: {said or 'it is gone or idle'}")

    # the end of a step

    def _end_step(
        self, step: RunningStep, parameters: ExperimentParameters, error: Exception | None
    ) -> MeasureStep.Result:
        result = _unmeasured(self._experiment, step.number, error)
        result.stamp = to_msg(step.stamp)
        if error is None:
            self._measured.add(step.number)
            if step.is_reference:
                self._reference, self._next_is_reference = step.number, False
            self._fill_in(result, step, parameters)
            self.diagnostics.success(result.processing_time)
        else:
            if step.is_reference and self._reference is not None:
                self._publish_reference(self._reference)
            self.get_logger().error(result.error_message)
            self.diagnostics.failure(result.error_message)
        result.duration = time.monotonic() - step.started
        self._announce(step, StepStatus.END if error is None else StepStatus.ERROR, result)
        if error is None:
            step.goal.succeed()
        elif result.error_code == Result.CANCELLED:
            step.goal.canceled()
        else:
            self._request_hold()
            step.goal.abort()
        return result

    def _fill_in(self, result: MeasureStep.Result, step: RunningStep, parameters: ExperimentParameters) -> None:
        """Fill in the figures of a step that succeeded."""
        fringes = step.projections[0].kind == PatternKind.FRINGES
        measures = "coupling" if fringes else "dic"
        measured = step.statuses.get(measures)
        result.valid_fraction = measured.valid_fraction if measured else nan
        result.rms_displacement = measured.rms if measured else nan
        result.processing_time = max(step.answered - step.exposed, 0.0) if step.statuses else 0.0
        samples = step.load_during_exposures()
        result.load_samples = len(samples)
        result.force_mean, result.force_range = _mean_and_range([sample.force for sample in samples])
        result.position_mean, result.position_range = _mean_and_range([sample.position for sample in samples])

    def _request_hold(self) -> None:
        if self._hold.service_is_ready():
            self._hold.call_async(Trigger.Request()).add_done_callback(self._log_hold)

    def _log_hold(self, future: Future) -> None:
        response = future.result()
        if not response.success:
            self.get_logger().error(f"the load frame does not hold: {response.message}")

    # messages

    def _announce(self, step: RunningStep, stage: int, result: MeasureStep.Result | None = None) -> None:
        message = StepStatus(
            experiment=self._experiment,
            step=step.number,
            stage=stage,
            frame=step.taken,
            frames=len(step.projections),
            reference=step.is_reference,
        )
        if stage in (StepStatus.BEGIN, StepStatus.CAPTURE) or not step.stamp:
            message.header.stamp = self.get_clock().now().to_msg()
        else:
            message.header.stamp = to_msg(step.stamp)
        if result is not None:
            message.error_code, message.error_message = result.error_code, result.error_message
        self._steps.publish(message)

    def _feed_back(self, step: RunningStep, stage: str) -> None:
        step.goal.publish_feedback(MeasureStep.Feedback(stage=stage, frame=step.taken, frames=len(step.projections)))

    # waiting

    async def _call(
        self, step: RunningStep, client: Client, request: Any, timeout_s: float, code: int, what: str
    ) -> Any:
        """Answer of a service; the step ends with `code` when there is no such service or no answer in time."""
        name = client.srv_name
        if not client.service_is_ready():
            await self._wait_polling(
                step, client.service_is_ready, timeout_s, lambda: (code, f"{what}: there is no service {name}")
            )
        future = client.call_async(request)
        future.add_done_callback(lambda _: self._changed.notify())
        try:
            await self._wait(
                step, future.done, timeout_s, lambda: (code, f"{what}: {name} did not answer in {timeout_s:g} s")
            )
        finally:
            client.remove_pending_request(future)
        return future.result()

    async def _pause(self, step: RunningStep, seconds: float) -> None:
        """Let time pass, unless the caller cancels."""
        if seconds > 0:
            with suppress(WaitTimeoutError):
                await self._changed.wait(lambda: step.cancelled, seconds)
            _check(step)

    async def _wait(
        self,
        step: RunningStep,
        predicate: Callable[[], bool],
        timeout_s: float,
        failure: Callable[[], tuple[int, str]],
    ) -> None:
        """Wait for something that a callback changes; the step ends as `failure` says after the time-out."""
        with suppress(WaitTimeoutError):
            await self._changed.wait(lambda: step.cancelled or predicate(), timeout_s)
        _check(step)
        if not predicate():
            raise StepFailure(*failure())

    async def _wait_polling(
        self,
        step: RunningStep,
        predicate: Callable[[], bool],
        timeout_s: float,
        failure: Callable[[], tuple[int, str]],
    ) -> None:
        """Like `_wait`, for the graph, which tells nobody that it changed."""
        with suppress(WaitTimeoutError):
            await until(self, lambda: step.cancelled or predicate(), timeout_s)
        _check(step)
        if not predicate():
            raise StepFailure(*failure())


def _check(step: RunningStep) -> None:
    if step.cancelled:
        raise StepFailure(Result.CANCELLED, "cancelled by the caller")


def _unmeasured(experiment: str, step: int, error: Exception | None) -> MeasureStep.Result:
    """Result of a step of which nothing is known but how it ended."""
    result = MeasureStep.Result(experiment=experiment, step=step)
    if error is not None:
        result.error_code = error.code if isinstance(error, StepFailure) else Result.CAMERA_FAILED
        result.error_message = f"experiment '{experiment}', step {step}: {error}"
    result.valid_fraction = result.rms_displacement = nan
    result.force_mean = result.force_range = result.position_mean = result.position_range = nan
    return result


def _mean_and_range(values: list[float]) -> tuple[float, float]:
    if not values:
        return nan, nan
    return sum(values) / len(values), max(values) - min(values)


def main() -> int:
    """Run the experiment node."""
    return run(ExperimentNode)
