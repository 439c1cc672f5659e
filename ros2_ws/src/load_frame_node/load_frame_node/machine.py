"""Testing machines. The machine decides: software asks for moves and holds, and reads what it does.

Limits, ramps and emergency stop belong to the machine's own controller.
"""

from __future__ import annotations

import time
from typing import Protocol

from fringedic.virtual_rig import LoadSample, SimulatedLoadFrame, VirtualRigConfiguration


class Machine(Protocol):
    """What the node asks of a testing machine."""

    def move_to(self, position: float, speed: float) -> None:
        """Ask for a move to `position` [m] at `speed` [m/s]; raises `CrossheadRangeError` when it is out of range."""

    def hold(self) -> None:
        """Ask the machine to stop and hold."""

    def sample(self) -> LoadSample:
        """Read mode, force [N] and crosshead position [m] now."""


class SimulatedMachine:
    """The virtual rig's machine, running with the steady clock."""

    def __init__(self, configuration: VirtualRigConfiguration) -> None:
        self._frame = SimulatedLoadFrame(configuration.load_frame, configuration.seed)
        self._time = time.monotonic()

    def move_to(self, position: float, speed: float) -> None:
        """Start moving to `position` [m] at `speed` [m/s]."""
        self._advance()
        self._frame.move_to(position, speed)

    def hold(self) -> None:
        """Stop with the machine's ramp and hold."""
        self._advance()
        self._frame.hold()

    def sample(self) -> LoadSample:
        """Read mode, force [N] and crosshead position [m] now."""
        self._advance()
        return self._frame.sample()

    def _advance(self) -> None:
        now = time.monotonic()
        self._frame.advance(now - self._time)
        self._time = now
