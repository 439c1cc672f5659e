"""The machine in use and its latest sample, shared by sampling, moves and hold requests."""

from __future__ import annotations

import threading

from rclpy.node import Node

from fringedic_ros.waiting import Condition
from load_frame_node.machines import LoadMode, Machine, Sample


class Crosshead:
    """The machine that is open, used by one thread at a time, and the latest that is known of it.

    Attributes
    ----------
    machine
        The open machine; None before the node is configured.
    sample
        The latest sample; UNKNOWN before the first one.
    changed
        Notified after each sample.
    hold_requested
        A hold was requested after the start of the latest move.
    """

    def __init__(self, node: Node) -> None:
        self.machine: Machine | None = None
        self.sample = Sample(0, LoadMode.UNKNOWN, 0.0, 0.0)
        self.changed = Condition(node)
        self.hold_requested = False
        self._in_use = threading.Lock()

    def open(self, machine: Machine) -> None:
        """Use a machine from now on."""
        self.machine = machine

    def close(self) -> None:
        """Release the machine."""
        if self.machine is not None:
            self.machine.close()
            self.machine = None

    def read(self) -> Sample:
        """Return a new sample; `take` makes it the latest.

        Raises
        ------
        MachineError
            There is no sample.
        """
        with self._in_use:
            return self._open_machine().sample()

    def take(self, sample: Sample) -> None:
        """Make a sample the latest one."""
        self.sample = sample
        self.changed.notify()

    def move_to(self, position: float, speed: float) -> None:
        """Request a move to `position` [m] at `speed` [m/s].

        Raises
        ------
        CrossheadRangeError
            The position or the speed is outside the range of the machine.
        MachineError
            The machine does not accept the request.
        """
        with self._in_use:
            self._open_machine().move_to(position, speed)

    def hold(self) -> None:
        """Request a hold.

        Raises
        ------
        MachineError
            The machine does not accept the request.
        """
        with self._in_use:
            self._open_machine().hold()

    def _open_machine(self) -> Machine:
        assert self.machine is not None, "an active load frame has a machine"
        return self.machine
