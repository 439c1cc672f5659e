"""USB cameras (UVC) and other devices of Video4Linux: frames through OpenCV, controls by calls of the kernel."""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import time
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from rclpy.node import Node

from camera_node.drivers.driver import Frame, Scene
from fringedic.errors import CameraError, CameraTimeoutError
from fringedic.frames.clocks import ClockEstimate, wall_minus_monotonic_ns
from fringedic.settings.camera import V4l2Camera

NO_DROP = Path("/sys/module/uvcvideo/parameters/nodrop")  # whether the kernel returns frames with lost packets
_CAPABILITY = 0x80685600  # VIDIOC_QUERYCAP
_CAPABILITY_BYTES, _DRIVER_BYTES = 104, 16  # of the answer, which starts with the name of the driver
_GET, _SET = 0xC008561B, 0xC008561C  # VIDIOC_G_CTRL, VIDIOC_S_CTRL of linux/videodev2.h
_CONTROL = struct.Struct("=Ii")  # identifier and value
_AUTOMATIC_GAIN = 0x00980912  # V4L2_CID_AUTOGAIN: 0 is off
_EXPOSURE_MODE = 0x009A0901  # V4L2_CID_EXPOSURE_AUTO
_MANUAL = 1  # of it
_EXPOSURE = 0x009A0902  # V4L2_CID_EXPOSURE_ABSOLUTE
_EXPOSURE_UNIT_S = 1e-4  # of it
_LARGEST_DEVIATION = 0.05  # of the exposure time that a camera sets, relative to the requested one
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 8.0  # between two attempts to open a lost camera
# formats with the grey levels of the sensor; in YUYV, every second byte
_FORMATS = {"Mono8": ("GREY", "YUYV"), "Mono16": ("Y16 ",)}


