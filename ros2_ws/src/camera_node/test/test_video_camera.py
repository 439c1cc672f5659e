"""Frames of a video file: grey levels, order, times and the end."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from camera_node.drivers import Scene
from camera_node.drivers.video import VideoDriver
from camera_node.testing import Studio
from fringedic.errors import CameraError
from fringedic.settings.camera import VideoCamera
from fringedic_msgs.srv import CaptureFrame
from fringedic_ros.images import image_array
from fringedic_ros.testing import NodeProcess

SCENE = Scene(0, (), 0.0, exposure_time=0.004)
RATE_HZ = 25.0
COUNT = 6


def frames(dtype: type, *, channels: int = 1) -> np.ndarray:
    shape = (COUNT, 48, 64) if channels == 1 else (COUNT, 48, 64, channels)
    return np.random.default_rng(4).integers(0, np.iinfo(dtype).max, shape, endpoint=True).astype(dtype)


def save(path: Path, images: np.ndarray, code: str = "FFV1") -> Path:
    depth = cv2.CV_16U if images.dtype == np.uint16 else cv2.CV_8U
    settings = [cv2.VIDEOWRITER_PROP_DEPTH, depth, cv2.VIDEOWRITER_PROP_IS_COLOR, int(images.ndim == 4)]
    size = images.shape[2], images.shape[1]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*code), RATE_HZ, size, settings)
    assert writer.isOpened()
    for image in images:
        writer.write(image)
    writer.release()
    return path


@pytest.mark.parametrize("suffix", ["avi", "mkv"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_lossless_grey_levels_are_those_recorded(tmp_path: Path, suffix: str, dtype: type) -> None:
    images = frames(dtype)
    driver = VideoDriver(VideoCamera(files=str(save(tmp_path / f"test.{suffix}", images))))
    for image in images:
        frame = driver.expose(SCENE)
        assert frame.image.dtype == dtype
        assert frame.exposure_time == 0.004
        np.testing.assert_array_equal(frame.image, image)
    with pytest.raises(CameraError, match=r"all 6 frames of .*test.* have been taken; set repeat"):
        driver.expose(SCENE)
    driver.close()


def test_colours_become_luminance(tmp_path: Path) -> None:
    images = frames(np.uint8, channels=3)
    driver = VideoDriver(VideoCamera(files=str(save(tmp_path / "test.avi", images)), repeat=True))
    for image in (*images, images[0]):
        expected = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        difference = np.abs(driver.expose(SCENE).image.astype(int) - expected)
        assert difference.max() <= 1, f"{difference.max()} grey levels"


def test_compressed_video_is_read(tmp_path: Path) -> None:
    ramp = np.tile(np.linspace(20, 220, 64).astype(np.uint8), (COUNT, 48, 1))
    driver = VideoDriver(VideoCamera(files=str(save(tmp_path / "test.avi", ramp, "MJPG"))))
    difference = np.abs(driver.expose(SCENE).image.astype(int) - ramp[0])
    assert difference.max() < 8, f"compression and range change the ramp by {difference.max()} grey levels"


@pytest.mark.parametrize(
    ("name", "words"), [("absent.avi", "there is no video"), ("junk.avi", "is not a video that can be read")]
)
def test_no_such_video(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / "junk.avi").write_text("no video")
    with pytest.raises(CameraError, match=words):
        VideoDriver(VideoCamera(files=str(tmp_path / name)))


def test_node_takes_frame_after_frame_until_the_end(studio: Studio, tmp_path: Path) -> None:
    images = frames(np.uint16)
    parameters = {"source": "video", "files": str(save(tmp_path / "test.mkv", images))}
    with NodeProcess("camera_node.camera_node", tmp_path, parameters):
        for index, image in enumerate(images):
            response = studio.capture(index)
            assert response.error_code == CaptureFrame.Request.NONE, response.error_message
            np.testing.assert_array_equal(image_array(studio.frame(response.stamp)[0]), image)
        response = studio.capture(COUNT)
        assert response.error_code == CaptureFrame.Request.CAMERA_FAILED
        assert "all 6 frames" in response.error_message


def test_free_run_has_the_times_of_the_file(tmp_path: Path) -> None:
    driver = VideoDriver(VideoCamera(files=str(save(tmp_path / "test.avi", frames(np.uint8)))))
    with pytest.raises(CameraError, match="has 25 frames/s, not 30; set frame_rate_hz to 25"):
        driver.start(30.0)
    driver.expose(SCENE)
    driver.start(RATE_HZ)
    stamps = []
    for _ in range(COUNT - 1):
        stamps.append(driver.expose(SCENE).stamp_ns)
        assert time.time_ns() >= stamps[-1], "no frame before its time"
    np.testing.assert_allclose(np.diff(stamps), 1e9 / RATE_HZ, atol=1e6)
