"""Testing machines with Modbus TCP."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from itertools import product
from typing import Any, Literal, get_args

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from fringedic.errors import MachineError, MachineGoneError
from load_frame_node.machines.described import Answer, DescribedMachine
from load_frame_node.machines.description import (
    ForceRegister,
    LengthRegister,
    ModbusDescription,
    Register,
    SignalRegister,
    SpeedRegister,
    StatusRegister,
    Switch,
    TimeRegister,
)
from load_frame_node.machines.machine import LoadMode

_REGISTERS = {"int16": 1, "uint16": 1, "int32": 2, "uint32": 2, "float32": 2, "float64": 4}
_LARGEST_BLOCK = 125  # registers that one Modbus request may read
_SENSIBLE = (1e-9, 1e9)  # amounts of a floating-point number other than 0; wrong orders give most often others

Order = Literal["big", "little"]
ReadRegister = ForceRegister | LengthRegister | TimeRegister | StatusRegister | SignalRegister


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

    def answers(self) -> Iterator[Answer]:
        """Read the registers, in one request when they are close enough."""
        entries = self.description.entries()
        for (name, place), registers in zip(entries, self._read([place for _, place in entries]), strict=True):
            yield self._answer(name, place, registers)

    def single_answers(self) -> Iterator[Answer]:
        """Read the registers of each entry in a request of their own."""
        for name, place in self.description.entries():
            try:
                [registers] = self._read([place])
                answer = self._answer(name, place, registers)
            except MachineGoneError as error:
                yield Answer(name, _request(place), "", None, error)
            except MachineError as error:
                cure = f"check register (counted from 0), type and table of {name}, and device"
                yield Answer(name, _request(place), "", None, MachineError(f"{name}: {error}; {cure}"))
            else:
                yield answer._replace(error=answer.error or self._other_order(name, place, registers))

    def _other_order(self, name: str, place: Register, registers: list[int]) -> MachineError | None:
        """Return which order of registers and bytes would make sense of a number that makes none."""
        present = self.description.word_order, self.description.byte_order
        if _makes_sense(_decoded(registers, place, *present), place):
            return None
        for words, octets in product(get_args(Order), repeat=2):
            number = _decoded(registers, place, words, octets)
            if _makes_sense(number, place):
                return MachineError(
                    f"{name}: {_decoded(registers, place, *present):g} makes no sense; with word_order: {words} and "
                    f"byte_order: {octets} it would be {number:g}"
                )
        return None

    def move_requests(self, position: float, speed: float) -> list[str]:
        """Return the registers and the coil that a move writes."""
        move = self.description.move
        assert move is not None, "asked for only when described"
        numbers = ((move.position, position), (move.speed, speed))
        written = [f"register {place.register_} = {_sent(place, si):g}" for place, si in numbers]
        return [*written, _switched(move.start)]

    def hold_requests(self) -> list[str]:
        """Return the coil or register that requests a hold."""
        return [] if self.description.hold is None else [_switched(self.description.hold)]

    def send_move(self, position: float, speed: float) -> None:
        """Write position and speed, then start the move."""
        move = self.description.move
        assert move is not None, "sent only when described"
        self._write(move.position, position)
        self._write(move.speed, speed)
        self._switch(move.start)

    def send_hold(self) -> None:
        """Write the coil or register that requests a hold."""
        assert self.description.hold is not None, "sent only when described"
        self._switch(self.description.hold)

    def _answer(self, name: str, place: ReadRegister, registers: list[int]) -> Answer:
        """Return the meaning of the registers of an entry."""
        number = self._number(registers, place)
        request, raw = _request(place), _raw(registers)
        self.replies[name] = f"register {place.register_} contains {number:g}"
        if not isinstance(place, StatusRegister):
            return Answer(name, request, raw, place.si(number))
        if not math.isfinite(number) or number != math.floor(number):
            error = MachineError(f"the status is {number}, which is not a whole number")
            return Answer(name, request, raw, None, error)
        return Answer(name, request, raw, int(number))

    def _read(self, places: list[Register]) -> list[list[int]]:
        """Return the registers of each place."""
        first = min(place.register_ for place in places)
        end = max(place.register_ + _REGISTERS[place.type] for place in places)
        if len({place.table for place in places}) == 1 and end - first <= _LARGEST_BLOCK:
            block = self._block(places[0].table, first, end - first)
            return [block[place.register_ - first :][: _REGISTERS[place.type]] for place in places]
        return [self._block(place.table, place.register_, _REGISTERS[place.type]) for place in places]

    def _block(self, table: str, first: int, count: int) -> list[int]:
        read = self._client.read_input_registers if table == "input" else self._client.read_holding_registers
        answer = self._answered(read, first, count=count)
        if len(answer.registers) != count:
            raise MachineError(
                f"{count} registers from {first} on were requested, {len(answer.registers)} were received"
            )
        return list(answer.registers)

    def _number(self, registers: list[int], place: Register) -> float:
        order = self.description
        return _decoded(registers, place, order.word_order, order.byte_order)

    def _write(self, place: LengthRegister | SpeedRegister, si: float) -> None:
        value = _sent(place, si)
        try:
            registers = ModbusTcpClient.convert_to_registers(
                value, _kind(place), word_order=self.description.word_order
            )
        except (struct.error, OverflowError, ValueError) as error:
            raise MachineError(f"{value:g} does not fit register {place.register_} of type {place.type}") from error
        self._answered(self._client.write_registers, place.register_, self._ordered(registers))

    def _ordered(self, registers: list[int]) -> list[int]:
        return _in_byte_order(registers, self.description.byte_order)

    def _switch(self, switch: Switch) -> None:
        if switch.coil is not None:
            self._answered(self._client.write_coil, switch.coil, bool(switch.value))
        else:
            self._answered(self._client.write_register, switch.register_, *self._ordered([switch.value]))

    def _answered(self, request: Any, *arguments: Any, **options: Any) -> Any:
        try:
            answer = request(*arguments, device_id=self.description.device, **options)
        except (ModbusException, OSError) as error:
            raise MachineGoneError(f"no answer: {error}") from error
        if answer.isError():
            raise MachineError(f"refused: {answer}")
        return answer


def _kind(place: Register) -> Any:
    return ModbusTcpClient.DATATYPE[place.type.upper()]


def _in_byte_order(registers: list[int], order: Order) -> list[int]:
    return registers if order == "big" else [(each & 0xFF) << 8 | each >> 8 for each in registers]


def _decoded(registers: list[int], place: Register, words: Order, octets: Order) -> float:
    number = ModbusTcpClient.convert_from_registers(_in_byte_order(registers, octets), _kind(place), word_order=words)
    assert isinstance(number, (int, float)), "every described type is a number"
    return number


def _makes_sense(number: float, place: Register) -> bool:
    """Return whether a number can be meant: a status that is listed, or a float of a usual amount."""
    if isinstance(place, StatusRegister):
        return math.isfinite(number) and place.mode(int(number)) is not LoadMode.UNKNOWN
    return not place.type.startswith("float") or number == 0 or _SENSIBLE[0] < abs(number) < _SENSIBLE[1]


def _sent(place: LengthRegister | SpeedRegister, si: float) -> float:
    number = place.number(si)
    return number if place.type.startswith("float") else round(number)


def _request(place: Register) -> str:
    last = place.register_ + _REGISTERS[place.type] - 1
    places = f"{place.register_}" if last == place.register_ else f"{place.register_} to {last}"
    return f"{place.table} {places}, {place.type}"


def _raw(registers: list[int]) -> str:
    return " ".join(f"0x{each:04X}" for each in registers)


def _switched(switch: Switch) -> str:
    """Return what a switch writes, for people."""
    place = f"register {switch.register_}" if switch.coil is None else f"coil {switch.coil}"
    return f"{place} = {switch.value if switch.coil is None else int(bool(switch.value))}"
