"""Somebody who asks a camera node for frames."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rclpy

from camera_node.testing import Studio


@pytest.fixture
def studio() -> Iterator[Studio]:
    """Return a node that hears what the camera publishes."""
    rclpy.init()
    studio = Studio()
    yield studio
    studio.destroy_node()
    rclpy.shutdown()
