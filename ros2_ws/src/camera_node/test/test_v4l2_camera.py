"""Video4Linux through OpenCV's own code, against a device that stands in for the kernel's (`fake_video.cpp`)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from camera_node.drivers.v4l2 import V4l2Driver
from camera_node.testing import Studio
from fringedic.errors import CameraError
from fringedic.settings.camera import V4l2Camera
from fringedic_msgs.srv import CaptureFrame
from fringedic_ros.images import image_array
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.testing import NodeProcess

DEVICE = "/dev/video77"
PERIOD_NS = 20_000_000
SIZE = (64, 48)

# opens the device once per line of JSON and tells what came of it
SCRIPT = """
import json, os, sys
from pathlib import Path
from camera_node.drivers import Scene, v4l2
from fringedic.settings.camera import V4l2Camera
from fringedic.errors import CameraError
for line in sys.stdin:
    environment, settings = json.loads(line)
    v4l2.NO_DROP = Path(settings.pop("no_drop"))
    for name in ("FAKE_VIDEO_FORMAT", "FAKE_VIDEO_STICKY", "FAKE_VIDEO_BROKEN", "FAKE_VIDEO_DRIVER"):
        os.environ.pop(name, None)
    os.environ.update(environment)
    driver = None
    try:
        driver = v4l2.V4l2Driver(V4l2Camera(exposure_ms=5.0, **settings))
        image = driver.expose(Scene(0, (), 0.0, exposure_time=0.005)).image
        longer = driver.expose(Scene(0, (), 0.0, exposure_time=0.0123)).exposure_time
        answer = [image.dtype.name, image.shape, int(image.min()), int(image.max()), longer]
    except CameraError as error:
        answer = str(error)
    if driver is not None:
        driver.close()
    print(json.dumps(answer), flush=True)
"""

# is interrupted once, after it has read its clock for the second frame; prints the stamps of both frames
INTERRUPTED_SCRIPT = """
import sys, time
from camera_node.drivers import Scene
from camera_node.drivers.v4l2 import V4l2Driver
from fringedic.settings.camera import V4l2Camera
true_time_ns = time.time_ns
def interrupted():
    time.time_ns, shown = true_time_ns, true_time_ns()
    time.sleep(0.31)
    return shown
driver = V4l2Driver(V4l2Camera(camera=sys.argv[1], exposure_ms=5.0))
for clock in (true_time_ns, interrupted):
    time.time_ns = clock
    print(driver.expose(Scene(0, (), 0.0, exposure_time=0.005)).stamp_ns)
