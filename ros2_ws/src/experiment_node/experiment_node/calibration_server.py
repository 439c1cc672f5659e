"""The actions ``calibrate_distortion`` and ``calibrate_rig``: what is placed and measured, step by step.

A calibration is an experiment of its own, whose steps are measured and recorded like load steps. What stood in front
of the camera in each of them is published on ``experiment/plane``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Coroutine, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rclpy.action import ActionServer
from rclpy.action.server import ServerGoalHandle
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image

from experiment_node.running_step import Experiment, RunningStep
from experiment_node.turn import StepFailure, Turn
from fringedic.calibration_session import CalibrationSession, Plane, Setting, grid_in_words, place_in_words
from fringedic.camera.turned_grid import SMALLEST_TURN
from fringedic.errors import FringedicError, WaitTimeoutError
from fringedic.sequence import PatternKind, Projection
from fringedic_msgs.action import CalibrateDistortion, CalibrateRig
from fringedic_msgs.msg import ReferencePlane
from fringedic_msgs.srv import PlaceReferencePlane
from fringedic_ros.images import image_array
from fringedic_ros.qos import DERIVED, EVENTS, IMAGES
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.waiting import call, wait_for
from fringedic_ros.work import Worker

if TYPE_CHECKING:
    from experiment_node.experiment_node import ExperimentNode

GRID_FRAMES = 8
MAXIMUM_ANGLE = math.radians(80)
GIVING_BACK_TIMEOUT = 10.0  # [s] for the specimen to be put back
ARRIVAL_TIMEOUT = 10.0  # [s] for images and maps that were published already
CANCEL_PERIOD = 0.2  # [s] after which a computation looks whether the caller has cancelled
PHASE_MAPS = {"phase/map": DERIVED, "phase/sigma": DERIVED}

Heard = dict[str, dict[int, Image]]
Procedure = Callable[[Turn, Any], Coroutine[Any, Any, None]]


class CalibrationServer:
    """Two action servers that have the plane placed, measure it, and leave the arithmetic to a `CalibrationSession`.

    Parameters
    ----------
    node
        Owner of everything; has the rig, whose turn it is, and the experiments.
    """

    def __init__(self, node: ExperimentNode) -> None:
        self._node = node
        self._session = CalibrationSession()
        self._worker = Worker(node)
        self._place = node.create_client(PlaceReferencePlane, "reference_plane/place")
        self._planes = node.create_publisher(ReferencePlane, "experiment/plane", EVENTS)
        ActionServer(
            node, CalibrateDistortion, "calibrate_distortion", self._calibrate_distortion, cancel_callback=node.cancel
        )
        ActionServer(node, CalibrateRig, "calibrate_rig", self._calibrate_rig, cancel_callback=node.cancel)

    def close(self) -> None:
        """Wait for a fit that is under way."""
        self._worker.stop()

    async def _calibrate_distortion(self, goal: ServerGoalHandle) -> CalibrateDistortion.Result:
        result = CalibrateDistortion.Result(residual=math.nan)
        return await self._act(goal, result, self._measure_grid, "the camera's distortion is being measured")

    async def _calibrate_rig(self, goal: ServerGoalHandle) -> CalibrateRig.Result:
        result = CalibrateRig.Result(residual=math.nan, held_out_residual=math.nan, drift=math.nan)
        return await self._act(goal, result, self._measure_planes, "the rig is being calibrated")

    async def _act(self, goal: ServerGoalHandle, result: Any, procedure: Procedure, doing: str) -> Any:
        """Give the rig to a goal while its procedure runs, and end the goal as that ended."""
        if self._node.doing:
            result.error_code = result.BUSY
            result.error_message = f"{self._node.doing}; ask again when it has ended"
            goal.abort()
            return result
        turn = self._node.begin_turn(goal, doing)
        try:
            await procedure(turn, result)
        except Exception as error:
            result.error_message = str(error) if isinstance(error, FringedicError | StepFailure) else repr(error)
            result.error_code = error.code if isinstance(error, StepFailure) else result.STEP_FAILED
        finally:
            await self._give_back()
            self._node.end_turn()
        if not result.error_code:
            goal.succeed()
            return result
        self._node.get_logger().error(result.error_message)
        self._node.diagnostics.failure(result.error_message)
        if turn.cancelled:
            result.error_code = result.CANCELLED
            goal.canceled()
        else:
            goal.abort()
        return result

    async def _give_back(self) -> None:
        """Have the specimen put back, whatever happened; who cannot do it says so to the next step."""
        if self._place.service_is_ready():
            request = PlaceReferencePlane.Request(kind=PlaceReferencePlane.Request.SPECIMEN)
            with suppress(WaitTimeoutError):
                placed = await call(self._node, self._place, request, GIVING_BACK_TIMEOUT)
                self._node.runner.placed = placed.placed

    # the grid

    async def _measure_grid(self, turn: Turn, result: CalibrateDistortion.Result) -> None:
        request = turn.goal.request
        if not 0 < request.grid_pitch < 1:
            raise StepFailure(
                result.INVALID_GOAL, f"grid_pitch is {request.grid_pitch:g} m; give the distance of the printed lines"
            )
        angles = [0.0, *_grid_angles(request, result)]
        experiment = self._node.begin_experiment()
        result.experiment = result.identifier = experiment.name
        folder = self._folder(request.folder, experiment)
        feedback = CalibrateDistortion.Feedback(planes=len(angles))
        white = (Projection(PatternKind.WHITE),) * (request.frames or GRID_FRAMES)

        def feed_back(words: str, step: RunningStep | None = None) -> None:
            feedback.words, feedback.frame, feedback.frames = words, 0, 0
            if step is not None:
                feedback.words = "measuring"
                feedback.frame, feedback.frames = step.taken, len(step.projections)
            turn.goal.publish_feedback(feedback)

        for feedback.plane, angle in enumerate(angles, start=1):
            plane = ReferencePlane(
                kind=ReferencePlane.GRID, angle=angle, grid_pitch=request.grid_pitch, sigma_angle=request.sigma_angle
            )
            with self._listening({"camera/image_raw": IMAGES}) as heard:
                feed_back(place_in_words(plane.kind, angle, 0.0))
                await self._put(turn, result, plane)
                step = await self._step(turn, result, experiment, plane, white, (), feed_back)
                images = heard["camera/image_raw"]
                await self._arrived(turn, result, images, step.stamps, "camera/image_raw")
                frames = np.stack([image_array(images[stamp]) for stamp in step.stamps])
            code, session = result.GRID_REJECTED, self._session
            if feedback.plane == 1:
                feed_back("measuring the distortion")
                await self._compute(turn, code, session.measure_grid, frames, request.grid_pitch)
            else:
                feed_back("finding the grid on the turned plane")
                await self._compute(turn, code, session.measure_turned_grid, frames, plane.angle)
        orientation = self._node.parameters.value.projections()[-1].orientation
        grid = await self._compute(
            turn, result.GRID_REJECTED, self._session.locate_pin_hole, request.sigma_angle, orientation
        )
        await self._compute(turn, result.FILES_FAILED, self._session.save_grid, folder)
        result.residual, result.go, result.verdict = grid.residual, True, grid_in_words(grid)
        result.folder = str(folder)

    # the planes

    async def _measure_planes(self, turn: Turn, result: CalibrateRig.Result) -> None:
        request, parameters = turn.goal.request, self._node.parameters.value
        if not parameters.projector:
            raise StepFailure(result.INVALID_GOAL, "a rig without projector has nothing to calibrate but its camera")
        planes = _planes(request, result)
        experiment = self._node.begin_experiment()
        result.experiment = result.identifier = experiment.name
        folder = self._folder(request.folder, experiment)
        size = (parameters.projector_width_px, parameters.projector_height_px)
        finest = parameters.projections()[-1]
        setting = Setting(experiment.name, size, finest, request.sigma_angle, request.sigma_height)
        await self._compute(turn, result.INVALID_GOAL, self._session.begin, setting)
        feedback = CalibrateRig.Feedback(planes=len(planes))

        def feed_back(words: str, step: RunningStep | None = None) -> None:
            feedback.words, feedback.frame, feedback.frames = words, 0, 0
            if step is not None:
                feedback.words = "measuring"
                feedback.frame, feedback.frames = step.taken, len(step.projections)
            turn.goal.publish_feedback(feedback)

        with self._listening(PHASE_MAPS) as heard:
            await self._node.runner.reach_readers(turn, ("phase",), parameters.start_timeout_s)
            for feedback.plane, plane in enumerate(planes, start=1):
                feed_back(place_in_words(plane.kind, plane.angle, plane.height))
                await self._put(turn, result, plane)
                step = await self._step(
                    turn, result, experiment, plane, parameters.projections(), ("phase",), feed_back
                )
                for topic in PHASE_MAPS:
                    await self._arrived(turn, result, heard[topic], [step.stamp], topic)
                phase, sigma = (image_array(heard[topic].pop(step.stamp)) for topic in PHASE_MAPS)
                measured = Plane(plane.angle, plane.height, plane.held_out, phase, sigma)
                feed_back(await self._compute(turn, result.PLANE_REJECTED, self._session.add_plane, measured))
        feed_back("fitting the model of the rig")
        measured_at = datetime.fromtimestamp(1e-9 * step.stamp, UTC)
        calibrated = await self._compute(turn, result.FIT_FAILED, self._session.calibrate, measured_at)
        await self._compute(turn, result.FILES_FAILED, self._session.save, folder)
        result.verdict, result.folder = " ".join([calibrated.verdict, *calibrated.warnings]), str(folder)
        result.residual, result.held_out_residual = calibrated.residual, calibrated.held_out
        result.drift = self._session.drift
        if not calibrated.go:
            raise StepFailure(result.NO_GO, calibrated.verdict)
        result.go = True
        self._node.publish_calibration(calibrated.model, str(folder))

    # what both consist of

    def _folder(self, asked: str, experiment: Experiment) -> Path:
        return Path(asked or Path(self._node.parameters.value.calibration_folder) / experiment.name).absolute()

    async def _put(self, turn: Turn, result: Any, plane: ReferencePlane) -> None:
        """Have the plane put where it is wanted, and note where it came to stand."""
        parameters = self._node.parameters.value
        request = PlaceReferencePlane.Request(kind=plane.kind, angle=plane.angle, height=plane.height)
        await turn.wait_polling(
            self._place.service_is_ready,
            parameters.start_timeout_s,
            lambda: (
                result.PLACING_FAILED,
                f"nobody places the reference plane: there is no service {self._place.srv_name}; start a stage, or "
                "calibrate with `fringedic calibrate`, which asks an operator",
            ),
        )
        what = place_in_words(plane.kind, plane.angle, plane.height)
        placed = await turn.call(self._place, request, parameters.placing_timeout_s, result.PLACING_TIMEOUT, what)
        if not placed.success:
            raise StepFailure(result.PLACING_FAILED, f"{what}: {placed.message or 'refused without a reason'}")
        self._node.runner.placed = placed.placed
        if plane.kind == ReferencePlane.PLANE or plane.angle:
            plane.angle, plane.height = placed.angle, placed.height

    async def _step(
        self,
        turn: Turn,
        result: Any,
        experiment: Experiment,
        plane: ReferencePlane,
        projections: tuple[Projection, ...],
        nodes: tuple[str, ...],
        feed_back: Callable[[str, RunningStep], None],
    ) -> RunningStep:
        """Measure one step of a calibration and say what stands there."""
        number = experiment.take_number()
        plane.experiment, plane.step = experiment.name, number
        plane.header.stamp = self._node.get_clock().now().to_msg()
        self._planes.publish(plane)
        step = RunningStep(turn, experiment, number, projections, nodes, is_reference=False, feed_back=feed_back)
        failure = await self._node.runner.measure(step, self._node.parameters.value)
        if failure is not None:
            raise StepFailure(result.STEP_FAILED, str(failure))
        return step

    @contextmanager
    def _listening(self, topics: Mapping[str, QoSProfile]) -> Iterator[Heard]:
        """Hear image topics, by stamp, while a procedure needs them: maps of every load step would cost time."""
        heard: Heard = {topic: {} for topic in topics}

        def taker(topic: str) -> Callable[[Image], None]:
            def take(message: Image) -> None:
                heard[topic][to_nanoseconds(message.header.stamp)] = message
                self._node.changed.notify()

            return take

        subscriptions = [
            self._node.create_subscription(Image, topic, taker(topic), qos) for topic, qos in topics.items()
        ]
        try:
            yield heard
        finally:
            for subscription in subscriptions:
                self._node.destroy_subscription(subscription)

    async def _arrived(self, turn: Turn, result: Any, heard: dict[int, Image], stamps: list[int], topic: str) -> None:
        await turn.wait(
            lambda: heard.keys() >= set(stamps),
            ARRIVAL_TIMEOUT,
            lambda: (result.STEP_FAILED, f"{topic} did not arrive here within {ARRIVAL_TIMEOUT:g} s of its publishing"),
        )

    async def _compute(self, turn: Turn, code: int, function: Callable[..., Any], *arguments: Any) -> Any:
        """What a function of the session returns, from the worker's thread; its named errors end the turn."""
        future = self._worker.run(function, *arguments)
        while True:
            try:
                return await wait_for(self._node, future, CANCEL_PERIOD)
            except WaitTimeoutError:
                turn.check()
            except (FringedicError, OSError) as error:
                raise StepFailure(code, str(error)) from error


