"""A serial line that prints numbers: Arduino, HX711, balances, thermometers."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from typing import Any

import serial

from fringedic.errors import MachineError, MachineGoneError
from fringedic.settings.signals import SerialSignal
from fringedic.wording.causes import cause_of
from load_frame_node.signal_sources.source import Reading

_WAIT_S = 0.05
_LONGEST_LINE = 4096  # byte
_ANY_SEPARATOR = re.compile(r"[\s;]+")
_NUMBER = re.compile(r"[-+]?\s*(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_PLAIN = re.compile(r"-?\d+(\.\d*)?")
_FAST_HZ = 200.0
_READINGS_AT_ONCE = 20  # of a fast device
_BIT_PER_BYTE = 10  # of a line with 8 data bits, one start bit and one stop bit


class SerialSource:
    """Readings from the lines of a serial device; one that was lost is opened again.

    The time of a line is that of its first byte: the arrival of the bytes, less the time that those after it took on
    the line. A fast device is read every few readings; the lines of one read are spread over the time since the last.
    """

    def __init__(self, settings: SerialSignal, _node: Any = None) -> None:
        self._settings = settings
        self._port: serial.Serial | None = None
        self._buffer = b""
        self._is_first = True
        self._latest_ns = 0  # stamp of the latest reading
        self._pause_s = _READINGS_AT_ONCE / settings.rate_hz if settings.rate_hz >= _FAST_HZ else 0.0
        self._read_ns = 0  # time of the latest read

    def read(self) -> Sequence[Reading]:
        """Return the readings of the lines that are complete.

        Raises
        ------
        MachineError
            The device cannot be opened or was lost, or no line has such a number.
        """
        try:
            if self._port is None:
                self._port = serial.Serial(
                    self._settings.device, self._settings.baud_rate, timeout=_WAIT_S, exclusive=True
                )
                self._port.reset_input_buffer()
                self._buffer, self._is_first = b"", True
            time.sleep(self._pause_s)
            data = self._port.read(max(1, self._port.in_waiting))
        except (OSError, ValueError, TypeError) as error:  # PySerial raises each of them for a lost device
            self.close()
            time.sleep(_WAIT_S)
            raise MachineGoneError(f"{self._settings.device}: {cause_of(error)}") from error
        now = time.time_ns()
        since, self._read_ns = now - self._read_ns, now
        spread = min(since, 1e9 * self._pause_s) / max(len(data), 1) if self._pause_s else 0.0
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        if len(self._buffer) > _LONGEST_LINE:
            self._buffer = b""
            raise MachineError(
                f"{self._settings.device}: prints no ends of lines; check baud_rate {self._settings.baud_rate}"
            )
        if lines and self._is_first:  # it began before the device was opened
            self._is_first = False
            lines = lines[1:]
        return self._readings(lines, now, max(spread, 1e9 * _BIT_PER_BYTE / self._settings.baud_rate))

    def close(self) -> None:
        """Close the device."""
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def _readings(self, lines: Sequence[bytes], now: int, of_byte: float) -> list[Reading]:
        """Return the readings of lines of which a byte took a time [ns]; the buffer came after the last one."""
        later = len(self._buffer)
        found: list[Reading] = []
        wrong: MachineError | None = None
        for line in reversed(lines):
            later += len(line) + 1
            text = line.decode("latin-1").strip()
            try:
                if text:
                    found.append(Reading(now - round(later * of_byte), self._number(text)))
            except MachineError as error:  # such as a comment among the numbers
                wrong = error
        if wrong is not None and not found:
            raise wrong
        # a device on USB is not bound to the rate of the line, and may send at once what it has kept
        for place, each in enumerate(reversed(found)):
            self._latest_ns = max(self._latest_ns + 1, each.stamp_ns)
            found[-1 - place] = each._replace(stamp_ns=self._latest_ns)
        return found[::-1]

    def _number(self, text: str) -> float:
        settings = self._settings
        parts = text.split(settings.separator) if settings.separator.strip() else _ANY_SEPARATOR.split(text)
        if settings.column >= len(parts):
            raise MachineError(
                f"{settings.device}: the line {text[:40]!r} has {len(parts)} parts, and no column {settings.column} "
                "counted from 0; correct column or separator"
            )
        part = parts[settings.column]
        if settings.decimal == "." and _PLAIN.fullmatch(part):
            return float(part)
        match = _NUMBER.search(part.replace(",", ".") if settings.decimal == "," else part)
        if match is None:
            if part.strip().lower() in ("nan", "ovf", "inf", "-inf"):
                return float("nan")
            raise MachineError(
                f"{settings.device}: {part[:40]!r} of the line {text[:40]!r} is no number; correct column, separator "
                "or baud_rate"
            )
        return float(match[0].replace(" ", ""))