assert time.time_ns is true_time_ns, "it was interrupted"
driver.close()
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The stand-in for the device, built."""
    path = tmp_path_factory.mktemp("fake_video") / "fake_video.so"
    source = Path(__file__).parent / "fake_video.cpp"
    subprocess.run(["g++", "-shared", "-fPIC", "-O1", "-Wall", "-o", str(path), str(source), "-ldl"], check=True)
    return path


def test_formats_and_settings(library: Path, tmp_path: Path) -> None:
    def case(code: str, driver: str = "fake", fault: str = "", no_drop: str = "1", **settings: object) -> list[dict]:
        environment = {"FAKE_VIDEO_FORMAT": code, "FAKE_VIDEO_DRIVER": driver}
        if fault:
            environment[f"FAKE_VIDEO_{fault}"] = "1"
        parameter = tmp_path / f"nodrop_{no_drop}"
        if no_drop:
            parameter.write_text(f"{no_drop}\n")
        return [
            environment,
            {"camera": DEVICE, "width": SIZE[0], "height": SIZE[1], "no_drop": str(parameter), **settings},
        ]

    cases = [
        case("GREY"),
        case("YUYV"),
        case("Y16 ", pixel_format="Mono16"),
        case("MJPG"),
        case("GREY", fault="STICKY"),
        case("GREY", width=1280, height=720),
        case("GREY", fault="BROKEN"),
        *(case("GREY", "uvcvideo", no_drop=value) for value in ("1", "Y", "0", "N", "")),
    ]
    environment = {**os.environ, "LD_PRELOAD": str(library), "FAKE_VIDEO": DEVICE}
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        input="".join(json.dumps(each) + "\n" for each in cases),
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    answers = list(map(json.loads, run.stdout.splitlines()))
    grey, luminance, deep, compressed, sticky, size, broken, *incomplete = answers[:9]
    complete = [("uint8", answer) for answer in (grey, luminance, *answers[9:])]
    for kind, answer in [*complete, ("uint16", deep)]:
        dtype, shape, lowest, highest, longer = answer
        assert (dtype, shape) == (kind, [48, 64])
        assert lowest == highest, "every pixel of a frame is its number"
        assert kind == "uint8" or lowest >> 8 == 3, "the upper byte is 3"
        assert longer == pytest.approx(0.0123), "the exposure time of one frame"
    assert "has none of the formats GREY, YUYV of Mono8; compressed images" in compressed
    assert f"automatic exposure of {DEVICE} cannot be switched off: " in sticky
    assert f"{DEVICE} has no images of 1280x720 px, the nearest are 64x48" in size
    assert f"{DEVICE} does not accept its settings: Input/output error; check" in broken
    for answer in incomplete:
        assert f"{DEVICE} may return incomplete images" in answer
        assert "options uvcvideo nodrop=0" in answer


def test_interruption_while_the_clock_is_read_does_not_change_a_stamp(library: Path) -> None:
    """The stamps are those of the device, converted; its frames begin every 20 ms."""
    environment = {**os.environ, "LD_PRELOAD": str(library), "FAKE_VIDEO": DEVICE, "FAKE_VIDEO_FORMAT": "GREY"}
    run = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_SCRIPT, DEVICE],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    first, second = map(int, run.stdout.split())
    half = PERIOD_NS // 2
    assert abs((second - first + half) % PERIOD_NS - half) < 1e6


def test_node_takes_what_began_late_enough_and_survives_unplugging(
    library: Path, studio: Studio, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unplugged = tmp_path / "unplugged"
    monkeypatch.setenv("LD_PRELOAD", str(library))
    monkeypatch.setenv("FAKE_VIDEO", DEVICE)
    monkeypatch.setenv("FAKE_VIDEO_FORMAT", "GREY")
    monkeypatch.setenv("FAKE_VIDEO_UNPLUGGED", str(unplugged))
    parameters = {"source": "v4l2", "camera": DEVICE, "exposure_ms": 5.0}
    with NodeProcess("camera_node.camera_node", tmp_path, parameters):
        stamps, numbers = [], []
        for index in range(6):
            shown = time.time_ns()
            response = studio.capture(index, shown=to_msg(shown))
            assert response.error_code == CaptureFrame.Request.NONE, response.error_message
            image = image_array(studio.frame(response.stamp)[0])
            assert len(np.unique(image)) == 1
            stamps.append(to_nanoseconds(response.stamp))
            numbers.append(int(image[0, 0]))
            began_ms = 1e-6 * (stamps[-1] - shown) - 2.5
            assert began_ms >= 0, f"the exposure of frame {index} began {began_ms:.1f} ms after its pattern"
        apart = np.diff(stamps) - PERIOD_NS * (np.diff(numbers) % 256)
        assert np.abs(apart).max() < 1e6, "stamps are the device's, not those of reading"
        unplugged.touch()
        gone = studio.capture(6)
        assert gone.error_code == CaptureFrame.Request.CAMERA_FAILED
        assert f"{DEVICE} is lost: " in gone.error_message
        assert "check its cable" in gone.error_message
        studio.wait(lambda: f"there is no device {DEVICE}" in studio.capture(6).error_message, "looking for it")
        unplugged.unlink()
        studio.wait(lambda: studio.capture(6).error_code == CaptureFrame.Request.NONE, "the camera again")


@pytest.mark.parametrize(
    ("device", "words"),
    [
        ("/dev/video97", "there is no device /dev/video97; present devices: "),
        ("/dev/v4l/by-id/none", "there is no device /dev/v4l/by-id/none"),
        ("/dev/null", "/dev/null is not a video device"),
    ],
)
def test_device_that_is_no_camera(device: str, words: str) -> None:
    with pytest.raises(CameraError, match=words):
        V4l2Driver(V4l2Camera(camera=device))


def test_pixels_that_no_such_device_has() -> None:
    with pytest.raises(CameraError, match="pixel format Mono12: Video4Linux has Mono8, Mono16"):
        V4l2Driver(V4l2Camera(camera=DEVICE, pixel_format="Mono12"))
