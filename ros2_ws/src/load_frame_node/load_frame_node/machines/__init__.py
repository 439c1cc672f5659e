"""Testing machines: each gives samples and accepts requests for moves and for a hold."""

from load_frame_node.machines.description import (
    MachineDescription,
    ModbusDescription,
    ScpiDescription,
    load_machine,
)
from load_frame_node.machines.machine import LoadMode, Machine, Sample
from load_frame_node.machines.modbus import ModbusMachine
from load_frame_node.machines.scpi import ScpiMachine
from load_frame_node.machines.simulated import SimulatedMachine


def open_machine(description: MachineDescription) -> Machine:
    """Connect to the machine of a description.

    Raises
    ------
    MachineError
        The machine does not answer.
    """
    if isinstance(description, ModbusDescription):
        return ModbusMachine(description)
    return ScpiMachine(description)


__all__ = [
    "LoadMode",
    "Machine",
    "MachineDescription",
    "ModbusDescription",
    "ModbusMachine",
    "Sample",
    "ScpiDescription",
    "ScpiMachine",
    "SimulatedMachine",
    "load_machine",
    "open_machine",
]
