"""Shows single patterns and takes single frames of a rig, for what is measured before there is an experiment."""

from __future__ import annotations

from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.client import Client
from sensor_msgs.msg import Image

from fringedic.errors import StepFailedError
from fringedic.sequence import FrameRecord, PatternKind, Projection, frame_record
from fringedic_bringup.client import RigClient
from fringedic_msgs.msg import Exposure
from fringedic_msgs.srv import CaptureFrame, ShowPattern
from fringedic_ros.images import image_array
from fringedic_ros.qos import IMAGES
from fringedic_ros.stamps import to_nanoseconds

FRAME_TIMEOUT_S = 30.0  # for an image and its record, once the camera has answered
WHITE = Projection(PatternKind.WHITE)
SETUP = Projection(PatternKind.OTHER)


class ExposingClient(RigClient):
    """Shows one pattern and takes one frame after the other; parameters as of `RigClient`."""

    def __init__(self, namespace: str = "rig", **options: Any) -> None:
        super().__init__(namespace, **options)
        self._shows = self._node.create_client(ShowPattern, "projector/show")
        self._captures = self._node.create_client(CaptureFrame, "camera/capture")
        self._image: Image | None = None
        self._exposure: Exposure | None = None
        self._shown, self._projection = Time(), SETUP
        self._node.create_subscription(Image, "camera/image_raw", self._take_image, IMAGES)
        self._node.create_subscription(Exposure, "camera/exposure", self._take_exposure, IMAGES)

    def show(self, projection: Projection, name: str = "") -> int:
        """Show a pattern from now on and return when it was handed to the projector [ns].

        Parameters
        ----------
        projection
            What to show.
        name
            Which set-up pattern, for projections of kind OTHER.

        Raises
        ------
        StepFailedError
            The projector does not show it.
        NotAnsweredError
            It does not answer.
        """
        self._ready(self._shows)
        request = ShowPattern.Request(
            kind=int(projection.kind),
            name=name,
            pitch=projection.pitch,
            shift=projection.shift,
            shifts=projection.shifts,
            orientation=int(projection.orientation),
        )
        response = self._call(self._shows, request)
        if response.error_code != ShowPattern.Request.NONE:
            raise StepFailedError(f"{response.error_message} (error {response.error_code})")
        self._shown, self._projection = response.shown, projection
        return to_nanoseconds(response.shown)

    def expose(self, exposure_time: float = 0.0) -> tuple[np.ndarray, FrameRecord]:
        """Take a frame of what is shown and return it with its record.

        Parameters
        ----------
        exposure_time
            [s]; 0: as the camera is set up.

        Raises
        ------
        StepFailedError
            There is no frame.
        NotAnsweredError
            The camera does not answer.
        """
        self._ready(self._captures)
        request = CaptureFrame.Request(
            experiment="single frames",
            count=1,
            kind=int(self._projection.kind),
            orientation=int(self._projection.orientation),
            pitch=self._projection.pitch,
            shift=self._projection.shift,
            shifts=self._projection.shifts,
            exposure_time=exposure_time,
            shown=self._shown,
            image_subscribers=1,
            exposure_subscribers=1,
        )
        response = self._call(self._captures, request)
        if response.error_code != CaptureFrame.Request.NONE:
            raise StepFailedError(f"{response.error_message} (error {response.error_code})")

        def arrived() -> bool:
            return all(
                each is not None and each.header.stamp == response.stamp for each in (self._image, self._exposure)
            )

        self._wait(arrived, FRAME_TIMEOUT_S, lambda: "camera/image_raw: the frame was taken and did not arrive")
        assert self._image is not None, "it arrived"
        return image_array(self._image), frame_record(self._exposure)

    def _ready(self, client: Client) -> None:
        if not client.service_is_ready():
            self._wait(client.service_is_ready, FRAME_TIMEOUT_S, lambda: f"{client.srv_name}: no such service")

    def _take_image(self, message: Image) -> None:
        self._image = message

    def _take_exposure(self, message: Exposure) -> None:
        self._exposure = message
