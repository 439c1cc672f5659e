"""USB cameras (UVC) and other devices of Video4Linux: frames through OpenCV, controls by the kernel's own calls."""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from camera_node.drivers.driver import Frame, Scene
from camera_node.drivers.stamp_of import StampOf
from fringedic.clocks import ClockEstimate
from fringedic.errors import CameraError, CameraTimeoutError

_GET, _SET = 0xC008561B, 0xC008561C  # VIDIOC_G_CTRL, VIDIOC_S_CTRL of linux/videodev2.h
_CONTROL = struct.Struct("=Ii")  # identifier and value
_AUTOMATIC_GAIN = 0x00980912  # V4L2_CID_AUTOGAIN: 0 is off
_EXPOSURE_MODE = 0x009A0901  # V4L2_CID_EXPOSURE_AUTO
_MANUAL = 1  # of it
_EXPOSURE = 0x009A0902  # V4L2_CID_EXPOSURE_ABSOLUTE
_EXPOSURE_UNIT_S = 1e-4  # of it
_LARGEST_DEVIATION = 0.05  # of the exposure time that a camera takes from the one asked for
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 8.0  # between attempts to find a camera that is gone
# formats of which the grey levels are what the sensor gave; of YUYV every other byte
_FORMATS = {"Mono8": ("GREY", "YUYV"), "Mono16": ("Y16 ",)}


@dataclass(frozen=True)
class V4l2Settings:
    """How a device is to be used.

    Attributes
    ----------
    device
        Its path; those in /dev/v4l/by-id stay the same when it is plugged in again.
    exposure_time
        [s], in units of 0.1 ms.
    size
        (width, height) of its images [px]; None is what the device is set to.
    pixel_format
        "Mono8" or "Mono16".
    stamp_of
        Moment of the exposure that the kernel's stamps are of.
    timeout
        How long to wait for a frame beyond its exposure time [s].
    """

    device: str
    exposure_time: float
    size: tuple[int, int] | None = None
    pixel_format: str = "Mono8"
    stamp_of: StampOf = StampOf.END
    timeout: float = 5.0


