"""Shows single patterns and takes single frames of a rig, for measurements without an experiment."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.client import Client
from sensor_msgs.msg import Image

from fringedic.errors import StepFailedError, WaitTimeoutError
from fringedic.frames.records import Frame, frame_record
from fringedic.patterns.pattern import SETUP, PatternKind, ProjectedPattern
from fringedic_bringup.client import RigClient
from fringedic_msgs.msg import Exposure
from fringedic_msgs.srv import CaptureFrame, ShowPattern
from fringedic_ros.arrivals import unconnected
from fringedic_ros.images import image_array
from fringedic_ros.qos import IMAGES
from fringedic_ros.stamps import to_nanoseconds

CONNECTING_S = 2.0  # for a frame that may be lost because the camera is not connected yet
FRAME_TIMEOUT_S = 30.0  # for an image and its record after the answer of the camera


class ExposingClient(RigClient):
    """Shows one pattern and takes one frame after the other; parameters as of `RigClient`."""

    def __init__(
        self, namespace: str = "rig", *, domain: int | None = None, watch: Callable[[], None] = lambda: None
    ) -> None:
        super().__init__(namespace, domain=domain, watch=watch)
        self._shows = self.node.create_client(ShowPattern, "projector/show")
        self._captures = self.node.create_client(CaptureFrame, "camera/capture")
        self._reached: set[Client] = set()
        self._image: Image | None = None
        self._connected = False  # a frame has arrived
        self._exposure: Exposure | None = None
        self._shown_at, self._pattern = Time(), SETUP
        self.node.create_subscription(Image, "camera/image_raw", self._take_image, IMAGES)
        self.node.create_subscription(Exposure, "camera/exposure", self._take_exposure, IMAGES)

    def show(self, pattern: ProjectedPattern, name: str = "") -> int:
        """Show a pattern and return the time at which it was handed to the projector [ns].

        Parameters
        ----------
        pattern
            The pattern.
        name
            Name of the set-up pattern, for patterns of kind OTHER.

        Raises
        ------
        StepFailedError
            The projector node refuses it.
        WaitTimeoutError
            The projector node does not answer.
        """
        self._reach(self._shows, ShowPattern.Request(kind=int(PatternKind.WHITE)))
        request = ShowPattern.Request(
            kind=int(pattern.kind),
            name=name,
            pitch=pattern.pitch,
            shift=pattern.shift,
            shifts=pattern.shifts,
            orientation=int(pattern.orientation),
        )
        response = self.call(self._shows, request)
        if response.error_code != ShowPattern.Request.NONE:
            raise StepFailedError(f"{response.error_message} (error {response.error_code})")
        self._shown_at, self._pattern = response.shown, pattern
        return to_nanoseconds(response.shown)

    def expose(self, exposure_time: float = 0.0) -> Frame:
        """Take a frame of the current pattern.

        Parameters
        ----------
        exposure_time
            Exposure time [s]; 0: that of the camera node.

        Raises
        ------
        StepFailedError
            The camera node took no frame.
        WaitTimeoutError
            The camera node does not answer or has not discovered this client, or the frame did not arrive.
        """
        self._reach(self._captures, CaptureFrame.Request(count=0))
        if not self._connected:
            self._connect(exposure_time)
        return self._capture(exposure_time, FRAME_TIMEOUT_S)

    def _connect(self, exposure_time: float) -> None:
        """Take frames until one arrives.

        The camera counts its subscribers; another one, such as the operator's page, may be connected before this one.
        """
        end = time.monotonic() + FRAME_TIMEOUT_S
        while not self._connected:
            try:
                self._capture(exposure_time, CONNECTING_S)
            except WaitTimeoutError:
                if time.monotonic() > end:
                    raise
            else:
                self._connected = True

    def _capture(self, exposure_time: float, timeout_s: float) -> Frame:
        """Take one frame and wait for its image and its record."""
        request = CaptureFrame.Request(
            experiment="single frames",
            count=1,
            kind=int(self._pattern.kind),
            orientation=int(self._pattern.orientation),
            pitch=self._pattern.pitch,
            shift=self._pattern.shift,
            shifts=self._pattern.shifts,
            exposure_time=exposure_time,
            shown=self._shown_at,
            image_subscribers=1,
            exposure_subscribers=1,
        )
        response = self.call(self._captures, request)
        if response.error_code == CaptureFrame.Request.NO_SUBSCRIBER:
            raise WaitTimeoutError(response.error_message)
        if response.error_code != CaptureFrame.Request.NONE:
            raise StepFailedError(f"{response.error_message} (error {response.error_code})")

        def arrived() -> bool:
            return all(
                each is not None and each.header.stamp == response.stamp for each in (self._image, self._exposure)
            )

        def missing() -> str:
            reason = unconnected(self.node, Image, "camera/image_raw") or unconnected(
                self.node, Exposure, "camera/exposure"
            )
            return reason or "camera/image_raw: the frame was taken, but no image and record with its stamp arrived"

        self.wait_for(arrived, timeout_s, missing)
        assert self._image is not None, "it arrived"
        assert self._exposure is not None, "it arrived"
        return Frame(image_array(self._image), frame_record(self._exposure))

    def _reach(self, client: Client, harmless: Any) -> None:
        """Wait for a first response: a server that has not discovered this client yet loses its responses."""
        if client not in self._reached:
            self.call_again(client, harmless, FRAME_TIMEOUT_S)
            self._reached.add(client)

    def _take_image(self, message: Image) -> None:
        self._image = message

    def _take_exposure(self, message: Exposure) -> None:
        self._exposure = message
