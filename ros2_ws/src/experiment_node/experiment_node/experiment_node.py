"""Runs load steps and calibrations, and keeps the step numbers and references of experiments.

The client of the action ``measure_step`` holds the machine; this node only observes it, and requests a hold when a step
fails.
"""

from __future__ import annotations

import time
from contextlib import suppress
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING

from rclpy.action.server import ActionServer, ServerGoalHandle
from rclpy.task import Future
from std_srvs.srv import Trigger

from experiment_node.active_goal import GoalSlot, StepFailure
from experiment_node.calibration_server import CalibrationServer
from experiment_node.experiments import Experiments
from experiment_node.plane_steps import PlaneSteps
from experiment_node.rig_transforms import RigTransforms
from experiment_node.running_step import RunningStep
from experiment_node.step_runner import StepRunner
from fringedic.errors import PatternError, WaitTimeoutError
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.rig.model import RigModel
from fringedic.settings.experiment import ExperimentNodeSettings
from fringedic.signals import FORCE, POSITION
from fringedic.steps.recorded_parameters import MODELS
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import NodeParameters, RigCalibration
from fringedic_msgs.srv import SetReference, StartExperiment
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.main import run
from fringedic_ros.parameters import declare, parameters_message
from fringedic_ros.qos import LATCHED, LATCHED_BY_MANY
from fringedic_ros.records import calibration_message
from fringedic_ros.rig_node import RIG_FRAME, RigNode, frame_id
from fringedic_ros.stamps import to_msg
from fringedic_ros.topics import NODE_PARAMETERS
from fringedic_ros.waiting import wait_for

if TYPE_CHECKING:
    from fringedic.sensors.poses import SensorPose

Goal, Result = MeasureStep.Goal, MeasureStep.Result
HOLD_S = 5.0  # for the load frame to answer the hold of a failed step


