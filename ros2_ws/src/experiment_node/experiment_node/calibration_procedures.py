"""What a calibration does: planes are placed and measured one after the other, then lens and rig are fitted."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from functools import partial
from typing import Any, TypeVar

import numpy as np

from experiment_node.active_goal import StepFailure
from experiment_node.calibration_goals import grid_angles, plane_sequence
from experiment_node.calibration_run import CalibrationRun
from experiment_node.plane_steps import Images, PlaneSteps
from fringedic.calibration.result import RigCalibration
from fringedic.calibration.sentences import (
    calibration_in_words,
    grid_in_words,
    placing_instruction,
    plane_in_words,
    verdict_sentence,
)
from fringedic.calibration.session import CalibrationSession, Plane, Setting
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.report.calibration import CALIBRATION_REPORT, write_calibration_report
from fringedic.rig.model import RigModel
from fringedic_msgs.msg import ReferencePlane
from fringedic_ros.images import image_array
from fringedic_ros.qos import DERIVED, IMAGES

GRID_FRAMES = 8
CAMERA_IMAGE = "camera/image_raw"
PHASE_MAPS = {"phase/map": DERIVED, "phase/sigma": DERIVED}

Answer = TypeVar("Answer")


class CalibrationProcedures:
    """Places and measures planes; a `CalibrationSession` computes.

    The session remains from goal to goal: the distortion that one of them measures is that of the next calibration.

    Parameters
    ----------
    steps
        Places and measures planes.
    publish_calibration
        Puts a calibration in force; called with the model and its source.
    """

    def __init__(self, steps: PlaneSteps, publish_calibration: Callable[[RigModel, str], None]) -> None:
        self._steps = steps
        self._publish_calibration = publish_calibration
        self._session = CalibrationSession()

    async def _until_accepted(self, run: CalibrationRun, measure: Callable[[], Awaitable[Answer]]) -> Answer:
        """Place and measure a plane again when the measurement is rejected, as often as the parameters allow.

        Raises
        ------
        StepFailure
            Of the last attempt; or at once, when it does not concern the measurement of the plane.
        """
        rejected = (run.result.STEP_FAILED, _rejection(run.result))
        for left in reversed(range(self._steps.parameters.placing_attempts)):
            try:
                return await measure()
            except StepFailure as failure:
                if not left or failure.code not in rejected:
                    raise
                run.report(str(failure))
        raise AssertionError("there is at least one attempt")

    # the printed grid

    async def measure_distortion(self, run: CalibrationRun) -> None:
        """Measure the printed grid at 0 and at the angles of the goal, and save the distortion of the lens.

        Raises
        ------
        StepFailure
            With an error code of the action.
        """
        request, result, session = run.goal.goal.request, run.result, self._session
        angles = [0.0, *grid_angles(request)]
        result.experiment = result.identifier = run.experiment.name
        run.feedback.planes = len(angles)
        # one subscription for all: of two in succession the camera could take the first for the second, and lose images
        with self._steps.collect({CAMERA_IMAGE: IMAGES}) as images:
            for run.feedback.plane, angle in enumerate(angles, start=1):
                await self._until_accepted(run, partial(self._measure_grid, run, angle, images))
        orientation = self._steps.parameters.step_patterns()[-1].orientation
        grid = await self._steps.compute(
            run, result.GRID_REJECTED, session.locate_pin_hole, request.sigma_angle, orientation
        )
        await self._steps.compute(run, result.FILES_FAILED, session.save_grid, run.folder)
        result.residual, result.go, result.verdict = grid.residual, True, grid_in_words(grid)
        result.folder = str(run.folder)

    async def _measure_grid(self, run: CalibrationRun, angle: float, images: Images) -> None:
        """Measure the grid at one angle [rad]; the first one is at 0 and gives the distortion."""
        request, session = run.goal.goal.request, self._session
        plane = ReferencePlane(
            kind=ReferencePlane.GRID, angle=angle, grid_pitch=request.grid_pitch, sigma_angle=request.sigma_angle
        )
        white = (ProjectedPattern(PatternKind.WHITE),) * (request.frames or GRID_FRAMES)
        run.report(placing_instruction(plane.kind, angle, 0.0))
        await self._steps.place(run, plane)
        step = await self._steps.measure(run, plane, white)
        await self._steps.await_images(run, images, CAMERA_IMAGE, step.stamps)
        frames = np.stack([image_array(images[CAMERA_IMAGE].pop(stamp)) for stamp in step.stamps])
        if run.feedback.plane == 1:
            run.report("measuring the distortion")
            await self._steps.compute(run, run.result.GRID_REJECTED, session.measure_grid, frames, request.grid_pitch)
        else:
            run.report("finding the grid on the tilted plane")
            await self._steps.compute(run, run.result.GRID_REJECTED, session.measure_tilted_grid, frames, plane.angle)

    # the planes

    async def measure_rig(self, run: CalibrationRun) -> None:
        """Measure the phase of all planes, fit the model of the rig, and put it in force when it is good.

        Raises
        ------
        StepFailure
            With an error code of the action.
        """
        request, result, parameters = run.goal.goal.request, run.result, self._steps.parameters
        if not parameters.projector:
            raise StepFailure(result.INVALID_GOAL, "a rig without projector needs no calibration beside its distortion")
        planes, patterns = plane_sequence(request), parameters.step_patterns()
        result.experiment = result.identifier = run.experiment.name
        setting = Setting(
            run.experiment.name,
            (parameters.projector_width_px, parameters.projector_height_px),
            patterns[-1],
            request.sigma_angle,
            request.sigma_height,
            (parameters.camera_first_column_px, parameters.camera_first_row_px),
            self._steps.sensor,
        )
        await self._steps.compute(run, result.INVALID_GOAL, self._session.begin, setting)
        run.feedback.planes = len(planes)
        with self._steps.collect(PHASE_MAPS) as images:
            await self._steps.reach_readers(run, "phase")
            for run.feedback.plane, plane in enumerate(planes, start=1):
                stamp = await self._until_accepted(run, partial(self._measure_plane, run, plane, patterns, images))
        run.report("fitting the model of the rig")
        calibrated = await self._fit(run, datetime.fromtimestamp(1e-9 * stamp, UTC))
        if not calibrated.go:
            raise StepFailure(result.NO_GO, verdict_sentence(calibrated))
        result.go = True
        self._publish_calibration(calibrated.model, str(run.folder))

    async def _measure_plane(
        self, run: CalibrationRun, plane: ReferencePlane, patterns: tuple[ProjectedPattern, ...], images: Images
    ) -> int:
        """Measure the phase of one plane and return the stamp of its step [ns].

        The patterns are those of the begin: the fit takes all phases as those of one pitch.
        """
        run.report(placing_instruction(plane.kind, plane.angle, plane.height))
        await self._steps.place(run, plane)
        step = await self._steps.measure(run, plane, patterns, ("phase",))
        for topic in PHASE_MAPS:
            await self._steps.await_images(run, images, topic, [step.stamp])
        phase, sigma = (image_array(images[topic].pop(step.stamp)) for topic in PHASE_MAPS)
        measured = Plane(plane.angle, plane.height, plane.held_out, phase, sigma)
        quality = await self._steps.compute(run, run.result.PLANE_REJECTED, self._session.add_plane, measured)
        run.report(plane_in_words(quality))
        return step.stamp

    async def _fit(self, run: CalibrationRun, measured_at: datetime) -> RigCalibration:
        """Fit the model of the rig, write its files and enter its figures in the result."""
        result, session = run.result, self._session
        calibrated = await self._steps.compute(run, result.FIT_FAILED, session.calibrate, measured_at)
        summary = verdict_sentence(calibrated)
        await self._steps.compute(run, result.FILES_FAILED, session.save, run.folder, summary)
        await self._steps.compute(
            run, result.FILES_FAILED, write_calibration_report, calibrated, run.folder / CALIBRATION_REPORT
        )
        result.verdict, result.folder = calibration_in_words(calibrated), str(run.folder)
        result.residual, result.held_out_residual = calibrated.residual, calibrated.held_out
        result.drift = session.drift
        return calibrated


def _rejection(result: Any) -> int:
    """Return the error code of an action for a measurement that shows no plane, or no grid."""
    return int(getattr(result, "PLANE_REJECTED", 0) or result.GRID_REJECTED)
