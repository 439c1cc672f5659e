"""One slot per client and topic: the newest message replaces one that the client has not received yet."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

Payload = bytes | str


class Client:
    """The messages that one connection has still to receive.

    Parameters
    ----------
    session
        Name of its session.
    """

    def __init__(self, session: str) -> None:
        self.session = session
        self._slots: dict[str, Callable[[], Payload]] = {}
        self._filled = asyncio.Event()

    def put(self, topic: str, make: Callable[[], Payload]) -> None:
        """Fill the slot of a topic; called in the thread of the event loop."""
        self._slots.pop(topic, None)  # the topic goes to the end, so that a fast one does not starve the others
        self._slots[topic] = make
        self._filled.set()

    async def take(self) -> Payload:
        """Wait for a message and return the one that waits longest; it is made now, and left out when it is empty."""
        while True:
            while not self._slots:
                self._filled.clear()
                await self._filled.wait()
            topic = next(iter(self._slots))
            if payload := self._slots.pop(topic)():
                return payload


class Hub:
    """The connections of a server.

    A message is made when a client is ready for it, and once for all clients that want the same one.
    """

    def __init__(self) -> None:
        self.clients: set[Client] = set()

    def publish(self, topic: str, make: Callable[[], Payload]) -> None:
        """Offer a message to all clients; called in the thread of the event loop."""
        once = _Once(make)
        for client in self.clients:
            client.put(topic, once)


class _Once:
    """Calls a function at the first call only, and returns its result at every call."""

    def __init__(self, make: Callable[[], Payload]) -> None:
        self._make: Callable[[], Payload] | None = make
        self._made: Payload = b""

    def __call__(self) -> Payload:
        if self._make is not None:
            self._made, self._make = self._make(), None
        return self._made