class V4l2Driver:
    """A camera of Video4Linux; it exposes by itself, and the first frame that began late enough counts.

    Automatic exposure and gain are switched off, and an exposure is refused when one of them is found on; the gain
    stays what the device is set to. What the device makes of a setting is read back. A camera that is lost fails the
    exposures of that time and is looked for again at the next ones, with pauses that double up to 8 s.

    Parameters
    ----------
    settings
        How the device is to be used.

    Raises
    ------
    CameraError
        There is no such device, or it refuses a setting; the message says which.
    """

    needs_scene = False
    dropped = 0
    counts: Mapping[str, int] = {}
    clock: ClockEstimate | None = None  # the kernel stamps frames by this computer's steady clock

    def __init__(self, settings: V4l2Settings) -> None:
        if settings.pixel_format not in _FORMATS:
            raise CameraError(f"pixel format {settings.pixel_format}: Video4Linux has {', '.join(_FORMATS)}")
        self._settings = settings
        self._path = settings.device
        self._pause = _FIRST_PAUSE_S
        self._next_attempt = 0.0
        self._rate: float | None = None
        self._asked_exposure_time = self._exposure_time = settings.exposure_time
        self._controls: _Controls | None = None
        self._video: cv2.VideoCapture | None = self._connect()

    def start(self, rate_hz: float) -> None:
        """Give every frame from now on.

        Raises
        ------
        CameraError
            The device does not offer this rate.
        """
        self._set_rate(self._device()[0], rate_hz)
        self._rate = rate_hz

    def interrupt(self) -> None:
        """Nothing: a frame is never long in coming."""

    def stop(self) -> None:
        """End what `start` began."""
        self._rate = None

    def expose(self, scene: Scene) -> Frame:
        """Wait for the first frame whose exposure begins from now on, or for the next one of a stream.

        Raises
        ------
        CameraTimeoutError
            No such frame came.
        CameraError
            The camera is gone, or sets itself.
        """
        video, controls = self._device()
        try:
            if scene.exposure_time != self._asked_exposure_time:
                self._set_exposure_time(controls, scene.exposure_time)
            controls.refuse_automatic()
        except OSError as error:
            raise self._lost(str(error)) from error
        asked = 0 if self._rate else time.monotonic_ns()
        deadline = time.monotonic() + self._settings.timeout + self._exposure_time
        while time.monotonic() < deadline:
            try:
                read, raw = video.read()
            except cv2.error as error:
                raise self._lost(error.err) from error
            if not read:
                raise self._lost("it gives no frame")
            # a device without stamps of its own: when its frame was here
            stamp = round(1e6 * video.get(cv2.CAP_PROP_POS_MSEC)) or time.monotonic_ns()
            if self._settings.stamp_of.start_ns(stamp, self._exposure_time) >= asked:
                middle = self._settings.stamp_of.middle_ns(stamp, self._exposure_time)
                return Frame(self._grey(raw), middle + time.time_ns() - time.monotonic_ns(), self._exposure_time)
        raise CameraTimeoutError(f"{self._path}: no frame began after it was asked for; is stamp_of right?")

    def close(self) -> None:
        """Give the device back."""
        if self._video is not None:
            self._video.release()
            self._video = None
        if self._controls is not None:
            self._controls.close()
            self._controls = None

    # connection

    def _connect(self) -> cv2.VideoCapture:
        settings = self._settings
        self._controls = _Controls(self._path)
        video = cv2.VideoCapture(self._path, cv2.CAP_V4L2)
        try:
            if not video.isOpened():
                raise CameraError(f"{self._path} gives no frames; does another program use it?")
            self._set_format(video)
            if settings.size is not None:
                video.set(cv2.CAP_PROP_FRAME_WIDTH, settings.size[0])
                video.set(cv2.CAP_PROP_FRAME_HEIGHT, settings.size[1])
                given = round(video.get(cv2.CAP_PROP_FRAME_WIDTH)), round(video.get(cv2.CAP_PROP_FRAME_HEIGHT))
                if given != settings.size:
                    raise CameraError(
                        f"{self._path} has no images of {settings.size[0]}x{settings.size[1]} px, the nearest are "
                        f"{given[0]}x{given[1]}"
                    )
            self._controls.switch_automatic_off()
            self._set_exposure_time(self._controls, self._asked_exposure_time)
            if self._rate is not None:
                self._set_rate(video, self._rate)
        except (CameraError, OSError):
            video.release()
            self._controls.close()
            self._controls = None
            raise
        return video

    def _device(self) -> tuple[cv2.VideoCapture, _Controls]:
        """The device, opened again when it was lost."""
        if self._video is None:
            wait = self._next_attempt - time.monotonic()
            if wait > 0:
                raise CameraError(f"{self._path} is gone; looking for it again in {wait:.1f} s")
            try:
                self._video = self._connect()
            except (CameraError, OSError) as error:
                raise self._lost(str(error)) from error
            self._pause = _FIRST_PAUSE_S
        assert self._controls is not None, "both are opened together"
        return self._video, self._controls

    def _lost(self, why: str) -> CameraError:
        self.close()
        self._next_attempt = time.monotonic() + self._pause
        self._pause = min(2 * self._pause, _LONGEST_PAUSE_S)
        return CameraError(f"{self._path} is gone: {why}; check its cable")

    def _set_format(self, video: cv2.VideoCapture) -> None:
        """Ask for grey levels as the sensor gives them, not for colours made of them."""
        video.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        for code in _FORMATS[self._settings.pixel_format]:
            video.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*code))
            if int(video.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little") == code.encode():
                self._format = code
                return
        raise CameraError(
            f"{self._path} has none of the formats {', '.join(_FORMATS[self._settings.pixel_format])} of "
            f"{self._settings.pixel_format}; compressed images are not measured in"
        )

    def _set_exposure_time(self, controls: _Controls, wanted: float) -> None:
        controls.set(_EXPOSURE, round(wanted / _EXPOSURE_UNIT_S))
        taken = controls.get(_EXPOSURE) * _EXPOSURE_UNIT_S
        if abs(taken - wanted) > _LARGEST_DEVIATION * wanted:
            raise CameraError(f"exposure time: {self._path} makes {1e3 * taken:g} ms of {1e3 * wanted:g} ms")
        self._asked_exposure_time, self._exposure_time = wanted, taken

    def _set_rate(self, video: cv2.VideoCapture, rate_hz: float) -> None:
        video.set(cv2.CAP_PROP_FPS, rate_hz)
        given = video.get(cv2.CAP_PROP_FPS)
        if abs(given - rate_hz) > 0.01 * rate_hz:
            raise CameraError(f"{self._path} does not give {rate_hz:g} frames/s, the nearest is {given:g}")

    def _grey(self, raw: np.ndarray) -> np.ndarray:
        """Grey levels of an image as the device gave it, (row, column)."""
        if self._format == "YUYV":
            return np.ascontiguousarray(raw[:, :, 0])
        return raw if raw.ndim == 2 else np.ascontiguousarray(raw[:, :, 0])


class _Controls:
    """Controls of a device, by its own file descriptor."""

    def __init__(self, path: str) -> None:
        self._path = path
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        except FileNotFoundError:
            raise CameraError(f"there is no device {path}; those that are there: {_present()}") from None
        except OSError as error:
            raise CameraError(f"{path}: {error.strerror}; this user may have to be in the group video") from error
        try:
            self._known(_EXPOSURE)
        except OSError as error:
            os.close(self._descriptor)
            raise CameraError(f"{path} is not a video device ({error.strerror})") from error

    def get(self, control: int) -> int:
        """Value of a control."""
        answer = fcntl.ioctl(self._descriptor, _GET, _CONTROL.pack(control, 0))
        return int(_CONTROL.unpack(answer)[1])

    def set(self, control: int, value: int) -> None:
        """Set a control; OSError when the device has none or refuses."""
        fcntl.ioctl(self._descriptor, _SET, _CONTROL.pack(control, value))

    def switch_automatic_off(self) -> None:
        """Let the device set nothing by itself."""
        for what, control, off in _AUTOMATIC:
            if self._known(control):
                try:
                    self.set(control, off)
                except OSError as error:
                    raise CameraError(f"{what} of {self._path} cannot be switched off: {error.strerror}") from error
        if not self._known(_EXPOSURE):
            raise CameraError(f"{self._path} has no exposure time that can be set; use another camera")
        self.refuse_automatic()

    def refuse_automatic(self) -> None:
        """Raise a CameraError when the device sets itself."""
        for what, control, off in _AUTOMATIC:
            if self._known(control) and self.get(control) != off:
                raise CameraError(
                    f"{what} of {self._path} is on, so grey levels of different frames cannot be compared; another "
                    "program may have switched it on"
                )

    def close(self) -> None:
        """Close the descriptor."""
        os.close(self._descriptor)

    def _known(self, control: int) -> bool:
        try:
            self.get(control)
        except OSError as error:
            if error.errno == errno.EINVAL:
                return False
            raise
        return True


_AUTOMATIC = (("automatic exposure", _EXPOSURE_MODE, _MANUAL), ("automatic gain", _AUTOMATIC_GAIN, 0))


def _present() -> str:
    devices = sorted(entry.path for entry in os.scandir("/dev") if entry.name.startswith("video"))
    return ", ".join(devices) or "none; is the camera plugged in?"
