"""The machine of the virtual rig, in the time of this computer."""

from __future__ import annotations

import time

from fringedic.virtual_rig import SimulatedLoadFrame
from load_frame_node.machines.machine import Sample


class SimulatedMachine:
    """Lets the simulated machine's time pass as this computer's clock does."""

    def __init__(self, machine: SimulatedLoadFrame) -> None:
        self._machine = machine
        self._stamp_ns = time.time_ns()

    def sample(self) -> Sample:
        """Advance to the present and read."""
        self._pass_time()
        mode, force, position = self._machine.sample()
        return Sample(self._stamp_ns, mode, force, position)

    def move_to(self, position: float, speed: float) -> None:
        """Start a move with the machine's ramps.

        Raises
        ------
        CrossheadRangeError
            The position or the speed is outside the machine's range.
        """
        self._pass_time()
        self._machine.move_to(position, speed)

    def hold(self) -> None:
        """Stop with the machine's ramp."""
        self._pass_time()
        self._machine.hold()

    def close(self) -> None:
        """Nothing to let go of."""

    def _pass_time(self) -> None:
        now = time.time_ns()
        # a clock that was set back must not turn the machine's time back
        self._machine.advance(1e-9 * max(now - self._stamp_ns, 0))
        self._stamp_ns = now
