"""YAML file that describes the interface of a testing machine: registers or commands, units and scales.

protocol: modbus
host: 192.168.1.10
force: {register: 0, unit: N}
position: {register: 2, unit: mm}
status: {register: 4, type: uint16, moving: [1], hold: [2], idle: [0], fault: [3]}
move: {position: {register: 10, unit: mm}, speed: {register: 12, unit: mm/s}, start: {coil: 0}}
hold: {coil: 1}
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, get_args

import yaml
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StrictStr,
    TypeAdapter,
    ValidationError,
    field_validator,
    model_validator,
)

from fringedic.errors import ConfigurationError
from fringedic.settings.signals import SignalName
from fringedic.signals import Channel
from fringedic.signals.units import Unit, find_unit, known_units
from fringedic.wording.yaml_text import load_yaml
from load_frame_node.machines.machine import FARTHEST_M, LARGEST_FORCE_N, LoadMode

ForceUnit = Literal["mN", "N", "kN"]
LengthUnit = Literal["um", "mm", "m"]
SpeedUnit = Literal["um/s", "mm/s", "mm/min", "m/s"]
TimeUnit = Literal["us", "ms", "s"]

_SI = {"mN": 1e-3, "N": 1.0, "kN": 1e3, "um": 1e-6, "mm": 1e-3, "m": 1.0}
_SI |= {"us": 1e-6, "ms": 1e-3, "s": 1.0}
_SI |= {"um/s": 1e-6, "mm/s": 1e-3, "mm/min": 1e-3 / 60, "m/s": 1.0}
_NO_NUMBER = 9.9e37  # of SCPI: 9.91E37 is not a number, 9.9E37 an overload
DescriptionT = TypeVar("DescriptionT")

_BEYOND_LIMITS_MM = 2000.0  # a crosshead is parked outside the range of a test, but not further than its frame is high


_SHOWN = 40  # characters of a status that a message repeats


class Section(BaseModel):
    """Base of all sections: unknown keys, NaN and infinity are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Scaled(Section):
    """A number of the machine and its meaning: value = (scale * number + offset) in `unit`."""

    unit: str
    scale: float = Field(1.0, description="Per count of the machine; negative where compression counts as positive.")
    offset: float = Field(0.0, description="In the unit.")

    @model_validator(mode="after")
    def _can_be_undone(self) -> Scaled:
        if self.scale == 0:
            raise ValueError("scale is 0: every value would be the same")
        return self

    def si(self, number: float, unit: str | None = None) -> float:
        """Return the SI value of a number received from the machine, in `unit` if the machine has named one."""
        if unit is not None:
            number *= _SI[unit] / _SI[self.unit]
        return (self.scale * number + self.offset) * _SI[self.unit]

    def number(self, si: float) -> float:
        """Return the number to send for an SI value."""
        return (si / _SI[self.unit] - self.offset) / self.scale

    @property
    def units(self) -> tuple[str, ...]:
        """The units that the value may have."""
        return get_args(type(self).model_fields["unit"].annotation)


class MachineSignal(Scaled):
    """A number of a further signal and its meaning, in any known unit."""

    sigma: float | None = Field(None, ge=0, description="Standard uncertainty in the unit; by default not known.")
    positive: str = Field("", description="Direction or state of positive values.")

    @field_validator("unit")
    @classmethod
    def _unit_is_known(cls, unit: str) -> str:
        if find_unit(unit) is None:
            raise ValueError(f"the unit '{unit}' is not known; write one such as {known_units()}")
        return unit

    @property
    def _unit(self) -> Unit:
        unit = find_unit(self.unit)
        assert unit is not None, "checked above"
        return unit

    def si(self, number: float, unit: str | None = None) -> float:
        """Return the SI value of a number received from the machine, NaN for one that states that nothing is measured.

        A unit that it has named is that of the file.
        """
        assert unit in (None, self.unit), "others are refused before"
        if abs(number) >= _NO_NUMBER:
            return math.nan
        return self._unit.factor * (self.scale * number + self.offset) + self._unit.zero

    @property
    def units(self) -> tuple[str, ...]:
        """The unit that a reply may name."""
        return (self.unit,)

    @property
    def sigma_si(self) -> float:
        """Standard uncertainty in the SI unit, NaN if it is not known."""
        return math.nan if self.sigma is None else self._unit.factor * self.sigma

    def channel(self, name: str, source: str) -> Channel:
        """Return the channel of the signal."""
        return Channel(name, self._unit.quantity, self._unit.si, self.positive, source)


