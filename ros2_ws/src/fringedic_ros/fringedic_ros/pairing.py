"""Subscribes to camera images and their exposure records, and pairs them.

Images stay serialised until somebody needs their pixels: the small record decides, and most readers need few of them.
"""

from __future__ import annotations

from collections.abc import Callable

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import Image

from fringedic.errors import RecordingError
from fringedic.frames.pairing import FramePairs
from fringedic_msgs.msg import Exposure
from fringedic_ros.qos import IMAGES
from fringedic_ros.serialized import header_stamp
from fringedic_ros.stamps import to_nanoseconds


class ImageExposurePairs:
    """Subscribes to images and exposure records and passes on the pairs, in the order of their stamps.

    Parameters
    ----------
    node
        Owner of the subscriptions.
    on_pair
        Called with the serialised image, for `fringedic_ros.serialized.image_view`, and its record.
    image_topic, exposure_topic
        Relative names.
    callback_group
        Of both subscriptions; the node's default group when None.
    """

    def __init__(
        self,
        node: Node,
        on_pair: Callable[[bytes, Exposure], None],
        *,
        image_topic: str = "camera/image_raw",
        exposure_topic: str = "camera/exposure",
        callback_group: CallbackGroup | None = None,
    ) -> None:
        self._node = node
        self._on_pair = on_pair
        self._pairs: FramePairs[bytes, Exposure] = FramePairs(IMAGES.depth)
        node.create_subscription(
            Image,
            image_topic,
            self._add_image,
            IMAGES,
            callback_group=callback_group,
            raw=True,
        )
        node.create_subscription(Exposure, exposure_topic, self._add_exposure, IMAGES, callback_group=callback_group)

    @property
    def unpaired(self) -> int:
        """Images and records that were dropped without a partner."""
        return self._pairs.unpaired

    @property
    def waiting(self) -> int:
        """Images and records that have no partner yet."""
        return self._pairs.waiting

    def _add_image(self, image: bytes) -> None:
        try:
            stamp = header_stamp(image)
        except RecordingError as error:
            self._node.get_logger().warning(f"an image is ignored: {error}", throttle_duration_sec=10.0)
        else:
            self._pass_on(self._pairs.add_image(stamp, image))

    def _add_exposure(self, exposure: Exposure) -> None:
        self._pass_on(self._pairs.add_record(to_nanoseconds(exposure.header.stamp), exposure))

    def _pass_on(self, pair: tuple[bytes, Exposure] | None) -> None:
        if pair is not None:
            self._on_pair(*pair)