def _grid_angles(request: CalibrateDistortion.Goal, result: CalibrateDistortion.Result) -> list[float]:
    """The angles at which the grid is seen besides 0: none, or some on both sides."""
    angles = list(request.angles)
    one_sided = bool(angles) and not min(angles) < -SMALLEST_TURN < SMALLEST_TURN < max(angles)
    if one_sided or not all(abs(angle) < MAXIMUM_ANGLE for angle in angles) or not 0 <= request.sigma_angle < 1:
        raise StepFailure(
            result.INVALID_GOAL,
            f"angles {angles} rad, sigma_angle {request.sigma_angle:g} rad: give no angles, or some on both sides of 0 "
            "in radian",
        )
    return angles


def _planes(request: CalibrateRig.Goal, result: CalibrateRig.Result) -> list[ReferencePlane]:
    """The planes to measure; the last is the first once more."""
    angles, heights = list(request.angles), list(request.heights) or [0.0] * len(request.angles)
    held_out = set(request.held_out)
    if not angles or len(heights) != len(angles):
        raise StepFailure(
            result.INVALID_GOAL, f"{len(angles)} angles and {len(heights)} heights; give one of each for every plane"
        )
    if not all(abs(angle) < MAXIMUM_ANGLE for angle in angles) or not all(map(math.isfinite, heights)):
        raise StepFailure(
            result.INVALID_GOAL,
            f"angles {angles} rad, heights {heights} m: angles in radian between -1.4 and 1.4 and finite heights are "
            "needed",
        )
    if not held_out < set(range(len(angles))):
        raise StepFailure(
            result.INVALID_GOAL, f"held_out names planes {sorted(held_out)} of {len(angles)}; they count from 0"
        )
    if not (0 <= request.sigma_angle < 1 and 0 <= request.sigma_height < 1):
        raise StepFailure(
            result.INVALID_GOAL,
            f"sigma_angle {request.sigma_angle:g} rad, sigma_height {request.sigma_height:g} m: 0 to 1 make sense",
        )
    return [
        ReferencePlane(
            kind=ReferencePlane.PLANE,
            angle=angle,
            height=height,
            held_out=index in held_out or index == len(angles),
            sigma_angle=request.sigma_angle,
            sigma_height=request.sigma_height,
        )
        for index, (angle, height) in enumerate(zip([*angles, angles[0]], [*heights, heights[0]], strict=True))
    ]
