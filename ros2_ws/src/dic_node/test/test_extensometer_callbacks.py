"""The extensometer node in the process of the test, which decides when its callbacks run."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.task import Future
from sensor_msgs.msg import Image
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from dic_node import extensometer_node
from dic_node.extensometer_node import ExtensometerNode
from fringedic.correlation.extensometer import StrainReading
from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic_msgs.msg import Exposure
from fringedic_ros import waiting
from fringedic_ros.images import image_message
from fringedic_ros.qos import IMAGES, STATE
from fringedic_ros.records import exposure_message
from fringedic_ros.testing import Peer, await_readers

STANDSTILL_S = 60.0
PERIODS_S = 0.2  # several of the node's timer, at a `frame_timeout_s` of 0.1 s


class Clock:
    """The module `time` for the node, with a monotonic time that a test sets [s]."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now

    def time_ns(self) -> int:
        return round(1e9 * self.now)


class Camera(Peer):
    """Camera, and controller that reads whether the strain is valid."""

    def __init__(self) -> None:
        super().__init__()
        self.valid = self.listen(Bool, "extensometer/valid", STATE)
        self._images = self.create_publisher(Image, "camera/image_raw", IMAGES)
        self._exposures = self.create_publisher(Exposure, "camera/exposure", IMAGES)
        self._zero = self.create_client(Trigger, "extensometer/zero")
        self._texture = np.random.default_rng(1).integers(0, 255, (480, 640), np.uint8)

    def connect(self) -> None:
        for publisher in (self._images, self._exposures):
            await_readers(publisher, 1)
        self.wait(self._zero.service_is_ready, "the service")

    def send(self, stamp_ns: int) -> None:
        """Send one frame; it has arrived when this function returns, but no callback has taken it."""
        self._images.publish(image_message(self._texture, stamp_ns=stamp_ns, frame_id="camera"))
        record = FrameRecord("", 0, 0, 0, ProjectedPattern(PatternKind.OTHER), stamp_ns, 0.005, 0)
        self._exposures.publish(exposure_message(record, frame_id="camera"))
        for publisher in (self._images, self._exposures):
            assert publisher.wait_for_all_acked(Duration(seconds=180))

    def request_zero(self) -> Future:
        return self._zero.call_async(Trigger.Request())


@pytest.fixture
def camera() -> Iterator[Camera]:
    rclpy.init(args=["--ros-args", "-p", "first_px:=[160, 240]", "-p", "second_px:=[480, 240]"])
    camera = Camera()
    yield camera
    camera.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    for module in (extensometer_node, waiting):
        monkeypatch.setattr(module, "time", clock)
    return clock


@pytest.fixture
def node(camera: Camera) -> Iterator[ExtensometerNode]:
    """The node, none of whose callbacks runs yet."""
    node = ExtensometerNode()
    camera.connect()
    yield node
    node.destroy_node()


def test_frames_that_are_queued_after_a_standstill_are_measured_before_silence_is_reported(
    clock: Clock, camera: Camera, node: ExtensometerNode
) -> None:
    """The executor runs timers before subscriptions, so the timer of the node does not see the frame yet."""
    camera.send(1)
    clock.now += STANDSTILL_S
    camera.serve(PERIODS_S)  # the timer is due
    camera.serve_also(node)
    camera.wait(lambda: any(flag.data for flag in camera.valid), "a valid strain")
    assert all(flag.data for flag in camera.valid)


def test_silence_is_reported_when_callbacks_could_run(clock: Clock, camera: Camera, node: ExtensometerNode) -> None:
    camera.send(1)
    camera.serve_also(node)
    camera.wait(lambda: any(flag.data for flag in camera.valid), "a valid strain")
    camera.forget()

    def look() -> bool:
        clock.now += 0.01
        return bool(camera.valid)

    camera.wait(look, "the report")
    assert not camera.valid[-1].data


@pytest.mark.usefixtures("clock")  # no silence is reported before the first frame
def test_a_zero_is_answered_after_the_frame_that_is_being_measured(
    monkeypatch: pytest.MonkeyPatch, camera: Camera, node: ExtensometerNode
) -> None:
    """After the answer, no strain against the earlier reference is published, and no frame in progress replaces it."""
    answered: list[bool] = []
    zeros: list[Future] = []

    class Slow:
        """An extensometer that a zero is requested from while it measures."""

        def __init__(self, *_: object, **__: object) -> None:
            pass

        def measure(self, _: np.ndarray) -> StrainReading:
            if not zeros:
                done = threading.Event()
                zeros.append(camera.request_zero())
                zeros[0].add_done_callback(lambda _: done.set())
                answered.append(done.wait(PERIODS_S))
            return StrainReading(0.0, 1e-6, np.zeros((2, 2)))

    monkeypatch.setattr(extensometer_node, "VirtualExtensometer", Slow)
    camera.serve_also(node)
    camera.meet("extensometer")
    camera.send(1)
    camera.wait(lambda: zeros and zeros[0].done(), "the zero")
    camera.wait(lambda: camera.valid, "the strain of the frame")
    assert answered == [False]
    camera.send(2)
    camera.wait(lambda: len(camera.valid) > 1, "the answer to the next frame")
    assert [flag.data for flag in camera.valid] == [True, False], "a frame of before the zero"
