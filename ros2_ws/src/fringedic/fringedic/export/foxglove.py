"""Topics of ROS 2 for Foxglove, by its WebSocket protocol: those of a recording, or of any other source."""

from __future__ import annotations

import queue
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

from fringedic.errors import OperatorError
from fringedic.recording.reader import BagReader
from fringedic.recording.topics import RawMessage
from fringedic.wording.optional_packages import optional_import

LOCAL = "127.0.0.1"  # the protocol has no token: other computers are not served
TICK_S = 0.02


class TopicServer:
    """Serves topics to viewers on this computer; viewers cannot publish, call services or set parameters.

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
        ``("leave", topic)`` of the last one, or ``("play", request)`` of the controls for playing.

    Raises
    ------
    FringedicError
        foxglove-sdk is not installed.
    OperatorError
        The port is in use.
    """

    def __init__(self, port: int, name: str, span: tuple[int, int] | None = None) -> None:
        with optional_import("foxglove"):
            import foxglove
        self._sdk = foxglove
        self._context = foxglove.Context()
        self._channels: dict[str, foxglove.Channel] = {}
        self._viewers: Counter[str] = Counter()
        self.requests: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        try:
            self._server = foxglove.start_server(
                name=name,
                host=LOCAL,
                port=port,
                capabilities=[] if span is None else [foxglove.websocket.Capability.Time],
                server_listener=cast("Any", self),  # its methods are those of the protocol
                supported_encodings=["cdr"],
                context=self._context,
                playback_time_range=span,
            )
        except RuntimeError as error:
            raise OperatorError(f"port {port}: Foxglove cannot be served ({error}); choose another --port") from error

    @property
    def url(self) -> str:
        """Address for the viewer."""
        return f"ws://{LOCAL}:{self._server.port}"

    @property
    def topics(self) -> set[str]:
        """Names of the topics that are offered."""
        return set(self._channels)

    def offer(self, topic: str, type_name: str, definition: str) -> None:
        """Offer a topic with serialised messages of ROS 2.

        Parameters
        ----------
        topic, type_name
            ``/rig/camera/image_raw``, ``sensor_msgs/msg/Image``.
        definition
            Full text of the message definition, as of `fringedic.recording.Topic`.
        """
        schema = self._sdk.Schema(name=type_name, encoding="ros2msg", data=definition.encode())
        self._channels[topic] = self._sdk.Channel(topic, schema=schema, message_encoding="cdr", context=self._context)

    def is_watched(self, topic: str) -> bool:
        """Return whether a viewer wants the messages of a topic."""
        return self._viewers[topic] > 0

    def send(self, topic: str, data: bytes, log_time: int) -> None:
        """Send a message with its log time [ns] to the viewers of its topic."""
        self._channels[topic].log(data, log_time=log_time)

    def show_time(self, state: Any, time_ns: int) -> None:
        """Show the present time of a recording, and the state of its playing."""
        self._server.broadcast_time(time_ns)
        self._server.broadcast_playback_state(state)

    def close(self) -> None:
        """End the server."""
        self._server.stop()

    # called by the SDK, in its threads

    def on_subscribe(self, _: Any, channel: Any) -> None:
        """Count a viewer of a topic."""
        self._viewers[channel.topic] += 1
        self.requests.put(("watch", channel.topic))

    def on_unsubscribe(self, _: Any, channel: Any) -> None:
        """Count a viewer that has left a topic."""
        self._viewers[channel.topic] -= 1
        if not self._viewers[channel.topic]:
            self.requests.put(("leave", channel.topic))

    def on_playback_control_request(self, request: Any) -> None:
        """Pass on what a viewer asks for; the answer follows with the next time."""
        self.requests.put(("play", request))


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
        foxglove-sdk is not installed, the port is in use, or there is no such recording.
    """

    def __init__(self, path: Path, port: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._reader = BagReader(path)
        self._first, self._last = self._reader.start_time, self._reader.end_time
        self.server = TopicServer(port, Path(path).name, (self._first, self._last))
        for topic in self._reader.topics.values():
            if topic.encoding == "ros2msg":
                self.server.offer(topic.name, topic.type_name, topic.definition)
        self._clock, self._seen = clock, clock()
        self._time, self._speed, self._request_id = self._first, 1.0, ""
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
                from foxglove.websocket import PlaybackCommand

                self._request_id, self._speed = content.request_id, content.playback_speed or 1.0
                self._is_playing, self._has_played = content.playback_command == PlaybackCommand.Play, True
                if content.seek_time is not None:
                    self._seek(content.seek_time)
                elif self._is_playing and self._time >= self._last:
                    self._seek(self._first)
                self._show_time(sought=content.seek_time is not None)
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
            self._show_time(sought=False)
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

    def _show_time(self, *, sought: bool) -> None:
        from foxglove.websocket import PlaybackState, PlaybackStatus

        ended = PlaybackStatus.Ended if self._time >= self._last else PlaybackStatus.Paused
        status = PlaybackStatus.Playing if self._is_playing else ended
        self.server.show_time(PlaybackState(status, self._time, self._speed, sought, self._request_id), self._time)
        self._request_id = ""
