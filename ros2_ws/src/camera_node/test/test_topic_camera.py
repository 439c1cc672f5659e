"""Images of another node, over real DDS: which of them is taken for what was projected, and what is refused."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import rclpy

from camera_node.testing import Studio
from fringedic.sequence import frame_record
from fringedic_msgs.srv import CaptureFrame
from fringedic_ros.images import image_array
from fringedic_ros.stamps import to_msg
from fringedic_ros.testing import NodeProcess

MODULE = "camera_node.camera_node"
Request = CaptureFrame.Request
EXPOSURE_S = 0.01
PERIOD_S = 0.03
PARAMETERS = {"source": "topic", "topic": "/cam/image_raw", "exposure_time_s": EXPOSURE_S, "timeout_s": 5.0}

# A driver as they are: exposes by itself, stamps the end of the exposure, delivers a little later. The image says its
# number and, in its first row, when its exposure began.
DRIVER = """
import sys, time
import numpy as np, rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
from fringedic_ros.images import image_message
reliability, encoding, exposure, period, offset, jump_after, jump = sys.argv[1:]
rclpy.init()
node = rclpy.create_node("driver", namespace="cam")
policy = ReliabilityPolicy.RELIABLE if reliability == "reliable" else ReliabilityPolicy.BEST_EFFORT
images = node.create_publisher(Image, "image_raw", QoSProfile(depth=4, reliability=policy))
number = 0
while True:
    begin = time.time_ns()
    time.sleep(float(exposure))
    end = time.time_ns() + round(1e9 * float(offset))
    if 0 < int(jump_after) <= number:
        end += round(1e9 * float(jump))
    kind = np.uint16 if encoding in ("mono16", "16UC1") else np.uint8
    shape = (24, 32, 3) if encoding in ("rgb8", "bgr8") else (24, 32)
    pixels = np.full(shape, number % 200, kind)
    if len(shape) == 2:
        pixels[0, :8] = np.frombuffer(np.int64(begin).tobytes(), np.uint8)
    message = image_message(pixels, stamp_ns=end, frame_id="elsewhere")
    message.encoding = encoding
    images.publish(message)
    number += images.get_subscription_count() > 0
    time.sleep(max(float(period) - float(exposure), 0.0))
"""


@contextmanager
def driver(
    reliability: str = "best_effort",
    encoding: str = "mono8",
    *,
    clock_offset_s: float = 0.0,
    jump_after: int = 0,
    jump_s: float = 0.0,
) -> Iterator[subprocess.Popen[bytes]]:
    words = (reliability, encoding, EXPOSURE_S, PERIOD_S, clock_offset_s, jump_after, jump_s)
    with subprocess.Popen([sys.executable, "-c", DRIVER, *map(str, words)]) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture
def studio() -> Iterator[Studio]:
    rclpy.init()
    studio = Studio()
    yield studio
    studio.destroy_node()
    rclpy.shutdown()


def begin_ns(image: np.ndarray) -> int:
    """When the driver began this exposure [ns]."""
    return int(np.frombuffer(image[0, :8].astype(np.uint8).tobytes(), np.int64)[0])


@pytest.mark.parametrize(("reliability", "encoding"), [("best_effort", "mono8"), ("reliable", "16UC1")])
def test_first_frame_that_began_after_pattern_and_settling(
    studio: Studio, tmp_path: Path, reliability: str, encoding: str
) -> None:
    parameters = {**PARAMETERS, "settle_time_s": 0.02}
    with driver(reliability, encoding), NodeProcess(MODULE, tmp_path, parameters):
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
        print(f"exposures begin {np.round(delays, 1)} ms after their patterns")
        studio.wait(lambda: studio.clocks, "the driver's clock")
        assert studio.clocks[0].clock == "camera"


def test_colours_become_grey_and_a_word(studio: Studio, tmp_path: Path) -> None:
    with driver(encoding="rgb8"), NodeProcess(MODULE, tmp_path, PARAMETERS) as node:
        response = studio.capture()
        assert response.error_code == Request.NONE, response.error_message
        image = studio.frame(response.stamp)[0]
        assert image.encoding == "mono8"
        assert len(np.unique(image_array(image))) == 1
        assert "carries colours (rgb8); their luminance is taken" in node.log


def test_clock_of_the_driver_that_is_set_back(studio: Studio, tmp_path: Path) -> None:
    """It is said by name, and frames go on."""
    parameters = {**PARAMETERS, "frame_rate_hz": 30.0}
    with driver(jump_after=30, jump_s=-0.5), NodeProcess(MODULE, tmp_path, parameters) as node:
        studio.wait(lambda: "the driver's clock jumped back by 0.5 s" in node.log, "the jump")
        studio.forget()
        studio.wait(lambda: len(studio.images) >= 5, "frames after it")


def test_driver_that_goes_comes_back_with_another_reliability(studio: Studio, tmp_path: Path) -> None:
    with NodeProcess(MODULE, tmp_path, {**PARAMETERS, "timeout_s": 2.0}):
        absent = studio.capture()
        assert absent.error_code == Request.CAMERA_TIMEOUT
        assert "nobody publishes /cam/image_raw; is the camera's driver running?" in absent.error_message
        for reliability in ("reliable", "best_effort"):
            with driver(reliability):
                studio.wait(lambda: studio.capture().error_code == Request.NONE, f"a frame of the {reliability} driver")
        gone = studio.capture()
        assert gone.error_code == Request.CAMERA_TIMEOUT, gone.error_message


def test_images_that_cannot_be_used(studio: Studio, tmp_path: Path) -> None:
    faults: list[tuple[dict, int, str]] = [
        ({"clock_offset_s": 2.0}, Request.CAMERA_FAILED, r"s before the end of its exposure.*synchronise"),
        ({"clock_offset_s": -60.0}, Request.CAMERA_TIMEOUT, r"the last 60 s after its stamp.*synchronise"),
        ({"encoding": "bayer_rggb8"}, Request.CAMERA_FAILED, "encoding bayer_rggb8; set the camera's driver to mono8"),
    ]
    with NodeProcess(MODULE, tmp_path, {**PARAMETERS, "timeout_s": 1.5}):
        for changes, code, words in faults:
            with driver(**changes):
                studio.wait(partial(told, studio, code, words), words)
        with driver():
            studio.wait(lambda: studio.capture().error_code == Request.NONE, "a frame of the right driver")


def told(studio: Studio, code: int, words: str) -> bool:
    response = studio.capture()
    return response.error_code == code and re.search(words, response.error_message) is not None
