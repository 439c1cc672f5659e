"""Joins every image with the exposure record of exactly the same stamp."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import Image

from fringedic_msgs.msg import Exposure
from fringedic_ros.qos import IMAGES, OVERRIDABLE
from fringedic_ros.stamps import to_nanoseconds


class ImageExposurePairs:
    """Subscribes to images and exposure records and hands on the pairs, in the order of their stamps.

    One camera publishes both topics, each in order of its strictly increasing stamps. So when a pair is complete, what
    is older and still alone has lost its partner for good: it is dropped and counted in `unpaired`.

    Parameters
    ----------
    node
        Owner of the subscriptions.
    on_pair
        Called with the image and its record.
    image_topic, exposure_topic
        Relative names.
    callback_group
        Of both subscriptions; the node's default group when None.
    """

    def __init__(
        self,
        node: Node,
        on_pair: Callable[[Image, Exposure], None],
        *,
        image_topic: str = "camera/image_raw",
        exposure_topic: str = "camera/exposure",
        callback_group: CallbackGroup | None = None,
    ) -> None:
        self.unpaired = 0
        self._on_pair = on_pair
        self._images: OrderedDict[int, Image] = OrderedDict()
        self._exposures: OrderedDict[int, Exposure] = OrderedDict()
        node.create_subscription(
            Image,
            image_topic,
            self._add_image,
            IMAGES,
            callback_group=callback_group,
            qos_overriding_options=OVERRIDABLE,
        )
        node.create_subscription(Exposure, exposure_topic, self._add_exposure, IMAGES, callback_group=callback_group)

    @property
    def waiting(self) -> int:
        """Images and records that have no partner yet."""
        return len(self._images) + len(self._exposures)

    def _add_image(self, image: Image) -> None:
        stamp = to_nanoseconds(image.header.stamp)
        self._images[stamp] = image
        self._join(stamp)

    def _add_exposure(self, exposure: Exposure) -> None:
        stamp = to_nanoseconds(exposure.header.stamp)
        self._exposures[stamp] = exposure
        self._join(stamp)

    def _join(self, stamp: int) -> None:
        if stamp in self._images and stamp in self._exposures:
            image, exposure = self._images.pop(stamp), self._exposures.pop(stamp)
            for waiting in (self._images, self._exposures):
                for older in [other for other in waiting if other < stamp]:
                    del waiting[older]
                    self.unpaired += 1
            self._on_pair(image, exposure)
        for waiting in (self._images, self._exposures):
            while len(waiting) > IMAGES.depth:
                waiting.popitem(last=False)
                self.unpaired += 1
