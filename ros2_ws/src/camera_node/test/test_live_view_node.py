"""The live view node in a process of its own, fed with frames as the camera node sends them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from scipy.ndimage import gaussian_filter
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from camera_node.live_view_node import LiveViewParameters
from fringedic.figures.live_preview import RED
from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic_msgs.msg import Exposure, LiveView
from fringedic_ros.images import image_array, image_message
from fringedic_ros.qos import DERIVED, IMAGES
from fringedic_ros.records import exposure_message
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.testing import NodeProcess, Peer

MODULE = "camera_node.live_view_node"


class Studio(Peer):
    """Plays the camera, and the person who looks."""

    def __init__(self) -> None:
        super().__init__()
        self.figures = self.listen(LiveView, "live_view/figures", DERIVED)
        self.pictures = self.listen(Image, "live_view/image", DERIVED)
        self._images = self.create_publisher(Image, "camera/image_raw", IMAGES)
        self._exposures = self.create_publisher(Exposure, "camera/exposure", IMAGES)
        self._reset = self.create_client(Trigger, "live_view/reset")
        self._parameters = self.create_client(SetParameters, "live_view/set_parameters")
        self._random = np.random.default_rng(5)
        pattern = gaussian_filter(self._random.normal(size=(120, 160)), 1.6)
        self._surface = 110 + 30 * pattern / pattern.std()
        self._stamp = 0

    def ready(self) -> None:
        self.wait(
            lambda: self._images.get_subscription_count() and self._exposures.get_subscription_count(), "the node"
        )
        self.wait(lambda: self.count_publishers("live_view/image"), "its picture")
        self.wait(self._reset.service_is_ready, "its service")
        self.meet("live_view")

    def send(self, *, blur: float = 0.0, free: bool = False, timeout_s: float = 300.0) -> LiveView:
        """Send a frame, with two rows of it saturated, and return its figures."""
        grey = gaussian_filter(self._surface, blur) if blur else self._surface
        image = np.clip(np.rint(grey + self._random.normal(0, 2, grey.shape)), 1, 254).astype(np.uint8)
        image[10:12, :] = 255
        self._stamp += 100_000_000
        kind, count = (PatternKind.OTHER, 0) if free else (PatternKind.WHITE, 1)
        record = FrameRecord("", 0, 0, count, ProjectedPattern(kind), self._stamp, 0.01)
        self._exposures.publish(exposure_message(record, frame_id="camera_optical_frame"))
        self._images.publish(image_message(image, stamp_ns=self._stamp, frame_id="camera_optical_frame"))
        self.wait(
            lambda: self.figures and to_nanoseconds(self.figures[-1].header.stamp) == self._stamp, "figures", timeout_s
        )
        return self.figures[-1]

    def set_region(self, region: list[int]) -> None:
        change = Parameter("region_px", Parameter.Type.INTEGER_ARRAY, region).to_parameter_msg()
        response = self.ask(self._parameters, SetParameters.Request(parameters=[change]), "the change of the region")
        assert response.results[0].successful

    def reset(self) -> None:
        self.ask(self._reset, Trigger.Request(), "the reset")


def test_figures_and_picture_of_every_frame(studio: Studio, tmp_path: Path) -> None:
    with NodeProcess(MODULE, tmp_path, {"maximum_rate_hz": 1000.0}):
        studio.ready()
        assert math.isnan(studio.send().noise)
        sharp = studio.send()
        assert (sharp.column, sharp.row, sharp.width, sharp.height) == (0, 0, 160, 120)
        assert sharp.focus == 1.0
        assert sharp.saturated == 2 / 120
        assert sharp.full_scale == 255
        assert sum(sharp.histogram) == 120 * 160
        assert sharp.histogram[255] == 2 * 160
        assert sharp.noise == pytest.approx(2.0, rel=0.06)
        studio.send(blur=1.5)
        assert 0 < studio.send(blur=1.5).focus < 0.5
        studio.reset()
        studio.send(blur=1.5)
        assert studio.send(blur=1.5).focus == 1.0
        studio.wait(lambda: studio.pictures, "a picture")
        picture = image_array(studio.pictures[-1])
        assert picture.shape == (120, 160, 3)
        assert tuple(picture[10, 80]) == RED
        studio.send(free=True)
        free = studio.send(free=True)
        assert free.speckle_size == pytest.approx(4 * math.sqrt(math.log(2)) * 1.6, rel=0.1), (
            "a free run is looked at, too"
        )


def test_region_is_told_and_one_outside_the_image_is_named(studio: Studio, tmp_path: Path) -> None:
    with NodeProcess(MODULE, tmp_path, {"region_px": "[32, 40, 64, 48]"}) as node:
        studio.ready()
        figures = studio.send()
        assert (figures.column, figures.row, figures.width, figures.height) == (32, 40, 64, 48)
        assert figures.saturated == 0
        studio.set_region([120, 40, 64, 48])
        with pytest.raises(AssertionError, match="figures did not happen"):
            studio.send(timeout_s=1.0)
        named = "the region of 64x48 px from column 120 and row 40 is not inside the image of 160x120"
        studio.wait(lambda: named in node.log, "the reason")
        studio.set_region([])
        assert studio.send().width == 160, "the next frame works"
    with pytest.raises(ValueError, match="four numbers"):
        LiveViewParameters(region_px=[32, 40, 64])
