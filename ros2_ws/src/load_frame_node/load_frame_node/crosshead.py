"""The machine in use and its latest sample, shared by sampling, moves and hold requests."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Container
from contextlib import suppress

from rclpy.node import Node

from fringedic.errors import MachineError, MachineGoneError, MachineNotReadyError
from fringedic_ros.waiting import Condition
from load_frame_node.machines import LoadMode, Machine, Sample

_STANDSTILL = (LoadMode.IDLE, LoadMode.HOLD)
_AGAIN_S = 0.2  # between two requests of a hold to a machine that does not answer
FAULT = "the machine reports a fault; find its cause, and reset the machine at its own controls"
REPEAT_S = 1.0  # after which a hold that the machine accepted is requested again while it moves


class Crosshead:
    """The machine that is open, used by one thread at a time, and the latest that is known of it.

    Attributes
    ----------
    machine
        The open machine; None before the node is configured.
    sample
        The latest sample; UNKNOWN before the first one.
    changed
        Notified after each sample.
    hold_requested
        A hold was requested after the start of the latest move.
    reached
        The sample that reached the limit of the latest move; None before.
    """

    def __init__(self, node: Node) -> None:
        self.machine: Machine | None = None
        self.sample = Sample(0, LoadMode.UNKNOWN, 0.0, 0.0)
        self.changed = Condition(node)
        self.hold_requested = False
        self.reached: Sample | None = None
        self._ends_move: Callable[[Sample], bool] = _never
        self._hold_is_owed_until: Container[LoadMode] | None = None  # a mode among these is reported; None: no hold
        self._accepted_s: float | None = None  # when the machine accepted the hold that is owed; None before
        self._log = node.get_logger()
        self._in_use = threading.Lock()

    def open(self, machine: Machine) -> None:
        """Use a machine from now on. A hold is owed unless it stands still: an earlier node may have left it moving."""
        self.machine = machine
        self._owe_hold(_STANDSTILL)

    def close(self) -> None:
        """Release the machine."""
        if self.machine is not None:
            self.machine.close()
            self.machine = None

    def read(self) -> Sample:
        """Return a new sample; `take` makes it the latest.

        Raises
        ------
        MachineError
            There is no sample.
        """
        with self._in_use:
            begun_s = time.monotonic()
            return self._open_machine().sample()._replace(begun_s=begun_s)

    def take(self, sample: Sample) -> None:
        """Make a sample the latest one, and request a hold when it ends the move or when one is owed."""
        self.sample = sample
        with self._in_use:
            if self._hold_is_owed_until is not None and sample.mode in self._hold_is_owed_until:
                self._hold_is_owed_until = None
            if self._ends_move(sample):
                self.reached, self._ends_move = sample, _never
                self._owe_hold()
            if self._hold_is_due():
                with suppress(MachineError):  # requested again at the next sample
                    self._request_hold()
        self.changed.notify()

    def move_to(self, position: float, speed: float, ends_move: Callable[[Sample], bool]) -> None:
        """Request a move to `position` [m] at `speed` [m/s], unless a sample of now shows a fault or no state.

        Parameters
        ----------
        ends_move
            Called with every sample from now on, in the thread that takes them; a hold is requested once it is true.

        Raises
        ------
        CrossheadRangeError
            The position or the speed is outside the range of the machine.
        MachineNotReadyError
            The sample, which is the latest one now, shows a fault, no state or no position; no move was sent.
        MachineError
            The machine does not accept the request.
        """
        with self._in_use:
            machine = self._open_machine()
            self._require_ready(machine)
            try:
                machine.move_to(position, speed)
            except MachineGoneError:  # it may have begun the move
                self._owe_hold()
                raise
            self.reached, self._ends_move, self._hold_is_owed_until = None, ends_move, None

    def end_move(self) -> None:
        """Forget what ends the move, which is over."""
        self._ends_move = _never

    def hold(self) -> None:
        """Request a hold, which is owed until a sample shows standstill or the machine is moved again.

        It is requested with every sample until the machine accepts it, and once a second while the machine then moves:
        a request may be lost with the connection.

        Raises
        ------
        MachineError
            The machine does not accept the request now.
        """
        with self._in_use:
            self._owe_hold()
            self._request_hold()

    def hold_at_last(self, timeout_s: float) -> None:
        """Request a hold, while the machine does not answer again and again for up to `timeout_s`.

        Raises
        ------
        MachineError
            The machine did not accept it.
        """
        end = time.monotonic() + timeout_s
        while True:
            try:
                return self.hold()
            except MachineGoneError:
                if time.monotonic() >= end:
                    raise
            time.sleep(_AGAIN_S)

    def _owe_hold(self, until: Container[LoadMode] = ()) -> None:
        self._hold_is_owed_until, self._accepted_s = until, None

    def _hold_is_due(self) -> bool:
        if self._hold_is_owed_until is None or self._accepted_s is None:
            return self._hold_is_owed_until is not None
        return self.sample.mode is LoadMode.MOVING and time.monotonic() >= self._accepted_s + REPEAT_S

    def _request_hold(self) -> None:
        if self._accepted_s is not None:
            self._log.error(
                f"the machine still moves {REPEAT_S:g} s after it accepted a hold, which is requested again; if it "
                "does not stop, stop it at its own controls",
                throttle_duration_sec=REPEAT_S,
            )
        self._open_machine().hold()
        self._hold_is_owed_until, self._accepted_s = _STANDSTILL, time.monotonic()

    def _require_ready(self, machine: Machine) -> None:
        begun_s = time.monotonic()
        try:
            self.sample = machine.sample()._replace(begun_s=begun_s)
            reason = reason_not_to_move(self.sample)
        except MachineError as error:
            reason = str(error)
            self.sample = Sample.without_answer(begun_s, reason)
        if reason:
            raise MachineNotReadyError(f"no move was sent: {reason}")

    def _open_machine(self) -> Machine:
        if self.machine is None:
            raise MachineError("the load frame is not configured; configure and activate it")
        return self.machine


def reason_not_to_move(sample: Sample) -> str:
    """Return why a machine in this state is not moved, and what to do; empty when it may be moved."""
    if sample.mode is LoadMode.FAULT:
        return FAULT
    if sample.mode is LoadMode.UNKNOWN:
        cause = f": {sample.unknown}" if sample.unknown else ""
        return (
            "the machine reports no state that the machine file names; look at the machine, check its connection and "
            f"the status in the machine file{cause}"
        )
    if math.isnan(sample.position):
        return f"the position of the crosshead is unknown; {sample.unknown or 'check its sensor'}"
    return ""


def _never(_: Sample) -> bool:
    return False
