"""Exposes frames and publishes each with its exposure record, under exactly equal stamps."""

from __future__ import annotations

import math
import time
from collections import deque
from pathlib import Path
from typing import Literal

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import CameraInfo, Image

from camera_node.drivers import Driver, Frame, PlacedPlane, Scene, ShownPattern, StreamingDriver, VirtualDriver
from camera_node.drivers.virtual import TruthFile
from camera_node.parameters import CameraParameters
from fringedic.errors import CameraError, CameraTimeoutError, ClockJumpError, FringedicError, WaitTimeoutError
from fringedic.rig import RigModel
from fringedic.sequence import FrameRecord, PatternKind, Projection, projection_of
from fringedic_msgs.msg import ClockDrift, Exposure, LoadState, ReferencePlane, RigCalibration, StepStatus
from fringedic_msgs.srv import CaptureFrame
from fringedic_ros.camera_info import camera_info
from fringedic_ros.images import image_array, image_message
from fringedic_ros.lifecycle import HardwareNode
from fringedic_ros.main import run
from fringedic_ros.qos import EVENTS, IMAGES, LATCHED, LATEST, OVERRIDABLE
from fringedic_ros.records import clock_message, exposure_message
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.waiting import Condition, sleep, until, wait_for
from fringedic_ros.work import Worker

FRAME_ID = "camera_optical_frame"
Request = CaptureFrame.Request
_TRUTH_TIMEOUT_S = 10.0
_LONGEST_EXPOSURE_S = 60.0
_RESUME_S = 5.0  # after a capture that belongs to no step, or to one that is given up without a word
_BUFFERS = 4  # exposures of the free run that may be under way, as in a camera driver
_BROWN_RESIDUAL_PX = 0.05
_KEPT_PATTERNS = 16  # that a slow projector may still show beside the latest
_LOST_CAMERA_PAUSE_S = 0.05  # between attempts to take a frame
_DRIVER_PERIOD_S = 1.0  # between two reports of the camera's clock and of what was lost on the way
_AHEAD_S = 0.1  # a pattern that was shown later than this from now was shown before a clock was set back
_BACK_NS = 100_000_000  # a frame is never so much older than the one before, unless a clock was set


class NoSubscriberError(FringedicError, LookupError):
    """A frame would reach fewer subscribers than expected."""