SIGNAL = "signals."
"""Begin of the name of the entry of a further signal."""
BitNumbers = list[Annotated[int, Field(ge=0, le=63)]]


class Bits(Section):
    """Bits of a status that is a number, counted from 0 for the lowest; the others may have any value."""

    bits_set: BitNumbers = []
    bits_clear: BitNumbers = []

    @model_validator(mode="after")
    def _can_be_met(self) -> Bits:
        if not self.bits_set and not self.bits_clear:
            raise ValueError("every status has no bits; give bits_set or bits_clear")
        both = set(self.bits_set) & set(self.bits_clear)
        if both:
            raise ValueError(f"bit {min(both)} is in bits_set and in bits_clear")
        return self

    def match(self, status: int | str) -> bool:
        """Return whether a status has these bits."""
        if isinstance(status, str):
            return False
        return all(status >> bit & 1 for bit in self.bits_set) and not any(status >> bit & 1 for bit in self.bits_clear)


StatusValue = Bits | int | str


class Modes(Section):
    """Status values of each mode: numbers, words or bits; every other status is UNKNOWN."""

    idle: list[StatusValue] = []
    moving: list[StatusValue]
    hold: list[StatusValue] = []
    fault: list[StatusValue] = []

    def mode(self, status: int | str) -> LoadMode:
        """Return the mode of a status; with bits of several modes a fault comes first, then a motion."""
        for mode in (LoadMode.FAULT, LoadMode.MOVING, LoadMode.HOLD, LoadMode.IDLE):
            for each in getattr(self, mode.name.lower()):
                if each.match(status) if isinstance(each, Bits) else status == each:
                    return mode
        return LoadMode.UNKNOWN

    def unlisted(self, status: int | str) -> str:
        """Return what to do about a status that is in no list."""
        shown = repr(status[:_SHOWN] if isinstance(status, str) else status)
        for name in ("idle", "moving", "hold", "fault"):
            for each in getattr(self, name):
                if isinstance(each, str) and isinstance(status, str) and each.casefold() == status.casefold():
                    return f"status: {shown} is in no list of status, and {name} has {each!r}: write {shown} in {name}"
        return f"status: {shown} is in no list of status: add it to idle, moving, hold or fault"


class MotionSection(Section):
    """How motion of the crosshead is recognised when the machine does not report it."""

    slowest_mm_per_s: float = Field(0.01, gt=0, description="Speed above which the crosshead counts as moving.")
    span_s: float = Field(0.2, gt=0, le=10, description="Time over which the speed is determined.")


class Limits(Section):
    """Range of the requests sent to the machine. The limits of the machine itself remain decisive."""

    lowest_mm: float
    highest_mm: float
    fastest_mm_per_s: float = Field(gt=0)

    @model_validator(mode="after")
    def _in_order(self) -> Limits:
        if self.highest_mm <= self.lowest_mm:
            raise ValueError(f"highest_mm {self.highest_mm:g} is not above lowest_mm {self.lowest_mm:g}")
        return self


class Bounds(NamedTuple):
    """Values that a machine can show; one outside is not known.

    Attributes
    ----------
    lowest, highest
        In SI units.
    words
        The bounds with their origin, for messages.
    """

    lowest: float
    highest: float
    words: str

    def contain(self, value: float) -> bool:
        """Return whether the machine can show a value."""
        return self.lowest <= value <= self.highest


