"""The web server in a thread of its own, with its address, token and hosts."""

from __future__ import annotations

import asyncio
import ipaddress
import math
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol, h11  # type: ignore[attr-defined]
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.protocol import State

from fringedic.errors import OperatorError
from fringedic.report.page_server.access import Sessions, Wheel
from fringedic.report.page_server.app import Rig, make_app
from fringedic.report.page_server.guard import Guard
from fringedic.report.page_server.streams import Hub, Payload
from fringedic.wording.causes import cause_of

LONGEST_MESSAGE = 4096  # [byte] of a browser on the stream: it has nothing to say there
ENDING_S = 8.0  # longer than the end of a process of an evaluation
SILENT_S = 10.0  # until a connection has sent its request; it needs no token to be open
MOST_SILENT = 50  # connections that may wait so at the same time
_ENDED = """HTTP/1.1 408 Request Timeout\r
Connection: close\r
Content-Type: text/plain\r
\r
The connection was ended, because it sent no complete request.
"""


@dataclass(frozen=True)
class Address:
    """Where a page is served.

    Attributes
    ----------
    host, port
        Name or address of this computer, and port.
    token
        Secret of the printed address.
    certificate, key
        Files of TLS; None without.
    """

    host: str
    port: int
    token: str
    certificate: Path | None = None
    key: Path | None = None

    @property
    def url(self) -> str:
        """Return the address for people, with the token."""
        scheme = "http" if self.certificate is None else "https"
        return f"{scheme}://{_bracket(self.host)}:{self.port}/?token={self.token}"

    @property
    def is_local(self) -> bool:
        """Return whether only this computer can reach it."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    def hosts(self) -> list[str]:
        """Return the names with port by which browsers may address the server."""
        names = {_bracket(self.host)} | ({"localhost"} if self.is_local else {socket.gethostname()})
        return [f"{name}:{self.port}" for name in names]


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that accepts connections at an address.

    Raises
    ------
    OperatorError
        The address is not this computer's, or the port is in use.
    """
    try:
        family, _, _, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        return socket.create_server(place[:2], family=family, backlog=64)
    except OSError as error:
        raise OperatorError(
            f"{host} port {port}: the page cannot be served ({cause_of(error)}); end the other program there, "
            "or choose another --port or --address"
        ) from error


class _Connection(WebSocketsSansIOProtocol):
    """A connection that the browser has closed, and that still has something to send, is cut at the end of the server.

    The protocol of uvicorn 0.54 closes it again, which is an error that ends the thread of the server. A browser has
    nothing to say on the stream: a text is not decoded, and one that is no UTF-8 writes no traceback.
    """

    handle_text = WebSocketsSansIOProtocol.handle_bytes

    def shutdown(self) -> None:
        if self.conn.state is State.CLOSING:
            self.transport.abort()
        else:
            super().shutdown()


class _Requests(H11Protocol):
    """A connection that sends no complete request in time is ended; the longest silent one, when there are too many."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._await_request()
        silent = [each for each in self.connections if isinstance(each, _Requests) and each.is_awaited]
        if len(silent) > MOST_SILENT:
            min(silent, key=_Requests.ends_at).end()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        is_incomplete = bool(self.conn.trailing_data[0]) or self.cycle is None
        if self.conn.their_state is not h11.IDLE or not is_incomplete:
            self._forget_deadline()
        elif self._deadline is None:
            self._await_request()

    def connection_lost(self, exc: Exception | None) -> None:
        self._forget_deadline()
        super().connection_lost(exc)

    def _await_request(self) -> None:
        self._deadline = self.loop.call_later(SILENT_S, self.end)

    def _forget_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    @property
    def is_awaited(self) -> bool:
        return self._deadline is not None

    def ends_at(self) -> float:
        return self._deadline.when() if self._deadline is not None else math.inf

    def end(self) -> None:
        self._forget_deadline()
        self.transport.write(_ENDED.encode())
        self.transport.close()


class PageServer:
    """Serves the page of a rig in a thread until `close`.

    Parameters
    ----------
    rig
        What the page shows and drives.
    address
        Where it is served.

    Raises
    ------
    OperatorError
        The port is in use, or a file of TLS cannot be read.
    """

    def __init__(self, rig: Rig, address: Address) -> None:
        self.hub, self.wheel = Hub(), Wheel()
        self._listening = listen(address.host, address.port)
        app = Guard(
            make_app(rig, self.hub, self.wheel),
            Sessions(address.token),
            address.hosts(),
            f"fringedic_{address.port}",  # cookies of all ports of a computer are in one jar
            address.certificate is not None,
        )
        config = uvicorn.Config(
            app,
            http=_Requests,
            ws=_Connection,
            ws_max_size=LONGEST_MESSAGE,
            ws_per_message_deflate=False,
            log_level="warning",
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=1,
            ssl_certfile=address.certificate,
            ssl_keyfile=address.key,
        )
        try:
            config.load()
        except OSError as error:
            self._listening.close()
            raise OperatorError(f"{address.certificate}, {address.key}: no TLS certificate with its key") from error
        self._server = uvicorn.Server(config)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()

    def publish(self, topic: str, make: Callable[[], Payload]) -> None:
        """Offer a message to all browsers; from any thread."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self.hub.publish, topic, make)

    def close(self) -> None:
        """End all connections and the thread."""
        self._server.should_exit = True
        self._thread.join(ENDING_S)

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._server.serve(sockets=[self._listening]))


def _bracket(host: str) -> str:
    return f"[{host}]" if ":" in host else host
