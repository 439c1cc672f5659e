"""Machines that a file describes: the part that does not depend on the protocol."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, Generic, NamedTuple, TypeVar

from fringedic.errors import CrossheadRangeError, MachineError
from fringedic.frames.clocks import wall_minus_monotonic_ns
from fringedic.signals import Sample as SignalSample
from load_frame_node.machines.description import SIGNAL, Bounds, MachineSection
from load_frame_node.machines.machine import Link, LoadMode, Motion, Sample

DescriptionT = TypeVar("DescriptionT", bound=MachineSection)


_LATEST_TIME_S = 9e9  # 285 years: later times exceed 64 bits of nanoseconds
_STANDSTILL_S = 1.0  # a clock that has not advanced for this time means that the machine repeats an old sample


class Reading(NamedTuple):
    """One reading: monotonic time [ns], force [N], position [m]; status and time [s] when the machine reports them.

    Further signals are in their SI units, by their names.
    """

    acquired_ns: int
    force: float
    position: float
    status: int | str | None
    time: float | None = None
    signals: Mapping[str, float] = MappingProxyType({})


class Answer(NamedTuple):
    """Answer of the machine to one entry of its file.

    Attributes
    ----------
    entry
        Name of the entry: force, position, status or time.
    request
        Query or registers.
    raw
        The answer as it was received; empty when there was none.
    value
        Its meaning: force [N], position [m], time [s] or status; None when it has none.
    error
        Why it does not fit the file, and what to change there; None when it fits.
    """

    entry: str
    request: str
    raw: str
    value: float | int | str | None
    error: MachineError | None = None


class DescribedMachine(ABC, Generic[DescriptionT]):
    """A machine whose connection may be lost and opened again.

    Parameters
    ----------
    description
        Content of the machine file.
    place
        Address of the machine for messages.

    Attributes
    ----------
    description
        Content of the machine file.
    title
        Name and address of the machine.
    replies
        The latest reply for each entry of the file, in words.
    """

    def __init__(self, description: DescriptionT, place: str) -> None:
        self.description = description
        self.title = f"{description.name} at {place}"
        self._link = Link(self.title, self.connect, self.disconnect)
        self._motion = Motion(1e-3 * description.motion.slowest_mm_per_s, description.motion.span_s)
        self._device_ns, self._advanced_ns = -1, 0  # its time, and when that was new on the monotonic clock
        self._force_bounds, self._position_bounds = description.force_bounds, description.position_bounds
        self.replies: dict[str, str] = {}  # the latest reply for each quantity, as the machine sent it

    def sample(self) -> Sample:
        """Read force, position and status; a force or position that no machine can show is NaN.

        Raises
        ------
        MachineError
            The machine does not answer, a value of its answer is not a finite number, or its clock stands still.
        """
        read = self._link.ask("sample", self.read)
        for what, value in (("force", read.force), ("position", read.position), ("time", read.time or 0.0)):
            if not math.isfinite(value):
                raise MachineError(f"{self.description.name}: sample: {what} is {value}, which is not a number")
        unknown = list[str]()
        force = self._known("force", read.force, self._force_bounds, unknown)
        position = self._known("position", read.position, self._position_bounds, unknown)
        device_ns = None if read.time is None else self._device_time(read.time, read.acquired_ns)
        if self.description.status is None or read.status is None:
            mode = self._motion.mode(read.acquired_ns, position)
        else:
            mode = self.description.status.mode(read.status)
            if mode is LoadMode.UNKNOWN:
                unknown.append(f"{self.description.name}: {self.description.status.unlisted(read.status)}")
        stamp_ns = read.acquired_ns + wall_minus_monotonic_ns()
        signals = tuple(
            SignalSample(each.channel(name, self.description.name), stamp_ns, read.signals[name], each.sigma_si)
            for name, each in self.description.signals.items()
        )
        return Sample(stamp_ns, mode, force, position, device_ns, unknown="; ".join(unknown), signals=signals)

    def _known(self, what: str, value: float, bounds: Bounds, unknown: list[str]) -> float:
        """Return a value that the machine can show; otherwise NaN, and append the reason to a list.

        Machines answer with numbers for what they have not measured: 9.91E37 is the not-a-number of SCPI, 9.9E37 and
        -9.9E37 are its overload.
        """
        if bounds.contain(value):
            return value
        reply = self.replies.get(what, f"{value:g}")
        unknown.append(f"{self.description.name}: the {what} is unknown: {reply}, outside {bounds.words}")
        return math.nan

    def inspect(self) -> list[Answer]:
        """Return the answer to each entry of the file, also of those that do not fit; nothing else is sent.

        Raises
        ------
        MachineGoneError
            The machine cannot be reached, or answers nothing at all.
        """
        answers = self._link.ask("queries", self._single_answers)
        return [each if each.error is not None else each._replace(error=self.doubt(each)) for each in answers]

    def _single_answers(self) -> list[Answer]:
        answers = list(self.single_answers())
        first = answers[0].error
        if first is not None and not any(answer.raw for answer in answers):
            raise first
        return answers

    def _device_time(self, time_s: float, acquired_ns: int) -> int:
        """Return the time of the machine [ns], which has to be possible and to advance."""
        if abs(time_s) > _LATEST_TIME_S:
            raise MachineError(f"{self.description.name}: sample: time is {time_s:g} s, which no clock shows")
        device_ns = round(1e9 * time_s)
        if device_ns != self._device_ns:
            self._device_ns, self._advanced_ns = device_ns, acquired_ns
        elif acquired_ns - self._advanced_ns > 1e9 * _STANDSTILL_S:
            raise MachineError(
                f"{self.description.name}: sample: its clock has stood at {time_s:g} s for more than "
                f"{_STANDSTILL_S:g} s, so it repeats an old sample; check its controller"
            )
        return device_ns

    def move_to(self, position: float, speed: float) -> None:
        """Request a move to `position` [m] at `speed` [m/s].

        Raises
        ------
        CrossheadRangeError
            The move exceeds the limits of the description. These only intercept typing errors; the limits of the
            machine itself remain decisive.
        MachineError
            The description has no move, or the machine refuses it.
        """
        limits = self.description.limits
        if self.description.move is None or limits is None:
            raise MachineError(
                f"{self.description.name}: its description has no move; move the crosshead at the machine"
            )
        if not (math.isfinite(position) and limits.lowest_mm <= 1e3 * position <= limits.highest_mm):
            raise CrossheadRangeError(
                f"crosshead position {1e3 * position:g} mm is outside {limits.lowest_mm:g} to {limits.highest_mm:g} mm"
            )
        if not (math.isfinite(speed) and 0 < 1e3 * speed <= limits.fastest_mm_per_s):
            raise CrossheadRangeError(
                f"crosshead speed {1e3 * speed:g} mm/s is outside 0 to {limits.fastest_mm_per_s:g} mm/s"
            )
        self._link.ask("move", lambda: self.send_move(position, speed))

    def hold(self) -> None:
        """Request a hold: the machine stops and holds its position.

        Raises
        ------
        MachineError
            The description has no hold, or the machine does not accept it.
        """
        if not self.description.hold:
            raise MachineError(f"{self.description.name}: its description has no hold; stop it at the machine")
        self._link.ask("hold", self.send_hold)

    def close(self) -> None:
        """Disconnect."""
        self._link.close()

    @abstractmethod
    def connect(self) -> None:
        """Connect, or raise `MachineGoneError`."""

    @abstractmethod
    def disconnect(self) -> None:
        """End the connection in whatever state it is."""

    def read(self) -> Reading:
        """Read force, position, status and time; the time of the reading is the middle of all requests.

        Raises
        ------
        MachineError
            There is no answer, or one that does not fit the file.
        """
        values: dict[str, Any] = {}
        before = time.monotonic_ns()
        for answer in self.answers():
            if answer.error is not None:
                raise answer.error
            values[answer.entry] = answer.value
        acquired = (before + time.monotonic_ns()) // 2
        signals = {name: values[f"{SIGNAL}{name}"] for name in self.description.signals}
        force, position = values.get("force", math.nan), values.get("position", math.nan)
        return Reading(acquired, force, position, values.get("status"), values.get("time"), signals)

    def read_signals(self) -> Reading:
        """Return a reading of an instrument, which has neither force nor position.

        Raises
        ------
        MachineError
            It does not answer, or an answer does not fit the file.
        """
        return self._link.ask("signals", self.read)

    def single_answers(self) -> Iterator[Answer]:
        """Ask for each entry by itself, so that one that the machine refuses does not hide the others."""
        return self.answers()

    def doubt(self, answer: Answer) -> MachineError | None:
        """Return why an answer is doubtful although it fits the file, and what to change there; None if it is not."""
        status, value = self.description.status, answer.value
        if answer.entry == "status" and status is not None and value is not None:
            if status.mode(value) is LoadMode.UNKNOWN:
                return MachineError(status.unlisted(value))
        elif isinstance(value, float) and not math.isfinite(value):
            return MachineError(f"{answer.entry}: {value} is not a number")
        return None

    @abstractmethod
    def answers(self) -> Iterator[Answer]:
        """Ask for force, position, status and time; answers that do not fit the file contain their error."""

    def start_requests(self) -> list[str]:
        """Return what is sent after connecting, for people."""
        return []

    @abstractmethod
    def move_requests(self, position: float, speed: float) -> list[str]:
        """Return what a move would send, for people; the description has one."""

    @abstractmethod
    def hold_requests(self) -> list[str]:
        """Return what a hold would send, for people; the description has one."""

    @abstractmethod
    def send_move(self, position: float, speed: float) -> None:
        """Send a move that is within the limits of the description."""

    @abstractmethod
    def send_hold(self) -> None:
        """Send a hold; the description has one."""
