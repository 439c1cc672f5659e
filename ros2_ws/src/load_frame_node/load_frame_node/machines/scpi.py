"""Testing machines with text commands (SCPI) over sockets, serial lines and every other VISA resource."""

from __future__ import annotations

import json
import math
import termios
import time
from collections.abc import Iterator
from typing import Any

import pyvisa
from pyvisa.constants import VI_TMO_IMMEDIATE, ControlFlow, Parity, StatusCode, StopBits

from fringedic.errors import MachineError, MachineGoneError
from load_frame_node.machines.described import Answer, DescribedMachine, Reading
from load_frame_node.machines.description import NumberQuery, ScpiDescription, SerialSection, StatusQuery
from load_frame_node.machines.replies import UnfitReplyError, number_in, quoted, shown, status_in

_CHECK_PERIOD_S, _SHORTEST_CHECK_S = 1.0, 0.002
_LONGEST_REST = 200  # characters that are read of what a machine sends without a request
_LONGEST_REPLY = 4096  # bytes with the end; a machine that sends for ever would fill the memory
_LONGEST_ACKNOWLEDGEMENT = 40  # characters that the machine file is advised to contain
_NEXT_BYTE_MS = 100  # longest wait within such characters; at 300 baud each takes 33 ms
_LATE_S = 1.0  # at least so long a late answer is awaited, to find out that timeout_s is too short
_LINE = "serial: baud_rate, data_bits, parity, stop_bits and flow_control"
_STOP_BITS = {1: StopBits.one, 1.5: StopBits.one_and_a_half, 2: StopBits.two}


