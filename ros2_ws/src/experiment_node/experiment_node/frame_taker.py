"""Frames of a step: one pattern after the other is shown and exposed."""

from __future__ import annotations

import time

from builtin_interfaces.msg import Time
from rclpy.node import Node

from experiment_node.active_goal import StepFailure
from experiment_node.load_watch import JUMPED_BACK, LoadWatch
from experiment_node.running_step import RunningStep
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.settings.experiment import ExperimentNodeSettings
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.srv import CaptureFrame, ShowPattern
from fringedic_ros.placing import STATE, PlaceWatch
from fringedic_ros.stamps import to_nanoseconds

Result = MeasureStep.Result
AGAIN_S = 1.0
PLACED_S = 2.0  # longest wait for the state of a stage, which an inactive one does not publish
_DARK = ShowPattern.Request(kind=int(PatternKind.OTHER), name="dark")
CAPTURE_ERRORS = {
    CaptureFrame.Request.CAMERA_TIMEOUT: Result.CAMERA_TIMEOUT,
    CaptureFrame.Request.CAMERA_FAILED: Result.CAMERA_FAILED,
    CaptureFrame.Request.NO_SUBSCRIBER: Result.NO_SUBSCRIBER,
}


class FrameTaker:
    """Client of `projector/show` and `camera/capture`.

    Parameters
    ----------
    node
        Owner of the clients.
    load
        Observes the load frame, whose motion is often the cause of a failed capture.

    Attributes
    ----------
    place
        State of the stage: the camera waits for the latest message of it, which it may receive later than this node.
    """

    def __init__(self, node: Node, load: LoadWatch) -> None:
        self._node = node
        self._load = load
        self._show = node.create_client(ShowPattern, "projector/show")
        self._capture = node.create_client(CaptureFrame, "camera/capture")
        self.place = PlaceWatch(node)
        self._is_white = True

    def servers(self) -> list[int]:
        """Return how many servers of each service are known."""
        return [self._node.count_services(client.srv_name) for client in (self._show, self._capture)]

    async def await_responses(self, step: RunningStep, parameters: ExperimentNodeSettings) -> None:
        """Wait until projector and camera have discovered this node, and this node the stage: nothing is lost then.

        Raises
        ------
        StepFailure
            PROJECTOR_TIMEOUT, CAMERA_TIMEOUT.
        """
        white, nothing = ShowPattern.Request(kind=int(PatternKind.WHITE)), CaptureFrame.Request(count=0)
        pings = [(self._capture, nothing, Result.CAMERA_TIMEOUT)]
        if parameters.projector:
            pings.insert(0, (self._show, white, Result.PROJECTOR_TIMEOUT))
        for client, request, code in pings:
            await step.goal.call(
                client, request, parameters.start_timeout_s, code, "before the first frame", again_s=AGAIN_S
            )
        end = time.monotonic() + PLACED_S
        while self._node.count_publishers(STATE) and not to_nanoseconds(self.place.placed) and time.monotonic() < end:
            await step.goal.pause(0.05)
        if self._node.count_publishers(STATE) and not to_nanoseconds(self.place.placed):
            self._node.get_logger().warning(f"what the stage has placed is not waited for: {self.place.arrivals}")

    async def show(self, step: RunningStep, pattern: ProjectedPattern, parameters: ExperimentNodeSettings) -> Time:
        """Show a pattern and return the stamp of it.

        Raises
        ------
        StepFailure
            PROJECTOR_TIMEOUT, PROJECTOR_FAILED.
        """
        request = ShowPattern.Request(
            kind=int(pattern.kind),
            pitch=pattern.pitch,
            shift=pattern.shift,
            shifts=pattern.shifts,
            orientation=int(pattern.orientation),
        )
        self._is_white = False
        response = await step.goal.call(
            self._show, request, parameters.projector_timeout_s, Result.PROJECTOR_TIMEOUT, str(pattern)
        )
        if response.error_code != ShowPattern.Request.NONE:
            raise StepFailure(Result.PROJECTOR_FAILED, f"{pattern}: {response.error_message}")
        self._is_white = pattern.kind is PatternKind.WHITE
        return response.shown

    async def darken(self, step: RunningStep, parameters: ExperimentNodeSettings) -> None:
        """Show the dark screen, and wait until it is there.

        Raises
        ------
        StepFailure
            PROJECTOR_TIMEOUT, PROJECTOR_FAILED.
        """
        response = await step.goal.call(
            self._show, _DARK, parameters.projector_timeout_s, Result.PROJECTOR_TIMEOUT, "dark screen"
        )
        if response.error_code != ShowPattern.Request.NONE:
            raise StepFailure(Result.PROJECTOR_FAILED, f"dark screen: {response.error_message}")

    def leave(self, parameters: ExperimentNodeSettings) -> None:
        """Request white or dark after a step that failed or was cancelled while a pattern was on the screen.

        Nobody waits for the answer: the record of the failure and the request to hold come first.
        """
        if parameters.projector and parameters.white_between_steps and not self._is_white:
            self._show.call_async(ShowPattern.Request(kind=int(PatternKind.WHITE)))
        if parameters.projector and parameters.dark_between_steps:
            self._show.call_async(_DARK)

    async def capture(
        self, step: RunningStep, index: int, pattern: ProjectedPattern, shown: Time, parameters: ExperimentNodeSettings
    ) -> None:
        """Expose frame `index` of a step after its pattern was `shown`.

        Raises
        ------
        StepFailure
            CAMERA_TIMEOUT, CAMERA_FAILED, NO_SUBSCRIBER; LOAD_NOT_HELD when the machine explains the failure.
        """
        first = index == 0
        # the first frame waits for subscribers; the camera reports which are missing, a time-out here would not
        timeout = parameters.camera_timeout_s + (parameters.start_timeout_s if first else 0.0)
        end = time.monotonic() + parameters.start_timeout_s
        while True:
            if first:
                step.requested_ns = time.time_ns()
            request = self._request(step, index, pattern, shown, parameters)
            response = await step.goal.call(self._capture, request, timeout, Result.CAMERA_TIMEOUT, f"frame {index}")
            # a subscriber that was counted may have ended since: ask again with the number of now
            if response.error_code != CaptureFrame.Request.NO_SUBSCRIBER or time.monotonic() >= end:
                break
            await step.goal.pause(AGAIN_S)
        if response.error_code != CaptureFrame.Request.NONE:
            self._load.check_latest(step, parameters)  # a virtual camera needs the load frame
            code = CAPTURE_ERRORS.get(response.error_code, Result.CAMERA_FAILED)
            raise StepFailure(code, f"frame {index}: {response.error_message}")
        stamp = to_nanoseconds(response.stamp)
        if not first and stamp <= step.stamp:
            raise StepFailure(
                Result.CAMERA_FAILED,
                f"frame {index} is stamped {1e-9 * (step.stamp - stamp):.3f} s before frame {index - 1}: {JUMPED_BACK}",
            )
        step.stamps.append(stamp)
        step.answered_ns = time.time_ns()
        step.exposed = time.monotonic()

    def _request(
        self, step: RunningStep, index: int, pattern: ProjectedPattern, shown: Time, parameters: ExperimentNodeSettings
    ) -> CaptureFrame.Request:
        # at the first frame of each step the camera, which may have been restarted, waits for its subscribers
        topics = ("camera/image_raw", "camera/exposure")
        images, exposures = (self._node.count_subscribers(topic) if index == 0 else 0 for topic in topics)
        return CaptureFrame.Request(
            experiment=step.experiment.name,
            step=step.number,
            index=index,
            count=len(step.patterns),
            kind=int(pattern.kind),
            orientation=int(pattern.orientation),
            pitch=pattern.pitch,
            shift=pattern.shift,
            shifts=pattern.shifts,
            exposure_time=parameters.exposure_time(index, pattern),
            shown=shown,
            placed=self.place.placed,
            loaded=self._load.latest_stamp,
            image_subscribers=images,
            exposure_subscribers=exposures,
        )