class ExperimentNode(RigNode):
    """Actions `measure_step`, `calibrate_distortion` and `calibrate_rig`, experiments and references."""

    def __init__(self) -> None:
        super().__init__("experiment")
        self._settings = self.create_publisher(NodeParameters, NODE_PARAMETERS, LATCHED_BY_MANY)
        self.parameters = declare(self, ExperimentNodeSettings, self._take_parameters)
        parameters = self.parameters.value
        self._first_step = parameters.first_step
        self._publish_later(parameters)
        self._diagnostics = NodeDiagnostics(self)
        self._slot = GoalSlot(self)
        self._calibrations = self.create_publisher(RigCalibration, "calibration", LATCHED)
        self._hold = self.create_client(Trigger, "load_frame/hold")
        self._runner = StepRunner(self, self._slot.changed, self._diagnostics)
        self.create_service(StartExperiment, "experiment/start", self._start_experiment)
        self.create_service(SetReference, "experiment/set_reference", self._set_reference)
        ActionServer(self, MeasureStep, "measure_step", self._measure_step, cancel_callback=self._slot.cancel)
        self._step: RunningStep | None = None
        self._experiments = Experiments()
        reference = None if parameters.reference_step < 0 else parameters.reference_step
        self._experiment = self._experiments.resume(
            parameters.experiment, parameters.first_step, reference, previous_lost=parameters.reference_lost
        )
        self._plane_steps = PlaneSteps(self, self._slot.changed, self.parameters, self._runner)
        self._calibration_server = CalibrationServer(
            self, self._slot, self._plane_steps, self._experiments, self._diagnostics, self._publish_calibration
        )
        self._transforms = RigTransforms(self, _pose(parameters))
        self._transforms.publish(None, to_msg(time.time_ns()))
        if parameters.calibration_file:
            file = Path(parameters.calibration_file)
            self._publish_calibration(RigModel.from_yaml(file), file.name)

    def destroy_node(self) -> None:
        """End a step that is under way with an error and a hold, wait for a running fit, then end the node."""
        if self._runner.close():
            self._request_hold()
        self._plane_steps.close()
        super().destroy_node()

    # experiments, references, calibrations

    def _publish_calibration(self, model: RigModel, source: str) -> None:
        """Put a calibration in force for all nodes."""
        message = calibration_message(model, stamp_ns=time.time_ns(), frame_id=frame_id(self, RIG_FRAME))
        message.source = message.source or source
        self._calibrations.publish(message)
        self._transforms.publish(model, message.header.stamp)

    def _take_parameters(self, parameters: ExperimentNodeSettings) -> None:
        """Act on changed parameters; a later number continues beside other sensors, whose steps have the same ones."""
        if parameters.first_step != self._first_step:
            self._first_step = parameters.first_step
            self._experiment.next_step = max(self._experiment.next_step, parameters.first_step)
        self._publish_later(parameters)

    def _publish_later(self, parameters: ExperimentNodeSettings) -> None:
        """Record what the frames are to be measured with later, as the processing nodes would if they ran."""
        if parameters.record_only:
            for node in MODELS:
                self._settings.publish(parameters_message(node, getattr(parameters.later_parameters, node)))

    def _start_experiment(
        self, request: StartExperiment.Request, response: StartExperiment.Response
    ) -> StartExperiment.Response:
        if self._slot.activity:
            response.message = f"{self._slot.activity}; start an experiment between steps"
        elif request.experiment in self._experiments:
            response.message = f"experiment '{request.experiment}' exists already; choose another name"
        else:
            self._experiment = self._experiments.begin(request.experiment)
            response.success = True
            response.message = f"experiment '{self._experiment.name}'"
        return response

    def _set_reference(self, request: SetReference.Request, response: SetReference.Response) -> SetReference.Response:
        experiment = self._experiment
        if self._slot.activity:
            response.message = f"{self._slot.activity}; set the reference between steps"
        elif request.next:
            experiment.require_reference(previous_lost=request.previous_lost)
            response.success = True
            response.message = "the next step becomes the reference"
        elif request.step not in experiment.measured:
            response.message = f"step {request.step} of experiment '{experiment.name}' has not been measured"
        else:
            experiment.set_reference(request.step)
            self._runner.publish_reference(experiment, request.step)
            response.success = True
            response.message = f"step {request.step} is the reference"
        return response

    # load steps

    async def _measure_step(self, goal: ServerGoalHandle) -> MeasureStep.Result:
        parameters, experiment = self.parameters.value, self._experiment
        refusal = self._reason_to_refuse(goal.request, parameters)
        if refusal is not None:
            self.get_logger().warning(f"goal refused: {refusal}")
            goal.abort()
            number = experiment.next_step if self._step is None else self._step.number
            return _empty_result(experiment.name, number, refusal)
        step = self._begin_step(goal, parameters)
        try:
            failure = await self._runner.measure(step, parameters)
        finally:
            self._step = None
            self._slot.end()
        result = _empty_result(experiment.name, step.number, failure)
        if failure is not None:  # who called the action reads the message alone
            result.error_message = f"experiment '{experiment.name}', step {step.number}: {failure}"
        result.stamp = to_msg(step.stamp)
        result.duration = time.monotonic() - step.started
        if failure is None:
            _fill_in(result, step)
            goal.succeed()
            return result
        goes_on = step.is_moving and failure.code != Result.CANCELLED  # a failed stack does not stop the motion
        if not goes_on and (hold := self._request_hold()) is not None:
            with suppress(WaitTimeoutError):  # after the result the client may move again; a late hold would stop that
                await wait_for(self, hold, HOLD_S, "the answer to the hold")
        if failure.code == Result.CANCELLED:
            goal.canceled()
        else:
            goal.abort()
        return result

    def _begin_step(self, goal: ServerGoalHandle, parameters: ExperimentNodeSettings) -> RunningStep:
        request, experiment = goal.request, self._experiment
        number = experiment.take_number()
        client = f" for {request.controller}" if request.controller else ""
        self._step = RunningStep(
            goal=self._slot.begin(goal, f"step {number} is being measured{client}"),
            experiment=experiment,
            number=number,
            patterns=_patterns(request.mode, parameters),
            nodes=() if parameters.record_only else parameters.nodes,
            is_reference=request.set_reference or experiment.next_is_reference,
            previous_lost=experiment.previous_lost and not request.set_reference,
            on_stage=_publish_feedback,
        )
        return self._step

    def _reason_to_refuse(self, request: MeasureStep.Goal, parameters: ExperimentNodeSettings) -> StepFailure | None:
        if self._slot.activity:
            who = f"{request.controller} has to" if request.controller else "you have to"
            return StepFailure(Result.BUSY, f"{self._slot.activity}; {who} wait until it has ended")
        if request.mode not in (Goal.FRINGES, Goal.WHITE, Goal.MOVING):
            return StepFailure(Result.INVALID_GOAL, f"mode {request.mode} is unknown; use FRINGES, WHITE or MOVING")
        if request.mode != Goal.WHITE and not parameters.projector:
            return StepFailure(Result.INVALID_GOAL, "fringes need a projector; set projector to true or measure WHITE")
        try:
            _patterns(request.mode, parameters)
        except PatternError as error:
            return StepFailure(Result.INVALID_GOAL, str(error))
        return None

    def _request_hold(self) -> Future | None:
        """Request a hold, and return its answer; None without a load frame."""
        if not self._hold.service_is_ready():
            return None
        answer = self._hold.call_async(Trigger.Request())
        answer.add_done_callback(self._log_hold)
        return answer

    def _log_hold(self, future: Future) -> None:
        response = future.result()
        if not response.success:
            self.get_logger().error(f"the load frame did not accept the hold: {response.message}")


