"""Runs load steps and calibrations: answers the load frame, and keeps the books of one experiment after the other.

The caller of the action ``measure_step`` holds the machine; this node only observes it, and asks for a hold when a
step fails.
"""

from __future__ import annotations

import time
from datetime import UTC, datetime
from math import nan
from pathlib import Path

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from experiment_node.calibration_server import CalibrationServer
from experiment_node.experiment_parameters import ExperimentParameters
from experiment_node.running_step import Experiment, RunningStep
from experiment_node.step_runner import StepRunner
from experiment_node.turn import StepFailure, Turn
from fringedic.load_samples import summarise_load
from fringedic.rig import RigModel
from fringedic.sequence import PatternKind, Projection
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import RigCalibration
from fringedic_msgs.srv import SetReference, StartExperiment
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.main import run
from fringedic_ros.parameters import declare
from fringedic_ros.qos import LATCHED
from fringedic_ros.records import calibration_message
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.waiting import Condition

Result = MeasureStep.Result


class ExperimentNode(Node):
    """Action servers ``measure_step``, ``calibrate_distortion``, ``calibrate_rig``, and the book-keeping of steps."""

    def __init__(self) -> None:
        super().__init__("experiment")
        self.parameters = declare(self, ExperimentParameters)
        self.diagnostics = NodeDiagnostics(self)
        self.changed = Condition(self)
        self._calibrations = self.create_publisher(RigCalibration, "calibration", LATCHED)
        self._hold = self.create_client(Trigger, "load_frame/hold")
        self.runner = StepRunner(self, self.changed, self.diagnostics)
        self.create_service(StartExperiment, "experiment/start", self._start_experiment)
        self.create_service(SetReference, "experiment/set_reference", self._set_reference)
        ActionServer(self, MeasureStep, "measure_step", self._measure_step, cancel_callback=self.cancel)
        self._turn: Turn | None = None
        self._step: RunningStep | None = None
        self._names: set[str] = set()
        self._experiment = self._go_on_with(self.parameters.value)
        self._calibrating = CalibrationServer(self)
        if self.parameters.value.calibration_file:
            file = Path(self.parameters.value.calibration_file)
            self.publish_calibration(RigModel.from_yaml(file), file.name)

    def destroy_node(self) -> None:
        """Let a fit that is under way end first."""
        self._calibrating.close()
        super().destroy_node()

    # whose turn it is

    @property
    def doing(self) -> str:
        """What the rig is busy with, empty when it is free."""
        return self._turn.doing if self._turn is not None else ""

    def begin_turn(self, goal: ServerGoalHandle, doing: str) -> Turn:
        """Give the free rig to a goal."""
        self._turn = Turn(self, self.changed, goal, doing)
        return self._turn

    def end_turn(self) -> None:
        """Set the rig free."""
        self._turn = None

    def cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        """Answer the wish to cancel a goal of any action: only the one whose turn it is can be cancelled."""
        if self._turn is None or goal.goal_id != self._turn.goal.goal_id:
            return CancelResponse.REJECT
        self._turn.cancel()
        return CancelResponse.ACCEPT

    # experiments, references, calibrations

    def begin_experiment(self, name: str = "") -> Experiment:
        """Return a new experiment; without a name it is called after the time, to the microsecond."""
        experiment = Experiment(name or datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%S.%f"))
        self._names.add(experiment.name)
        return experiment

    def _go_on_with(self, parameters: ExperimentParameters) -> Experiment:
        """Return the first experiment, which another process of this node may have begun."""
        experiment = self.begin_experiment(parameters.experiment)
        experiment.next_step = parameters.first_step
        if parameters.reference_step >= 0:
            experiment.measured.add(parameters.reference_step)
            experiment.reference, experiment.next_is_reference = parameters.reference_step, False
        return experiment

    def publish_calibration(self, model: RigModel, source: str) -> None:
        """Put a calibration in force for everybody."""
        message = calibration_message(model, stamp_ns=self.get_clock().now().nanoseconds)
        message.source = message.source or source
        self._calibrations.publish(message)

    def _start_experiment(
        self, request: StartExperiment.Request, response: StartExperiment.Response
    ) -> StartExperiment.Response:
        if self.doing:
            response.message = f"{self.doing}; start an experiment between steps"
        elif request.experiment in self._names:
            response.message = (
                f"experiment '{request.experiment}' exists already; its steps would be mixed up with these"
            )
        else:
            self._experiment = self.begin_experiment(request.experiment)
            response.success = True
            response.message = f"experiment '{self._experiment.name}'"
        return response

    def _set_reference(self, request: SetReference.Request, response: SetReference.Response) -> SetReference.Response:
        experiment = self._experiment
        if self.doing:
            response.message = f"{self.doing}; set the reference between steps"
        elif request.next:
            experiment.next_is_reference = True
            response.success = True
            response.message = "the next step becomes the reference"
        elif request.step not in experiment.measured:
            response.message = f"step {request.step} of experiment '{experiment.name}' has not been measured"
        else:
            experiment.reference, experiment.next_is_reference = request.step, False
            self.runner.publish_reference(experiment, request.step)
            response.success = True
            response.message = f"step {request.step} is the reference"
        return response

    # load steps

    async def _measure_step(self, goal: ServerGoalHandle) -> MeasureStep.Result:
        parameters, experiment = self.parameters.value, self._experiment
        refusal = self._refusal(goal.request, parameters)
        if refusal is not None:
            self.get_logger().warning(f"goal refused: {refusal}")
            goal.abort()
            number = experiment.next_step if self._step is None else self._step.number
            return _unmeasured(experiment.name, number, refusal)
        fringes = goal.request.mode == MeasureStep.Goal.FRINGES
        number = experiment.take_number()
        step = RunningStep(
            turn=self.begin_turn(goal, f"step {number} is being measured{_asked_by(goal.request.controller)}"),
            experiment=experiment,
            number=number,
            projections=parameters.projections() if fringes else (Projection(PatternKind.WHITE),),
            nodes=() if parameters.record_only else parameters.nodes,
            is_reference=goal.request.set_reference or experiment.next_is_reference,
            feed_back=_feed_back,
        )
        self._step = step
        try:
            failure = await self.runner.measure(step, parameters)
        finally:
            self._step = None
            self.end_turn()
        result = _unmeasured(experiment.name, number, failure)
        result.stamp = to_msg(step.stamp)
        result.duration = time.monotonic() - step.started
        if failure is None:
            _fill_in(result, step)
            goal.succeed()
        else:
            self._request_hold()
            if failure.code == Result.CANCELLED:
                goal.canceled()
            else:
                goal.abort()
        return result

    def _refusal(self, request: MeasureStep.Goal, parameters: ExperimentParameters) -> StepFailure | None:
        if self.doing:
            asking = f"{request.controller} has to" if request.controller else "you have to"
            return StepFailure(Result.BUSY, f"{self.doing}; {asking} wait until it has ended")
        if request.mode not in (MeasureStep.Goal.FRINGES, MeasureStep.Goal.WHITE):
            return StepFailure(Result.INVALID_GOAL, f"mode {request.mode} is unknown; use FRINGES or WHITE")
        if request.mode == MeasureStep.Goal.FRINGES and not parameters.projector:
            return StepFailure(Result.INVALID_GOAL, "fringes need a projector; set projector to true or measure WHITE")
        return None

    def _request_hold(self) -> None:
        if self._hold.service_is_ready():
            self._hold.call_async(Trigger.Request()).add_done_callback(self._log_hold)

    def _log_hold(self, future: Future) -> None:
        response = future.result()
        if not response.success:
            self.get_logger().error(f"the load frame does not hold: {response.message}")


def _asked_by(controller: str) -> str:
    return f" for {controller}" if controller else ""


def _feed_back(stage: str, step: RunningStep) -> None:
    feedback = MeasureStep.Feedback(stage=stage, frame=step.taken, frames=len(step.projections))
    step.turn.goal.publish_feedback(feedback)


def _unmeasured(experiment: str, step: int, failure: StepFailure | None) -> MeasureStep.Result:
    """Result of a step of which nothing is known but how it ended."""
    result = MeasureStep.Result(experiment=experiment, step=step)
    if failure is not None:
        result.error_code, result.error_message = failure.code, str(failure)
    result.valid_fraction = result.rms_displacement = nan
    result.force_mean = result.force_range = result.position_mean = result.position_range = nan
    return result


def _fill_in(result: MeasureStep.Result, step: RunningStep) -> None:
    """Fill in the figures of a step that succeeded."""
    measured = step.statuses.get("coupling" if step.projections[-1].kind == PatternKind.FRINGES else "dic")
    if measured is not None:
        result.valid_fraction, result.rms_displacement = measured.valid_fraction, measured.rms
    result.processing_time = step.processing_time
    samples = step.load_during_exposures()
    stamps = [to_nanoseconds(sample.header.stamp) for sample in samples]
    force = summarise_load(stamps, [sample.force for sample in samples])
    position = summarise_load(stamps, [sample.position for sample in samples])
    result.load_samples = force.samples
    result.force_mean, result.force_range = force.mean, force.spread
    result.position_mean, result.position_range = position.mean, position.spread


def main() -> int:
    """Run the experiment node."""
    return run(ExperimentNode)
