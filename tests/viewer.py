"""A client of the protocol of Foxglove."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

LAYOUT = Path(__file__).parents[1] / "docs" / "foxglove" / "fringedic.json"
WAIT_S = 90.0  # for a message on a busy computer
MESSAGE, TIME, PLAYBACK = 1, 2, 5  # opcodes of the server
CONTROL = 3  # of a client


class Viewer:
    """Subscribes to topics and collects their messages.

    Parameters
    ----------
    connection
        To the server.

    Attributes
    ----------
    topics
        Channel of each topic that the server has announced.
    messages
        (topic, data, log time [ns]) in the order of their arrival.
    info
        What the server says of itself.
    """

    def __init__(self, connection: ClientConnection) -> None:
        self._socket = connection
        self.topics: dict[str, dict[str, Any]] = {}
        self.messages: list[tuple[str, bytes, int]] = []
        self.info: dict[str, Any] = {}
        self.ended = False
        self._watched: dict[int, str] = {}

    def watch(self, *topics: str) -> None:
        """Subscribe to topics as soon as they are announced."""
        for topic in topics:
            while topic not in self.topics:
                self.read(WAIT_S)
            number = len(self._watched) + 1
            self._watched[number] = topic
            channel = self.topics[topic]["id"]
            self._send({"op": "subscribe", "subscriptions": [{"id": number, "channelId": channel}]})

    def control(self, *, play: bool, seek: int) -> None:
        """Ask for playing from a time [ns] on, or for a pause there."""
        self._socket.send(struct.pack("<BBfBQI", CONTROL, 0 if play else 1, 1.0, 1, seek, 1) + b"1")

    def read(self, timeout_s: float) -> None:
        """Read one message of the server."""
        received = self._socket.recv(timeout_s)
        if isinstance(received, str):
            self._take(json.loads(received))
        elif received[0] == MESSAGE:
            number, time = struct.unpack_from("<IQ", received, 1)
            self.messages.append((self._watched[number], received[13:], time))
        elif received[0] == PLAYBACK:
            self.ended = received[1] == 3

    def received(self, count: int) -> Iterator[tuple[str, bytes, int]]:
        """Wait until there are so many messages, and return and forget them."""
        while len(self.messages) < count:
            self.read(WAIT_S)
        found, self.messages = self.messages, []
        yield from found

    def _take(self, content: dict[str, Any]) -> None:
        if content["op"] == "serverInfo":
            self.info = content
        elif content["op"] == "advertise":
            self.topics |= {channel["topic"]: channel for channel in content["channels"]}

    def _send(self, content: dict[str, Any]) -> None:
        self._socket.send(json.dumps(content))


@contextmanager
def viewing(url: str) -> Iterator[Viewer]:
    """Connect a viewer to a server."""
    with connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None) as connection:  # type: ignore[list-item]
        yield Viewer(connection)


def drawn(layout: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Every topic of the panels of a layout, with the field that is drawn."""
    for panel in layout["configById"].values():
        for path in panel.get("paths", ()):
            topic, _, field = path["value"].partition(".")
            yield topic, field
        yield from ((topic, "") for topic in panel.get("topics", ()))
        for topic in (panel.get("imageMode", {}).get("imageTopic"), panel.get("topicToRender"), panel.get("topicPath")):
            if topic:
                yield topic, ""
