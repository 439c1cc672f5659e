"""Testing machines with Modbus TCP."""

from __future__ import annotations

import math
import struct
import time
from typing import Any

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from fringedic.errors import MachineError, MachineGoneError
from load_frame_node.machines.described import DescribedMachine, Reading
from load_frame_node.machines.description import ModbusDescription, Register, Switch

_REGISTERS = {"int16": 1, "uint16": 1, "int32": 2, "uint32": 2, "float32": 2, "float64": 4}
_LARGEST_BLOCK = 125  # registers that one Modbus request may read


class ModbusMachine(DescribedMachine[ModbusDescription]):
    """Machine with the registers and coils of its description.

    A sample is read in one request when its registers are close enough to each other, so that force, position and
    status belong to the same time.
    """

    def __init__(self, description: ModbusDescription) -> None:
        self._client = ModbusTcpClient(
            description.host, port=description.port, timeout=description.timeout_s, retries=0, reconnect_delay=0
        )
        super().__init__(description, f"{description.host}:{description.port}")

    def connect(self) -> None:
        """Open the socket."""
        if not self._client.connect():
            raise MachineGoneError("no connection")

    def disconnect(self) -> None:
        """Close the socket."""
        self._client.close()

    def read(self) -> Reading:
        """Read the registers; their time is the middle between request and answer."""
        description = self.description
        further = (description.status, description.time)
        places: list[Register] = [description.force, description.position]
        places += [place for place in further if place is not None]
        before = time.monotonic_ns()
        force, position, *others = self._numbers(places)
        acquired = (before + time.monotonic_ns()) // 2
        for what, place, number in (("force", places[0], force), ("position", places[1], position)):
            self.replies[what] = f"register {place.register_} contains {number:g}"
        return Reading(
            acquired,
            description.force.si(force),
            description.position.si(position),
            _status(others[0]) if description.status is not None else None,
            description.time.si(others[-1]) if description.time is not None else None,
        )

    def send_move(self, position: float, speed: float) -> None:
        """Write position and speed, then start the move."""
        move = self.description.move
        assert move is not None, "sent only when described"
        self._write(move.position, move.position.number(position))
        self._write(move.speed, move.speed.number(speed))
        self._switch(move.start)

    def send_hold(self) -> None:
        """Write the coil or register that requests a hold."""
        assert self.description.hold is not None, "sent only when described"
        self._switch(self.description.hold)

    def _numbers(self, places: list[Register]) -> list[float]:
        first = min(place.register_ for place in places)
        end = max(place.register_ + _REGISTERS[place.type] for place in places)
        if len({place.table for place in places}) == 1 and end - first <= _LARGEST_BLOCK:
            block = self._block(places[0].table, first, end - first)
            return [self._number(block[place.register_ - first :], place) for place in places]
        return [
            self._number(self._block(place.table, place.register_, _REGISTERS[place.type]), place) for place in places
        ]

    def _block(self, table: str, first: int, count: int) -> list[int]:
        read = self._client.read_input_registers if table == "input" else self._client.read_holding_registers
        answer = self._answered(read, first, count=count)
        if len(answer.registers) != count:
            raise MachineError(
                f"{count} registers from {first} on were requested, {len(answer.registers)} were received"
            )
        return list(answer.registers)

    def _number(self, registers: list[int], place: Register) -> float:
        kind = self._client.DATATYPE[place.type.upper()]
        number = self._client.convert_from_registers(
            registers[: _REGISTERS[place.type]], kind, word_order=self.description.word_order
        )
        assert isinstance(number, (int, float)), "every described type is a number"
        return number

    def _write(self, place: Register, number: float) -> None:
        kind = self._client.DATATYPE[place.type.upper()]
        value = number if place.type.startswith("float") else round(number)
        try:
            registers = self._client.convert_to_registers(value, kind, word_order=self.description.word_order)
        except (struct.error, OverflowError, ValueError) as error:
            raise MachineError(f"{value:g} does not fit register {place.register_} of type {place.type}") from error
        self._answered(self._client.write_registers, place.register_, registers)

    def _switch(self, switch: Switch) -> None:
        if switch.coil is not None:
            self._answered(self._client.write_coil, switch.coil, bool(switch.value))
        else:
            self._answered(self._client.write_register, switch.register_, switch.value)

    def _answered(self, request: Any, *arguments: Any, **options: Any) -> Any:
        try:
            answer = request(*arguments, device_id=self.description.device, **options)
        except (ModbusException, OSError) as error:
            raise MachineGoneError(f"no answer: {error}") from error
        if answer.isError():
            raise MachineError(f"refused: {answer}")
        return answer


def _status(number: float) -> int:
    if not math.isfinite(number) or number != math.floor(number):
        raise MachineError(f"the status is {number}, which is not a whole number")
    return int(number)