class MachineSection(Section):
    """Keys of every protocol."""

    name: str = "testing machine"
    timeout_s: float = Field(0.5, gt=0, le=60, description="Longest wait for one answer.")
    motion: MotionSection = MotionSection()
    limits: Limits | None = Field(
        None, description="Moves beyond them are not sent to the machine; required for moves."
    )
    force_range_n: tuple[float, float] | None = Field(
        None, description="Smallest and largest force of the load cell [N]; a value outside is not known."
    )

    @model_validator(mode="after")
    def _force_range_is_in_order(self) -> MachineSection:
        if self.force_range_n is not None and self.force_range_n[0] >= self.force_range_n[1]:
            raise ValueError(f"force_range_n {list(self.force_range_n)}: give the smaller force first")
        return self

    @property
    def force_bounds(self) -> Bounds:
        """Forces that the machine can show [N]."""
        lowest, highest = self.force_range_n or (-LARGEST_FORCE_N, LARGEST_FORCE_N)
        origin = "force_range_n" if self.force_range_n else "no testing machine shows more; give force_range_n"
        return Bounds(lowest, highest, f"{lowest:g} to {highest:g} N ({origin})")

    @property
    def position_bounds(self) -> Bounds:
        """Positions that the crosshead can have [m]: the range of the requests and 2 m on either side."""
        lowest, highest, origin = -1e3 * FARTHEST_M, 1e3 * FARTHEST_M, "no crosshead is farther; give limits"
        if self.limits is not None:
            lowest, highest = self.limits.lowest_mm - _BEYOND_LIMITS_MM, self.limits.highest_mm + _BEYOND_LIMITS_MM
            origin = f"limits and {_BEYOND_LIMITS_MM:g} mm on either side"
        return Bounds(1e-3 * lowest, 1e-3 * highest, f"{lowest:g} to {highest:g} mm ({origin})")

    # each protocol declares these with its own type
    status: Any = None
    move: Any = None
    hold: Any = None

    signals: Mapping[str, Any] = {}

    def entries(self) -> list[tuple[str, Any]]:
        """Return name and section of each value that is read, in the order of reading."""
        named = [(name, getattr(self, name)) for name in ("force", "position", "status", "time")]
        named += [(f"{SIGNAL}{name}", entry) for name, entry in self.signals.items()]
        return [(name, entry) for name, entry in named if entry is not None]


NumberType = Literal["int16", "uint16", "int32", "uint32", "float32", "float64"]


class Register(Section):
    """A number in 16-bit registers."""

    register_: int = Field(alias="register", ge=0, le=65535, description="Address of its first register, from 0 on.")
    type: NumberType = "float32"
    table: Literal["input", "holding"] = "holding"


class ForceRegister(Register, Scaled):
    """Register of the force."""

    unit: ForceUnit = "N"


class LengthRegister(Register, Scaled):
    """Register of a position."""

    unit: LengthUnit = "mm"


class SpeedRegister(Register, Scaled):
    """Register of a speed."""

    unit: SpeedUnit = "mm/s"


class TimeRegister(Register, Scaled):
    """Register of the time of a sample on the clock of the machine."""

    type: NumberType = "uint32"
    unit: TimeUnit = "ms"


class StatusRegister(Register, Modes):
    """Register of the state of the machine."""

    type: NumberType = "uint16"


class Switch(Section):
    """A coil that is set, or a register that a number is written to."""

    coil: int | None = Field(None, ge=0, le=65535)
    register_: int | None = Field(None, alias="register", ge=0, le=65535)
    value: int = Field(1, ge=0, le=65535)

    @model_validator(mode="after")
    def _one_of_both(self) -> Switch:
        if (self.coil is None) == (self.register_ is None):
            raise ValueError("give either coil or register")
        return self


class SignalRegister(Register, MachineSignal):
    """Register of a further signal."""


class ModbusMove(Section):
    """Registers that start a move."""

    position: LengthRegister
    speed: SpeedRegister
    start: Switch


class ModbusDescription(MachineSection):
    """A machine with Modbus TCP."""

    protocol: Literal["modbus"]
    host: str
    port: int = Field(502, ge=1, le=65535)
    device: int = Field(1, ge=0, le=255, description="Unit identifier of the device at this address.")
    word_order: Literal["big", "little"] = Field("big", description="Order of the registers of one number.")
    byte_order: Literal["big", "little"] = Field("big", description="Order of the two bytes in every register.")
    force: ForceRegister
    position: LengthRegister
    time: TimeRegister | None = Field(None, description="Clock of the machine; its drift is reported.")
    status: StatusRegister | None = None
    signals: dict[SignalName, SignalRegister] = Field({}, description="Further signals by their names.")
    move: ModbusMove | None = None
    hold: Switch | None = None

    @model_validator(mode="after")
    def _moves_can_be_stopped(self) -> ModbusDescription:
        _check_that_moves_can_be_stopped(self)
        return self

    @model_validator(mode="after")
    def _slowest_motion_changes_the_position(self) -> ModbusDescription:
        if self.status is None and self.position is not None and not self.position.type.startswith("float"):
            count, motion = 1e3 * abs(self.position.scale) * _SI[self.position.unit], self.motion
            if count > motion.slowest_mm_per_s * motion.span_s:
                raise ValueError(
                    f"one count of the position is {count:g} mm, and a motion of {motion.slowest_mm_per_s:g} mm/s "
                    f"would look like a hold within {motion.span_s:g} s; add status, or increase motion.span_s or "
                    "motion.slowest_mm_per_s"
                )
        return self


