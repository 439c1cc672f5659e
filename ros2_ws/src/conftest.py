"""A ROS domain for every test module that starts nodes, so that test runs go side by side, and a context per test."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from fringedic_ros.spinning import Spinning

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the nodes, and before NumPy is loaded
LIBRARY = Path(__file__).parent / "fringedic"  # imports no ROS


@pytest.fixture(scope="module", autouse=True)
def domain(request: pytest.FixtureRequest) -> Iterator[int | None]:
    """Set aside a ROS domain, and let contexts and processes of this module's tests run as nodes do."""
    if request.path.is_relative_to(LIBRARY):
        yield None
        return
    from fringedic_bringup.launch.environment import node_environment, private_domain

    with private_domain() as number, pytest.MonkeyPatch.context() as patch:
        for name, value in node_environment(number).items():
            patch.setenv(name, value)
        yield number


@pytest.fixture
def ros() -> Iterator[None]:
    """Initialise the default context."""
    import rclpy

    rclpy.init()
    yield
    rclpy.try_shutdown()


@pytest.fixture
def spinning(ros: None) -> Iterator[Spinning]:  # noqa: ARG001 (the context comes first)
    """Run an executor in a thread; nodes are added to it."""
    from fringedic_ros.spinning import Spinning

    with Spinning() as loop:
        yield loop
