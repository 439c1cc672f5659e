"""Images of another node, over real DDS: which of them is taken for what was projected, and what is refused."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from std_msgs.msg import String

from camera_node.testing import Studio
from fringedic.frames.records import frame_record
from fringedic_msgs.srv import CaptureFrame
from fringedic_ros.images import image_array
from fringedic_ros.stamps import to_msg
from fringedic_ros.testing import NodeProcess

MODULE = "camera_node.camera_node"
Request = CaptureFrame.Request
EXPOSURE_S = 0.01
PERIOD_S = 0.03
PARAMETERS = {"source": "topic", "topic": "/cam/image_raw", "exposure_ms": 1e3 * EXPOSURE_S, "timeout_s": 5.0}

# A driver as they are: exposes by itself, stamps the end of the exposure, delivers a little later. The first row of
# its image says when the exposure began. A line of JSON on standard input changes how it behaves.
SCRIPT = """
import json, select, sys, time
import numpy as np, rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
from fringedic_ros.images import image_message
exposure, period = map(float, sys.argv[1:])
rclpy.init()
node = rclpy.create_node("driver", namespace="cam")
images = None
print(flush=True)
while True:
    if images is None or select.select([sys.stdin], [], [], 0)[0]:
        now = json.loads(sys.stdin.readline())
        if images is not None:
            node.destroy_publisher(images)
        images = None
        if now["reliability"] is not None:
            policy = ReliabilityPolicy[now["reliability"].upper()]
            images = node.create_publisher(Image, "image_raw", QoSProfile(depth=4, reliability=policy))
        sent = 0
        continue
    begin = time.time_ns()
    time.sleep(exposure)
    offset = now["clock_offset_s"] + now["jump_s"] * (sent // 30)
    colours = now["encoding"] == "rgb8"
    pixels = np.full((24, 32, 3) if colours else (24, 32), 100, np.uint16 if now["encoding"] == "16UC1" else np.uint8)
    if not colours:
        pixels[0, :8] = np.frombuffer(np.int64(begin).tobytes(), np.uint8)
    end = begin + round(1e9 * (exposure + offset))  # and not when this process went on after it
    message = image_message(pixels, stamp_ns=end, frame_id="elsewhere")
    message.encoding = now["encoding"]
    if now["stamp_s"] is not None:
        message.header.stamp.sec, message.header.stamp.nanosec = now["stamp_s"], 0
    images.publish(message)
    sent += images.get_subscription_count() > 0
    time.sleep(period - exposure)
"""


class CameraDriver:
    """Another node that publishes `/cam/image_raw`, in a process of its own."""

    def __init__(self) -> None:
        command = [sys.executable, "-c", SCRIPT, str(EXPOSURE_S), str(PERIOD_S)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.process.stdout.readline()

    def behave(
        self,
        reliability: str | None = "best_effort",
        *,
        encoding: str = "mono8",
        clock_offset_s: float = 0.0,
        jump_s: float = 0.0,
        stamp_s: int | None = None,
    ) -> None:
        """Publish anew: with this reliability (None: no more), encoding, clock, and jump of it every 30 images.

        It jumps again and again because the driver knows a reader before that reader knows the driver: a single jump
        may come before the first image that the reader receives.
        """
        behaviour = {
            "reliability": reliability,
            "encoding": encoding,
            "clock_offset_s": clock_offset_s,
            "jump_s": jump_s,
            "stamp_s": stamp_s,
        }
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(behaviour) + "\n")
        self.process.stdin.flush()


@pytest.fixture(scope="module")
def process(domain: int | None) -> Iterator[CameraDriver]:
    assert domain is not None, "the process has to be in the domain of this module"
    driver = CameraDriver()
    with driver.process:
        yield driver
        driver.process.kill()


@pytest.fixture
def driver(process: CameraDriver) -> Iterator[CameraDriver]:
    """The driver, silent before and after each test."""
    yield process
    process.behave(None)


def begin_ns(image: np.ndarray) -> int:
    """When the driver began this exposure [ns]."""
    return int(np.frombuffer(image[0, :8].astype(np.uint8).tobytes(), np.int64)[0])


@pytest.mark.parametrize(("reliability", "encoding"), [("best_effort", "mono8"), ("reliable", "16UC1")])
def test_first_frame_that_began_after_pattern_and_settling(
    driver: CameraDriver, studio: Studio, tmp_path: Path, reliability: str, encoding: str
) -> None:
    driver.behave(reliability, encoding=encoding)
    with NodeProcess(MODULE, tmp_path, {**PARAMETERS, "settle_ms": 20.0}):
        delays = []
        for index in range(6):
            shown = time.time_ns()
            response = studio.capture(index=index, shown=to_msg(shown))
            assert response.error_code == Request.NONE, response.error_message
            message, _, exposure = studio.frame(response.stamp)
            image = image_array(message)
            assert image.dtype == (np.uint8 if encoding == "mono8" else np.uint16)
            began = begin_ns(image)
            delays.append(1e-6 * (began - shown))
            assert delays[-1] >= 20.0, f"frame {index} began {delays[-1]:.1f} ms after its pattern, settling is 20 ms"
            stamp = frame_record(exposure).stamp
            late = 1e-6 * (stamp - began) - 1e3 * EXPOSURE_S / 2
            assert late >= -0.01, f"stamp {late:.2f} ms after the middle of the exposure"
            assert exposure.exposure_time == EXPOSURE_S
        other = studio.capture(exposure_time=0.02)
        assert other.error_code == Request.CAMERA_FAILED
        assert "20 ms is requested; the driver of /cam/image_raw exposes for 10 ms" in other.error_message
        studio.wait(lambda: studio.clocks, "the driver's clock")
        assert studio.clocks[0].clock == "camera"


def test_driver_that_goes_and_comes_back_otherwise(driver: CameraDriver, studio: Studio, tmp_path: Path) -> None:
    """Each state is told by name, and the node goes on as soon as it can."""
    faults: list[tuple[dict, int, str]] = [
        ({"clock_offset_s": 2.0}, Request.CAMERA_FAILED, r"s before the end of its exposure.*synchronise"),
        (
            {"clock_offset_s": -60.0},
            Request.CAMERA_TIMEOUT,
            r"clock of this computer \(the latest by 60 s\); synchronise",
        ),
        (
            {"stamp_s": 0},
            Request.CAMERA_TIMEOUT,
            r"\d+ with a stamp of 0 s, which the publisher has not set; set header",
        ),
        ({"stamp_s": 1_700_000_000}, Request.CAMERA_TIMEOUT, r"\d+ with the stamp of the message before; give each"),
        ({"encoding": "bayer_rggb8"}, Request.CAMERA_FAILED, "encoding bayer_rggb8; set the camera's driver to mono8"),
        ({"reliability": None}, Request.CAMERA_TIMEOUT, "no node publishes /cam/image_raw; start its node"),
    ]
    with NodeProcess(MODULE, tmp_path, {**PARAMETERS, "timeout_s": 1.5}) as node:
        absent = studio.capture()
        assert absent.error_code == Request.CAMERA_TIMEOUT
        assert "no node publishes /cam/image_raw; start its node" in absent.error_message
        text = studio.create_publisher(String, "/cam/image_raw", 1)
        studio.wait(
            partial(told, studio, Request.CAMERA_TIMEOUT, "with the type std_msgs/msg/String; sensor_msgs"), "it"
        )
        studio.destroy_publisher(text)
        for reliability in ("reliable", "best_effort"):
            driver.behave(reliability)
            studio.wait(lambda: studio.capture().error_code == Request.NONE, f"a frame of the {reliability} driver")
        for changes, code, words in faults:
            driver.behave(**changes)
            studio.wait(partial(told, studio, code, words), words)
        driver.behave(encoding="rgb8")
        studio.wait(lambda: studio.capture().error_code == Request.NONE, "a frame of the colour camera")
        studio.wait(lambda: len(np.unique(image_array(studio.images[-1]))) == 1, "its image")
        assert studio.images[-1].encoding == "mono8"
        assert "has colours (rgb8); their luminance is used" in node.log


def told(studio: Studio, code: int, words: str) -> bool:
    response = studio.capture()
    return response.error_code == code and re.search(words, response.error_message) is not None


def test_clock_of_the_driver_that_is_set_back(driver: CameraDriver, studio: Studio, tmp_path: Path) -> None:
    """It is said by name, and frames go on."""
    driver.behave(jump_s=-0.5)
    with NodeProcess(MODULE, tmp_path, {**PARAMETERS, "frame_rate_hz": 30.0}) as node:
        studio.wait(lambda: re.search(r"the driver's clock jumped back by 0\.[3-7]", node.log), "the jump")
        studio.forget()
        studio.wait(lambda: len(studio.images) >= 5, "frames after it")
