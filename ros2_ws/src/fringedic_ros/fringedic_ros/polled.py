"""Topics that are read when their reader has time."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile

Message = TypeVar("Message")


class PolledTopic(Generic[Message]):
    """A subscription without callback.

    A callback at each of 1000 samples per second takes half a processor core in Python, also where only ten of them are
    used.

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
    """

    def __init__(self, node: Node, kind: type[Any], topic: str, profile: QoSProfile, *, raw: bool = False) -> None:
        self._subscription = node.create_subscription(
            kind, topic, lambda _: None, profile, callback_group=_NeverExecuted(), raw=raw
        )

    def take(self) -> Message | None:
        """Return the message that waits longest, or None; called in the thread of the executor."""
        subscription = self._subscription
        with subscription.handle:
            found = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        return None if found is None else found[0]


class _NeverExecuted(CallbackGroup):
    """A group whose callbacks the executor neither waits for nor calls."""

    def can_execute(self, *_: Any) -> bool:
        return False

    def beginning_execution(self, *_: Any) -> bool:
        return False

    def ending_execution(self, *_: Any) -> None:
        pass
