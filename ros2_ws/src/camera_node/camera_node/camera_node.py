"""Exposes frames and publishes each with its exposure record, under exactly equal stamps."""

from __future__ import annotations

import time
from pathlib import Path
from statistics import fmean

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup

from camera_node.driver_thread import DriverThread
from camera_node.drivers import Scene
from camera_node.drivers.virtual import VirtualDriver
from camera_node.frame_publisher import FramePublisher
from camera_node.free_run import FreeRun
from camera_node.scene_watch import SceneStamps, SceneWatch
from camera_node.truth_file import TruthFile
from fringedic.errors import CameraError, CameraTimeoutError, FringedicError, PatternError, WaitTimeoutError
from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import moving_frames, pattern_of_message
from fringedic.settings.camera import CameraNodeSettings
from fringedic_msgs.msg import StepStatus
from fringedic_msgs.srv import CaptureFrame
from fringedic_ros.lifecycle import HardwareNode
from fringedic_ros.main import run
from fringedic_ros.qos import EVENTS
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.waiting import sleep, until

Request = CaptureFrame.Request
_TRUTH_TIMEOUT_S = 10.0
_LONGEST_EXPOSURE_S = 60.0
_SUBSCRIBERS_S = 5.0  # longest wait for subscribers; the number that a client counted may contain one that has ended
_AHEAD_S = 0.1  # a pattern with a stamp further ahead than this was shown before a clock was set back


class NoSubscriberError(FringedicError, LookupError):
    """A frame would reach fewer subscribers than expected."""


