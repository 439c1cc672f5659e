"""The YAML file that describes how a testing machine is spoken to: registers or commands, units and scales.

protocol: modbus
host: 192.168.1.10
force: {register: 0, unit: N}
position: {register: 2, unit: mm}
status: {register: 4, type: uint16, moving: [1], hold: [2], idle: [0], fault: [3]}
move: {position: {register: 10, unit: mm}, speed: {register: 12, unit: mm/s}, start: {coil: 0}}
hold: {coil: 1}
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from fringedic.errors import MachineFileError
from fringedic.virtual_rig import LoadMode

ForceUnit = Literal["mN", "N", "kN"]
LengthUnit = Literal["um", "mm", "m"]
SpeedUnit = Literal["um/s", "mm/s", "mm/min", "m/s"]
TimeUnit = Literal["us", "ms", "s"]

_SI = {"mN": 1e-3, "N": 1.0, "kN": 1e3, "um": 1e-6, "mm": 1e-3, "m": 1.0}
_SI |= {"us": 1e-6, "ms": 1e-3, "s": 1.0}
_SI |= {"um/s": 1e-6, "mm/s": 1e-3, "mm/min": 1e-3 / 60, "m/s": 1.0}


class Section(BaseModel):
    """Base of all sections: unknown keys, NaN and infinity are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Scaled(Section):
    """A number of the machine and what it means: SI value = (scale * number + offset) in `unit`."""

    unit: str
    scale: float = Field(1.0, description="Per count of the machine; negative where compression counts as positive.")
    offset: float = Field(0.0, description="In the unit.")

    @model_validator(mode="after")
    def _can_be_undone(self) -> Scaled:
        if self.scale == 0:
            raise ValueError("scale is 0: every value would be the same")
        return self

    def si(self, number: float) -> float:
        """SI value of a number that the machine sent."""
        return (self.scale * number + self.offset) * _SI[self.unit]

    def number(self, si: float) -> float:
        """Number to send for an SI value."""
        return (si / _SI[self.unit] - self.offset) / self.scale


class Modes(Section):
    """Which numbers or words of the status stand for which mode; what is not listed is UNKNOWN."""

    idle: list[int | str] = []
    moving: list[int | str]
    hold: list[int | str] = []
    fault: list[int | str] = []

    def mode(self, status: int | str) -> LoadMode:
        """Mode that a status stands for."""
        for mode in (LoadMode.IDLE, LoadMode.MOVING, LoadMode.HOLD, LoadMode.FAULT):
            if status in getattr(self, mode.name.lower()):
                return mode
        return LoadMode.UNKNOWN


class MotionSection(Section):
    """How to tell that a crosshead moves when the machine does not say it."""

    slowest_mm_per_s: float = Field(0.01, gt=0, description="Speed from which it counts as moving.")
    span_s: float = Field(0.2, gt=0, le=10, description="Time over which the speed is taken.")


class Limits(Section):
    """What may be asked of the machine through this file. The machine's own limits stay in charge."""

    lowest_mm: float
    highest_mm: float
    fastest_mm_per_s: float = Field(gt=0)

    @model_validator(mode="after")
    def _in_order(self) -> Limits:
        if self.highest_mm <= self.lowest_mm:
            raise ValueError(f"highest_mm {self.highest_mm:g} is not above lowest_mm {self.lowest_mm:g}")
        return self


class MachineSection(Section):
    """What every protocol has."""

    name: str = "testing machine"
    timeout_s: float = Field(0.5, gt=0, le=60, description="For one answer.")
    motion: MotionSection = MotionSection()
    limits: Limits | None = Field(None, description="Moves beyond are refused here already; needed for moves.")

    # what a protocol makes of these is its own
    status: Any = None
    move: Any = None
    hold: Any = None


NumberType = Literal["int16", "uint16", "int32", "uint32", "float32", "float64"]


class Register(Section):
    """A number in 16-bit registers."""

    register_: int = Field(alias="register", ge=0, le=65535, description="Address of its first register, from 0 on.")
    type: NumberType = "float32"
    table: Literal["input", "holding"] = "holding"


class ForceRegister(Register, Scaled):
    """Where the force stands."""

    unit: ForceUnit = "N"


class LengthRegister(Register, Scaled):
    """Where a position stands."""

    unit: LengthUnit = "mm"


class SpeedRegister(Register, Scaled):
    """Where a speed stands."""

    unit: SpeedUnit = "mm/s"


class TimeRegister(Register, Scaled):
    """Where the machine's own time of a sample stands."""

    type: NumberType = "uint32"
    unit: TimeUnit = "ms"


