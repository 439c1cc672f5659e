"""Topics of ROS 2 for Foxglove, by its WebSocket protocol: those of a recording, or of any other source."""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import math
import queue
import re
import socket
import struct
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from enum import IntEnum
from http import HTTPStatus
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

from fringedic.errors import OperatorError
from fringedic.recording.reader import BagReader
from fringedic.recording.topics import RawMessage
from fringedic.report.page_server.access import new_token
from fringedic.wording.causes import cause_of
from fringedic.wording.optional_packages import optional_import

LOCAL = "127.0.0.1"  # the connection is not encrypted: other computers are not served
TICK_S = 0.02
PROTOCOL = "foxglove.sdk.v1"
SILENT_S = 10.0  # until a connection has sent its request
MOST_VIEWERS = 20
LONGEST_MESSAGE = 1 << 20  # [byte] of a viewer: a subscription of all topics
BACKLOG = 64_000_000  # [byte] that wait for a slow viewer; then it misses messages
# Web pages that may connect: the application of Foxglove, its desktop application, and pages of this computer.
_ORIGINS = re.compile(
    r"https://(app|studio)\.foxglove\.dev|foxglove://.*|file://|https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?"
)
_MESSAGE, _TIME, _PLAYBACK = 1, 2, 5  # opcodes of the server
_PLAYBACK_CONTROL = 3  # of a viewer
_CONTROL = struct.Struct("<BBfBQI")  # opcode, command, speed, whether to seek, time [ns], length of the identifier


class PlayStatus(IntEnum):
    """State of the playing of a recording, as the protocol numbers it."""

    PLAYING = 0
    PAUSED = 1
    ENDED = 3


class PlayRequest(NamedTuple):
    """What a viewer asks of the playing of a recording.

    Attributes
    ----------
    is_play
        Whether to play; otherwise to pause.
    speed
        Recorded seconds in a second.
    seek_ns
        Time to go to; None: where it is.
    identifier
        Repeated in the answer.
    """

    is_play: bool
    speed: float
    seek_ns: int | None
    identifier: str


