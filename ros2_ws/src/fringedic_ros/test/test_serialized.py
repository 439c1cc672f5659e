"""Serialised images are read without a copy of their pixels."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from fringedic.errors import RecordingError
from fringedic_ros.images import image_array, image_message
from fringedic_ros.serialized import image_view


@pytest.mark.parametrize("frame", ["", "rig", "rig/camera_optical_frame"])  # of different paddings
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_view_has_the_fields_of_the_message(frame: str, kind: type) -> None:
    pixels = np.arange(15, dtype=kind).reshape(3, 5) * 17
    message = image_message(pixels, stamp_ns=3_000_000_007, frame_id=frame)
    view = image_view(serialize_message(message))
    for name in ("height", "width", "encoding", "is_bigendian", "step"):
        assert getattr(view, name) == getattr(message, name), name
    assert view.stamp == 3_000_000_007
    np.testing.assert_array_equal(image_array(view), pixels)


@pytest.mark.parametrize("size", [0, 3, 11, 30, 40])
def test_too_few_bytes_are_an_error(size: int) -> None:
    data = serialize_message(image_message(np.zeros((3, 5), np.uint8), stamp_ns=0, frame_id="rig"))
    with pytest.raises(RecordingError, match="cannot be read as Image"):
        image_view(data[:size])
