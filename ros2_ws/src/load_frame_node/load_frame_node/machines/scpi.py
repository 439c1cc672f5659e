"""Testing machines that speak text commands (SCPI), over sockets, serial lines or whatever else VISA reaches."""

from __future__ import annotations

import time
from typing import Any

import pyvisa

from fringedic.errors import MachineError, MachineGoneError
from load_frame_node.machines.description import Query, ScpiDescription
from load_frame_node.machines.limits import check_move
from load_frame_node.machines.machine import Link, Motion, Sample, finite


class ScpiMachine:
    """Questions and commands of a machine, as its description words them.

    Raises
    ------
    MachineError
        The machine does not answer.
    """

    def __init__(self, description: ScpiDescription) -> None:
        self._description = description
        self._resource: Any = None
        self._link = Link(f"{description.name} at {description.resource}", self._open, self._disconnect)
        self._motion = Motion(1e-3 * description.motion.slowest_mm_per_s, description.motion.span_s)
        try:
            self.sample()
        except MachineError:
            self.close()
            raise

    def sample(self) -> Sample:
        """Ask for force, position and status, in this order; the stamp is the middle of the three.

        Raises
        ------
        MachineError
            The machine does not answer in time, or answers with something that is no number.
        """
        return self._link.ask("sample", self._read_sample)

    def move_to(self, position: float, speed: float) -> None:
        """Send the commands of a move.

        Raises
        ------
        CrossheadRangeError
            The description's limits do not allow it.
        MachineError
            The description has no move, or the machine does not take it.
        """
        check_move(self._description, position, speed)
        move = self._description.move
        assert move is not None, "checked with the limits"
        self._link.ask("move", lambda: self._send(move.texts(position, speed)))

    def hold(self) -> None:
        """Send the commands that stop the machine.

        Raises
        ------
        MachineError
            The description has no hold, or the machine does not take it.
        """
        if not self._description.hold:
            raise MachineError(f"{self._description.name}: its description has no hold; stop it at the machine")
        self._link.ask("hold", lambda: self._send(self._description.hold))

    def close(self) -> None:
        """Disconnect."""
        self._link.close()

    def _open(self) -> None:
        description = self._description
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
        self._send(description.start)

    def _disconnect(self) -> None:
        resource, self._resource = self._resource, None
        if resource is not None:
            try:
                resource.close()
            except (pyvisa.Error, OSError):
                return  # it was lost already

    def _read_sample(self) -> Sample:
        description = self._description
        before = time.time_ns()
        force = self._number("force", description.force)
        position = self._number("position", description.position)
        status = None if description.status is None else self._answer(description.status.query)
        stamp = (before + time.time_ns()) // 2
        if description.status is None or status is None:
            return Sample(stamp, self._motion.mode(stamp, position), force, position)
        word: int | str = int(status) if status.lstrip("+-").isdigit() else status
        return Sample(stamp, description.status.mode(word), force, position)

    def _number(self, what: str, query: Query) -> float:
        answer = self._answer(query.query)
        try:
            number = float(answer)
        except ValueError:
            # perhaps the late answer to an earlier question: a new connection begins afresh
            raise MachineGoneError(
                f"{what}: '{query.query}' was answered with '{answer}', which is no number"
            ) from None
        return query.si(finite(what, number))

    def _answer(self, query: str) -> str:
        try:
            answer: str = self._resource.query(query)
        except (pyvisa.Error, OSError, UnicodeDecodeError) as error:
            raise MachineGoneError(f"'{query}' has no answer: {error}") from error
        return answer.strip()

    def _send(self, commands: list[str]) -> None:
        for command in commands:
            try:
                self._resource.write(command)
            except (pyvisa.Error, OSError) as error:
                raise MachineGoneError(f"'{command}' cannot be sent: {error}") from error