class TopicServer:
    """Serves topics to viewers on this computer; viewers cannot publish, call services or set parameters.

    A viewer needs the token of `url`, because every user and every web page of the computer reaches the port. Web pages
    other than those of Foxglove and of this computer are refused with the token, too.

    Parameters
    ----------
    port
        Port of the server; 0 takes a free one.
    name
        Shown by the viewer.
    span
        Log times of a recording [ns]; the viewer then shows its own controls for playing.

    Attributes
    ----------
    requests
        What viewers have asked for, to be taken by the owner: ``("watch", topic)`` of the first viewer of a topic,
        ``("leave", topic)`` of the last one, or ``("play", PlayRequest)`` of the controls for playing.

    Raises
    ------
    FringedicError
        websockets is not installed.
    OperatorError
        The port is in use.
    """

    def __init__(self, port: int, name: str, span: tuple[int, int] | None = None) -> None:
        with optional_import("foxglove"):
            import websockets.asyncio.server  # noqa: F401, used in the thread of the server
        self._name, self._span = name, span
        self._token, self._session = new_token(), new_token()
        self._topics: set[str] = set()
        self._channels: list[dict[str, Any]] = []  # their descriptions, in the thread of the server
        self._watchers: Counter[str] = Counter()
        self._viewers: set[Viewer] = set()
        self.requests: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        try:
            self._listening = socket.create_server((LOCAL, port))
        except OSError as error:
            raise OperatorError(
                f"port {port}: Foxglove cannot be served ({cause_of(error)}); choose another --port"
            ) from error
        self._loop, self._ended = asyncio.new_event_loop(), asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="foxglove", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Address for the viewer, with the token."""
        return f"ws://{LOCAL}:{self._listening.getsockname()[1]}/?token={self._token}"

    @property
    def topics(self) -> set[str]:
        """Names of the topics that are offered."""
        return set(self._topics)

    def offer(self, topic: str, type_name: str, definition: str) -> None:
        """Offer a topic with serialised messages of ROS 2.

        Parameters
        ----------
        topic, type_name
            ``/rig/camera/image_raw``, ``sensor_msgs/msg/Image``.
        definition
            Full text of the message definition, as of `fringedic.recording.Topic`.
        """
        self._topics.add(topic)
        channel = {"id": len(self._topics), "topic": topic, "encoding": "cdr", "schemaName": type_name}
        self._loop.call_soon_threadsafe(self._add, channel | {"schemaEncoding": "ros2msg", "schema": definition})

    def is_watched(self, topic: str) -> bool:
        """Return whether a viewer wants the messages of a topic."""
        return self._watchers[topic] > 0

    def send(self, topic: str, data: bytes, log_time: int) -> None:
        """Send a message with its log time [ns] to the viewers of its topic."""
        if self.is_watched(topic):
            self._loop.call_soon_threadsafe(self._publish, topic, data, log_time)

    def show_time(
        self, status: PlayStatus, time_ns: int, speed: float, *, is_sought: bool = False, identifier: str = ""
    ) -> None:
        """Show the present time of a recording, and the state of its playing."""
        state = struct.pack("<BBQfBI", _PLAYBACK, status, time_ns, speed, is_sought, len(identifier.encode()))
        self._loop.call_soon_threadsafe(self._show, struct.pack("<BQ", _TIME, time_ns), state + identifier.encode())

    def close(self) -> None:
        """End the server."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._ended.set)
            self._thread.join()

    # in the thread of the server

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        from websockets.asyncio.server import serve
        from websockets.typing import Subprotocol

        silent = logging.Logger("foxglove", logging.CRITICAL + 1)  # a traceback for everything that is no request
        async with serve(
            self._converse,
            sock=self._listening,
            subprotocols=[Subprotocol(PROTOCOL)],
            process_request=self._refusal,
            compression=None,
            open_timeout=SILENT_S,
            max_size=LONGEST_MESSAGE,
            server_header=None,
            logger=silent,
        ):
            await self._ended.wait()

    def _refusal(self, connection: Any, request: Any) -> Any:
        """Return the answer to a request that may not connect; None for one that may."""
        origin = request.headers.get("Origin")
        if origin is not None and not _ORIGINS.fullmatch(origin):
            return connection.respond(HTTPStatus.FORBIDDEN, "Web pages other than Foxglove's are refused.\n")
        (token, *_) = parse_qs(urlsplit(request.path).query).get("token", [""])
        if not hmac.compare_digest(token.encode(), self._token.encode()):
            return connection.respond(
                HTTPStatus.FORBIDDEN, "The address has no or a wrong token: copy it completely from the terminal.\n"
            )
        if len(self._viewers) >= MOST_VIEWERS:
            return connection.respond(
                HTTPStatus.SERVICE_UNAVAILABLE, f"{MOST_VIEWERS} viewers are connected: close one of them.\n"
            )
        return None

    async def _converse(self, connection: Any) -> None:
        """Serve one viewer until it leaves."""
        from websockets.exceptions import ConnectionClosed

        viewer = Viewer()
        self._viewers.add(viewer)
        viewer.say(self._description())
        viewer.say({"op": "advertise", "channels": self._channels})
        sending = asyncio.create_task(viewer.send_all(connection))
        try:
            with suppress(ConnectionClosed):
                async for message in connection:
                    try:
                        self._take(viewer, message)
                    except (ValueError, LookupError, TypeError, RecursionError, struct.error):
                        viewer.say({"op": "status", "level": 2, "message": "The message is not of the protocol."})
        finally:
            sending.cancel()
            self._viewers.discard(viewer)
            self._leave(viewer, list(viewer.watched))

    def _description(self) -> dict[str, Any]:
        capabilities = [] if self._span is None else ["time", "playbackControl"]
        content: dict[str, Any] = {
            "op": "serverInfo",
            "name": self._name,
            "capabilities": capabilities,
            "supportedEncodings": ["cdr"],
        }
        content |= {"metadata": {}, "sessionId": self._session}
        for key, time_ns in zip(("dataStartTime", "dataEndTime"), self._span or (), strict=False):
            content[key] = {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}
        return content

    def _take(self, viewer: Viewer, message: str | bytes) -> None:
        """Carry out what a viewer asks for; errors of any kind say that it is not of the protocol."""
        if isinstance(message, bytes):
            self.requests.put(("play", _play_request(message)))
            return
        content = json.loads(message)
        if content["op"] == "subscribe":
            for each in content["subscriptions"]:
                self._watch(viewer, int(each["id"]), self._channels[int(each["channelId"]) - 1]["topic"])
        elif content["op"] == "unsubscribe":
            self._leave(viewer, content["subscriptionIds"])

    def _watch(self, viewer: Viewer, number: int, topic: str) -> None:
        struct.pack("<I", number)  # which every message contains
        if number not in viewer.watched:
            viewer.watched[number] = topic
            self._watchers[topic] += 1
            self.requests.put(("watch", topic))

    def _leave(self, viewer: Viewer, numbers: Sequence[int]) -> None:
        for number in numbers:
            topic = viewer.watched.pop(number)
            self._watchers[topic] -= 1
            if not self._watchers[topic]:
                self.requests.put(("leave", topic))

    def _add(self, channel: dict[str, Any]) -> None:
        self._channels.append(channel)
        for viewer in self._viewers:
            viewer.say({"op": "advertise", "channels": [channel]})

    def _publish(self, topic: str, data: bytes, log_time: int) -> None:
        for viewer in self._viewers:
            for number, watched in viewer.watched.items():
                if watched == topic:
                    viewer.put(struct.pack("<BIQ", _MESSAGE, number, log_time) + data)

    def _show(self, *messages: bytes) -> None:
        for viewer in self._viewers:
            for message in messages:
                viewer.put(message)