class CameraNode(HardwareNode[CameraParameters]):
    """Service `camera/capture`; topics `camera/image_raw`, `camera/camera_info` and `camera/exposure`."""

    def __init__(self) -> None:
        super().__init__("camera", CameraParameters)
        self._driver: Driver | None = None
        self._worker = Worker(self)
        self._truth: TruthFile | None = None
        self._truth_experiment = ""
        self._free_run: Timer | None = None
        self._streaming = False
        self._free_run_index = 0
        self._paused = False
        self._resuming: Timer | None = None
        self._dropped = 0
        self._dropped_before = 0  # by the driver, when the free run began
        self._stamp_ns = 0
        self._patterns: deque[Image] = deque(maxlen=_KEPT_PATTERNS)
        self._load: LoadState | None = None
        self._plane: PlacedPlane | None = None
        self._placed_ns = 0
        self._info = CameraInfo()
        self._scene_changed = Condition(self)
        self._images = self.create_publisher(Image, "camera/image_raw", IMAGES, qos_overriding_options=OVERRIDABLE)
        self._infos = self.create_publisher(CameraInfo, "camera/camera_info", IMAGES)
        self._exposures = self.create_publisher(Exposure, "camera/exposure", IMAGES)
        self._clocks = self.create_publisher(ClockDrift, "camera/clock", LATCHED)
        self._told_of_driver = -math.inf
        self._of_scene: list[Subscription] = []
        self.create_subscription(RigCalibration, "calibration", self._take_calibration, LATCHED)
        self.create_subscription(StepStatus, "experiment/step", self._take_step, EVENTS)
        # a capture waits for the scene: it needs a group of its own, which also serves one capture after the other
        self.create_service(
            CaptureFrame, "camera/capture", self._capture, callback_group=MutuallyExclusiveCallbackGroup()
        )

    # lifecycle

    def open(self) -> None:
        """Open the camera that the parameters name."""
        self._driver = self.parameters.value.open(self)
        if self._driver.needs_scene:  # a real camera sees it: a load frame at 1 kHz would take it half a core
            self._of_scene = [
                self.create_subscription(Image, "projector/image", self._take_pattern, LATCHED),
                self.create_subscription(LoadState, "load_frame/state", self._take_load, LATEST),
                self.create_subscription(ReferencePlane, "reference_plane/state", self._take_plane, LATCHED),
            ]

    def activate(self) -> None:
        """Begin the free run, when one is asked for."""
        self._free_run_index = 0
        self._start_free_run()

    def deactivate(self) -> None:
        """End the free run."""
        self._paused = False
        self._stop_resuming()
        self._stop_free_run()

    def _start_free_run(self) -> None:
        self._dropped_before = 0 if self._driver is None else self._driver.dropped
        rate = self.parameters.value.frame_rate_hz
        if rate > 0 and isinstance(self._driver, StreamingDriver):
            self._driver.start(rate)
            self._streaming = True
            self._worker.submit(self._stream, self._driver)
        elif rate > 0:
            self._free_run = self.create_timer(
                1 / rate, self._expose_freely, callback_group=MutuallyExclusiveCallbackGroup()
            )

    def _stop_free_run(self) -> None:
        if self._free_run is not None:
            self.destroy_timer(self._free_run)
            self._free_run = None
        if self._streaming:
            self._streaming = False
            assert isinstance(self._driver, StreamingDriver), "only such a camera streams"
            self._driver.interrupt()
            self._worker.stop(self.parameters.value.timeout_s)
            self._worker = Worker(self)
            self._driver.stop()

    async def _pause_free_run(self) -> None:
        """Give the camera to a step, whose frames are taken when they are asked for."""
        self._stop_resuming()
        if self._free_run is not None or self._streaming:
            self._stop_free_run()
            self._free_run_index += 0 if self._driver is None else self._driver.dropped - self._dropped_before
            self._paused = True
            # frames that are under way come first: later ones have later stamps
            await wait_for(self, self._worker.run(time.time_ns), self.parameters.value.timeout_s, "the free run's end")

    def _resume_free_run(self) -> None:
        """Run freely again; the index goes on."""
        self._stop_resuming()
        if self._paused and self.active:
            self._paused = False
            try:
                self._start_free_run()
            except FringedicError as error:
                self.get_logger().error(str(error))
                self.diagnostics.failure(str(error))

    def _stop_resuming(self) -> None:
        if self._resuming is not None:
            self.destroy_timer(self._resuming)
            self._resuming = None

    def close(self) -> None:
        """Give the camera back; what is still to be written of the truth is written first."""
        deadline = time.monotonic() + _TRUTH_TIMEOUT_S
        while self._truth is not None and self._worker.pending and time.monotonic() < deadline:
            time.sleep(0.01)
        self._worker.stop()
        self._worker = Worker(self)
        while self._of_scene:
            self.destroy_subscription(self._of_scene.pop())
        if self._driver is not None:
            self._driver.close()
            self._driver = None

    def destroy_node(self) -> None:
        """End the background thread, too."""
        super().destroy_node()
        self._worker.stop()

    def _take_calibration(self, message: RigCalibration) -> None:
        """Tell other tools of the lens from now on."""
        try:
            info, residual = camera_info(RigModel.from_message(message))
        except FringedicError as error:
            self.get_logger().error(f"calibration '{message.identifier}' refused: {error}")
            return
        self._info = info
        if residual > _BROWN_RESIDUAL_PX:
            self.get_logger().info(
                f"camera/camera_info describes the lens to within {residual:.2f} px only; the calibration does better"
            )

    def _take_step(self, message: StepStatus) -> None:
        """Run freely again when the frames of a step are taken, or it has ended."""
        if message.stage in (StepStatus.PROCESS, StepStatus.END, StepStatus.ERROR):
            self._resume_free_run()

    # the scene of a virtual camera

    def _take_pattern(self, message: Image) -> None:
        self._patterns.append(message)
        self._scene_changed.notify()

    def _take_load(self, message: LoadState) -> None:
        self._load = message
        self._scene_changed.notify()

    def _take_plane(self, message: ReferencePlane) -> None:
        surface: Literal["plain", "grid"] = "grid" if message.kind == ReferencePlane.GRID else "plain"
        there = message.kind != ReferencePlane.SPECIMEN
        self._plane = PlacedPlane(surface, message.angle, message.height) if there else None
        self._placed_ns = to_nanoseconds(message.header.stamp)
        self._scene_changed.notify()

    async def _scene(self, shown_ns: int, placed_ns: int, exposure_time: float) -> Scene:
        """What the camera sees now: the pattern that was shown and the specimen at the middle of the exposure."""
        timeout = self.parameters.value.timeout_s
        stamp = self.get_clock().now().nanoseconds + round(exposure_time * 1e9 / 2)
        if not self._of_scene:
            return Scene(stamp, (), 0.0, None, exposure_time)
        if shown_ns:
            await self._scene_changed.wait(
                lambda: self._shown_ns() >= shown_ns,
                timeout,
                f"the pattern shown at {shown_ns} ns on projector/image",
            )
        if shown_ns and self._shown_ns() != shown_ns:
            raise CameraError(f"the projector shows another pattern already than that of {shown_ns} ns")
        if placed_ns > self._placed_ns:
            await self._scene_changed.wait(
                lambda: self._placed_ns >= placed_ns, timeout, "reference_plane/state of what was placed"
            )
        if self.count_publishers("load_frame/state"):
            await self._scene_changed.wait(
                lambda: self._load is not None and to_nanoseconds(self._load.header.stamp) >= stamp,
                timeout,
                "a sample of load_frame/state during the exposure",
            )
        position = 0.0 if self._load is None else self._load.position
        return Scene(stamp, self._shown(), position, self._plane, exposure_time)

    def _shown_ns(self) -> int:
        """When the latest pattern was shown [ns]; 0 before the first."""
        return to_nanoseconds(self._patterns[-1].header.stamp) if self._patterns else 0

    def _shown(self) -> tuple[ShownPattern, ...]:
        """The latest patterns, oldest first."""
        return tuple(ShownPattern(image_array(each), to_nanoseconds(each.header.stamp)) for each in self._patterns)

    # one frame on request

    async def _capture(self, request: CaptureFrame.Request, response: CaptureFrame.Response) -> CaptureFrame.Response:
        started = time.monotonic()
        try:
            self._check(request)
            await self._pause_free_run()
            await self._await_subscribers(request.image_subscribers, request.exposure_subscribers)
            await self._settle(to_nanoseconds(request.shown))
            exposure_time = request.exposure_time or self.parameters.value.exposure_time_s
            scene = await self._scene(to_nanoseconds(request.shown), to_nanoseconds(request.placed), exposure_time)
            frame = await self._expose(scene)
            response.stamp = to_msg(self._publish(frame, _record(request)))
            self._save_truth(request, scene)
            self.diagnostics.success(time.monotonic() - started)
        except NoSubscriberError as error:
            self._fail(request, response, Request.NO_SUBSCRIBER, error)
        except (WaitTimeoutError, CameraTimeoutError) as error:
            self._fail(request, response, Request.CAMERA_TIMEOUT, error)
        except FringedicError as error:
            self._fail(request, response, Request.CAMERA_FAILED, error)
        response.subscribers = self._subscribers()
        if self._paused:  # the end of a step is announced, unless nobody announces anything
            self._resuming = self.create_timer(_RESUME_S, self._resume_free_run)
        return response

    def _check(self, request: CaptureFrame.Request) -> None:
        if not self.active:
            raise CameraError("the camera is not active; configure and activate it")
        if request.index >= request.count:
            raise CameraError(f"index {request.index} is not below the count {request.count}")
        if not 0 <= request.exposure_time <= _LONGEST_EXPOSURE_S:
            raise CameraError(f"an exposure of {request.exposure_time:g} s is outside 0 to {_LONGEST_EXPOSURE_S:g} s")
        _record(request)

    def _subscribers(self) -> int:
        return min(self._images.get_subscription_count(), self._exposures.get_subscription_count())

    async def _await_subscribers(self, images: int, exposures: int) -> None:
        def connected() -> bool:
            return (
                self._images.get_subscription_count() >= images
                and self._exposures.get_subscription_count() >= exposures
            )

        try:
            await until(self, connected, self.parameters.value.timeout_s)
        except WaitTimeoutError:
            raise NoSubscriberError(
                f"camera/image_raw has {self._images.get_subscription_count()} subscribers and {images} are expected, "
                f"camera/exposure has {self._exposures.get_subscription_count()} and {exposures} are expected"
            ) from None

    async def _settle(self, shown_ns: int) -> None:
        if shown_ns:
            passed = 1e-9 * (self.get_clock().now().nanoseconds - shown_ns)
            if passed < -_AHEAD_S:
                raise CameraError(
                    f"the pattern was shown {-passed:.3f} s from now: the clock jumped back, or the projector's is "
                    "ahead; measure the step again, and let nothing set a clock during a test"
                )
            await sleep(self, self.parameters.value.settle_time_s - passed)

    async def _expose(self, scene: Scene) -> Frame:
        assert self._driver is not None, "an active camera has a driver"
        try:
            timeout = self.parameters.value.timeout_s + scene.exposure_time
            return await wait_for(self, self._worker.run(self._driver.expose, scene), timeout, "the frame")
        except WaitTimeoutError:
            # the thread hangs in the driver and is left to itself; the next capture gets a new one
            self._worker.stop(0.0)
            self._worker = Worker(self)
            raise

    def _fail(
        self, request: CaptureFrame.Request, response: CaptureFrame.Response, code: int, error: Exception
    ) -> None:
        response.error_code = code
        response.error_message = f"step {request.step}, frame {request.index}: {error}"
        self.get_logger().error(response.error_message)
        self.diagnostics.failure(response.error_message)

    def _publish(self, frame: Frame, record: FrameRecord) -> int:
        """Publish image, camera information and record under one stamp, later than every stamp before [ns].

        Raises
        ------
        ClockJumpError
            The frame is older than the one before it; the next frame begins a new order.
        """
        back = self._stamp_ns - frame.stamp_ns
        if back > _BACK_NS:
            self._stamp_ns = frame.stamp_ns
            raise ClockJumpError(
                f"the clock jumped back by {1e-9 * back:.3g} s between two frames; take the step again, and let "
                "nothing set the clock during a test"
            )
        self._stamp_ns = max(frame.stamp_ns, self._stamp_ns + 1)
        image = image_message(frame.image, stamp_ns=self._stamp_ns, frame_id=FRAME_ID)
        exposure = exposure_message(record, frame_id=FRAME_ID)
        exposure.header = image.header
        exposure.exposure_time = frame.exposure_time
        exposure.dropped = self._dropped + (0 if self._driver is None else self._driver.dropped)
        self._images.publish(image)
        self._infos.publish(self._info_of(image))
        self._exposures.publish(exposure)
        self._tell_of_driver()
        return self._stamp_ns

    def _tell_of_driver(self) -> None:
        """Publish how the camera's clock runs, and report what was lost on the way, once a second at most."""
        now = time.monotonic()
        if self._driver is None or now - self._told_of_driver < _DRIVER_PERIOD_S:
            return
        self._told_of_driver = now
        for name, count in self._driver.counts.items():
            self.diagnostics.tell(name, str(count))
        clock = self._driver.clock
        if clock is not None:
            self._clocks.publish(clock_message("camera", clock))

    def _info_of(self, image: Image) -> CameraInfo:
        """Return what is known of the camera; nothing of one that was calibrated with another size of images."""
        known = self._info
        if (known.width, known.height) != (image.width, image.height):
            return CameraInfo(header=image.header, height=image.height, width=image.width)
        return CameraInfo(
            header=image.header,
            height=image.height,
            width=image.width,
            distortion_model=known.distortion_model,
            d=known.d,
            k=known.k,
            r=known.r,
            p=known.p,
        )

    def _save_truth(self, request: CaptureFrame.Request, scene: Scene) -> None:
        """Write the truth of a step when its last frame is taken."""
        folder = self.parameters.value.truth_folder
        if not folder or not isinstance(self._driver, VirtualDriver) or request.index + 1 < request.count:
            return
        if scene.plane is not None:
            return  # the truth is that of the specimen
        if self._truth is None or self._truth_experiment != request.experiment:
            self._truth = TruthFile(Path(folder) / "truth.nc", self._driver.rig)
            self._truth_experiment = request.experiment
        self._worker.submit(self._truth.add, request.step, scene.position)

    # free run

    def _expose_freely(self) -> None:
        if self._worker.pending >= _BUFFERS:
            self._dropped += 1
            self.diagnostics.drop()
            return
        self._worker.submit(self._take_free_frame, self._free_run_index)
        self._free_run_index += 1

    def _take_free_frame(self, number: int) -> None:
        """Take and publish one frame of the free run; in the worker's thread."""
        position = 0.0 if self._load is None else self._load.position
        exposure_time = self.parameters.value.exposure_time_s
        scene = Scene(self.get_clock().now().nanoseconds, self._shown(), position, None, exposure_time)
        if not self._publish_free_frame(scene, number):
            self._dropped += 1
            self.diagnostics.drop()

    def _stream(self, driver: StreamingDriver) -> None:
        """Take the frames of a camera that runs by its own clock; in the worker's thread."""
        while self._streaming:
            dropped = driver.dropped
            scene = Scene(
                self.get_clock().now().nanoseconds, (), 0.0, exposure_time=self.parameters.value.exposure_time_s
            )
            if self._publish_free_frame(scene, self._free_run_index):
                self._free_run_index += 1
            else:
                time.sleep(_LOST_CAMERA_PAUSE_S)
            if driver.dropped > dropped:
                self.diagnostics.drop(driver.dropped - dropped)

    def _publish_free_frame(self, scene: Scene, number: int) -> bool:
        """Expose and publish; False, and an error in the diagnostics, when there is no frame."""
        assert self._driver is not None, "an active camera has a driver"
        try:
            frame = self._driver.expose(scene)
            # frames that the camera exposed and that did not arrive count as well
            index = number + self._driver.dropped - self._dropped_before
            self._publish(frame, FrameRecord("", 0, index, 0, Projection(PatternKind.OTHER), 0, 0.0, 0))
        except FringedicError as error:
            if self._streaming or self._free_run is not None:  # otherwise it was interrupted
                self.diagnostics.failure(str(error))
                self.get_logger().error(str(error), throttle_duration_sec=1.0)
            return False
        self.diagnostics.success()
        return True


def _record(request: CaptureFrame.Request) -> FrameRecord:
    """Record of the frame that a request asks for; stamp and exposure time are filled in when it is published."""
    try:
        projection = projection_of(request)
    except ValueError as error:
        raise CameraError(f"no such pattern: {error}") from None
    return FrameRecord(request.experiment, request.step, request.index, request.count, projection, 0, 0.0, 0)


def main() -> int:
    """Run the camera node."""
    return run(CameraNode.started)


if __name__ == "__main__":
    raise SystemExit(main())
