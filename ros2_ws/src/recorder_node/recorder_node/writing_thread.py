"""Thread that compresses and writes the messages of a recording."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Literal, NamedTuple

from fringedic.recording.topics import Qos
from fringedic.recording.writer import BagWriter

# Between middleware and disk: 13 s of 30 images/s of 1.2 MB.
BACKLOG_BYTES = 512_000_000
NICENESS = 5  # measuring a step is more urgent than compressing its messages

Order = Literal["sync", "end", "flush"] | Callable[[], None]


class ReceivedMessage(NamedTuple):
    """One message as it was received.

    Attributes
    ----------
    topic
        Full name.
    data
        The serialised message.
    received_ns, published_ns
        Times of receipt and of publishing [ns].
    sequence
        Sequence number of the publisher, where the middleware gives it.
    """

    topic: str
    data: bytes
    received_ns: int
    published_ns: int
    sequence: int | None


class WritingThread:
    """Writes to a bag in the order of `put`, away from the thread of the middleware.

    While the backlog is full, `put` blocks: the middleware then keeps the messages, for which its depth is sufficient.
    After an error, messages are discarded and `error` contains the reason.

    Parameters
    ----------
    writer
        The open bag.
    flush_interval_s
        Longest time between receipt of a message and its flush to the operating system [s].

    Attributes
    ----------
    error
        Reason why the recording ended; None while it goes on.
    messages, bytes
        Numbers of messages and bytes written so far.
    """

    def __init__(self, writer: BagWriter, flush_interval_s: float) -> None:
        self.error: Exception | None = None
        self.messages = 0
        self.bytes = 0
        self._writer = writer
        self._writer_lock = threading.Lock()
        self._flush_interval_s = flush_interval_s
        self._queue: queue.Queue[list[ReceivedMessage] | Order] = queue.Queue()
        self._waiting_bytes = 0
        self._written = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._thread.start()

    def add_topic(self, topic: str, type_name: str, offered: list[Qos], publisher_hash: str) -> None:
        """Declare a topic before its first message.

        Raises
        ------
        FringedicError, OSError
            The topic cannot be recorded.
        """
        with self._writer_lock:
            self._writer.add_topic(topic, type_name, offered, publisher_hash=publisher_hash)

    def put(self, messages: list[ReceivedMessage]) -> None:
        """Queue messages to be written; blocks while the backlog is full."""
        with self._written:
            self._written.wait_for(lambda: self._waiting_bytes < BACKLOG_BYTES)
            self._waiting_bytes += _size(messages)
        self._queue.put(messages)

    def sync(self) -> None:
        """Write everything that was queued so far to the disk, where it survives a power failure."""
        self._queue.put("sync")

    def then(self, written: Callable[[], None]) -> None:
        """Call a function in the thread that writes, when the operating system has everything that was queued so far.

        From then on a killed recorder does not lose it. After an error the function is not called.
        """
        self._queue.put(written)

    def close(self) -> None:
        """Write what is queued, close the bag and end the thread."""
        self._queue.put("end")
        self._thread.join()

    def _run(self) -> None:
        with suppress(OSError):  # only Linux has priorities of single threads
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        ended = False
        while not ended:
            item = self._next()
            ended = item == "end"
            if not self.error or ended:
                try:
                    with self._writer_lock:
                        self._handle(item)
                except Exception as error:  # a thread that ended unnoticed would lose all later messages silently
                    self.error = self.error or error
            if isinstance(item, list):
                with self._written:
                    self._waiting_bytes -= _size(item)
                    self._written.notify()

    def _next(self) -> list[ReceivedMessage] | Order:
        try:
            return self._queue.get(timeout=self._flush_interval_s)
        except queue.Empty:
            return "flush"

    def _handle(self, item: list[ReceivedMessage] | Order) -> None:
        match item:
            case "end":
                self._writer.close()
            case "sync":
                self._writer.sync()
                self.bytes = self._writer.size
            case "flush":
                self._writer.flush()
                self.bytes = self._writer.size  # fails when the file has been removed
            case list():
                for message in item:
                    self._writer.write(*message)
                self.messages += len(item)
            case written:
                self._writer.flush()
                written()


def _size(messages: list[ReceivedMessage]) -> int:
    return sum(len(message.data) for message in messages)
