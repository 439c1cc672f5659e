"""Replies of machines that are wrong in every way; HOLD may only be believed when the machine said it.

Long form: ``python tests/fuzzed_replies.py 100000``.
"""

from __future__ import annotations

import random
import socket
import struct
import sys
import threading
from collections import Counter
from collections.abc import Callable
from typing import Any

from fringedic.errors import MachineError
from load_frame_node.machines import LoadMode, ModbusDescription, ScpiDescription, open_machine

KINDS = ("scpi", "scpi with keys", "modbus", "modbus with keys")
HOLD, MOVING = 2, 1
HOLD_BITS, MOVING_BITS = 0b1001, 0b0001  # bit 0 is set, bit 3 tells a hold
TIMEOUT_S = 0.01
LONGEST_MESSAGE = 500
NONSENSE = (
    b"--5", b"+-3", b"5" * 5000, b"1e308", b"-1e400", b"nan", b"inf", b"", b" ", b"\xff\xfe", b"1_0", "\u0663".encode(),
    b"0x10", b"2\n2", b"2\n2\n2", b"1.5\n2", b"HOLD", b"2.0", b"+2", b"02", b"2 2", b"1,5", b"\x00", b"2\r", b"e5",
    b"2 N", b"3 mm", b"2;1", b"- 2", b"OK",
)  # fmt: skip


class FuzzedMachine:
    """A machine on a socket of this process whose replies are partly wrong.

    Parameters
    ----------
    seed
        Of its mistakes.
    converse
        Answers the next request of a connection.

    Attributes
    ----------
    statuses
        What the machine said of its state in the replies so far, None where it said nothing readable.
    """

    def __init__(self, seed: int, converse: Callable[[FuzzedMachine, socket.socket], bool]) -> None:
        self.random = random.Random(seed)
        self.statuses: list[Any] = []
        self._converse = converse
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()

    def close(self) -> None:
        """End the machine."""
        self._listening.close()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listening.accept()
            except OSError:
                return
            with connection:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                try:
                    while self._converse(self, connection):
                        pass
                except OSError:
                    continue


def say(machine: FuzzedMachine, connection: socket.socket) -> bool:
    """Answer a query as text."""
    query = b""
    while not query.endswith(b"\n"):
        received = connection.recv(64)
        if not received:
            return False
        query += received
    number = (
        str(machine.random.choice((HOLD, MOVING))).encode() if b"S?" in query else b"%.3f" % machine.random.random()
    )
    reply = number if machine.random.random() < 0.8 else machine.random.choice(NONSENSE)
    if b"S?" in query:
        machine.statuses.append(reply.strip())
    connection.sendall(reply + b"\n")
    return True


def say_in_one_line(machine: FuzzedMachine, connection: socket.socket) -> bool:
    """Repeat a query, and answer it with status, force and position in one line, with units and decimal commas."""
    query = b""
    while not query.endswith(b"\r"):
        received = connection.recv(64)
        if not received:
            return False
        query += received
    status = str(machine.random.choice((HOLD, MOVING))).encode()
    values = [status, b"%.3f N" % machine.random.random(), b"%.3f mm" % machine.random.random()]
    values = [each.replace(b".", b",") for each in values]
    change = machine.random.random()
    if change < 0.1:
        values[machine.random.randrange(3)] = machine.random.choice(NONSENSE)
    elif change < 0.15:
        machine.random.shuffle(values)
    reply = b";".join(values)
    if 0.15 < change < 0.2:
        reply = reply[: machine.random.randrange(len(reply))]
    machine.statuses.append(reply.split(b";")[0].strip())
    echo = query.strip() if change < 0.95 else machine.random.choice((b"", b"ERROR", query[:2]))
    connection.sendall(echo + b"\r\n" + reply + b"\r\n")
    return True


def send_registers(machine: FuzzedMachine, connection: socket.socket) -> bool:
    """Answer a request for registers with a frame of Modbus TCP, of which bytes may be wrong, missing or too many."""
    return _send_registers(machine, connection, are_swapped=False)


def send_swapped_registers(machine: FuzzedMachine, connection: socket.socket) -> bool:
    """Answer as `send_registers`, with swapped bytes and the status as bits."""
    return _send_registers(machine, connection, are_swapped=True)


