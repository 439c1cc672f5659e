"""The other side of a camera or live view node."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rclpy

from fringedic_ros.testing import Peer


@pytest.fixture
def studio(request: pytest.FixtureRequest) -> Iterator[Peer]:
    """Return the node that the module calls `Studio`: it asks, and hears what is published."""
    rclpy.init()
    studio = request.module.Studio()
    yield studio
    studio.destroy_node()
    rclpy.shutdown()
