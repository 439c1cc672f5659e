"""GigE Vision over the loopback: Aravis' own fake camera streams to the driver and to the node.

What arrives is known: the fake camera sends a diagonal ramp that moves by one column with each frame.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import rclpy
from sensor_msgs.msg import CameraInfo, Image

from camera_node.drivers import AravisDriver, AravisSettings, Scene, Trigger
from fringedic.errors import CameraError
from fringedic.sequence import frame_record
from fringedic_msgs.msg import Exposure
from fringedic_msgs.srv import CaptureFrame
from fringedic_ros.images import image_array
from fringedic_ros.qos import IMAGES
from fringedic_ros.testing import NodeProcess, Peer

pytestmark = pytest.mark.hardware

ADDRESS = "127.0.0.1"
NO_SCENE = Scene(0, (), 0.0)
REGION = (0, 0, 640, 480)


@contextmanager
def fake_camera() -> Iterator[subprocess.Popen[bytes]]:
    """Run a camera on the loopback; it can be killed, as a pulled cable would."""
    with subprocess.Popen(["arv-fake-gv-camera-0.8", "-i", ADDRESS]) as process:
        try:
            time.sleep(0.5)
            yield process
        finally:
            process.kill()


def settings(**changes: object) -> AravisSettings:
    values: dict = {"exposure_time": 0.01, "camera": ADDRESS, "region": REGION, "timeout": 2.0, **changes}
    return AravisSettings(**values)


@contextmanager
def driver(**changes: object) -> Iterator[AravisDriver]:
    opened = AravisDriver(settings(**changes))
    try:
        yield opened
    finally:
        opened.close()


@pytest.mark.parametrize("trigger", [Trigger.SOFTWARE, Trigger.INTERNAL])
def test_frame_begins_after_it_was_asked_for(trigger: Trigger) -> None:
    with fake_camera(), driver(trigger=trigger) as camera:
        for _ in range(5):
            asked = time.time_ns()
            frame = camera.expose(NO_SCENE)
            answered = time.time_ns()
            assert frame.image.shape == (480, 640)
            assert frame.image.dtype == np.uint8
            late_ms = 1e-6 * (frame.stamp_ns - asked)
            assert late_ms >= 5.0, f"middle of an exposure of 10 ms {late_ms:.1f} ms after it was asked for"
            assert frame.stamp_ns < answered
            time.sleep(0.05)  # a camera of its own clock goes on meanwhile


def test_pixels_of_16_bits_arrive_as_they_are() -> None:
    with fake_camera(), driver(pixel_format="Mono16") as camera:
        image = camera.expose(NO_SCENE).image
    assert image.dtype == np.uint16
    along_row, along_column = np.diff(image.astype(int)), np.diff(image.astype(int), axis=0)
    # the same ramp in both directions, but for where it begins again
    assert np.median(along_row) == np.median(along_column) > 0


def test_stream_is_complete_and_evenly_stamped() -> None:
    with fake_camera(), driver() as camera:
        camera.start(30.0)
        frames = [camera.expose(NO_SCENE) for _ in range(60)]
        camera.stop()
        assert camera.dropped == 0
        intervals = 1e-6 * np.diff([frame.stamp_ns for frame in frames])
        print(f"interval {np.median(intervals):.2f} ms, spread {intervals.std():.2f} ms, asked for 33.33 ms")
        assert np.median(intervals) == pytest.approx(1000 / 30, rel=0.02)
        steps = {int(np.median(np.diff([frame.image[0, :] for frame in frames], axis=0).astype(np.uint8)))}
        assert len(steps) == 1, "every frame moves the ramp by the same step: none is missing or repeated"
        assert camera.expose(NO_SCENE).image.shape == (480, 640)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera": "127.0.0.9"}, "camera: "),
        ({"pixel_format": "Mono12"}, "no pixel format Mono12; it has .*Mono8"),
        ({"exposure_time": 100.0}, "exposure time: .* is outside"),
        ({"gain": 90.0}, "gain: 90 dB is outside 0 to 10 dB"),
        ({"region": (0, 0, 5000, 480)}, "leaves the sensor of 2048x2048 px"),
        ({"trigger": Trigger.EXTERNAL_EDGE, "trigger_line": "Line7"}, "trigger: .*Line7"),
    ],
)
def test_setting_that_the_camera_does_not_have(changes: dict, words: str) -> None:
    with fake_camera(), pytest.raises(CameraError, match=words):
        AravisDriver(settings(**changes))


def test_unplugged_and_plugged_in_again() -> None:
    with driver_of_unplugged() as camera:
        with pytest.raises(CameraError, match="check its cable and power"):
            camera.expose(NO_SCENE)
        with pytest.raises(CameraError, match="the camera is gone"):
            camera.expose(NO_SCENE)
        with fake_camera():
            assert eventually(camera).shape == (480, 640)


@contextmanager
def driver_of_unplugged() -> Iterator[AravisDriver]:
    with fake_camera() as process, driver() as camera:
        camera.expose(NO_SCENE)
        process.kill()
        process.wait()
        yield camera


def eventually(camera: AravisDriver) -> np.ndarray:
    deadline = time.monotonic() + 20
    while True:
        try:
            return camera.expose(NO_SCENE).image
        except CameraError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.1)


class Viewer(Peer):
    def __init__(self) -> None:
        super().__init__()
        self.images = self.listen(Image, "camera/image_raw", IMAGES)
        self.infos = self.listen(CameraInfo, "camera/camera_info", IMAGES)
        self.exposures = self.listen(Exposure, "camera/exposure", IMAGES)
        self._capture = self.create_client(CaptureFrame, "camera/capture")

    def capture(self, index: int) -> CaptureFrame.Response:
        self.wait(self._capture.service_is_ready, "the camera's service")
        future = self._capture.call_async(
            CaptureFrame.Request(experiment="test", index=index, count=9, image_subscribers=1, exposure_subscribers=1)
        )
        self.wait(future.done, "the camera's answer", 30)
        return future.result()


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    rclpy.init()
    viewer = Viewer()
    yield viewer
    viewer.destroy_node()
    rclpy.shutdown()


PARAMETERS = {"source": "aravis", "camera": ADDRESS, "region_px": "[0, 0, 640, 480]", "timeout_s": 4.0}


def test_node_loses_its_camera_in_the_middle_of_a_stack(viewer: Viewer, tmp_path: Path) -> None:
    with fake_camera() as process, NodeProcess("camera_node.camera_node", tmp_path, PARAMETERS):
        assert viewer.capture(0).error_code == CaptureFrame.Request.NONE
        process.kill()
        process.wait()
        lost = viewer.capture(1)
        assert lost.error_code == CaptureFrame.Request.CAMERA_FAILED
        assert "check its cable and power" in lost.error_message
        with fake_camera():
            viewer.wait(lambda: viewer.capture(1).error_code == CaptureFrame.Request.NONE, "the camera again", 30)
        viewer.wait(lambda: len(viewer.images) == 2, "two images in all")


def test_node_streams_at_30_hz(viewer: Viewer, tmp_path: Path) -> None:
    parameters = {**PARAMETERS, "frame_rate_hz": 30.0}
    with fake_camera(), NodeProcess("camera_node.camera_node", tmp_path, parameters):
        viewer.wait(lambda: len(viewer.exposures) >= 60, "60 frames", 20)
    records = [frame_record(exposure) for exposure in viewer.exposures]
    indices = [record.index for record in records]
    assert indices == list(range(indices[0], indices[0] + len(indices)))
    assert records[-1].dropped == 0
    rate = 1e9 * (len(records) - 1) / (records[-1].stamp - records[0].stamp)
    print(f"{rate:.2f} frames/s")
    assert rate == pytest.approx(30, rel=0.05)
    assert image_array(viewer.images[0]).shape == (480, 640)
