"""A testing machine with text replies as real ones give them: behind a TCP socket or a pseudo-terminal."""

from __future__ import annotations

import os
import select
import socket
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass
class TextInstrument:
    """Position follows a target at a speed; force is 2000 N per mm.

    Attributes
    ----------
    force, position, status, all_values
        Forms of the replies to F?, P?, S? and ALL?, with {newton}, {mm} and {word}.
    end
        What ends a reply.
    request_end
        What ends a request; characters before it belong to the request.
    acknowledgement
        Reply to a command; none if empty.
    comma
        Numbers have a decimal comma.
    echo
        Each request is repeated.
    delay_s
        Time before a reply [s].
    received
        All requests.
    """

    force: str = "{newton:.3f}"
    position: str = "{mm:.5f}"
    status: str = "{word}"
    all_values: str = "{newton:.3f};{mm:.5f};{word}"
    end: str = "\n"
    request_end: str = "\n"
    acknowledgement: str = ""
    comma: bool = False
    echo: bool = False
    delay_s: float = 0.0
    received: list[str] = field(default_factory=list)
    at_mm: float = 0.5
    target_mm: float = 0.5
    mm_per_s: float = 1.0
    _seen_s: float = field(default_factory=time.monotonic)

    def answers(self, request: str) -> str:
        """Return all that the instrument sends after a request."""
        self.received.append(request)
        now = time.monotonic()
        way, self._seen_s = self.mm_per_s * (now - self._seen_s), now
        self.at_mm += max(-way, min(way, self.target_mm - self.at_mm))
        form = {"F?": self.force, "P?": self.position, "S?": self.status, "ALL?": self.all_values}.get(request)
        if form is not None:
            word = "HOLD" if self.at_mm == self.target_mm else "RUN"
            reply = form.format(newton=2000 * self.at_mm, kn=2 * self.at_mm, mm=self.at_mm, word=word)
            reply = reply.replace(".", ",") if self.comma else reply
        else:
            self._obey(request)
            reply = self.acknowledgement
        return (request + self.end if self.echo else "") + (reply + self.end if reply else "")

    def _obey(self, request: str) -> None:
        command, _, number = request.partition(" ")
        if command == "SPEED":
            self.mm_per_s = float(number)
        elif command == "GOTO":
            self.target_mm = float(number)
        elif command == "STOP":
            self.target_mm = self.at_mm

    def serve(self, descriptor: int, ended: threading.Event) -> None:
        """Answer what arrives at a descriptor, until the other side closes it or the event is set."""
        waiting, end = b"", self.request_end.encode()
        while not ended.is_set():
            if not select.select([descriptor], [], [], 0.02)[0]:
                continue
            try:
                arrived = os.read(descriptor, 4096)
            except OSError:  # the other side of a pseudo-terminal, or of a connection, has closed it
                arrived = b""
            if not arrived:
                return
            waiting += arrived
            while end in waiting:
                request, _, waiting = waiting.partition(end)
                sent = self.answers(request.decode())
                ended.wait(self.delay_s)
                os.write(descriptor, sent.encode("latin-1"))

    @contextmanager
    def on_socket(self) -> Iterator[str]:
        """Yield the VISA resource of a TCP server for any number of connections, one after the other."""
        ended = threading.Event()
        with socket.create_server(("127.0.0.1", 0)) as listening:
            listening.settimeout(0.02)

            def accept() -> None:
                while not ended.is_set():
                    try:
                        connection, _ = listening.accept()
                    except TimeoutError:
                        continue
                    with connection:
                        self.serve(connection.fileno(), ended)

            thread = threading.Thread(target=accept)
            thread.start()
            try:
                yield f"TCPIP::127.0.0.1::{listening.getsockname()[1]}::SOCKET"
            finally:
                ended.set()
                thread.join()

    @contextmanager
    def on_line(self) -> Iterator[tuple[str, int]]:
        """Yield the VISA resource of a pseudo-terminal, and the descriptor of its side for the computer."""
        instrument_side, computer_side = os.openpty()
        tty.setraw(computer_side)
        ended = threading.Event()
        thread = threading.Thread(target=self.serve, args=(instrument_side, ended))
        thread.start()
        try:
            yield f"ASRL{os.ttyname(computer_side)}::INSTR", computer_side
        finally:
            ended.set()
            thread.join()
            os.close(instrument_side)
            os.close(computer_side)
