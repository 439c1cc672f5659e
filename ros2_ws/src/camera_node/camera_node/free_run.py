"""Free run: frames at a rate while no step needs the camera."""

from __future__ import annotations

import time

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.timer import Timer

from camera_node.driver_thread import DriverThread
from camera_node.drivers import Scene, StreamingDriver
from camera_node.frame_publisher import FramePublisher
from camera_node.scene_watch import SceneWatch
from fringedic.errors import FringedicError
from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.settings.camera import CameraNodeSettings
from fringedic_ros.lifecycle import HardwareNode
from fringedic_ros.waiting import wait_for

_RESUME_S = 5.0  # after a capture of no step, or of a step whose end is not published
_BUFFERS = 4  # exposures that may be under way, as in a camera driver
_LOST_CAMERA_PAUSE_S = 0.05  # between two attempts to take a frame


class FreeRun:
    """Takes frames at the rate of the parameters, by a timer or by the clock of the camera.

    Parameters
    ----------
    node
        Owner of the timers.
    thread
        The driver.
    scenes
        Scene of a virtual camera.
    publisher
        Publishes the frames.
    """

    def __init__(
        self,
        node: HardwareNode[CameraNodeSettings],
        thread: DriverThread,
        scenes: SceneWatch,
        publisher: FramePublisher,
    ) -> None:
        self._node = node
        self._thread = thread
        self._scenes = scenes
        self._publisher = publisher
        self._timer: Timer | None = None
        self._streaming = False
        self._index = 0
        self._dropped_before = 0  # by the driver, when the free run started
        self._paused = False
        # one for all captures: a callback group keeps a reference to every timer that it ever had
        self._resuming = node.create_timer(_RESUME_S, self._resume, autostart=False)

    def begin(self) -> None:
        """Start with index 0, when the parameters ask for a free run."""
        self._index = 0
        self._start()

    def end(self) -> None:
        """Stop; nothing resumes."""
        self._paused = False
        self._resuming.cancel()
        self._stop()

    async def pause(self) -> None:
        """Give the camera to a step, which requests each of its frames."""
        self._resuming.cancel()
        if self._timer is None and not self._streaming:
            return
        self._stop()
        self._index += self._thread.dropped - self._dropped_before
        self._paused = True
        # frames that are under way come first: later ones have later stamps
        timeout = self._node.parameters.value.device.timeout_s
        await wait_for(self._node, self._thread.run(time.time_ns), timeout, "the end of the free run")

    def resume_later(self, after_s: float = _RESUME_S) -> None:
        """Continue after a time without a further capture; the index continues, too.

        The default is for a step whose end is never published.
        """
        if self._paused:
            self._resuming.timer_period_ns = round(1e9 * after_s)
            self._resuming.reset()

    def _resume(self) -> None:
        self._resuming.cancel()
        if self._paused and self._node.active:
            try:
                self._start()
                self._paused = False
            except FringedicError as error:
                self._node.get_logger().error(str(error))
                self._node.diagnostics.failure(str(error))
                self.resume_later()  # a lost camera may be present again

    def _start(self) -> None:
        driver, rate = self._thread.driver, self._node.parameters.value.frame_rate_hz
        self._dropped_before = self._thread.dropped
        if rate > 0 and isinstance(driver, StreamingDriver):
            try:
                driver.start(rate)
            except FringedicError:
                driver.stop()  # a capture must not find half of the settings of a stream
                raise
            self._streaming = True
            self._thread.submit(self._stream, driver)
        elif rate > 0:
            self._timer = self._node.create_timer(
                1 / rate, self._expose, callback_group=MutuallyExclusiveCallbackGroup()
            )

    def _stop(self) -> None:
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
        if self._streaming:
            self._streaming = False
            driver = self._thread.driver
            assert isinstance(driver, StreamingDriver), "only such a camera streams"
            driver.interrupt()
            self._thread.replace(self._node.parameters.value.device.timeout_s)
            driver.stop()

    def _expose(self) -> None:
        if self._thread.pending >= _BUFFERS:
            self._publisher.dropped += 1
            self._node.diagnostics.drop()
            return
        self._scenes.read_load()
        self._thread.submit(self._take_frame, self._index)
        self._index += 1

    # in the thread of the driver

    def _take_frame(self, number: int) -> None:
        scene = self._scenes.latest(self._node.parameters.value.device.exposure_time)
        if not self._publish_frame(scene, number):
            self._publisher.dropped += 1
            self._node.diagnostics.drop()

    def _stream(self, driver: StreamingDriver) -> None:
        """Take the frames of a camera that runs by its own clock."""
        while self._streaming:
            dropped, now = driver.dropped, time.time_ns()
            scene = Scene(now, (), 0.0, exposure_time=self._node.parameters.value.device.exposure_time)
            if self._publish_frame(scene, self._index):
                self._index += 1
            else:
                time.sleep(_LOST_CAMERA_PAUSE_S)
            if driver.dropped > dropped:
                self._node.diagnostics.drop(driver.dropped - dropped)

    def _publish_frame(self, scene: Scene, number: int) -> bool:
        """Expose and publish; return False, and report the error in the diagnostics, when there is no frame."""
        driver = self._thread.open_driver
        try:
            frame = driver.expose(scene)
            # the index also counts frames that the camera exposed and that did not arrive
            index = number + driver.dropped - self._dropped_before
            pattern = ProjectedPattern(PatternKind.OTHER)
            record = FrameRecord("", 0, index, 0, pattern, 0, 0.0, sensor=self._node.sensor)
            self._publisher.publish(frame, record, driver)
        except FringedicError as error:
            if self._streaming or self._timer is not None:  # otherwise the free run was interrupted
                self._node.diagnostics.failure(str(error))
                self._node.get_logger().error(str(error), throttle_duration_sec=1.0)
            return False
        self._node.diagnostics.success()
        return True
