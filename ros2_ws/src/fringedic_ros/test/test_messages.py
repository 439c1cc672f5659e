"""Arrays survive the way through real DDS; contradictory messages are refused by name."""

from __future__ import annotations

import array
import time

import numpy as np
import pytest
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import Image, PointCloud2

from fringedic.errors import ImageError
from fringedic.frames.records import FrameRecord, frame_record
from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic_ros.clouds import cloud_arrays, cloud_message
from fringedic_ros.images import image_array, image_message
from fringedic_ros.qos import IMAGES
from fringedic_ros.records import exposure_message
from fringedic_ros.stamps import to_msg, to_nanoseconds

STAMP = 1_790_000_000_123_456_789


def through_dds(message: Image | PointCloud2) -> Image | PointCloud2:
    node = Node("round_trip")
    received: list[Image | PointCloud2] = []
    node.create_subscription(type(message), "through", received.append, IMAGES)
    publisher = node.create_publisher(type(message), "through", IMAGES)
    deadline = time.monotonic() + 180
    while publisher.get_subscription_count() < 1 and time.monotonic() < deadline:
        time.sleep(0.01)
    publisher.publish(message)
    while not received and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    assert received, "the message did not arrive"
    return received[0]


def pixels(dtype: type, *shape: int) -> np.ndarray:
    values = np.random.default_rng(1).integers(0, 65536, shape)
    return values.astype(dtype)


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize(
    ("image", "encoding"),
    [
        (pixels(np.uint8, 5, 7), "mono8"),
        (pixels(np.uint16, 5, 7), "mono16"),
        (pixels(np.float32, 5, 7), "32FC1"),
        (pixels(np.float32, 5, 7, 2), "32FC2"),
        (pixels(np.uint8, 5, 7, 3), "rgb8"),
        (pixels(np.uint8, 5, 7, 3), "bgr8"),
        (pixels(np.uint8, 10, 14)[::2, ::2], "mono8"),
        (pixels(np.uint8, 960, 1280), "mono8"),
    ],
)
def test_image_round_trip(image: np.ndarray, encoding: str) -> None:
    sent = image_message(image, stamp_ns=STAMP, frame_id="camera_optical_frame", encoding=encoding)
    message = through_dds(sent)
    assert (message.encoding, message.width, message.height) == (encoding, image.shape[1], image.shape[0])
    assert (to_nanoseconds(message.header.stamp), message.header.frame_id) == (STAMP, "camera_optical_frame")
    received = image_array(message)
    assert received.dtype == image.dtype
    np.testing.assert_array_equal(received, image)


@pytest.mark.usefixtures("ros")
def test_nan_survives_and_views_are_read_only() -> None:
    image = np.array([[1.5, np.nan]], dtype=np.float32)
    received = image_array(through_dds(image_message(image, stamp_ns=STAMP, frame_id="")))
    np.testing.assert_array_equal(received, image)
    with pytest.raises(ValueError, match="read-only"):
        received[0, 0] = 0


def test_foreign_layouts_are_read() -> None:
    """Padded rows and big-endian words, as camera drivers send them."""
    message = Image(width=2, height=2, encoding="mono16", is_bigendian=1, step=6)
    message.data = array.array("B", [1, 2, 3, 4, 99, 99, 5, 6, 7, 8, 99, 99])
    np.testing.assert_array_equal(image_array(message), [[0x0102, 0x0304], [0x0506, 0x0708]])


def test_bad_images_are_refused() -> None:
    good = image_message(pixels(np.uint8, 5, 7), stamp_ns=STAMP, frame_id="")
    for field, value, words in [
        ("encoding", "bayer_rggb8", "bayer_rggb8"),
        ("encoding", "mono16", "7x5 px"),
        ("width", 8, "8x5 px"),
        ("height", 6, "7x6 px"),
        ("data", array.array("B", [0] * 34), "34 bytes"),
    ]:
        kept = getattr(good, field)
        setattr(good, field, value)
        with pytest.raises(ImageError, match=words):
            image_array(good)
        setattr(good, field, kept)
    with pytest.raises(ImageError, match="float64"):
        image_message(np.zeros((2, 2)), stamp_ns=0, frame_id="")
    with pytest.raises(ImageError, match="mono16"):
        image_message(pixels(np.uint8, 5, 7), stamp_ns=0, frame_id="", encoding="mono16")


@pytest.mark.usefixtures("ros")
def test_cloud_round_trip() -> None:
    fields = {name: pixels(np.float32, 4, 6) + i for i, name in enumerate("xyzw")}
    fields["w"][1, 2] = np.nan
    message = through_dds(cloud_message(fields, stamp_ns=STAMP, frame_id="reference_plane"))
    assert (message.width, message.height, message.point_step, message.is_dense) == (6, 4, 16, False)
    received = cloud_arrays(message)
    assert list(received) == list("xyzw")
    for name, values in fields.items():
        np.testing.assert_array_equal(received[name], values)


def test_bad_clouds_are_refused() -> None:
    with pytest.raises(ImageError, match="one shape"):
        cloud_message({"x": np.zeros((2, 2)), "y": np.zeros((2, 3))}, stamp_ns=0, frame_id="")
    with pytest.raises(ImageError, match="none"):
        cloud_message({}, stamp_ns=0, frame_id="")
    message = cloud_message({"x": np.zeros((2, 2))}, stamp_ns=0, frame_id="")
    message.height = 3
    with pytest.raises(ImageError, match="2x3 points"):
        cloud_arrays(message)


def test_records_round_trip() -> None:
    record = FrameRecord(
        experiment="plate",
        step=3,
        index=5,
        count=20,
        pattern=ProjectedPattern(PatternKind.FRINGES, Orientation.HORIZONTAL, 12.5, 2, 5),
        stamp=STAMP,
        exposure_time=0.02,
        dropped=7,
    )
    message = exposure_message(record, frame_id="camera_optical_frame")
    assert frame_record(message) == record
    message.kind = 9
    with pytest.raises(ValueError, match="9"):
        frame_record(message)


def test_stamps_are_exact() -> None:
    for nanoseconds in (0, 1, 999_999_999, 1_000_000_000, STAMP):
        assert to_nanoseconds(to_msg(nanoseconds)) == nanoseconds
