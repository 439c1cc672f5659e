"""Machine of the virtual rig, driven by the monotonic clock of this computer."""

from __future__ import annotations

import time

from fringedic.frames.clocks import wall_minus_monotonic_ns
from fringedic.settings.load_frame import LoadFrameNodeSettings, VirtualLoadFrame
from fringedic.virtual_rig import CrossheadState, SimulatedLoadFrame, VirtualRigConfiguration
from fringedic_ros.lifecycle import HardwareNode
from load_frame_node.machines.machine import LoadMode, Sample

_MODES = {
    CrossheadState.IDLE: LoadMode.IDLE,
    CrossheadState.MOVING: LoadMode.MOVING,
    CrossheadState.HOLDING: LoadMode.HOLD,
}


class SimulatedMachine:
    """Simulated machine whose time advances with the monotonic clock of this computer."""

    def __init__(self, machine: SimulatedLoadFrame) -> None:
        self._machine = machine
        self._advanced_ns = time.monotonic_ns()

    def sample(self) -> Sample:
        """Advance to the present time and read."""
        self._advance()
        state, force, position = self._machine.sample()
        return Sample(self._advanced_ns + wall_minus_monotonic_ns(), _MODES[state], force, position)

    def move_to(self, position: float, speed: float) -> None:
        """Start a move with the speed ramps of the machine.

        Raises
        ------
        CrossheadRangeError
            The position or the speed is outside the range of the machine.
        """
        self._advance()
        self._machine.move_to(position, speed)

    def hold(self) -> None:
        """Stop with the speed ramp of the machine, then hold."""
        self._advance()
        self._machine.hold()

    def close(self) -> None:
        """Do nothing: there is no connection."""

    def _advance(self) -> None:
        now = time.monotonic_ns()
        self._machine.advance(1e-9 * (now - self._advanced_ns))
        self._advanced_ns = now


def open_simulated_machine(_settings: VirtualLoadFrame, node: HardwareNode[LoadFrameNodeSettings]) -> SimulatedMachine:
    """Return the machine of the virtual rig of a load frame node."""
    rig = VirtualRigConfiguration.from_dict(node.parameters.value.virtual_rig)
    return SimulatedMachine(SimulatedLoadFrame(rig.load_frame, rig.seed))
