"""Order of the messages of a recording: by the numbers of their publishers, not by their place in the files.

Other programs write a recording topic after topic, or its second half first. Such an order says nothing about time.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime

import numpy as np

from fringedic.recording.bag_metadata import offered_profiles
from fringedic.recording.topics import RawMessage, Topic

_SET_BACK_NS = 1_000_000_000  # messages that were received one after the other overlap by less
_LATE = 64  # numbers by which a message may be received later than its successors


def is_latched(topic: Topic) -> bool:
    """Return whether a publisher of a topic offers its last messages to later subscribers."""
    return any(profile.get("durability") in ("transient_local", 1) for profile in offered_profiles(topic.qos))


def counted_topics(topics: Iterable[Topic]) -> set[str]:
    """Return the topics with one publisher, whose numbers form one count.

    A latched topic has several publishers, whose first recorded message may have any number.
    """
    return {topic.name for topic in topics if not is_latched(topic) and len(offered_profiles(topic.qos)) < 2}


class ClockCheck:
    """Finds that the clock of the computer was set back during a recording.

    Within a topic, a message with a larger number was received later. If its time is earlier by more than a second, the
    clock was set back. Earlier times of smaller numbers are due to the order of the file.

    Parameters
    ----------
    topics
        Of the recording.

    Examples
    --------
    >>> seconds = [(1, 4), (2, 9), (3, 6)]
    >>> check = ClockCheck([Topic("/force", "", "", "", "", "")])
    >>> for number, second in seconds:
    ...     check.add(RawMessage("/force", b"", second * 10**9, 0, number))
    >>> check.description
    'the clock was set back by 3.0 s at 1970-01-01 00:00:09 UTC; order and times of later messages are wrong'
    """

    def __init__(self, topics: Iterable[Topic]) -> None:
        self._last = dict.fromkeys(counted_topics(topics), (-1, 0))
        self._back, self._when = 0, 0

    def add(self, message: RawMessage) -> None:
        """Take the next message in the order of the file."""
        if message.topic in self._last:
            number, time = self._last[message.topic]
            self._last[message.topic] = message.sequence, message.log_time
            back = time - message.log_time
            if message.sequence > number and back > max(self._back, _SET_BACK_NS):
                self._back, self._when = back, time

    @property
    def description(self) -> str:
        """By how much and when the clock was set back; empty if it was not."""
        if not self._back:
            return ""
        time = datetime.fromtimestamp(1e-9 * self._when, UTC)
        later = "order and times of later messages are wrong"
        return f"the clock was set back by {1e-9 * self._back:.1f} s at {time:%Y-%m-%d %H:%M:%S} UTC; {later}"


class PublisherCounts:
    """Numbers of the publishers' own counts of their messages, with the gaps in them.

    Parameters
    ----------
    topics
        Of the recording, by name.
    """

    def __init__(self, topics: Mapping[str, Topic]) -> None:
        self._rows: dict[str, array[int]] = {name: array("q") for name in counted_topics(topics.values())}

    def add(self, message: RawMessage) -> None:
        """Take the next message in the order of the file."""
        if message.topic in self._rows:
            self._rows[message.topic].extend((message.log_time, message.publish_time, message.sequence))

    @property
    def unknown(self) -> list[str]:
        """Topics whose messages have no numbers, so that a missing one leaves no gap."""
        numbers = {name: rows[2::3] for name, rows in self._rows.items()}
        return sorted(name for name, each in numbers.items() if len(each) > 1 and len(set(each)) == 1)

    def missing(self, *, in_file_order: bool) -> dict[str, int]:
        """Return the number of missing messages of each topic, between its first and its last recorded one.

        Parameters
        ----------
        in_file_order
            Whether the order of the file is that of receipt, because the clock was set back; otherwise it is that of
            the log times.
        """
        unknown = set(self.unknown)
        counts = {
            name: _missing(_in_order(rows, in_file_order)) for name, rows in self._rows.items() if name not in unknown
        }
        return {name: count for name, count in counts.items() if count}


def _in_order(rows: array[int], in_file_order: bool) -> list[int]:
    """Return the numbers of a topic in the order of receipt; copies of a message are left out."""
    table = np.frombuffer(rows, dtype=np.int64).reshape(-1, 3)
    if not in_file_order:
        table = np.unique(table, axis=0)  # sorted; messages that were received together have one log time
    numbers: list[int] = table[:, 2].tolist()
    return numbers


def _missing(numbers: Iterable[int]) -> int:
    """Return how many numbers are missing; a number that comes again, or much too late, begins another count."""
    missing, count = 0, set[int]()
    last = -1
    for number in numbers:
        if number in count or number <= last - _LATE:
            missing += last - min(count) + 1 - len(count)
            count, last = set(), -1
        count.add(number)
        last = max(last, number)
    return missing + (last - min(count) + 1 - len(count) if count else 0)
