"""An executor per test, in the default context."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rclpy

from fringedic_ros.spinning import Spinning


@pytest.fixture
def spinning() -> Iterator[Spinning]:
    """An executor in a thread; nodes are added to it."""
    rclpy.init()
    with Spinning() as loop:
        yield loop
    rclpy.try_shutdown()
