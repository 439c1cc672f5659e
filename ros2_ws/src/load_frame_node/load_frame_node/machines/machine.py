"""Interface of a testing machine, and the parts that several kinds of machines share."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple, Protocol, TypeVar

from fringedic.errors import MachineError, MachineGoneError
from fringedic.signals import Sample as SignalSample

Answer = TypeVar("Answer")

LARGEST_FORCE_N, FARTHEST_M = 1e9, 100.0  # beyond those of every testing machine
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 8.0  # between two attempts to connect to a lost machine


class LoadMode(IntEnum):
    """What a machine does, numbered as the modes of fringedic_msgs/LoadState."""

    UNKNOWN = 0
    IDLE = 1
    MOVING = 2
    HOLD = 3
    FAULT = 4


class Sample(NamedTuple):
    """One reading of the machine.

    Attributes
    ----------
    stamp_ns
        Time of acquisition on the clock of this computer [ns].
    mode
        What the machine does.
    force
        Force [N], tension positive.
    position
        Position of the crosshead [m], positive in the direction of tension.
    device_ns
        The same time on the clock of the machine [ns]; None when the machine does not report it.
    begun_s
        Start of the acquisition on the monotonic clock, which is never set [s]; the crosshead adds it.
    unknown
        Why mode, force or position is unknown, with the reply of the machine; empty when they are known.
    signals
        Samples of further signals of the machine.
    """

    stamp_ns: int
    mode: LoadMode
    force: float
    position: float
    device_ns: int | None = None
    begun_s: float = -math.inf
    unknown: str = ""
    signals: tuple[SignalSample, ...] = ()

    @classmethod
    def without_answer(cls, begun_s: float, reason: str = "") -> Sample:
        """Return the sample of a machine that does not answer: everybody who relies on a hold must see that."""
        return cls(time.time_ns(), LoadMode.UNKNOWN, math.nan, math.nan, begun_s=begun_s, unknown=reason)


class Machine(Protocol):
    """A testing machine.

    Limits and emergency stop belong to the machine, which may refuse every request. The methods may block; one thread
    at a time calls them.
    """

    def sample(self) -> Sample:
        """Read mode, force and position.

        Raises
        ------
        MachineError
            There is no sample; the message gives the reason. The next call may succeed.
        """
        ...

    def move_to(self, position: float, speed: float) -> None:
        """Request a move to `position` [m] at `speed` [m/s].

        Raises
        ------
        CrossheadRangeError
            The position or the speed is outside the range of the machine, which does not move.
        MachineError
            The machine does not accept the request.
        """
        ...

    def hold(self) -> None:
        """Request a hold: the machine stops and holds its position.

        Raises
        ------
        MachineError
            The machine does not accept the request.
        """
        ...

    def close(self) -> None:
        """Release the machine."""
        ...


class Motion:
    """Mode of a crosshead from its positions alone, for machines that do not report it.

    Parameters
    ----------
    slowest
        Speed above which the crosshead counts as moving [m/s].
    span
        Time over which the speed is determined [s].
    """

    def __init__(self, slowest: float, span: float) -> None:
        self._slowest = slowest
        self._span_ns = round(1e9 * span)
        self._past: deque[tuple[int, float]] = deque()

    def mode(self, acquired_ns: int, position: float) -> LoadMode:
        """Return MOVING or HOLD; UNKNOWN until known positions cover the span, and after a clock that jumped back.

        Parameters
        ----------
        acquired_ns
            Time of acquisition on the monotonic clock [ns]: a motion would look like a hold on a clock that is set
            forward.
        position
            Position of the crosshead [m]; NaN when it is not known.
        """
        if math.isnan(position):
            self._past.clear()
            return LoadMode.UNKNOWN
        if self._past and acquired_ns <= self._past[-1][0]:
            self._past.clear()
        self._past.append((acquired_ns, position))
        while len(self._past) > 2 and acquired_ns - self._past[1][0] >= self._span_ns:
            self._past.popleft()
        first_ns, first = self._past[0]
        if acquired_ns - first_ns < self._span_ns:
            return LoadMode.UNKNOWN
        moving = abs(position - first) > 1e-9 * (acquired_ns - first_ns) * self._slowest
        return LoadMode.MOVING if moving else LoadMode.HOLD


class Link:
    """Connection to a machine; a lost one is opened again, with pauses that double up to 8 s.

    Parameters
    ----------
    name
        Name of the machine for messages.
    open_connection
        Connects, or raises `MachineGoneError`.
    close_connection
        Ends the connection; must not raise.
    """

    def __init__(self, name: str, open_connection: Callable[[], None], close_connection: Callable[[], None]) -> None:
        self._name = name
        self._open_connection = open_connection
        self._close_connection = close_connection
        self._connected = False
        self._pause = _FIRST_PAUSE_S
        self._next_attempt = 0.0

    def ask(self, what: str, question: Callable[[], Answer]) -> Answer:
        """Return the answer of a connected machine.

        Raises
        ------
        MachineGoneError
            The machine is not connected or does not answer.
        MachineError
            The machine refuses the request, or its answer cannot be used. The messages name machine and request.
        """
        self._connect(what)
        try:
            return question()
        except MachineGoneError as error:
            self._lose()
            raise MachineGoneError(f"{self._name}: {what}: {error}") from error
        except MachineError as error:
            raise MachineError(f"{self._name}: {what}: {error}") from error
        except Exception as error:  # of a library, about whatever a machine has sent
            raise MachineError(f"{self._name}: {what}: {type(error).__name__}: {error}") from error

    def close(self) -> None:
        """End the connection."""
        self._connected = False
        self._close_connection()

    def _connect(self, what: str) -> None:
        if self._connected:
            return
        wait = self._next_attempt - time.monotonic()
        if wait > 0:
            raise MachineGoneError(f"{self._name}: {what}: not connected; the next attempt is in {wait:.1f} s")
        try:
            self._open_connection()
        except MachineGoneError as error:
            self._lose()
            raise MachineGoneError(
                f"{self._name}: {what}: {error}; check cable, address and power of the machine"
            ) from error
        self._connected = True
        self._pause = _FIRST_PAUSE_S

    def _lose(self) -> None:
        self._connected = False
        self._close_connection()
        self._next_attempt = time.monotonic() + self._pause
        self._pause = min(2 * self._pause, _LONGEST_PAUSE_S)