class Viewer:
    """The subscriptions of one viewer, and what it has still to receive.

    Attributes
    ----------
    watched
        Topic of each subscription, by its number.
    """

    def __init__(self) -> None:
        self.watched: dict[int, str] = {}
        self._waiting: deque[bytes | str] = deque()
        self._size = 0
        self._filled = asyncio.Event()

    def say(self, content: dict[str, Any]) -> None:
        """Send a text."""
        self.put(json.dumps(content))

    def put(self, payload: bytes | str) -> None:
        """Send something; messages of topics are dropped when more waits than a viewer may leave waiting."""
        if self._size > BACKLOG:
            kept = [each for each in self._waiting if isinstance(each, str) or each[0] != _MESSAGE]
            self._waiting, self._size = deque(kept), sum(map(len, kept))
        self._waiting.append(payload)
        self._size += len(payload)
        self._filled.set()

    async def send_all(self, connection: Any) -> None:
        """Send what waits, until the connection ends."""
        from websockets.exceptions import ConnectionClosed

        with suppress(ConnectionClosed):
            while True:
                while not self._waiting:
                    self._filled.clear()
                    await self._filled.wait()
                payload = self._waiting.popleft()
                self._size -= len(payload)
                await connection.send(payload)


def _play_request(message: bytes) -> PlayRequest:
    """Return what a viewer asks of the playing.

    Raises
    ------
    ValueError, struct.error
        The message is not of the protocol.
    """
    opcode, command, speed, is_sought, seek_ns, length = _CONTROL.unpack_from(message)
    if opcode != _PLAYBACK_CONTROL or command not in (0, 1) or not 0 <= speed < math.inf:
        raise ValueError("no control of the playing")
    identifier = message[_CONTROL.size : _CONTROL.size + length].decode()
    return PlayRequest(command == 0, speed or 1.0, seek_ns if is_sought else None, identifier)


class RecordingPlayer:
    """Plays a recording to the viewers of a server, at its own pace or as they wish.

    It plays when the first viewer has come. A viewer first receives the last message of each topic before the present
    time: a map or a calibration is published once for all that follows.

    Parameters
    ----------
    path
        As of `fringedic.recording.BagReader`.
    port
        As of `TopicServer`.
    clock
        Returns the time [s].

    Raises
    ------
    FringedicError
        websockets is not installed, the port is in use, or there is no such recording.
    """

    def __init__(self, path: Path, port: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._reader = BagReader(path)
        self._first, self._last = self._reader.start_time, self._reader.end_time
        self.server = TopicServer(port, Path(path).name, (self._first, self._last))
        for topic in self._reader.topics.values():
            if topic.encoding == "ros2msg":
                self.server.offer(topic.name, topic.type_name, topic.definition)
        self._clock, self._seen = clock, clock()
        self._time, self._speed, self._identifier = self._first, 1.0, ""
        self._watched: set[str] = set()
        self._messages: Iterator[RawMessage]
        self._upcoming: RawMessage | None
        self._is_playing = self._has_played = False
        self._seek(self._first)

    def close(self) -> None:
        """End the server."""
        self.server.close()

    def spin_once(self) -> None:
        """Answer the viewers, and send what is due."""
        watched = []
        while not self.server.requests.empty():
            kind, content = self.server.requests.get()
            if kind == "watch":
                watched.append(content)
                self._watched.add(content)
            elif kind == "leave" and not self.server.is_watched(content):
                self._watched.discard(content)
            elif kind == "play":
                self._identifier, self._speed = content.identifier, content.speed
                self._is_playing, self._has_played = content.is_play, True
                if content.seek_ns is not None:
                    self._seek(content.seek_ns)
                elif self._is_playing and self._time >= self._last:
                    self._seek(self._first)
                self._show_time(is_sought=content.seek_ns is not None)
        due = self._last + 1 if self._upcoming is None else self._upcoming.log_time
        for message in self._reader.newest(watched, due):
            self._send(message)
        if watched and not self._has_played:
            self._is_playing = self._has_played = True
        now = self._clock()
        passed, self._seen = now - self._seen, now
        if self._is_playing:
            self._time = min(self._time + round(1e9 * passed * self._speed), self._last)
            while self._upcoming is not None and self._upcoming.log_time <= self._time:
                self._send(self._upcoming)
                self._upcoming = next(self._messages, None)
            self._is_playing = self._time < self._last
            self._show_time()
        time.sleep(TICK_S)

    def _seek(self, time_ns: int) -> None:
        self._time = min(max(time_ns, self._first), self._last)
        self._messages = self._reader.raw(self.server.topics, start=self._time)
        self._upcoming = next(self._messages, None)
        for message in self._reader.newest(self._watched, self._time):
            self._send(message)

    def _send(self, message: RawMessage) -> None:
        if message.topic in self._watched:
            self.server.send(message.topic, message.data, message.log_time)

    def _show_time(self, *, is_sought: bool = False) -> None:
        ended = PlayStatus.ENDED if self._time >= self._last else PlayStatus.PAUSED
        status = PlayStatus.PLAYING if self._is_playing else ended
        identifier, self._identifier = self._identifier, ""
        self.server.show_time(status, self._time, self._speed, is_sought=is_sought, identifier=identifier)
