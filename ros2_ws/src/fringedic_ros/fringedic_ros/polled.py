"""Topics that are read when their reader has time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile

Message = TypeVar("Message")


class PolledTopic(Generic[Message]):
    """A subscription whose callback the executor calls only while somebody waits for a message.

    Each turn of the executor costs milliseconds in Python: a callback at each of 100 samples per second takes a fifth
    of a processor core, also where only ten of them are used.

    Parameters
    ----------
    node
        Owner of the subscription.
    kind
        Type of the messages; `bytes` is read when `raw` is set.
    topic
        Name of the topic.
    profile
        Its depth is the number of messages that wait; of depth 1, `take` returns the newest message.
    raw
        Whether to return serialised messages.
    callback
        Receives the messages of `read` and `listening`.
    """

    def __init__(
        self,
        node: Node,
        kind: type[Any],
        topic: str,
        profile: QoSProfile,
        *,
        raw: bool = False,
        callback: Callable[[Any], None] = lambda _: None,
    ) -> None:
        self._group = OnDemand()
        self._callback = callback
        self._node = node
        self._subscription = node.create_subscription(
            kind, topic, callback, profile, callback_group=self._group, raw=raw
        )

    def take(self) -> Message | None:
        """Return the message that waits longest, or None; called in the thread of the executor."""
        subscription = self._subscription
        with subscription.handle:
            found = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        return None if found is None else found[0]

    def read(self) -> None:
        """Pass all waiting messages to the callback; called in the thread of the executor."""
        while (message := self.take()) is not None:
            self._callback(message)

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Context in which a message reaches the callback as soon as it arrives; entered in the executor's thread."""
        self.read()
        self._group.listeners += 1
        try:
            yield
        finally:
            self._group.listeners -= 1

    def destroy(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self._subscription)


class OnDemand(CallbackGroup):
    """A group whose callbacks the executor waits for and calls only while there are listeners.

    Attributes
    ----------
    listeners
        Their number.
    """

    def __init__(self) -> None:
        super().__init__()
        self.listeners = 0

    def can_execute(self, *_: Any) -> bool:
        """Return whether there are listeners."""
        return self.listeners > 0

    def beginning_execution(self, *_: Any) -> bool:
        """Return whether there are still listeners."""
        return self.listeners > 0

    def ending_execution(self, *_: Any) -> None:
        """Do nothing: several callbacks may run."""
