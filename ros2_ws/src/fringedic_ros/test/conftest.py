"""A ROS context per test, in a domain of its own."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rclpy

from fringedic_ros.spinning import Spinning


@pytest.fixture
def ros() -> Iterator[None]:
    """An initialised default context."""
    rclpy.init()
    yield
    rclpy.try_shutdown()


@pytest.fixture
def spinning(ros: None) -> Iterator[Spinning]:  # noqa: ARG001 (the context comes first)
    """An executor in a thread; nodes are added to it."""
    with Spinning() as loop:
        yield loop
