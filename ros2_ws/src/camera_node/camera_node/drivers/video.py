"""A recorded video instead of a camera: each exposure takes the next frame."""

from __future__ import annotations

import time
from pathlib import Path

import cv2

from camera_node.drivers.driver import Frame, LocalDriver, Scene
from camera_node.drivers.grey import luminance
from fringedic.errors import CameraError

# codes of OpenCV for pixels of one grey level, 8 and 16 bits, which it gives as they are when asked to
_GREY = {"Y800", "Y1\x00\x10"}
_SAME_RATE = 0.01


class VideoDriver(LocalDriver):
    """Camera that reads the frames of a video file in their order.

    On request a frame is stamped with the time at which it is read. A free run plays the file at its own times.

    Parameters
    ----------
    file
        Any video that OpenCV's FFmpeg reads. Of lossless grey ones the levels are those that were recorded; of others
        the luminance is taken.
    repeat
        Begin again after the last frame.

    Raises
    ------
    CameraError
        There is no such video.
    """

    def __init__(self, file: str, *, repeat: bool) -> None:
        self._file = file
        self._repeat = repeat
        if not Path(file).is_file():
            raise CameraError(f"there is no video '{file}'; set files to a video file")
        self._open()
        self._began_ns: int | None = None  # when a free run showed the time 0 of the file

    def start(self, rate_hz: float) -> None:
        """Play the file from now on; `expose` then gives each frame at its time.

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
        """Nothing: a frame is never long in coming."""

    def stop(self) -> None:
        """End what `start` began; the next frame is the one after the last."""
        self._began_ns = None

    def expose(self, scene: Scene) -> Frame:
        """Read the next frame.

        Raises
        ------
        CameraError
            All have been taken.
        """
        read, image = self._video.read()
        if not read and self._repeat and self._taken:
            self._open()
            if self._began_ns is not None:
                self._began_ns = time.time_ns()
            read, image = self._video.read()
        if not read:
            raise CameraError(
                f"all {self._taken} frames of '{self._file}' have been taken; set repeat to begin again"
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