class Query(Section):
    """A query and the place of the value in its reply."""

    query: str
    separator: str | None = Field(
        None, min_length=1, description="Between several values of one reply; a blank stands for any number of them."
    )
    index: int = Field(0, ge=0, le=255, description="Of the value among them, from 0.")

    @model_validator(mode="after")
    def _has_a_place(self) -> Query:
        if self.index and self.separator is None:
            raise ValueError(f"index {self.index} needs separator: the text between the values of a reply")
        return self


class NumberQuery(Query, Scaled):
    """A query whose reply is a number, with or without a unit."""

    decimal: Literal[".", ","] = Field(".", description="Decimal sign of the reply.")

    @model_validator(mode="after")
    def _signs_differ(self) -> NumberQuery:
        if self.separator == self.decimal:
            raise ValueError(f"separator and decimal are both '{self.decimal}'")
        return self


class ForceQuery(NumberQuery):
    """Query of the force."""

    unit: ForceUnit = "N"


class LengthQuery(NumberQuery):
    """Query of the position."""

    unit: LengthUnit = "mm"


class SignalQuery(NumberQuery, MachineSignal):
    """Query of a further signal."""


class TimeQuery(NumberQuery):
    """Query of the time on the clock of the machine."""

    unit: TimeUnit = "ms"


class StatusQuery(Query, Modes):
    """Query of the state of the machine."""


class ScpiMove(Section):
    """Commands that start a move, with {position} and {speed}."""

    commands: list[str] = Field(min_length=1)
    position_unit: LengthUnit = "mm"
    speed_unit: SpeedUnit = "mm/s"

    @model_validator(mode="after")
    def _names_both(self) -> ScpiMove:
        for command in self.commands:
            try:
                command.format(position=0.0, speed=0.0)
            except (KeyError, IndexError, ValueError) as error:
                raise ValueError(f"'{command}': only {{position}} and {{speed}} are allowed in braces") from error
        if "{position" not in "".join(self.commands):
            raise ValueError("no command contains {position}")
        return self

    def texts(self, position: float, speed: float) -> list[str]:
        """Return the commands for a move to `position` [m] at `speed` [m/s]."""
        numbers = {"position": position / _SI[self.position_unit], "speed": speed / _SI[self.speed_unit]}
        return [command.format(**numbers) for command in self.commands]


class SerialSection(Section):
    """Settings of a serial line, named as in PyVISA."""

    baud_rate: int = Field(9600, ge=50, le=4_000_000)
    data_bits: Literal[5, 6, 7, 8] = 8
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: float = 1
    flow_control: Literal["none", "xon_xoff", "rts_cts", "dtr_dsr"] = Field("none", description="Handshake.")

    @model_validator(mode="after")
    def _stop_bits_exist(self) -> SerialSection:
        if self.stop_bits not in (1, 1.5, 2):
            raise ValueError(f"stop_bits is {self.stop_bits:g}; give 1, 1.5 or 2")
        return self


def _as_text(value: Any) -> Any:
    """Return a number of the file as text, since a reply is a text: `acknowledge: 0`; false is none."""
    if isinstance(value, bool):
        return value or None
    return str(value) if isinstance(value, int) else value