class V4l2Driver:
    """A camera of Video4Linux; `expose` returns the first frame whose exposure began after the request.

    Automatic exposure and gain are switched off, and an exposure fails when one of them is found on; the gain keeps the
    setting of the device. Every setting is read back. While a camera is lost, exposures fail; the driver tries to open
    it again at each exposure, with pauses that double up to 8 s.

    Parameters
    ----------
    settings
        Settings of the device.

    Raises
    ------
    CameraError
        There is no such device, or it refuses a setting; the message names it.
    """

    needs_scene = False
    dropped = 0
    counts: Mapping[str, int] = {}
    clock: ClockEstimate | None = None  # the kernel stamps frames by the steady clock of this computer

    def __init__(self, settings: V4l2Camera, _node: Node | None = None) -> None:
        if settings.pixel_format not in _FORMATS:
            raise CameraError(f"pixel format {settings.pixel_format}: Video4Linux has {', '.join(_FORMATS)}")
        self._settings = settings
        self._path = settings.camera
        self._pause = _FIRST_PAUSE_S
        self._next_attempt = 0.0
        self._rate: float | None = None
        self._asked_exposure_time = self._exposure_time = settings.exposure_time
        self._controls: _Controls | None = None
        self._video: cv2.VideoCapture | None = self._connect()

    def start(self, rate_hz: float) -> None:
        """Return every frame from now on.

        Raises
        ------
        CameraError
            The device does not offer this rate.
        """
        self._set_rate(self._device()[0], rate_hz)
        self._rate = rate_hz

    def interrupt(self) -> None:
        """Do nothing: `expose` returns soon."""

    def stop(self) -> None:
        """End the stream that `start` began."""
        self._rate = None

    def expose(self, scene: Scene) -> Frame:
        """Wait for the first frame whose exposure begins from now on, or for the next one of a stream.

        Raises
        ------
        CameraTimeoutError
            No such frame arrived.
        CameraError
            The camera is lost, or controls its exposure by itself.
        """
        video, controls = self._device()
        try:
            if scene.exposure_time != self._asked_exposure_time:
                self._set_exposure_time(controls, scene.exposure_time)
            controls.refuse_automatic()
        except OSError as error:
            raise self._lost(str(error)) from error
        asked = 0 if self._rate else time.monotonic_ns()
        deadline = time.monotonic() + self._settings.driver_timeout + self._exposure_time
        while time.monotonic() < deadline:
            try:
                read, raw = video.read()
            except cv2.error as error:
                raise self._lost(error.err) from error
            if not read:
                raise self._lost("it returns no frame")
            # without stamps of the device: the time of arrival
            stamp = round(1e6 * video.get(cv2.CAP_PROP_POS_MSEC)) or time.monotonic_ns()
            if self._settings.stamp_of.start_ns(stamp, self._exposure_time) >= asked:
                middle = self._settings.stamp_of.middle_ns(stamp, self._exposure_time)
                return Frame(self._grey(raw), middle + wall_minus_monotonic_ns(), self._exposure_time)
        raise CameraTimeoutError(f"{self._path}: no frame began after the request; check stamp_of")

    def close(self) -> None:
        """Close the device."""
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
                raise CameraError(f"{self._path} returns no frames; check whether another program uses it")
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
            self._controls.refuse_incomplete()
            self._controls.switch_automatic_off()
            self._set_exposure_time(self._controls, self._asked_exposure_time)
            if self._rate is not None:
                self._set_rate(video, self._rate)
        except (CameraError, OSError) as error:
            video.release()
            self._controls.close()
            self._controls = None
            if isinstance(error, OSError):
                raise CameraError(
                    f"{self._path} does not accept its settings: {error.strerror}; check its cable and exposure time"
                ) from error
            raise
        return video

    def _device(self) -> tuple[cv2.VideoCapture, _Controls]:
        """Return the device, opened again when it was lost."""
        if self._video is None:
            wait = self._next_attempt - time.monotonic()
            if wait > 0:
                raise CameraError(f"{self._path} is lost; the next attempt to open it is in {wait:.1f} s")
            try:
                self._video = self._connect()
            except CameraError as error:
                raise self._lost(str(error)) from error
            self._pause = _FIRST_PAUSE_S
        assert self._controls is not None, "both are opened together"
        return self._video, self._controls

    def _lost(self, why: str) -> CameraError:
        self.close()
        self._next_attempt = time.monotonic() + self._pause
        self._pause = min(2 * self._pause, _LONGEST_PAUSE_S)
        return CameraError(f"{self._path} is lost: {why}; check its cable")

    def _set_format(self, video: cv2.VideoCapture) -> None:
        """Select a format with the grey levels of the sensor, not colours computed from them."""
        video.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        for code in _FORMATS[self._settings.pixel_format]:
            video.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*code))
            if int(video.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little") == code.encode():
                self._format = code
                return
        raise CameraError(
            f"{self._path} has none of the formats {', '.join(_FORMATS[self._settings.pixel_format])} of "
            f"{self._settings.pixel_format}; compressed images cannot be measured"
        )

    def _set_exposure_time(self, controls: _Controls, wanted: float) -> None:
        controls.set(_EXPOSURE, round(wanted / _EXPOSURE_UNIT_S))
        taken = controls.get(_EXPOSURE) * _EXPOSURE_UNIT_S
        if abs(taken - wanted) > _LARGEST_DEVIATION * wanted:
            raise CameraError(f"exposure time: {self._path} sets {1e3 * taken:g} ms instead of {1e3 * wanted:g} ms")
        self._asked_exposure_time, self._exposure_time = wanted, taken

    def _set_rate(self, video: cv2.VideoCapture, rate_hz: float) -> None:
        video.set(cv2.CAP_PROP_FPS, rate_hz)
        given = video.get(cv2.CAP_PROP_FPS)
        if abs(given - rate_hz) > 0.01 * rate_hz:
            raise CameraError(f"{self._path} does not offer {rate_hz:g} frames/s, the nearest rate is {given:g}")

    def _grey(self, raw: np.ndarray) -> np.ndarray:
        """Return the grey levels of an image of the device, (row, column)."""
        if self._format == "YUYV":
            return np.ascontiguousarray(raw[:, :, 0])
        return raw if raw.ndim == 2 else np.ascontiguousarray(raw[:, :, 0])


class _Controls:
    """Controls of a device, through a file descriptor of their own."""

    def __init__(self, path: str) -> None:
        self._path = path
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        except FileNotFoundError:
            raise CameraError(f"there is no device {path}; present devices: {_present()}") from None
        except OSError as error:
            raise CameraError(f"{path}: {error.strerror}; add this user to the group video") from error
        try:
            self._known(_EXPOSURE)
        except OSError as error:
            os.close(self._descriptor)
            raise CameraError(f"{path} is not a video device ({error.strerror})") from error

    def get(self, control: int) -> int:
        """Return the value of a control."""
        answer = fcntl.ioctl(self._descriptor, _GET, _CONTROL.pack(control, 0))
        return int(_CONTROL.unpack(answer)[1])

    def set(self, control: int, value: int) -> None:
        """Set a control; raises OSError when the device does not have it or refuses."""
        fcntl.ioctl(self._descriptor, _SET, _CONTROL.pack(control, value))

    def refuse_incomplete(self) -> None:
        """Raise a CameraError when the kernel may return an image with lost packets."""
        answer = fcntl.ioctl(self._descriptor, _CAPABILITY, bytes(_CAPABILITY_BYTES))
        is_uvc = answer[:_DRIVER_BYTES].rstrip(b"\0") == b"uvcvideo"
        if is_uvc and NO_DROP.exists() and NO_DROP.read_text().strip() not in ("0", "N"):
            raise CameraError(
                f"{self._path} may return incomplete images, because {NO_DROP} is not 0: write the line 'options "
                "uvcvideo nodrop=0' into /etc/modprobe.d/uvcvideo.conf and start this computer again"
            )

    def switch_automatic_off(self) -> None:
        """Switch automatic exposure and gain off."""
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
        """Raise a CameraError when automatic exposure or gain is on."""
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
    return ", ".join(devices) or "none; connect the camera"
