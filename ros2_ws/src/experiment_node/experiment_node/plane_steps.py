"""Steps of a calibration: the plane is placed, its frames are taken, and images of the step are collected."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TypeVar

from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image

from experiment_node.active_goal import StepFailure
from experiment_node.calibration_run import CalibrationRun
from experiment_node.running_step import RunningStep
from experiment_node.step_runner import StepRunner
from fringedic.calibration.sentences import placing_instruction
from fringedic.errors import FringedicError, WaitTimeoutError
from fringedic.patterns.pattern import ProjectedPattern
from fringedic.settings.experiment import ExperimentNodeSettings
from fringedic_msgs.msg import ReferencePlane
from fringedic_msgs.srv import PlaceReferencePlane
from fringedic_ros.arrivals import unconnected
from fringedic_ros.parameters import Parameters
from fringedic_ros.placing import placing_problem
from fringedic_ros.qos import LATCHED_BY_MANY
from fringedic_ros.rig_node import RIG_FRAME, RigNode, frame_id
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.waiting import Condition, LongRequest, call, wait_for
from fringedic_ros.work import Worker

RETURN_TIMEOUT = 10.0  # [s] for the specimen to be put back
ARRIVAL_TIMEOUT = 10.0  # [s] for images that have been published
CANCEL_PERIOD = 0.2  # [s] between two checks whether the client has cancelled a computation

Images = dict[str, dict[int, Image]]  # topic -> stamp [ns] -> image
Answer = TypeVar("Answer")


class PlaneSteps:
    """Places the reference plane, measures it as a step of an experiment, and computes off the executor's thread.

    Parameters
    ----------
    node, changed
        The node, and its condition that every callback notifies.
    parameters
        Parameters of the experiment node.
    runner
        Measures each step.
    """

    def __init__(
        self, node: RigNode, changed: Condition, parameters: Parameters[ExperimentNodeSettings], runner: StepRunner
    ) -> None:
        self._node = node
        self._changed = changed
        self._parameters = parameters
        self._runner = runner
        self._worker = Worker(node)
        self._place = node.create_client(PlaceReferencePlane, "reference_plane/place")
        self._planes = node.create_publisher(ReferencePlane, "experiment/plane", LATCHED_BY_MANY)

    @property
    def sensor(self) -> str:
        """Name of the sensor that is calibrated."""
        return self._node.sensor

    @property
    def parameters(self) -> ExperimentNodeSettings:
        """The present parameters of the experiment node."""
        return self._parameters.value

    def close(self) -> None:
        """Wait for a computation that is under way."""
        self._worker.stop()

    async def reach_readers(self, run: CalibrationRun, node: str) -> None:
        """Wait until the publishers of a node are connected to all readers."""
        await self._runner.readiness.reach_readers(run.goal, (node,), self.parameters.start_timeout_s)

    async def place(self, run: CalibrationRun, plane: ReferencePlane) -> None:
        """Request the placing of a plane, and enter the angle and height that were reached.

        Raises
        ------
        StepFailure
            PLACING_FAILED, PLACING_TIMEOUT.
        """
        parameters, result = self.parameters, run.result
        request = PlaceReferencePlane.Request(kind=plane.kind, angle=plane.angle, height=plane.height)
        await run.goal.wait_polling(
            self._place.service_is_ready,
            parameters.start_timeout_s,
            lambda: (
                result.PLACING_FAILED,
                f"the reference plane cannot be placed: there is no service {self._place.srv_name}; start a stage, or "
                "calibrate with `fringedic calibrate`, which asks an operator",
            ),
        )
        what = placing_instruction(plane.kind, plane.angle, plane.height)
        with LongRequest(self._node, self._place, request) as sent:
            await run.goal.wait_polling(
                sent.is_over,
                parameters.placing_timeout_s,
                lambda: (
                    result.PLACING_TIMEOUT,
                    f"{what}: {self._place.srv_name} did not answer in {parameters.placing_timeout_s:g} s",
                ),
            )
            if sent.loss:
                raise StepFailure(result.PLACING_FAILED, f"{what}: {sent.loss}")
            placed = sent.response
        if problem := placing_problem(request, placed):
            raise StepFailure(result.PLACING_FAILED, f"{what}: {problem}")
        self._runner.frames.place.take_response(plane.kind, placed)
        if plane.kind == ReferencePlane.PLANE or plane.angle:
            plane.angle, plane.height = placed.angle, placed.height

    async def return_specimen(self) -> None:
        """Request the specimen in front of the camera again; without it the next step fails by itself."""
        if self._place.service_is_ready():
            request = PlaceReferencePlane.Request(kind=PlaceReferencePlane.Request.SPECIMEN)
            with suppress(WaitTimeoutError):
                placed = await call(self._node, self._place, request, RETURN_TIMEOUT)
                self._runner.frames.place.take_response(request.kind, placed)

    async def measure(
        self,
        run: CalibrationRun,
        plane: ReferencePlane,
        patterns: tuple[ProjectedPattern, ...],
        nodes: tuple[str, ...] = (),
    ) -> RunningStep:
        """Publish the plane, measure it as one step, and wait for the results of the nodes.

        Raises
        ------
        StepFailure
            STEP_FAILED.
        """
        number = run.experiment.take_number()
        plane.experiment, plane.step = run.experiment.name, number
        plane.header.stamp, plane.header.frame_id = to_msg(time.time_ns()), frame_id(self._node, RIG_FRAME)
        self._planes.publish(plane)
        step = RunningStep(
            run.goal, run.experiment, number, patterns, nodes, is_reference=False, on_stage=run.report_frames
        )
        failure = await self._runner.measure(step, self.parameters)
        if failure is not None:
            raise StepFailure(run.result.STEP_FAILED, str(failure))
        if problem := self._runner.frames.place.problem():
            raise StepFailure(run.result.STEP_FAILED, problem)
        return step

    @contextmanager
    def collect(self, topics: Mapping[str, QoSProfile]) -> Iterator[Images]:
        """Collect the images of topics by their stamps; a permanent subscription would cost time at every load step."""
        images: Images = {topic: {} for topic in topics}

        def take_of(topic: str) -> Callable[[Image], None]:
            def take(message: Image) -> None:
                images[topic][to_nanoseconds(message.header.stamp)] = message
                self._changed.notify()

            return take

        subscriptions = [
            self._node.create_subscription(Image, topic, take_of(topic), qos) for topic, qos in topics.items()
        ]
        try:
            yield images
        finally:
            for subscription in subscriptions:
                self._node.destroy_subscription(subscription)

    async def await_images(self, run: CalibrationRun, images: Images, topic: str, stamps: list[int]) -> None:
        """Wait until the images with these stamps [ns] have arrived.

        Raises
        ------
        StepFailure
            STEP_FAILED.
        """
        await run.goal.wait(
            lambda: images[topic].keys() >= set(stamps),
            ARRIVAL_TIMEOUT,
            lambda: (
                run.result.STEP_FAILED,
                f"{topic} did not arrive within {ARRIVAL_TIMEOUT:g} s after it was published: "
                + (unconnected(self._node, Image, topic) or f"{len(images[topic])} images came, with other stamps")
                + "; calibrate again",
            ),
        )

    async def compute(
        self, run: CalibrationRun, code: int, function: Callable[..., Answer], *arguments: object
    ) -> Answer:
        """Return the result of a function that runs in a thread of its own.

        Raises
        ------
        StepFailure
            `code`, for the errors of the library and of the file system; CANCELLED.
        """
        future = self._worker.run(function, *arguments)
        while True:
            try:
                answer: Answer = await wait_for(self._node, future, CANCEL_PERIOD)
            except WaitTimeoutError:
                run.goal.check()
            except (FringedicError, OSError) as error:
                raise StepFailure(code, str(error)) from error
            else:
                return answer