class ScpiDescription(MachineSection):
    """A machine with text commands (SCPI) over a VISA resource."""

    protocol: Literal["scpi"]
    resource: str = Field(description="VISA resource, such as TCPIP::192.168.1.10::5025::SOCKET or ASRL/dev/ttyUSB0.")
    backend: str = Field("@py", description="VISA library of PyVISA.")
    serial: SerialSection | None = Field(None, description="Of a serial line (resource ASRL...).")
    termination: str = Field("\n", min_length=1, description="End of requests and replies.")
    read_termination: str | None = Field(None, min_length=1, description="End of replies, if it differs.")
    write_termination: str | None = Field(None, min_length=1, description="End of requests, if it differs.")
    echo: bool = Field(False, description="The machine repeats each request before it answers.")
    acknowledge: Annotated[Literal[True] | StrictStr | None, BeforeValidator(_as_text)] = Field(
        None, description="The machine answers each command with this text; true: with any line."
    )
    start: list[str] = Field([], description="Commands sent after connecting.")
    force: ForceQuery
    position: LengthQuery
    time: TimeQuery | None = Field(None, description="Clock of the machine; its drift is reported.")
    status: StatusQuery | None = None
    signals: dict[SignalName, SignalQuery] = Field({}, description="Further signals by their names.")
    move: ScpiMove | None = None
    hold: list[str] = Field([], description="Commands that request a hold.")

    @property
    def is_serial(self) -> bool:
        """Whether the resource is a serial line."""
        return self.resource.upper().startswith("ASRL")

    @property
    def end_of_reply(self) -> str:
        """The text after which a reply is complete."""
        return self.read_termination or self.termination

    @property
    def end_of_request(self) -> str:
        """The text after which the machine answers."""
        return self.write_termination or self.termination

    @model_validator(mode="after")
    def _serial_settings_have_a_line(self) -> ScpiDescription:
        if self.serial is not None and not self.is_serial:
            raise ValueError(
                f"serial belongs to a serial line (ASRL...), and the resource is {self.resource}; leave serial out"
            )
        return self

    @model_validator(mode="after")
    def _replies_have_an_end(self) -> ScpiDescription:
        end = self.end_of_reply
        if end[-1] in end[:-1]:
            raise ValueError(f"read_termination {end!r} contains its last character twice; give a shorter one")
        return self

    @model_validator(mode="after")
    def _moves_can_be_stopped(self) -> ScpiDescription:
        _check_that_moves_can_be_stopped(self)
        return self


MachineDescription = ModbusDescription | ScpiDescription
_DESCRIPTION: TypeAdapter[MachineDescription] = TypeAdapter(
    Annotated[MachineDescription, Field(discriminator="protocol")]
)


class ModbusInstrument(ModbusDescription):
    """An instrument with Modbus TCP, which has signals and is no testing machine."""

    force: None = None  # type: ignore[assignment]
    position: None = None  # type: ignore[assignment]
    signals: dict[SignalName, SignalRegister] = Field(min_length=1)


class ScpiInstrument(ScpiDescription):
    """An instrument with text commands (SCPI), which has signals and is no testing machine."""

    force: None = None  # type: ignore[assignment]
    position: None = None  # type: ignore[assignment]
    signals: dict[SignalName, SignalQuery] = Field(min_length=1)


InstrumentDescription = ModbusInstrument | ScpiInstrument
_INSTRUMENT: TypeAdapter[InstrumentDescription] = TypeAdapter(
    Annotated[InstrumentDescription, Field(discriminator="protocol")]
)


def load_instrument(path: str | os.PathLike[str]) -> InstrumentDescription:
    """Read and check the file of an instrument: a machine file with signals, without force and position.

    Raises
    ------
    ConfigurationError
        As of `load_machine`.
    """
    return _load(path, _INSTRUMENT)


def load_machine(path: str | os.PathLike[str]) -> MachineDescription:
    """Read and check a machine file.

    Raises
    ------
    ConfigurationError
        The file cannot be read, or a key is unknown, missing or out of range; the message names file and key.
    """
    return _load(path, _DESCRIPTION)


def _load(path: str | os.PathLike[str], kinds: TypeAdapter[DescriptionT]) -> DescriptionT:
    try:
        content = load_yaml(Path(path).read_text("utf-8"))
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path}: is not YAML: {error}") from error
    try:
        return kinds.validate_python(content)
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(map(str, each['loc'][1:])) or 'protocol'}: {each['msg'].removeprefix('Value error, ')}"
            for each in error.errors()
        )
        raise ConfigurationError(f"{path}: {problems}") from error


def _check_that_moves_can_be_stopped(description: MachineDescription) -> None:
    if description.move is not None and not description.hold:
        raise ValueError("move is given without hold: a machine that can be moved must also be stopped; add hold")
    if description.move is not None and description.limits is None:
        raise ValueError("move is given without limits; add limits with lowest_mm, highest_mm and fastest_mm_per_s")
