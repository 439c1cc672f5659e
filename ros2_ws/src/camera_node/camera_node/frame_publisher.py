"""Publishes each frame with its exposure record and camera information, under exactly equal stamps."""

from __future__ import annotations

import math
import time
import zlib

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

from camera_node.drivers import Driver, Frame
from fringedic.errors import ClockJumpError, FringedicError
from fringedic.frames.records import FrameRecord
from fringedic.rig.model import RigModel
from fringedic.wording.numbers import number_text
from fringedic_msgs.msg import ClockDrift, Exposure, RigCalibration
from fringedic_ros.camera_info import camera_info
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.images import image_message
from fringedic_ros.qos import IMAGES, LATCHED
from fringedic_ros.records import clock_message, exposure_message
from fringedic_ros.rig_node import CAMERA_FRAME, frame_id

_BROWN_RESIDUAL_PX = 0.05  # of the lens in camera_info; a larger one is logged
_DRIVER_PERIOD_S = 1.0  # between two reports about the clock and the losses of the camera
_BACK_NS = 100_000_000  # a frame is older than its predecessor by more than this only when a clock was set back


class FramePublisher:
    """Publishers of images, camera information, exposure records and the clock of the camera.

    Parameters
    ----------
    node
        Owner of publishers and subscription.
    diagnostics
        Shows the counts of the driver.

    Attributes
    ----------
    dropped
        Frames of the free run that were lost in this node.
    """

    def __init__(self, node: Node, diagnostics: NodeDiagnostics) -> None:
        self.dropped = 0
        self._frame = frame_id(node, CAMERA_FRAME)
        self._node = node
        self._diagnostics = diagnostics
        self._stamp_ns = 0
        self._info = CameraInfo()
        self._reported = -math.inf
        self._images = node.create_publisher(Image, "camera/image_raw", IMAGES)
        self._infos = node.create_publisher(CameraInfo, "camera/camera_info", IMAGES)
        self._exposures = node.create_publisher(Exposure, "camera/exposure", IMAGES)
        self._clocks = node.create_publisher(ClockDrift, "camera/clock", LATCHED)
        node.create_subscription(RigCalibration, "calibration", self._take_calibration, LATCHED)

    def subscribers(self) -> tuple[int, int]:
        """Return the numbers of connected subscribers of images and of exposure records."""
        return self._images.get_subscription_count(), self._exposures.get_subscription_count()

    def publish(self, frame: Frame, record: FrameRecord, driver: Driver) -> int:
        """Publish image, camera information and record under one stamp, and return it [ns].

        The stamps of successive frames increase strictly.

        Raises
        ------
        ClockJumpError
            The frame is older than the one before it; the next frame starts a new order.
        """
        back = self._stamp_ns - frame.stamp_ns
        if back > _BACK_NS:
            self._stamp_ns = frame.stamp_ns
            raise ClockJumpError(
                f"the clock jumped back by {number_text(1e-9 * back, 3)} s between two frames; measure the step again, "
                "and do not set the clock during a test"
            )
        self._stamp_ns = max(frame.stamp_ns, self._stamp_ns + 1)
        image = image_message(frame.image, stamp_ns=self._stamp_ns, frame_id=self._frame)
        exposure = exposure_message(record, frame_id=self._frame)
        exposure.header = image.header
        exposure.exposure_time = frame.exposure_time
        exposure.dropped = self.dropped + driver.dropped
        exposure.image_crc = zlib.crc32(image.data)
        self._images.publish(image)
        self._infos.publish(self._info_of(image))
        self._exposures.publish(exposure)
        self._report(driver)
        return self._stamp_ns

    def _report(self, driver: Driver) -> None:
        """Publish the clock and the counts of the driver, once a second at most."""
        now = time.monotonic()
        if now - self._reported < _DRIVER_PERIOD_S:
            return
        self._reported = now
        for name, count in driver.counts.items():
            self._diagnostics.set_value(name, str(count))
        clock = driver.clock
        if clock is not None:
            self._clocks.publish(clock_message("camera", clock))

    def _take_calibration(self, message: RigCalibration) -> None:
        """Publish the lens of a calibration in `camera/camera_info` from now on."""
        try:
            info, residual = camera_info(RigModel.from_message(message))
        except FringedicError as error:
            self._node.get_logger().error(f"calibration '{message.identifier}' refused: {error}")
            return
        self._info = info
        if residual > _BROWN_RESIDUAL_PX:
            self._node.get_logger().info(
                f"camera/camera_info describes the lens to within {residual:.2f} px only; the calibration is better"
            )

    def _info_of(self, image: Image) -> CameraInfo:
        """Return the camera information of an image; without a lens for images of another size than calibrated."""
        known = self._info
        if (known.width, known.height) != (image.width, image.height):
            return CameraInfo(header=image.header, height=image.height, width=image.width)
        return CameraInfo(
            header=image.header,
            height=image.height,
            width=image.width,
            distortion_model=known.distortion_model,
            d=known.d,
            k=known.k,
            r=known.r,
            p=known.p,
        )