def _send_registers(machine: FuzzedMachine, connection: socket.socket, *, are_swapped: bool) -> bool:
    request = connection.recv(260)
    if not request:
        return False
    transaction, unit, function, _, count = struct.unpack(">H4xBBHH", request[:12])
    if are_swapped:
        status = machine.random.choice((HOLD_BITS, MOVING_BITS)) | machine.random.randrange(16) << 8
        values = struct.pack(">ffI", machine.random.random(), machine.random.random(), status)
        values = bytes(values[position ^ 1] for position in range(len(values)))
    else:
        status = machine.random.choice((HOLD, MOVING))
        values = struct.pack(">fff", machine.random.random(), machine.random.random(), status)
    change = machine.random.random()
    if change < 0.2:
        position = machine.random.randrange(len(values))
        values = values[:position] + machine.random.randbytes(1) + values[position + 1 :]
    elif change < 0.3:
        values = machine.random.choice((values[:-2], values + b"\0\0", machine.random.randbytes(12)))
    content = struct.pack(">BBB", unit, function, len(values)) + values
    frame = struct.pack(">HHH", transaction, 0, len(content)) + content
    if change > 0.95:
        frame = frame[: machine.random.randrange(len(frame))]
    if len(values) != 2 * count:
        machine.statuses.append(None)
    elif are_swapped:
        machine.statuses.append(struct.unpack(">I", bytes(values[position ^ 1] for position in range(8, 12)))[0])
    else:
        machine.statuses.append(struct.unpack(">f", values[8:12])[0])
    connection.sendall(frame)
    return True


def description(kind: str, port: int) -> ScpiDescription | ModbusDescription:
    """Return the description of a machine on this computer."""
    keys: dict[str, Any] = {}
    if kind.startswith("scpi"):
        common = {"protocol": "scpi", "resource": f"TCPIP::127.0.0.1::{port}::SOCKET", "timeout_s": TIMEOUT_S}
        modes = {"moving": [MOVING], "hold": [HOLD]}
        keys = {"force": {"query": "F?"}, "position": {"query": "P?"}, "status": {"query": "S?"} | modes}
        if kind == "scpi with keys":
            one_line = {"query": "ALL?", "separator": ";"}
            keys = {
                "status": {**one_line, "index": 0} | modes,
                "force": {**one_line, "index": 1, "decimal": ","},
                "position": {**one_line, "index": 2, "decimal": ","},
                "write_termination": "\r",
                "read_termination": "\r\n",
                "echo": True,
            }
        return ScpiDescription.model_validate(common | keys)
    common = {"protocol": "modbus", "host": "127.0.0.1", "port": port, "timeout_s": TIMEOUT_S}
    keys = {"status": {"register": 4, "type": "float32", "moving": [MOVING], "hold": [HOLD]}}
    if kind == "modbus with keys":
        bits = {"moving": [{"bits_set": [0], "bits_clear": [3]}], "hold": [{"bits_set": [0, 3]}]}
        keys = {"status": {"register": 4, "type": "uint32"} | bits, "byte_order": "little"}
    return ModbusDescription.model_validate(common | {"force": {"register": 0}, "position": {"register": 2}} | keys)


def _holds(kind: str, said: Any) -> bool:
    """Return whether a status that the machine has sent means a hold."""
    if kind.startswith("scpi"):
        return said in (b"2", b"+2", b"02")
    return said & HOLD_BITS == HOLD_BITS if kind == "modbus with keys" else said == HOLD


def fuzz(kind: str, replies: int, seed: int = 1) -> Counter[str]:
    """Read samples until the machine has spoken of its state this often; return how often each mode was believed.

    Raises
    ------
    AssertionError
        A hold was believed that the machine had not reported, or the other way round.
    """
    manners = dict(zip(KINDS, (say, say_in_one_line, send_registers, send_swapped_registers), strict=True))
    machine = FuzzedMachine(seed, manners[kind])
    modes: Counter[str] = Counter()
    connected = None
    try:
        while len(machine.statuses) < replies:
            try:
                if connected is None:
                    connected = open_machine(description(kind, machine.port))
                sample = connected.sample()
            except MachineError as error:
                modes["refused" if len(str(error)) <= LONGEST_MESSAGE else "refused at length"] += 1
                if connected is not None:
                    connected.close()  # a new one connects at once, the old one would pause
                connected = None
                continue
            said = machine.statuses[-1]
            assert (sample.mode is LoadMode.HOLD) == _holds(kind, said), f"{said!r} was taken for {sample.mode.name}"
            modes[sample.mode.name] += 1
    finally:
        if connected is not None:
            connected.close()
        machine.close()
    return modes


if __name__ == "__main__":
    for name in KINDS:
        sys.stdout.write(f"{name}: {dict(fuzz(name, int(sys.argv[1])))}\n")
