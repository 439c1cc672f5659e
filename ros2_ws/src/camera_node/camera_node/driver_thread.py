"""The open driver of a camera and the one thread that calls it."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from rclpy.task import Future

from camera_node.drivers import Driver, Frame, Scene
from fringedic.errors import WaitTimeoutError
from fringedic_ros.waiting import wait_for
from fringedic_ros.work import Worker


class DriverThread:
    """Calls the driver in a background thread, one call after the other.

    Parameters
    ----------
    node
        Its executor is woken when a call returns.

    Attributes
    ----------
    driver
        The open driver; None before the node is configured.
    """

    def __init__(self, node: Node) -> None:
        self.driver: Driver | None = None
        self._node = node
        self._worker = Worker(node)

    @property
    def open_driver(self) -> Driver:
        """The driver of an active node."""
        assert self.driver is not None, "an active camera has a driver"
        return self.driver

    @property
    def dropped(self) -> int:
        """Frames that the driver lost since it was opened."""
        return 0 if self.driver is None else self.driver.dropped

    @property
    def pending(self) -> int:
        """Calls that are queued or running."""
        return self._worker.pending

    def submit(self, function: Callable[..., None], *arguments: object) -> None:
        """Queue a call without result."""
        self._worker.submit(function, *arguments)

    def run(self, function: Callable[..., object], *arguments: object) -> Future:
        """Queue a call and return the future of its result."""
        return self._worker.run(function, *arguments)

    async def expose(self, scene: Scene, timeout_s: float) -> Frame:
        """Take one frame.

        Raises
        ------
        WaitTimeoutError
            The driver did not return in time.
        FringedicError
            There is no frame.
        """
        try:
            frame: Frame = await wait_for(self._node, self.run(self.open_driver.expose, scene), timeout_s, "the frame")
        except WaitTimeoutError:
            self.replace(0.0)  # abandon the thread that hangs in the driver; the next capture uses a new one
            raise
        return frame

    def await_idle(self, timeout_s: float) -> None:
        """Block until all queued calls have returned."""
        self._worker.await_idle(timeout_s)

    def replace(self, timeout_s: float = 5.0) -> None:
        """Discard the queued calls, wait for the running one, and continue with a new thread."""
        self._worker.stop(timeout_s)
        self._worker = Worker(self._node)

    def close(self) -> None:
        """Close the driver."""
        self.replace()
        if self.driver is not None:
            self.driver.close()
            self.driver = None

    def end(self) -> None:
        """End the thread."""
        self._worker.stop()
