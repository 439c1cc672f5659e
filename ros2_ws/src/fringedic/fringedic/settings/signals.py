"""Settings of further signals of a rig: one model for each source, those of the signals node."""

from __future__ import annotations

import re
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, SerializeAsAny, StringConstraints, TypeAdapter, model_validator

from fringedic.settings.base import OR_EMPTY, FilePath, HardwareNodeSettings, Settings
from fringedic.settings.devices import Devices, DeviceSettings
from fringedic.signals import Channel, Scaling

_FEWEST_OF_REQUIRED_HZ = 2.0  # the experiment node accepts gaps of 1 s
_FIELD = re.compile(r"[A-Za-z]\w*(\[\d+\])?(\.[A-Za-z]\w*(\[\d+\])?)*")


class SignalSettings(DeviceSettings):
    """Settings of every source of signals."""

    elsewhere: ClassVar[str] = "see the sources of signals"

    source: str = Field(
        "topic",
        description="topic: a number in the messages of a ROS topic; serial: a serial line that prints numbers; "
        "instrument: registers or queries that a file describes; or the name of an installed driver.",
    )
    rate_hz: float = Field(10.0, gt=0, le=100_000, description="Expected readings per second [Hz].")
    silent_after_s: float = Field(
        1.5, gt=0, le=3600, description="Time without a reading after which the source is reported as silent [s]."
    )
    required: bool = Field(
        False, description="A step fails unless readings cover its exposures; otherwise a silent source is reported."
    )

    @model_validator(mode="after")
    def _readings_come_in_time(self) -> Self:
        if self.silent_after_s * self.rate_hz < 1:
            raise ValueError(
                f"silent_after_s {self.silent_after_s:g} is shorter than the time between two readings at rate_hz "
                f"{self.rate_hz:g}; increase one of them"
            )
        if self.required and self.rate_hz < _FEWEST_OF_REQUIRED_HZ:
            raise ValueError(f"required: true needs a rate_hz of {_FEWEST_OF_REQUIRED_HZ:g} or more")
        return self

    def channel(self, name: str) -> Channel:
        """Return the channel of the signal."""
        raise NotImplementedError


class ScaledSignal(SignalSettings):
    """Settings of a source of one number, with the calibration of its sensor."""

    unit: str = Field(description="Unit of a reading, such as degC, mV or kN; 1 without one.")
    scale: float | str = Field(
        1.0, description="Value per reading, a number or with uncertainty and unit: 12.5 +- 0.02 N/V."
    )
    offset: float | str = Field(
        0.0, description="Is added after the scale, a number or with uncertainty, in the unit of the value."
    )
    sigma: float | None = Field(
        None, ge=0, description="Standard uncertainty of a reading in its unit; by default it is not known."
    )
    quantity: str = Field("", description="What is measured; by default that of the unit.")
    positive: str = Field("", description="Direction or state of positive values, such as tension.")

    @model_validator(mode="after")
    def _calibration_is_complete(self) -> Self:
        self.scaling()
        return self

    def scaling(self) -> Scaling:
        """Return the calibration of the sensor."""
        return Scaling.of(self.unit, self.scale, self.offset, self.sigma)

    def channel(self, name: str) -> Channel:
        """Return the channel of the signal."""
        unit = self.scaling().unit
        return Channel(name, self.quantity or unit.quantity, unit.si, self.positive, self.source)


class TopicSignal(ScaledSignal):
    """A number in the messages of a ROS topic."""

    driver: ClassVar[str] = "load_frame_node.signal_sources.topic:TopicSource"

    source: Literal["topic"] = "topic"
    topic: str = Field(min_length=1, description="Name of the topic; relative names are in the namespace of the rig.")
    field: str = Field(description="The number in a message: temperature, wrench.force.z, data[3].")
    clock: Literal["stamp", "arrival"] = Field(
        "stamp", description="Time of a reading: stamp of the header, or arrival, also for messages without a header."
    )

    @model_validator(mode="after")
    def _field_can_be_read(self) -> Self:
        if not _FIELD.fullmatch(self.field):
            raise ValueError(f"field {self.field!r} is no field of a message; write it as wrench.force.z or data[3]")
        return self


class SerialSignal(ScaledSignal):
    """A serial line that prints numbers, a line for each reading."""

    driver: ClassVar[str] = "load_frame_node.signal_sources.serial_line:SerialSource"

    source: Literal["serial"] = "serial"
    device: str = Field(min_length=1, description="Serial device, such as /dev/ttyACM0.")
    baud_rate: int = Field(115_200, ge=50, le=4_000_000, description="Rate of the line [baud].")
    separator: str = Field("", description="Between the numbers of a line; by default any blanks, semicolons or tabs.")
    column: int = Field(0, ge=0, le=255, description="Which number of a line, from 0.")
    decimal: Literal[".", ","] = Field(".", description="Decimal sign.")


class InstrumentSignal(SignalSettings):
    """An instrument with Modbus registers or SCPI queries; its file names the signals."""

    driver: ClassVar[str] = "load_frame_node.signal_sources.instrument:InstrumentSource"
    elsewhere: ClassVar[str] = "the file of the instrument contains units, scales and names of its signals"

    source: Literal["instrument"] = "instrument"
    file: FilePath = Field(min_length=1, description="File with the section signals, as a machine file.")


SIGNAL_SOURCES = Devices("fringedic.signals", SignalSettings, (TopicSignal, SerialSignal, InstrumentSignal), "topic")
SignalSource = Annotated[SerializeAsAny[SignalSettings], SIGNAL_SOURCES]
"""Settings of any source of a signal; `source` selects their model."""
SignalName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$")]
Signals = dict[SignalName, SignalSource]
"""Settings of the signals of a rig by their names."""
_SIGNALS = TypeAdapter[dict[str, SignalSettings]](Signals)


def _checked_signals(entries: dict[str, Any]) -> dict[str, Any]:
    signal_settings(entries)
    return entries


def signal_settings(entries: dict[str, Any]) -> dict[str, SignalSettings]:
    """Return the settings of signals that a section of a rig file contains.

    Raises
    ------
    pydantic.ValidationError
        A setting is refused.
    """
    return _SIGNALS.validate_python(entries)


class SignalsNodeSettings(HardwareNodeSettings):
    """Settings of the signals node."""

    signals: Annotated[dict[str, Any], OR_EMPTY, AfterValidator(_checked_signals)] = Field(
        {}, description="Signals by their names, as the section `signals` of a rig file."
    )


class RequiredSignals(Settings):
    """Signals without which a step fails."""

    required_signals: list[str] = Field(
        [], description="Signals whose samples have to cover the exposures of a step, by their names."
    )