class StatusRegister(Register, Modes):
    """Where the machine's state stands."""

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


class ModbusMove(Section):
    """What makes the crosshead move."""

    position: LengthRegister
    speed: SpeedRegister
    start: Switch


class ModbusDescription(MachineSection):
    """A machine that speaks Modbus TCP."""

    protocol: Literal["modbus"]
    host: str
    port: int = Field(502, ge=1, le=65535)
    device: int = Field(1, ge=0, le=255, description="Number of the device behind the address.")
    word_order: Literal["big", "little"] = Field("big", description="Of numbers in several registers.")
    force: ForceRegister
    position: LengthRegister
    time: TimeRegister | None = Field(None, description="The machine's clock, to tell how it drifts.")
    status: StatusRegister | None = None
    move: ModbusMove | None = None
    hold: Switch | None = None

    @model_validator(mode="after")
    def _moves_can_be_stopped(self) -> ModbusDescription:
        _check_that_moves_can_be_stopped(self)
        return self


class Query(Scaled):
    """A question whose answer is a number."""

    query: str


class ForceQuery(Query):
    """Question for the force."""

    unit: ForceUnit = "N"


class LengthQuery(Query):
    """Question for the position."""

    unit: LengthUnit = "mm"


class TimeQuery(Query):
    """Question for the machine's own time."""

    unit: TimeUnit = "ms"


class StatusQuery(Modes):
    """Question for the machine's state."""

    query: str


class ScpiMove(Section):
    """What makes the crosshead move: commands with {position} and {speed}."""

    commands: list[str] = Field(min_length=1)
    position_unit: LengthUnit = "mm"
    speed_unit: SpeedUnit = "mm/s"

    @model_validator(mode="after")
    def _names_both(self) -> ScpiMove:
        for command in self.commands:
            try:
                command.format(position=0.0, speed=0.0)
            except (KeyError, IndexError, ValueError) as error:
                raise ValueError(f"'{command}': only {{position}} and {{speed}} can stand in braces") from error
        if "{position" not in "".join(self.commands):
            raise ValueError("no command names {position}")
        return self

    def texts(self, position: float, speed: float) -> list[str]:
        """Commands for a move to `position` [m] at `speed` [m/s]."""
        numbers = {"position": position / _SI[self.position_unit], "speed": speed / _SI[self.speed_unit]}
        return [command.format(**numbers) for command in self.commands]


class ScpiDescription(MachineSection):
    """A machine that speaks text commands (SCPI) over anything VISA reaches."""

    protocol: Literal["scpi"]
    resource: str = Field(description="VISA resource, such as TCPIP::192.168.1.10::5025::SOCKET or ASRL/dev/ttyUSB0.")
    backend: str = Field("@py", description="VISA library of PyVISA.")
    termination: str = "\n"
    start: list[str] = Field([], description="Commands after connecting.")
    force: ForceQuery
    position: LengthQuery
    time: TimeQuery | None = Field(None, description="The machine's clock, to tell how it drifts.")
    status: StatusQuery | None = None
    move: ScpiMove | None = None
    hold: list[str] = Field([], description="Commands that stop and hold.")

    @model_validator(mode="after")
    def _moves_can_be_stopped(self) -> ScpiDescription:
        _check_that_moves_can_be_stopped(self)
        return self


MachineDescription = ModbusDescription | ScpiDescription
_DESCRIPTION: TypeAdapter[MachineDescription] = TypeAdapter(
    Annotated[MachineDescription, Field(discriminator="protocol")]
)


def load_machine(path: str | os.PathLike[str]) -> MachineDescription:
    """Read and check a machine file.

    Raises
    ------
    MachineFileError
        The file cannot be read, or a key is unknown, missing or out of its range; the message names file and key.
    """
    try:
        content = yaml.safe_load(Path(path).read_text("utf-8"))
    except OSError as error:
        raise MachineFileError(f"{path}: cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise MachineFileError(f"{path}: is not YAML: {error}") from error
    try:
        return _DESCRIPTION.validate_python(content)
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(map(str, each['loc'][1:])) or 'protocol'}: {each['msg'].removeprefix('Value error, ')}"
            for each in error.errors()
        )
        raise MachineFileError(f"{path}: {problems}") from error


def _check_that_moves_can_be_stopped(description: MachineDescription) -> None:
    if description.move is not None and not description.hold:
        raise ValueError("move is given and hold is not: what can be moved has to be stopped, too")
    if description.move is not None and description.limits is None:
        raise ValueError("move is given and limits are not: say how far and how fast may be asked for")
