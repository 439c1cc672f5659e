"""Testing machines with text commands (SCPI) over sockets, serial lines and every other VISA resource."""

from __future__ import annotations

import math
import re
import time
from typing import Any

import pyvisa
from pyvisa.constants import VI_TMO_IMMEDIATE

from fringedic.errors import MachineGoneError
from load_frame_node.machines.described import DescribedMachine, Reading
from load_frame_node.machines.description import Query, ScpiDescription

_WHOLE_NUMBER = re.compile(r"[+-]?[0-9]{1,9}")
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")  # float() takes 1_0 and other digits, too
_CHECK_PERIOD_S, _SHORTEST_CHECK_S = 1.0, 0.002
_SHOWN = 40  # characters of an answer that a message repeats


class ScpiMachine(DescribedMachine[ScpiDescription]):
    """Machine with the queries and commands of its description."""

    def __init__(self, description: ScpiDescription) -> None:
        self._resource: Any = None
        self._slowest_answer_s = 0.0  # since the last wait for further lines
        self._checked_s = -math.inf  # when nothing had followed the last answer for long enough
        super().__init__(description, description.resource)

    def connect(self) -> None:
        """Open the resource and send the start commands."""
        description = self.description
        try:
            self._resource = pyvisa.ResourceManager(description.backend).open_resource(
                description.resource,
                read_termination=description.termination,
                write_termination=description.termination,
                timeout=round(1e3 * description.timeout_s),
                open_timeout=round(1e3 * description.timeout_s),
            )
        except (pyvisa.Error, OSError, ValueError) as error:
            raise MachineGoneError(f"no connection: {error}") from error
        self._slowest_answer_s = 0.0
        self._send(description.start)

    def disconnect(self) -> None:
        """Close the resource."""
        resource, self._resource = self._resource, None
        if resource is not None:
            try:
                resource.close()
            except (pyvisa.Error, OSError):
                return  # the connection was lost before

    def read(self) -> Reading:
        """Query force, position, status and time, in this order; their time is the middle of the queries.

        Answers have no names: one line too many would shift all later ones, and a position could be read as a status.
        No line may be left before a query. A line that is left over after the last one arrives up to one answering time
        later. The machine is given this time after each command, which it may have acknowledged, and once a second.
        The wait is twice the slowest answer since the last wait, and `timeout_s` at most, which no answer exceeds: time
        in which this process stood still counts as part of an answer, and must not delay all later samples and holds.
        """
        description = self.description
        before = time.monotonic_ns()
        force = self._number("force", description.force)
        position = self._number("position", description.position)
        status = None if description.status is None else self._answer(description.status.query)
        own_time = None if description.time is None else self._number("time", description.time)
        acquired = (before + time.monotonic_ns()) // 2
        if time.monotonic() - self._checked_s > _CHECK_PERIOD_S:
            wait_s = max(2 * self._slowest_answer_s, _SHORTEST_CHECK_S)
            self._check_nothing_follows(min(wait_s, description.timeout_s))
            self._checked_s, self._slowest_answer_s = time.monotonic(), 0.0
        else:
            self._check_nothing_follows(0.0)
        is_number = status is not None and _WHOLE_NUMBER.fullmatch(status)
        reported = int(status) if status is not None and is_number else status
        return Reading(acquired, force, position, reported, own_time)

    def send_move(self, position: float, speed: float) -> None:
        """Send the commands of a move."""
        assert self.description.move is not None, "sent only when described"
        self._send(self.description.move.texts(position, speed))

    def send_hold(self) -> None:
        """Send the commands that request a hold."""
        self._send(self.description.hold)

    def _number(self, what: str, query: Query) -> float:
        answer = self._answer(query.query)
        self.replies[what] = f"'{query.query}' was answered with '{answer[:_SHOWN]}'"
        if not _NUMBER.fullmatch(answer):
            # possibly the late answer to an earlier query: a new connection starts without pending answers
            raise MachineGoneError(
                f"{what}: '{query.query}' was answered with '{answer[:_SHOWN]}', which is not a number"
            )
        return query.si(float(answer))

    def _answer(self, query: str) -> str:
        self._check_nothing_follows(0.0)
        sent = time.monotonic()
        try:
            answer: str = self._resource.query(query)
        except (pyvisa.Error, OSError, UnicodeDecodeError) as error:
            raise MachineGoneError(f"'{query}' has no answer: {error}") from error
        self._slowest_answer_s = max(self._slowest_answer_s, time.monotonic() - sent)
        return answer.strip()

    def _check_nothing_follows(self, wait_s: float) -> None:
        patience, self._resource.timeout = self._resource.timeout, math.ceil(1e3 * wait_s) or VI_TMO_IMMEDIATE
        try:
            extra = self._resource.read_bytes(1)
        except (pyvisa.Error, OSError):
            return  # nothing more to read, as it should be; a lost connection fails at the next query
        finally:
            self._resource.timeout = patience
        raise MachineGoneError(
            f"it sent more than was requested, from {extra!r} on; if it acknowledges commands, switch that off"
        )

    def _send(self, commands: list[str]) -> None:
        self._checked_s = -math.inf
        for command in commands:
            try:
                self._resource.write(command)
            except (pyvisa.Error, OSError) as error:
                raise MachineGoneError(f"'{command}' cannot be sent: {error}") from error