def _patterns(mode: int, parameters: ExperimentNodeSettings) -> tuple[ProjectedPattern, ...]:
    """Return the patterns of the frames of a step.

    Raises
    ------
    PatternError
        A surface in motion cannot be measured with the sequence of the rig.
    """
    if mode == Goal.WHITE:
        return (ProjectedPattern(PatternKind.WHITE),)
    return parameters.moving_step_patterns() if mode == Goal.MOVING else parameters.step_patterns()


def _pose(parameters: ExperimentNodeSettings) -> tuple[str, SensorPose] | None:
    """Return the frame that several sensors have in common, and the pose of the frame of the rig in it."""
    if not parameters.common_frame:
        return None
    from fringedic.sensors.poses import SensorPose  # a rig of one sensor does not load it

    x, y, z, *rotation = parameters.pose_in_common_frame
    return parameters.common_frame, SensorPose((rotation[0], rotation[1], rotation[2]), (x, y, z))


def _publish_feedback(stage: str, step: RunningStep) -> None:
    feedback = MeasureStep.Feedback(stage=stage, frame=step.taken, frames=len(step.patterns))
    step.goal.goal.publish_feedback(feedback)


def _empty_result(experiment: str, step: int, failure: StepFailure | None) -> MeasureStep.Result:
    """Return a result without figures, with the failure of the step."""
    result = MeasureStep.Result(experiment=experiment, step=step)
    if failure is not None:
        result.error_code, result.error_message = failure.code, str(failure)
    result.valid_fraction = result.rms_displacement = result.rms_displacement_px = nan
    result.force_mean = result.force_range = result.position_mean = result.position_range = nan
    return result


def _fill_in(result: MeasureStep.Result, step: RunningStep) -> None:
    """Enter the figures of a step that succeeded."""
    for name in ("dic", "coupling"):  # the last one that measured the step has its measured part
        status = step.statuses.get(name)
        if status is not None and not status.skipped:
            result.valid_fraction = status.valid_fraction
    if "dic" in step.statuses:
        result.rms_displacement_px = step.statuses["dic"].rms_displacement_px
    if "coupling" in step.statuses:
        result.rms_displacement = step.statuses["coupling"].rms_displacement
    result.processing_time = step.processing_time
    result.load_samples = step.signals.signals[FORCE.name].summary_over(*step.exposed_over()).samples
    result.recorded_frames, result.recorded_crc = step.recorded_frames, step.recorded_crc
    result.force_mean, result.force_range = step.value_of(FORCE)
    result.position_mean, result.position_range = step.value_of(POSITION)


def main() -> int:
    """Run the experiment node."""
    return run(ExperimentNode)
