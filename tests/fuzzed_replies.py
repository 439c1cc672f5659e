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

HOLD, MOVING = 2, 1
TIMEOUT_S = 0.01
LONGEST_MESSAGE = 500
NONSENSE = (
    b"--5", b"+-3", b"5" * 5000, b"1e308", b"-1e400", b"nan", b"inf", b"", b" ", b"\xff\xfe", b"1_0", "\u0663".encode(),
    b"0x10", b"2\n2", b"2\n2\n2", b"1.5\n2", b"HOLD", b"2.0", b"+2", b"02", b"2 2", b"1,5", b"\x00", b"2\r", b"e5",
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


def send_registers(machine: FuzzedMachine, connection: socket.socket) -> bool:
    """Answer a request for registers with a frame of Modbus TCP, of which bytes may be wrong, missing or too many."""
    request = connection.recv(260)
    if not request:
        return False
    transaction, unit, function, _, count = struct.unpack(">H4xBBHH", request[:12])
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
    machine.statuses.append(struct.unpack(">f", values[8:12])[0] if len(values) == 2 * count else None)
    connection.sendall(frame)
    return True


def description(protocol: str, port: int) -> ScpiDescription | ModbusDescription:
    """Return the description of a machine on this computer, whose status 2 means that it holds."""
    modes = {"moving": [MOVING], "hold": [HOLD]}
    if protocol == "scpi":
        return ScpiDescription.model_validate(
            {
                "protocol": "scpi",
                "resource": f"TCPIP::127.0.0.1::{port}::SOCKET",
                "timeout_s": TIMEOUT_S,
                "force": {"query": "F?"},
                "position": {"query": "P?"},
                "status": {"query": "S?"} | modes,
            }
        )
    return ModbusDescription.model_validate(
        {
            "protocol": "modbus",
            "host": "127.0.0.1",
            "port": port,
            "timeout_s": TIMEOUT_S,
            "force": {"register": 0},
            "position": {"register": 2},
            "status": {"register": 4, "type": "float32"} | modes,
        }
    )


def fuzz(protocol: str, replies: int, seed: int = 1) -> Counter[str]:
    """Read samples until the machine has spoken of its state this often; return how often each mode was believed.

    Raises
    ------
    AssertionError
        A hold was believed that the machine had not reported, or the other way round.
    """
    machine = FuzzedMachine(seed, say if protocol == "scpi" else send_registers)
    modes: Counter[str] = Counter()
    connected = None
    try:
        while len(machine.statuses) < replies:
            try:
                if connected is None:
                    connected = open_machine(description(protocol, machine.port))
                sample = connected.sample()
            except MachineError as error:
                modes["refused" if len(str(error)) <= LONGEST_MESSAGE else "refused at length"] += 1
                if connected is not None:
                    connected.close()  # a new one connects at once, the old one would pause
                connected = None
                continue
            said = machine.statuses[-1]
            holds = said in (b"2", b"+2", b"02") if protocol == "scpi" else said == HOLD
            assert (sample.mode is LoadMode.HOLD) == holds, f"{said!r} was taken for {sample.mode.name}"
            modes[sample.mode.name] += 1
    finally:
        if connected is not None:
            connected.close()
        machine.close()
    return modes


if __name__ == "__main__":
    for name in ("scpi", "modbus"):
        sys.stdout.write(f"{name}: {dict(fuzz(name, int(sys.argv[1])))}\n")
