"""Measures one step: shows the patterns, takes the frames, waits for results, recorder and load samples."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress

from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rclpy.node import Node

from experiment_node.active_goal import StepFailure
from experiment_node.experiments import Experiment
from experiment_node.frame_taker import FrameTaker
from experiment_node.input_watch import InputWatch
from experiment_node.load_watch import LoadWatch
from experiment_node.readiness import Readiness
from experiment_node.recorder_watch import RECORDER, RecorderWatch
from experiment_node.running_step import RunningStep
from fringedic.errors import WaitTimeoutError
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.settings.experiment import ExperimentNodeSettings
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import Exposure, NodeStatus, RecorderStatus, Reference, StepStatus
from fringedic_ros.arrivals import Arrivals, Problem, mismatches
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.qos import EVENTS, LATCHED
from fringedic_ros.result_codes import failure_of
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.topics import PROCESSING_INPUTS
from fringedic_ros.waiting import Condition

Result = MeasureStep.Result
Feedback = MeasureStep.Feedback
LATE_S = 1.0  # without a further result, after which the next node is asked for its inputs
FAREWELL_S = 2  # for the record of a step that is cut off to be received


class StepRunner:
    """The part that load steps and steps of a calibration have in common.

    Parameters
    ----------
    node
        Owner of clients, publishers and subscriptions.
    changed
        Notified by every callback; a running step waits for it.
    diagnostics
        Counts the steps and their failures.

    Attributes
    ----------
    frames
        Client of projector and camera.
    readiness
        Connections of the nodes.
    """

    def __init__(self, node: Node, changed: Condition, diagnostics: NodeDiagnostics) -> None:
        self._node = node
        self._changed = changed
        self._diagnostics = diagnostics
        self._running: RunningStep | None = None
        self._steps = node.create_publisher(StepStatus, "experiment/step", EVENTS)
        self._references = node.create_publisher(Reference, "experiment/reference", LATCHED)
        self._load = LoadWatch(node, changed)
        self.frames = FrameTaker(node, self._load)
        self.readiness = Readiness(node, changed, self.frames)
        self.readiness.subscribe(Exposure, "camera/exposure", self._take_exposure)
        self._records = Arrivals(node, Exposure, "camera/exposure")
        self._answers = {name: Arrivals(node, NodeStatus, f"{name}/status") for name in PROCESSING_INPUTS}
        for name in PROCESSING_INPUTS:
            self.readiness.subscribe(NodeStatus, f"{name}/status", self._take_status_of(name))
        self._inputs = InputWatch(node)
        self._recorder = RecorderWatch(node, self._take_recorder_status)

    def publish_reference(self, experiment: Experiment, step: int, *, previous_lost: bool = False) -> None:
        """Publish the step that the following ones are measured against."""
        message = Reference(experiment=experiment.name, step=step, previous_lost=previous_lost)
        message.header.stamp = to_msg(time.time_ns())
        self._references.publish(message)

    async def measure(self, step: RunningStep, parameters: ExperimentNodeSettings) -> StepFailure | None:
        """Measure one step, from the stage BEGIN to END or ERROR; return its failure, None when it succeeded."""
        self._running = step
        for arrivals in (self._records, *self._answers.values()):
            arrivals.renew()
        failure: StepFailure | None = None
        try:
            with self._load.collecting(step):
                await self._run_stages(step, parameters)
        except StepFailure as error:
            failure = error
        except Exception as error:
            failure = StepFailure(Result.CAMERA_FAILED, f"{type(error).__name__}: {error}")
        finally:
            self._running = None
        if failure is None:
            self._accept(step)
        else:
            failure = self._reject(step, failure)
        self._publish_stage(step, StepStatus.END if failure is None else StepStatus.ERROR, failure)
        return failure

    def close(self) -> bool:
        """End a step that the end of this node cuts off with an error record; return whether there was one."""
        step, self._running = self._running, None
        if step is None:
            return False
        failure = self._reject(step, StepFailure(Result.CANCELLED, "the experiment node was ended during the step"))
        self._publish_stage(step, StepStatus.ERROR, failure)
        self._steps.wait_for_all_acked(Duration(seconds=FAREWELL_S))
        return True

    async def _run_stages(self, step: RunningStep, parameters: ExperimentNodeSettings) -> None:
        try:
            await self._become_ready(step, parameters)
        finally:
            self._begin_step(step)
        try:
            await self._take_frames(step, parameters)
        except Exception:
            self.frames.leave(parameters)
            raise
        if step.taken == len(step.patterns):  # fewer when a node has failed meanwhile
            await self._await_records(step, parameters)
            await self._load.check_exposures(step, parameters)  # before the results, which take longer
            self._publish_stage(step, StepStatus.PROCESS)  # in a recording, this proves the hold of the step
            step.report(Feedback.PROCESS)
        await self._await_results(step, parameters)

    def _accept(self, step: RunningStep) -> None:
        experiment = step.experiment
        experiment.measured.add(step.number)
        if step.is_reference:
            experiment.set_reference(step.number, replaces=step.previous_lost)
        self._diagnostics.success(step.processing_time)

    def _reject(self, step: RunningStep, failure: StepFailure) -> StepFailure:
        """Restore the reference of before the step, and return the failure.

        Without a reference in a node, the next step becomes one. The dic node then had lost it, or was started again;
        that of the coupling node may be a step without a phase, which a recording does not replace either.
        """
        experiment = step.experiment
        without = {name for name, each in step.statuses.items() if each.error_code == NodeStatus.NO_REFERENCE}
        if without:
            experiment.require_reference(previous_lost="dic" in without)
            failure = StepFailure(failure.code, f"{failure}; the next step becomes the reference")
        if step.is_reference and experiment.reference is not None:
            self.publish_reference(experiment, experiment.reference, previous_lost=experiment.reference_replaces)
        named = f"experiment '{experiment.name}', step {step.number}: {failure}"
        self._node.get_logger().error(named)
        self._diagnostics.failure(named)
        return failure

    # stages

    async def _become_ready(self, step: RunningStep, parameters: ExperimentNodeSettings) -> None:
        if not self.readiness.is_outdated(step):
            return
        await self._recorder.await_start(step, parameters)
        await self.readiness.await_nodes(step, parameters, lambda: RECORDER if self._recorder.records_results else "")
        self._recorder.check(parameters)  # it may have stopped meanwhile
        await step.goal.wait_polling(
            lambda: self._steps.get_subscription_count() >= self._node.count_subscribers("experiment/step"),
            parameters.start_timeout_s,
            lambda: (
                Result.NO_SUBSCRIBER,
                mismatches(self._node, "experiment/step") or "a subscriber of experiment/step is not connected",
            ),
        )

    def _begin_step(self, step: RunningStep) -> None:
        if step.is_reference:
            self.publish_reference(step.experiment, step.number, previous_lost=step.previous_lost)
        self._publish_stage(step, StepStatus.BEGIN)
        step.report(Feedback.BEGIN)

    async def _take_frames(self, step: RunningStep, parameters: ExperimentNodeSettings) -> None:
        begin = time.time_ns()
        await step.goal.pause(parameters.settle_time_s)
        step.report(Feedback.CAPTURE)
        shown, on_screen = Time(), None
        for index, pattern in enumerate(step.patterns):
            if parameters.projector and pattern != on_screen:  # further exposures of a pattern find it on the screen
                shown, on_screen = await self.frames.show(step, pattern, parameters), pattern
            if index == 0:
                await self._load.await_hold(step, parameters, begin)  # a sample has come while the pattern was shown
            await self.frames.capture(step, index, pattern, shown, parameters)
            self._publish_stage(step, StepStatus.CAPTURE)
            step.report(Feedback.CAPTURE)
            self._load.check_latest(step, parameters)
            self._recorder.check(parameters)
            if step.failed_node:
                self.frames.leave(parameters)
                return  # the step has failed: further frames are useless
        if parameters.projector and parameters.white_between_steps:
            await self.frames.show(step, ProjectedPattern(PatternKind.WHITE), parameters)
        if parameters.projector and parameters.dark_between_steps:
            await self.frames.darken(step, parameters)
        step.experiment.ready = True

    async def _await_records(self, step: RunningStep, parameters: ExperimentNodeSettings) -> None:
        await step.goal.wait(
            lambda: {0, len(step.patterns) - 1} <= step.exposures.keys(),
            parameters.camera_timeout_s,
            lambda: (Result.CAMERA_FAILED, f"no exposure record of the first or last frame: {self._records}"),
        )

    async def _await_results(self, step: RunningStep, parameters: ExperimentNodeSettings) -> None:
        def open_nodes() -> list[str]:
            return [name for name in step.nodes if name not in step.statuses]

        end = time.monotonic() + parameters.processing_timeout_s
        while names := open_nodes():
            left = end - time.monotonic()
            if left <= 0:
                late = "; ".join(str(self._answers[name]) for name in names)
                raise StepFailure(Result.PROCESSING_TIMEOUT, f"no result from {', '.join(names)}: {late}")
            with suppress(WaitTimeoutError):
                await self._changed.wait(lambda: step.goal.cancelled or open_nodes() != names, min(left, LATE_S))
            step.goal.check()
            await self._inputs.check(step, names[0], parameters.input_timeout_s)
        failed = step.failed_node
        if failed is not None:
            raise StepFailure(*failure_of(failed, step.statuses[failed]))
        await self._recorder.await_confirmation(step, parameters)

    def _publish_stage(self, step: RunningStep, stage: int, failure: StepFailure | None = None) -> None:
        message = StepStatus(
            experiment=step.experiment.name,
            step=step.number,
            stage=stage,
            frame=step.taken,
            frames=len(step.patterns),
            reference=step.is_reference,
        )
        if stage in (StepStatus.BEGIN, StepStatus.CAPTURE) or not step.stamp:
            message.header.stamp = to_msg(time.time_ns())
        else:
            message.header.stamp = to_msg(step.stamp)
        if failure is not None:
            message.error_code, message.error_message = failure.code, str(failure)
        self._steps.publish(message)

    # messages of other nodes

    def _take_exposure(self, message: Exposure) -> None:
        step = self._running
        self._records.take(_problem_of(step, message))
        if step is not None and step.is_named(message.experiment, message.step):
            middle, half = to_nanoseconds(message.header.stamp), round(message.exposure_time * 1e9 / 2)
            step.exposures[message.index] = (middle - half, middle + half)
            step.crcs[message.index] = message.image_crc
            self._changed.notify()

    def _take_recorder_status(self, message: RecorderStatus) -> None:
        if message.state == RecorderStatus.STARTING:
            self.readiness.forget()
        self._changed.notify()

    def _take_status_of(self, name: str) -> Callable[[NodeStatus], None]:
        def take(message: NodeStatus) -> None:
            step = self._running
            self._answers[name].take(_problem_of(step, message))
            if step is not None and step.is_named(message.experiment, message.step):
                step.statuses[name] = message
                step.answered = time.monotonic()
                self._changed.notify()

        return take


def _problem_of(step: RunningStep | None, message: Exposure | NodeStatus) -> Problem | None:
    """Return why a message does not belong to the running step; None when it does."""
    if step is None or step.is_named(message.experiment, message.step):
        return None
    cure = f"copy experiment '{step.experiment.name}' and step {step.number} from the request or the input"
    return Problem("of another step", cure, f"of experiment '{message.experiment}', step {message.step}")
