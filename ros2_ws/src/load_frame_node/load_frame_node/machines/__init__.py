"""Testing machines: each gives samples and accepts requests for moves and for a hold."""

from typing import Any

from fringedic.errors import MachineError
from fringedic.settings.load_frame import DescribedLoadFrame, LoadFrameNodeSettings
from fringedic_ros.lifecycle import HardwareNode
from load_frame_node.machines.described import Answer, DescribedMachine
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


def open_machine(description: MachineDescription, *, is_required: bool = True) -> DescribedMachine[Any]:
    """Connect to the machine of a description.

    Parameters
    ----------
    is_required
        Whether the machine has to answer now; otherwise it is connected at a later sample.

    Raises
    ------
    MachineError
        The machine does not answer.
    """
    machine: DescribedMachine[Any] = (
        ModbusMachine(description) if isinstance(description, ModbusDescription) else ScpiMachine(description)
    )
    if is_required:
        try:
            machine.sample()
        except MachineError:
            machine.close()
            raise
    return machine


def open_described_machine(
    settings: DescribedLoadFrame, node: HardwareNode[LoadFrameNodeSettings]
) -> DescribedMachine[Any]:
    """Connect to the machine that the file of the settings describes."""
    return open_machine(load_machine(settings.file), is_required=node.parameters.value.machine_required)


__all__ = [
    "Answer",
    "DescribedMachine",
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
    "open_described_machine",
    "open_machine",
]
