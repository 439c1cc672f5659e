"""Frames of a video file instead of a camera: each exposure reads the next frame."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
from rclpy.node import Node

from camera_node.drivers.driver import Frame, LocalDriver, Scene
from fringedic.errors import CameraError
from fringedic.frames.grey import luminance
from fringedic.settings.camera import VideoCamera

# codes of OpenCV for grey pixels of 8 and 16 bits, which it returns unchanged without CONVERT_RGB
_GREY = {"Y800", "Y1\x00\x10"}
_SAME_RATE = 0.01


class VideoDriver(LocalDriver):
    """Camera that reads the frames of a video file in their order.

    A requested frame has the time of reading as its stamp. A free run plays the file at its own rate.

    Parameters
    ----------
    settings
        A video that FFmpeg of OpenCV can read, and whether it is repeated. Lossless grey videos keep their grey levels;
        others are converted to luminance.

    Raises
    ------
    CameraError
        There is no such video.
    """

    def __init__(self, settings: VideoCamera, _node: Node | None = None) -> None:
        self._file, self._repeat = settings.files, settings.repeat
        if not Path(self._file).is_file():
            raise CameraError(f"there is no video '{self._file}'; set files to a video file")
        self._open()
        self._began_ns: int | None = None  # time of the first frame of the file in a free run

    def start(self, rate_hz: float) -> None:
        """Play the file from now on; `expose` then returns each frame at its time.

        Raises
        ------
        CameraError
            The file has another rate.
        """
        own = self._video.get(cv2.CAP_PROP_FPS)
        if abs(rate_hz - own) > _SAME_RATE * own:
            raise CameraError(f"'{self._file}' has {own:g} frames/s, not {rate_hz:g}; set frame_rate_hz to {own:g}")
        self._began_ns = time.time_ns() - round(1e6 * self._video.get(cv2.CAP_PROP_POS_MSEC))

    def interrupt(self) -> None:
        """Do nothing: `expose` returns soon."""

    def stop(self) -> None:
        """End the playback that `start` began; the next frame follows the last one."""
        self._began_ns = None

    def expose(self, scene: Scene) -> Frame:
        """Read the next frame.

        Raises
        ------
        CameraError
            All frames have been read.
        """
        read, image = self._video.read()
        if not read and self._repeat and self._taken:
            self._open()
            if self._began_ns is not None:
                self._began_ns = time.time_ns()
            read, image = self._video.read()
        if not read:
            raise CameraError(
                f"all {self._taken} frames of '{self._file}' have been taken; set repeat to start again"
                if self._taken
                else f"'{self._file}' has no frame that can be read"
            )
        self._taken += 1
        grey = image if image.ndim == 2 else luminance(image)
        if self._began_ns is None:
            return Frame(grey, time.time_ns(), scene.exposure_time)
        stamp = self._began_ns + round(1e6 * self._video.get(cv2.CAP_PROP_POS_MSEC))
        time.sleep(max(1e-9 * (stamp - time.time_ns()), 0.0))
        return Frame(grey, stamp, scene.exposure_time)

    def close(self) -> None:
        """Close the file."""
        self._video.release()

    def _open(self) -> None:
        self._taken = 0
        self._video = cv2.VideoCapture(self._file, cv2.CAP_FFMPEG)
        if not self._video.isOpened():
            raise CameraError(f"'{self._file}' is not a video that can be read")
        code = int(self._video.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT))
        if code.to_bytes(4, "little").decode("latin-1") in _GREY:
            self._video.set(cv2.CAP_PROP_CONVERT_RGB, 0)