class ScpiMachine(DescribedMachine[ScpiDescription]):
    """Machine with the queries and commands of its description."""

    def __init__(self, description: ScpiDescription) -> None:
        self._resource: Any = None
        self._slowest_answer_s = 0.0  # since the last wait for further lines
        self._checked_s = -math.inf  # when nothing had followed the last answer for long enough
        self._understood = False  # a reply since the connection was opened fitted the description
        self._unanswered: list[str] = []  # commands sent since the last reply
        super().__init__(description, description.resource)

    def connect(self) -> None:
        """Open the resource and send the start commands."""
        description = self.description
        try:
            self._resource = pyvisa.ResourceManager(description.backend).open_resource(
                description.resource, open_timeout=round(1e3 * description.timeout_s)
            )
            self._resource.timeout = round(1e3 * description.timeout_s)
            self._resource.read_termination = description.end_of_reply
            self._resource.write_termination = description.end_of_request
            if description.is_serial:
                self._set_serial_line(description.serial or SerialSection())
        except MachineGoneError:
            raise
        except Exception as error:  # of PyVISA, PySerial, PyUSB or the drivers below them
            raise MachineGoneError(f"no connection: {error or type(error).__name__}") from error
        self._slowest_answer_s, self._understood, self._unanswered = 0.0, False, []
        self._send(self.start_requests())

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
        reading = super().read()
        if time.monotonic() - self._checked_s > _CHECK_PERIOD_S:
            wait_s = max(2 * self._slowest_answer_s, _SHORTEST_CHECK_S)
            self._check_nothing_follows(min(wait_s, self.description.timeout_s))
            self._checked_s, self._slowest_answer_s = time.monotonic(), 0.0
        else:
            self._check_nothing_follows(0.0)
        self._understood = True
        return reading

    def answers(self) -> Iterator[Answer]:
        """Send the queries; entries with the same query share one reply."""
        replies: dict[str, str] = {}
        for name, entry in self.description.entries():
            yield self._answer(name, entry, replies)

    def single_answers(self) -> Iterator[Answer]:
        """Send the queries; whatever follows an answer that does not fit belongs to it, and not to the next one."""
        for answer in self.answers():
            rest = "" if answer.error is None else self._rest(self.description.timeout_s)
            yield answer._replace(raw=answer.raw + (shown(rest) if rest else ""))

    def start_requests(self) -> list[str]:
        """Return the commands that are sent after connecting."""
        return self.description.start

    def move_requests(self, position: float, speed: float) -> list[str]:
        """Return the commands of a move."""
        assert self.description.move is not None, "asked for only when described"
        return self.description.move.texts(position, speed)

    def hold_requests(self) -> list[str]:
        """Return the commands that request a hold."""
        return self.description.hold

    def send_move(self, position: float, speed: float) -> None:
        """Send the commands of a move."""
        self._send(self.move_requests(position, speed))

    def send_hold(self) -> None:
        """Send the commands that request a hold."""
        self._send(self.hold_requests())

    def _set_serial_line(self, line: SerialSection) -> None:
        """Set the serial line, and keep it from other programs: two programs would receive each other's replies."""
        session = getattr(self._resource.visalib, "sessions", {}).get(self._resource.session)
        port = getattr(session, "interface", None)  # PySerial's: PyVISA has no lock between programs
        try:
            if port is not None:
                port.exclusive = True
        except OSError as error:
            raise MachineGoneError(f"another program uses the serial line; end it ({error})") from error
        for name, value in (
            ("baud_rate", line.baud_rate),
            ("data_bits", line.data_bits),
            ("parity", Parity[line.parity]),
            ("stop_bits", _STOP_BITS[line.stop_bits]),
            ("flow_control", ControlFlow[line.flow_control]),
        ):
            try:
                setattr(self._resource, name, value)
            except (pyvisa.Error, termios.error, OSError, ValueError) as error:
                raise MachineGoneError(
                    f"the serial line does not accept {name} of the machine file: {error}"
                ) from error

    def _answer(self, name: str, entry: NumberQuery | StatusQuery, replies: dict[str, str]) -> Answer:
        query, reply = entry.query, ""
        try:
            reply = replies[query] if query in replies else self._ask(query)
            replies[query] = reply
            self.replies[name] = f"'{query}' was answered with {quoted(reply)}"
            value = number_in(reply, entry, name) if isinstance(entry, NumberQuery) else status_in(reply, entry, name)
        except UnfitReplyError as error:
            return Answer(name, query, shown(reply), None, self._unfit(reply, error))
        except MachineError as error:
            return Answer(name, query, "", None, error)
        self._unanswered.clear()
        return Answer(name, query, shown(reply), value)

    def _ask(self, query: str) -> str:
        self._check_nothing_follows(0.0)
        sent = time.monotonic()
        self._write(query)
        reply = self._take_echo(query) if self.description.echo else self._line(query)
        self._slowest_answer_s = max(self._slowest_answer_s, time.monotonic() - sent)
        return reply

    def _send(self, commands: list[str]) -> None:
        self._checked_s = -math.inf
        expected = self.description.acknowledge
        for command in commands:
            self._unanswered.append(command)
            self._write(command)
            if expected is None:
                if self.description.echo:
                    self._take_echo(command, is_query=False)
                continue
            reply = self._take_echo(command) if self.description.echo else self._line(command)
            if expected is not True and reply.strip() != expected:  # the command may have been followed all the same
                raise MachineGoneError(
                    f"'{command}' was answered with {quoted(reply)}, and acknowledge in the machine file is "
                    f"'{expected}'; the machine has refused the command, or the text in the file is wrong"
                )
            self._unanswered.clear()

    def _take_echo(self, request: str, *, is_query: bool = True) -> str:
        """Return the reply that follows the repeated request; empty for a command without reply."""
        line = self._line(request)
        if not line.strip().startswith(request.strip()):
            raise MachineGoneError(
                f"'{request}' was answered with {quoted(line)}, which does not repeat it; remove echo from the machine "
                "file if the machine does not repeat requests"
            )
        rest = line.strip().removeprefix(request.strip())
        return rest if rest or not is_query else self._line(request)

    def _line(self, request: str) -> str:
        try:
            line: bytes = self._resource.read_bytes(_LONGEST_REPLY, break_on_termchar=True)
        except (pyvisa.Error, OSError) as error:
            raise MachineGoneError(self._silence(request, error)) from error
        try:
            text = line.decode()
        except UnicodeDecodeError:
            text = line.decode("latin-1")
        if len(line) == _LONGEST_REPLY:
            raise MachineGoneError(
                f"'{request}' was answered with more than {_LONGEST_REPLY - 1} characters, {shown(text)}...: "
                "check query and read_termination"
            )
        return text

    def _write(self, request: str) -> None:
        try:
            self._resource.write(request)
        except (pyvisa.Error, OSError) as error:
            raise MachineGoneError(f"'{request}' cannot be sent: {error}") from error

    def _check_nothing_follows(self, wait_s: float) -> None:
        rest = self._rest(wait_s)
        if not rest:
            return  # as it should be; a lost connection fails at the next query
        if not rest.strip():
            end = self.description.end_of_reply + rest
            advice = f"replies end with {end!r}: write read_termination: {_yaml(end)}"
        elif self._is_repeated(rest):
            advice = "it repeats requests: add echo: true"
        else:
            advice = f"if it acknowledges commands, add acknowledge: {_yaml(rest.strip())} or switch that off"
        raise MachineGoneError(f"it sent more than was requested, {shown(rest)}; {advice}")

    def _rest(self, wait_s: float) -> str:
        """Return what the machine has sent without a request within this time."""
        patience, rest, wait_ms = self._resource.timeout, b"", math.ceil(1e3 * wait_s)
        try:
            while len(rest) < _LONGEST_REST:
                self._resource.timeout = (min(wait_ms, _NEXT_BYTE_MS) if rest else wait_ms) or VI_TMO_IMMEDIATE
                rest += self._resource.read_bytes(1)
        except (pyvisa.Error, OSError):
            pass  # nothing more to read
        finally:
            self._resource.timeout = patience
        return rest.decode("latin-1")

    def _unfit(self, reply: str, error: UnfitReplyError) -> MachineGoneError:
        """Return the error of a reply that does not fit, which may be a line that belongs to no query."""
        if self._is_repeated(reply):
            return MachineGoneError(f"{error}: it repeats requests: add echo: true")
        if self._unanswered and not error.cure and len(reply.strip()) <= _LONGEST_ACKNOWLEDGEMENT:
            return MachineGoneError(
                f"{error}; if it answered the command '{self._unanswered[0]}' with it, add acknowledge: "
                f"{_yaml(reply.strip())}"
            )
        return error

    def _is_repeated(self, text: str) -> bool:
        description = self.description
        requests = [*description.start, *description.hold, *(entry.query for _, entry in description.entries())]
        return any(text.strip().startswith(each.strip()) for each in requests if each.strip())

    def _silence(self, request: str, error: Exception) -> str:
        """Return why a request has no answer.

        Before the first answers that fit, the reason may lie in the machine file and is looked for. What has arrived
        without the end of a reply is lost with the error, so that a query is sent once more.
        """
        description = self.description
        if not (isinstance(error, pyvisa.VisaIOError) and error.error_code == StatusCode.error_timeout):
            return f"'{request}' has no answer: {error}"
        sentence = f"'{request}' has no answer within {description.timeout_s:g} s"
        is_query = any(request == entry.query for _, entry in description.entries())
        if self._understood or not (is_query or request in description.start):
            return sentence
        try:
            late = self._rest(max(2 * description.timeout_s, _LATE_S))
            if is_query and not late:
                self._resource.write(request)
                late = self._rest(description.timeout_s)
        except (pyvisa.Error, OSError):
            return sentence
        return f"{sentence}; {self._cure_of_silence(late, is_query=is_query)}"

    def _cure_of_silence(self, late: str, *, is_query: bool) -> str:
        description = self.description
        end, found = description.end_of_reply, late[len(late.rstrip("\r\n")) :]
        line = [_LINE] if description.is_serial else []
        if late.endswith(end):
            return f"{shown(late)} came later: increase timeout_s"
        if found:
            return f"it sent {shown(late)}, whose end is not {end!r}: write read_termination: {_yaml(found)}"
        if late:
            return f"it sent {shown(late)} without {end!r} at the end: check {', '.join(['read_termination', *line])}"
        expected = {"echo": description.echo, "acknowledge": description.acknowledge is not None}
        unmet = [f"{key} (remove it if the machine sends none)" for key, is_expected in expected.items() if is_expected]
        checks = ["the query"] if is_query else unmet
        checks += [f"write_termination, now {description.end_of_request!r}", "timeout_s", *line]
        return f"check {', '.join(checks)}"


def _yaml(text: str) -> str:
    return json.dumps(text)  # quotes and escapes of JSON are those of YAML
