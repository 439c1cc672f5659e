"""Actions `calibrate_distortion` and `calibrate_rig`: planes are placed and measured one after the other.

A calibration is an experiment of its own, whose steps are measured and recorded like load steps. The object in front of
the camera is published for each step on `experiment/plane`.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from rclpy.action.server import ActionServer, ServerGoalHandle
from rclpy.node import Node

from experiment_node.active_goal import GoalSlot, StepFailure
from experiment_node.calibration_run import CalibrationRun
from experiment_node.experiments import Experiments
from experiment_node.plane_steps import PlaneSteps
from fringedic.errors import FringedicError
from fringedic.rig.model import RigModel
from fringedic.wording.path_names import path_name
from fringedic_msgs.action import CalibrateDistortion, CalibrateRig
from fringedic_ros.diagnostics import NodeDiagnostics

if TYPE_CHECKING:
    from experiment_node.calibration_procedures import CalibrationProcedures


class CalibrationServer:
    """Two action servers whose goals run one of the `CalibrationProcedures`.

    Parameters
    ----------
    node
        Owner of the action servers.
    slot
        Place of the one active goal.
    steps
        Places and measures planes.
    experiments
        Gives each calibration an experiment.
    diagnostics
        Counts failures.
    publish_calibration
        Puts a calibration in force; called with the model and its source.
    """

    def __init__(
        self,
        node: Node,
        slot: GoalSlot,
        steps: PlaneSteps,
        experiments: Experiments,
        diagnostics: NodeDiagnostics,
        publish_calibration: Callable[[RigModel, str], None],
    ) -> None:
        self._node = node
        self._slot = slot
        self._steps = steps
        self._experiments = experiments
        self._diagnostics = diagnostics
        self._publish_calibration = publish_calibration
        for action, name, callback in (
            (CalibrateDistortion, "calibrate_distortion", self._calibrate_distortion),
            (CalibrateRig, "calibrate_rig", self._calibrate_rig),
        ):
            ActionServer(node, action, name, callback, cancel_callback=slot.cancel)

    async def _calibrate_distortion(self, goal: ServerGoalHandle) -> CalibrateDistortion.Result:
        result, feedback = CalibrateDistortion.Result(residual=math.nan), CalibrateDistortion.Feedback()
        if self._refuse(goal, result):
            return result
        run = self._begin(goal, result, feedback, "the camera's distortion is being measured")
        await self._run(run, self._procedures.measure_distortion)
        return result

    async def _calibrate_rig(self, goal: ServerGoalHandle) -> CalibrateRig.Result:
        result = CalibrateRig.Result(residual=math.nan, held_out_residual=math.nan, drift=math.nan)
        if self._refuse(goal, result):
            return result
        run = self._begin(goal, result, CalibrateRig.Feedback(), "the rig is being calibrated")
        await self._run(run, self._procedures.measure_rig)
        return result

    # one goal from begin to end

    @cached_property
    def _procedures(self) -> CalibrationProcedures:
        # with the first goal: most experiments need nothing that fits a rig, and start in half the time
        from experiment_node.calibration_procedures import CalibrationProcedures

        return CalibrationProcedures(self._steps, self._publish_calibration)

    def _refuse(self, goal: ServerGoalHandle, result: CalibrateDistortion.Result | CalibrateRig.Result) -> bool:
        """Refuse a goal when the rig is not free."""
        if not self._slot.activity:
            return False
        result.error_code = result.BUSY
        result.error_message = f"{self._slot.activity}; send the goal again when it has ended"
        goal.abort()
        return True

    def _begin(
        self,
        goal: ServerGoalHandle,
        result: CalibrateDistortion.Result | CalibrateRig.Result,
        feedback: CalibrateDistortion.Feedback | CalibrateRig.Feedback,
        activity: str,
    ) -> CalibrationRun:
        experiment = self._experiments.begin()
        parent = Path(self._steps.parameters.calibration_folder)
        folder = Path(goal.request.folder or parent / path_name(experiment.name))
        return CalibrationRun(self._slot.begin(goal, activity), result, feedback, experiment, folder.absolute())

    async def _run(self, run: CalibrationRun, procedure: Callable[[CalibrationRun], Awaitable[None]]) -> None:
        """Run a procedure, free the rig whatever happens, and end the goal with the outcome."""
        goal, result = run.goal.goal, run.result
        try:
            await procedure(run)
        except Exception as error:
            result.error_message = str(error) if isinstance(error, FringedicError | StepFailure) else repr(error)
            result.error_code = error.code if isinstance(error, StepFailure) else result.STEP_FAILED
        finally:
            await self._steps.return_specimen()
            self._slot.end()
        if not result.error_code:
            goal.succeed()
            return
        self._node.get_logger().error(result.error_message)
        self._diagnostics.failure(result.error_message)
        if run.goal.cancelled:
            result.error_code = result.CANCELLED
            goal.canceled()
        else:
            goal.abort()