class CameraNode(HardwareNode[CameraNodeSettings]):
    """Service `camera/capture`; topics `camera/image_raw`, `camera/camera_info` and `camera/exposure`."""

    def __init__(self) -> None:
        super().__init__("camera", CameraNodeSettings)
        self._thread = DriverThread(self)
        self._scenes = SceneWatch(self)
        self._publisher = FramePublisher(self, self.diagnostics)
        self._free_run = FreeRun(self, self._thread, self._scenes, self._publisher)
        self._truth: TruthFile | None = None
        self._truth_experiment = ""
        self._positions: list[tuple[FrameRecord, float]] = []  # of the crosshead during the frames of the step
        self.create_subscription(StepStatus, "experiment/step", self._take_step, EVENTS)
        # a capture waits for the scene: it needs a group of its own, which also serves one capture after the other
        self.create_service(
            CaptureFrame, "camera/capture", self._capture, callback_group=MutuallyExclusiveCallbackGroup()
        )

    # lifecycle

    def open(self) -> None:
        """Open the camera that the parameters select."""
        self._thread.driver = self.parameters.value.device.open(self)
        if self._thread.driver.needs_scene:
            self._scenes.open()

    def activate(self) -> None:
        """Start the free run, when the parameters ask for one."""
        self._free_run.begin()

    def deactivate(self) -> None:
        """End the free run."""
        self._free_run.end()

    def close(self) -> None:
        """Finish writing the truth, then close the camera."""
        if self._truth is not None:
            self._thread.await_idle(_TRUTH_TIMEOUT_S)
        self._scenes.close()
        self._thread.close()

    def destroy_node(self) -> None:
        """Close the camera, end its thread and the node."""
        super().destroy_node()
        self._thread.end()

    def _take_step(self, message: StepStatus) -> None:
        """Continue the free run when the frames of a step are taken, or the step has ended.

        The projector has received white just before, and needs the settle time until it shows it.
        """
        if message.stage in (StepStatus.PROCESS, StepStatus.END, StepStatus.ERROR):
            self._free_run.resume_later(self.parameters.value.device.settle_time)

    # one frame on request

    async def _capture(self, request: CaptureFrame.Request, response: CaptureFrame.Response) -> CaptureFrame.Response:
        if not request.count:
            return response  # a client asks whether its requests and the responses arrive
        started = time.monotonic()
        try:
            response.stamp = to_msg(await self._take_frame(request))
            self.diagnostics.success(time.monotonic() - started)
        except NoSubscriberError as error:
            self._fail(request, response, Request.NO_SUBSCRIBER, error)
        except (WaitTimeoutError, CameraTimeoutError) as error:
            self._fail(request, response, Request.CAMERA_TIMEOUT, error)
        except FringedicError as error:
            self._fail(request, response, Request.CAMERA_FAILED, error)
        response.subscribers = min(self._publisher.subscribers())
        self._free_run.resume_later()
        return response

    async def _take_frame(self, request: CaptureFrame.Request) -> int:
        """Expose and publish the requested frame, and return its stamp [ns]."""
        record, shown_ns = self._record(request), to_nanoseconds(request.shown)
        await self._free_run.pause()
        await self._await_subscribers(request.image_subscribers, request.exposure_subscribers)
        await self._settle(shown_ns)
        camera = self.parameters.value.device
        exposure_time = request.exposure_time or camera.exposure_time
        stamps = SceneStamps(shown_ns, to_nanoseconds(request.placed), to_nanoseconds(request.loaded))
        scene = await self._scenes.scene(stamps, exposure_time, camera.timeout_s)
        frame = await self._thread.expose(scene, camera.timeout_s + exposure_time)
        stamp = self._publisher.publish(frame, record, self._thread.open_driver)
        self._save_truth(request, record, scene)
        return stamp

    def _record(self, request: CaptureFrame.Request) -> FrameRecord:
        """Return the record of the requested frame; stamp and exposure time are entered when it is published.

        Raises
        ------
        CameraError
            The request is impossible.
        """
        if not self.active:
            raise CameraError("the camera is not active; configure and activate it")
        if request.index >= request.count:
            raise CameraError(f"index {request.index} is not below the count {request.count}")
        if not 0 <= request.exposure_time <= _LONGEST_EXPOSURE_S:
            raise CameraError(f"an exposure of {request.exposure_time:g} s is outside 0 to {_LONGEST_EXPOSURE_S:g} s")
        try:
            pattern = pattern_of_message(request)
        except PatternError as error:
            raise CameraError(str(error)) from None
        return FrameRecord(
            request.experiment, request.step, request.index, request.count, pattern, 0, 0.0, sensor=self.sensor
        )

    async def _await_subscribers(self, images: int, exposures: int) -> None:
        def connected() -> bool:
            of_images, of_exposures = self._publisher.subscribers()
            return of_images >= images and of_exposures >= exposures

        try:
            await until(self, connected, min(_SUBSCRIBERS_S, self.parameters.value.device.timeout_s))
        except WaitTimeoutError:
            of_images, of_exposures = self._publisher.subscribers()
            raise NoSubscriberError(
                f"camera/image_raw has {of_images} subscribers and {images} are expected, camera/exposure has "
                f"{of_exposures} and {exposures} are expected"
            ) from None

    async def _settle(self, shown_ns: int) -> None:
        """Wait until the pattern has been on the screen for the settle time."""
        if shown_ns:
            passed = 1e-9 * (time.time_ns() - shown_ns)
            if passed < -_AHEAD_S:
                raise CameraError(
                    f"the stamp of the pattern is {-passed:.3f} s in the future: the clock jumped back, or the clock "
                    "of the projector is ahead; measure the step again, and do not set a clock during a test"
                )
            await sleep(self, self.parameters.value.device.settle_time - passed)

    def _fail(
        self, request: CaptureFrame.Request, response: CaptureFrame.Response, code: int, error: Exception
    ) -> None:
        response.error_code = code
        response.error_message = f"step {request.step}, frame {request.index}: {error}"
        self.get_logger().error(response.error_message)
        self.diagnostics.failure(response.error_message)

    def _save_truth(self, request: CaptureFrame.Request, record: FrameRecord, scene: Scene) -> None:
        """Write the truth of a step of the specimen after its last frame, at the time that its results belong to."""
        self._positions = [*(self._positions if request.index else ()), (record, scene.position)]
        folder, driver = self.parameters.value.truth_folder, self._thread.driver
        is_last = request.index + 1 == request.count
        if not folder or not is_last or scene.plane is not None or not isinstance(driver, VirtualDriver):
            return
        if self._truth is None or self._truth_experiment != request.experiment:
            self._truth = TruthFile(Path(folder) / "truth.nc", driver.rig)
            self._truth_experiment = request.experiment
        finest = moving_frames([each.pattern for each, _ in self._positions])
        position = fmean(self._positions[k][1] for k in finest) if finest else scene.position
        self._thread.submit(self._truth.add, request.step, position)


def main() -> int:
    """Run the camera node."""
    return run(CameraNode.started)


if __name__ == "__main__":
    raise SystemExit(main())
