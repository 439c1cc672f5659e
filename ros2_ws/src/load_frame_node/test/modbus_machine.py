"""A testing machine with Modbus TCP, as a process: pymodbus's server before the simulated load frame.

Registers, as the machine file of the tests names them: 0 force [N], 2 position [mm], 4 status, 5 the same as bits (0
idle, 1 moving, 2 hold, 3 fault, 7 always set), 6 time since the start [ms] by a clock that is 1 % too fast, 10 target
[mm], 12 speed [mm/s]; coils: 0 starts a move, 1 holds, 2 breaks the load cell, 3 reports a fault, 4 makes it accept
holds without following them. With a second argument the bytes of every register are swapped.
"""

from __future__ import annotations

import asyncio
import math
import struct
import sys
import time

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from fringedic.errors import CrossheadRangeError
from fringedic.virtual_rig import SimulatedLoadFrame, VirtualRigConfiguration
from load_frame_node.machines import LoadMode, SimulatedMachine

STATUS = {LoadMode.IDLE: 0, LoadMode.MOVING: 11, LoadMode.HOLD: 12}
READ_HOLDING, WRITE_COIL = 3, 5


class Registers:
    def __init__(self, *, are_swapped: bool) -> None:
        self.are_swapped = are_swapped
        configuration = VirtualRigConfiguration.from_dict({"preset": "plate"})
        self.machine = SimulatedMachine(SimulatedLoadFrame(configuration.load_frame, seed=1))
        self.holding: list[int] = []
        self.broken = self.fault = self.deaf = False
        self.started = time.monotonic()

    async def access(
        self,
        function: int,
        start: int,  # noqa: ARG002 (the signature of pymodbus)
        address: int,
        count: int,  # noqa: ARG002
        current: list[int],
        new: list | None,
    ) -> ExcCodes | None:
        if function == READ_HOLDING:
            self.holding = current
            sample = self.machine.sample()
            current[0:2] = words(math.nan if self.broken else sample.force)
            current[2:4] = words(1e3 * sample.position)
            current[4] = 99 if self.fault else STATUS[sample.mode]
            passed = round(1.01e3 * (time.monotonic() - self.started))
            bits = {LoadMode.IDLE: 1, LoadMode.MOVING: 2, LoadMode.HOLD: 4}[sample.mode]
            current[5] = bits | self.fault << 3 | 0x80
            current[6:8] = [passed >> 16, passed & 0xFFFF]
            if self.are_swapped:
                current[0:8] = [swapped(each) for each in current[0:8]]
        elif function == WRITE_COIL and new:
            return self.switch(address, bool(new[0]))
        elif new and address >= 10:
            self.holding = current
        return None

    def switch(self, coil: int, on: bool) -> ExcCodes | None:
        if coil == 0 and on:
            written = [swapped(each) for each in self.holding] if self.are_swapped else self.holding
            try:
                self.machine.move_to(1e-3 * number(written[10:12]), 1e-3 * number(written[12:14]))
            except CrossheadRangeError:
                return ExcCodes.ILLEGAL_VALUE
        elif coil == 1 and on and not self.deaf:
            self.machine.hold()
        elif coil == 2:
            self.broken = on
        elif coil == 3:
            self.fault = on
        elif coil == 4:
            self.deaf = on
        return None


def words(value: float) -> list[int]:
    return list(struct.unpack(">HH", struct.pack(">f", value)))


def number(registers: list[int]) -> float:
    return float(struct.unpack(">f", struct.pack(">HH", *registers))[0])


def swapped(register: int) -> int:
    return int.from_bytes(register.to_bytes(2, "big"), "little")


async def serve(port: int, *, are_swapped: bool) -> None:
    registers = Registers(are_swapped=are_swapped)
    bits = [SimData(0, values=[False] * 16, datatype=DataType.BITS)]
    numbers = [SimData(0, count=32, values=0, datatype=DataType.REGISTERS)]
    device = SimDevice(1, (bits, bits, numbers, numbers), action=registers.access)
    server = ModbusTcpServer(device, address=("127.0.0.1", port))
    await server.listen()
    sys.stdout.write(f"{server.transport.sockets[0].getsockname()[1]}\n")
    sys.stdout.flush()
    await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(serve(int(sys.argv[1]), are_swapped=len(sys.argv) > 2))
