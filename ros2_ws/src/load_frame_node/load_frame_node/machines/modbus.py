"""Testing machines that speak Modbus TCP."""

from __future__ import annotations

import time
from typing import Any

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from fringedic.errors import MachineError, MachineGoneError
from load_frame_node.machines.description import ModbusDescription, Register, Switch
from load_frame_node.machines.limits import check_move
from load_frame_node.machines.machine import Link, Motion, Sample, finite

_REGISTERS = {"int16": 1, "uint16": 1, "int32": 2, "uint32": 2, "float32": 2, "float64": 4}
_LARGEST_BLOCK = 125  # registers that one Modbus request may read


class ModbusMachine:
    """Registers and coils of a machine, as its description names them.

    All that a sample needs is read in one request where its registers lie close enough together, so that force,
    position and status belong to the same moment.

    Raises
    ------
    MachineError
        The machine does not answer.
    """

    def __init__(self, description: ModbusDescription) -> None:
        self._description = description
        self._client = ModbusTcpClient(
            description.host, port=description.port, timeout=description.timeout_s, retries=0, reconnect_delay=0
        )
        self._link = Link(
            f"{description.name} at {description.host}:{description.port}", self._open, self._client.close
        )
        self._motion = Motion(1e-3 * description.motion.slowest_mm_per_s, description.motion.span_s)
        try:
            self.sample()
        except MachineError:
            self.close()
            raise

    def sample(self) -> Sample:
        """Read force, position and status.

        Raises
        ------
        MachineError
            The machine does not answer, or answers with something that is no number.
        """
        return self._link.ask("sample", self._read_sample)

    def move_to(self, position: float, speed: float) -> None:
        """Write position and speed, then start the move.

        Raises
        ------
        CrossheadRangeError
            The description's limits do not allow it.
        MachineError
            The description has no move, or the machine refuses it.
        """
        check_move(self._description, position, speed)
        move = self._description.move
        assert move is not None, "checked with the limits"

        def write() -> None:
            self._write(move.position, move.position.number(position))
            self._write(move.speed, move.speed.number(speed))
            self._switch(move.start)

        self._link.ask("move", write)

    def hold(self) -> None:
        """Write what stops the machine.

        Raises
        ------
        MachineError
            The description has no hold, or the machine does not take it.
        """
        hold = self._description.hold
        if hold is None:
            raise MachineError(f"{self._description.name}: its description has no hold; stop it at the machine")
        self._link.ask("hold", lambda: self._switch(hold))

    def close(self) -> None:
        """Disconnect."""
        self._link.close()

    def _open(self) -> None:
        if not self._client.connect():
            raise MachineGoneError("no connection")

    def _read_sample(self) -> Sample:
        description = self._description
        places: list[Register] = [description.force, description.position]
        if description.status is not None:
            places.append(description.status)
        before = time.time_ns()
        numbers = self._read(places)
        # the machine read its registers between the question and the answer
        stamp = (before + time.time_ns()) // 2
        force = finite("force", description.force.si(numbers[0]))
        position = finite("position", description.position.si(numbers[1]))
        if description.status is not None:
            return Sample(stamp, description.status.mode(int(numbers[2])), force, position)
        return Sample(stamp, self._motion.mode(stamp, position), force, position)

    def _read(self, places: list[Register]) -> list[float]:
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
            raise MachineError(f"{count} registers from {first} on asked for, {len(answer.registers)} came")
        return list(answer.registers)

    def _number(self, registers: list[int], place: Register) -> float:
        kind = self._client.DATATYPE[place.type.upper()]
        number = self._client.convert_from_registers(
            registers[: _REGISTERS[place.type]], kind, word_order=self._description.word_order
        )
        assert isinstance(number, (int, float)), "only types of numbers are described"
        return number

    def _write(self, place: Register, number: float) -> None:
        kind = self._client.DATATYPE[place.type.upper()]
        value = number if place.type.startswith("float") else round(number)
        registers = self._client.convert_to_registers(value, kind, word_order=self._description.word_order)
        self._answered(self._client.write_registers, place.register_, registers)

    def _switch(self, switch: Switch) -> None:
        if switch.coil is not None:
            self._answered(self._client.write_coil, switch.coil, bool(switch.value))
        else:
            self._answered(self._client.write_register, switch.register_, switch.value)

    def _answered(self, request: Any, *arguments: Any, **options: Any) -> Any:
        try:
            answer = request(*arguments, device_id=self._description.device, **options)
        except (ModbusException, OSError) as error:
            raise MachineGoneError(f"no answer: {error}") from error
        if answer.isError():
            raise MachineError(f"refused: {answer}")
        return answer
