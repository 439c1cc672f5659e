"""What the load frame node needs of a testing machine."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeVar

from fringedic.errors import MachineError, MachineGoneError
from fringedic.virtual_rig import LoadMode

Answer = TypeVar("Answer")

_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 8.0  # between attempts to reach a machine that is gone


class Sample(NamedTuple):
    """One reading of the machine.

    Attributes
    ----------
    stamp_ns
        When it was acquired, on this computer's clock [ns].
    mode
        What the machine is doing.
    force
        [N], tension positive.
    position
        Crosshead [m], positive in the direction of tension.
    device_ns
        The same moment on the machine's own clock [ns]; None where it does not tell.
    """

    stamp_ns: int
    mode: LoadMode
    force: float
    position: float
    device_ns: int | None = None


class Machine(Protocol):
    """A testing machine. Its limits and its emergency stop are its own; it may refuse whatever it is asked for.

    Its methods may block, and are called by one thread at a time.
    """

    def sample(self) -> Sample:
        """Read mode, force and position.

        Raises
        ------
        MachineError
            There is no sample; the message says why. The next call may succeed.
        """
        ...

    def move_to(self, position: float, speed: float) -> None:
        """Ask for a move to `position` [m] at `speed` [m/s].

        Raises
        ------
        CrossheadRangeError
            The position or the speed is outside what the machine offers; nothing moves.
        MachineError
            The machine does not take the request.
        """
        ...

    def hold(self) -> None:
        """Ask the machine to stop and hold.

        Raises
        ------
        MachineError
            The machine does not take the request.
        """
        ...

    def close(self) -> None:
        """Let go of the machine."""
        ...


class Motion:
    """Tells from positions alone whether a crosshead moves, for machines that do not say it.

    Parameters
    ----------
    slowest
        Speed from which it counts as moving [m/s].
    span
        Time over which the speed is taken [s].
    """

    def __init__(self, slowest: float, span: float) -> None:
        self._slowest = slowest
        self._span_ns = round(1e9 * span)
        self._past: deque[tuple[int, float]] = deque()

    def mode(self, stamp_ns: int, position: float) -> LoadMode:
        """MOVING or HOLD; UNKNOWN until positions cover the span, and when the clock jumped back."""
        if self._past and stamp_ns <= self._past[-1][0]:
            self._past.clear()
        self._past.append((stamp_ns, position))
        while len(self._past) > 2 and stamp_ns - self._past[1][0] >= self._span_ns:
            self._past.popleft()
        first_ns, first = self._past[0]
        if stamp_ns - first_ns < self._span_ns:
            return LoadMode.UNKNOWN
        moving = abs(position - first) > 1e-9 * (stamp_ns - first_ns) * self._slowest
        return LoadMode.MOVING if moving else LoadMode.HOLD


class Link:
    """The connection to a machine: opened again, with pauses that double up to 8 s, after it was lost.

    Parameters
    ----------
    name
        Of the machine, for messages.
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
            It is not connected, or does not answer.
        MachineError
            It refuses; the messages name the machine and what was asked for.
        """
        self._connect(what)
        try:
            return question()
        except MachineGoneError as error:
            self._lose()
            raise MachineGoneError(f"{self._name}: {what}: {error}") from error
        except MachineError as error:
            raise MachineError(f"{self._name}: {what}: {error}") from error

    def close(self) -> None:
        """End the connection."""
        self._connected = False
        self._close_connection()

    def _connect(self, what: str) -> None:
        if self._connected:
            return
        wait = self._next_attempt - time.monotonic()
        if wait > 0:
            raise MachineGoneError(f"{self._name}: {what}: not connected; trying again in {wait:.1f} s")
        try:
            self._open_connection()
        except MachineGoneError as error:
            self._lose()
            raise MachineGoneError(f"{self._name}: {what}: {error}; check its cable, address and power") from error
        self._connected = True
        self._pause = _FIRST_PAUSE_S

    def _lose(self) -> None:
        self._connected = False
        self._close_connection()
        self._next_attempt = time.monotonic() + self._pause
        self._pause = min(2 * self._pause, _LONGEST_PAUSE_S)
