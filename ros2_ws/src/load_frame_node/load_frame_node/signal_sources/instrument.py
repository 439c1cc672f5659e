"""An instrument with Modbus registers or SCPI queries, described as a testing machine is."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from fringedic.frames.clocks import wall_minus_monotonic_ns
from fringedic.settings.signals import InstrumentSignal
from load_frame_node.machines.description import ModbusInstrument, load_instrument
from load_frame_node.machines.modbus import ModbusMachine
from load_frame_node.machines.scpi import ScpiMachine
from load_frame_node.signal_sources.source import Reading

_LONGEST_WAIT_S = 0.2


class InstrumentSource:
    """Readings of the signals that a file describes, at a fixed rate.

    Attributes
    ----------
    description
        Content of the file.
    """

    def __init__(self, settings: InstrumentSignal, _node: Any = None) -> None:
        self.description = load_instrument(settings.file)
        if isinstance(self.description, ModbusInstrument):
            self._instrument: ModbusMachine | ScpiMachine = ModbusMachine(self.description)
        else:
            self._instrument = ScpiMachine(self.description)
        self._period_s, self._due_s = 1 / settings.rate_hz, 0.0

    def read(self) -> Sequence[Reading]:
        """Return the present readings when they are due.

        Raises
        ------
        MachineError
            The instrument does not answer.
        """
        now = time.monotonic()
        if self._due_s - now > _LONGEST_WAIT_S:
            time.sleep(_LONGEST_WAIT_S)
            return []
        time.sleep(max(self._due_s - now, 0.0))
        self._due_s = max(self._due_s + self._period_s, time.monotonic())
        read = self._instrument.read_signals()
        stamp = read.acquired_ns + wall_minus_monotonic_ns()
        return [Reading(stamp, value, name) for name, value in read.signals.items()]

    def close(self) -> None:
        """Disconnect."""
        self._instrument.close()
