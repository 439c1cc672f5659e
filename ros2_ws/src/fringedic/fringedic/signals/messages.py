"""Messages to signals; the only place that knows which message contains which signal."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from fringedic.errors import RecordingError
from fringedic.frames.records import stamp_of
from fringedic.signals.signal import FORCE, POSITION, Channel, Signal


class Sample(NamedTuple):
    """One sample of a channel."""

    channel: Channel
    stamp: int
    value: float
    sigma: float


def load_state_samples(message: Any) -> Iterator[Sample]:
    """Yield the samples in ``fringedic_msgs/LoadState``; their uncertainty is not known."""
    stamp = stamp_of(message)
    yield Sample(FORCE, stamp, message.force, np.nan)
    yield Sample(POSITION, stamp, message.position, np.nan)


def signal_samples(message: Any) -> Iterator[Sample]:
    """Yield the samples in ``fringedic_msgs/Signal``.

    Raises
    ------
    RecordingError
        The message has no name, or the numbers of stamps, values and uncertainties differ.
    """
    if not message.name or not len(message.stamps) == len(message.values) == len(message.sigmas):
        raise RecordingError(
            f"signals: a message of '{message.source}' about '{message.name}' has {len(message.stamps)} stamps, "
            f"{len(message.values)} values and {len(message.sigmas)} uncertainties: it needs a name and as many of each"
        )
    channel = Channel(message.name, message.quantity, message.unit, message.positive, message.source)
    for stamp, value, sigma in zip(message.stamps, message.values, message.sigmas, strict=True):
        yield Sample(channel, int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec), float(value), float(sigma))


SIGNAL_TOPICS: dict[str, Callable[[Any], Iterator[Sample]]] = {
    "load_frame/state": load_state_samples,
    "signals": signal_samples,
}
"""The topics that contain signals, by their names relative to the rig; a later one replaces channels of an earlier."""
_TOPICS = list(SIGNAL_TOPICS)


class SignalCollector:
    """Collects the signals in messages, recorded or live.

    Of two topics with the same channel, the later one in `SIGNAL_TOPICS` counts. Of two sources with one name, the
    second is called ``name_source``.

    Parameters
    ----------
    longest
        Number of the latest samples of each signal that are kept; None keeps all.

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> header = Message(stamp=Message(sec=1, nanosec=0))
    >>> collector = SignalCollector(longest=1)
    >>> collector.add("load_frame/state", Message(header=header, force=250.0, position=1e-3))
    ['force', 'position']
    >>> collector.latest["force"].value
    250.0
    """

    def __init__(self, longest: int | None = None) -> None:
        self._longest = longest
        self._names: dict[Channel, str] = {}
        self._topics: dict[str, str] = {}
        self._samples: dict[str, deque[Sample]] = {}
        for channel in (FORCE, POSITION):
            self._name_of(channel)

    def _name_of(self, channel: Channel) -> str:
        name = self._names.get(channel)
        if name is None:
            name = channel.name
            while name in self._samples:
                name += f"_{channel.source}"
            self._names[channel] = name
            self._samples[name] = deque(maxlen=self._longest)
        return name

    def add(self, topic: str, message: Any) -> list[str]:
        """Add a message of a topic in `SIGNAL_TOPICS`, and return the names of the signals that have new samples.

        Raises
        ------
        RecordingError
            The message is incomplete; see `signal_samples`.
        """
        changed: list[str] = []
        for sample in SIGNAL_TOPICS[topic](message):
            name = self._name_of(sample.channel)
            before = self._topics.setdefault(name, topic)
            if before != topic:
                if _TOPICS.index(before) > _TOPICS.index(topic):
                    continue
                self._topics[name] = topic
                self._samples[name].clear()
            self._samples[name].append(sample)
            if name not in changed:
                changed.append(name)
        return changed

    @property
    def latest(self) -> dict[str, Sample]:
        """Latest sample of each signal that has samples, by the name of the signal."""
        return {name: samples[-1] for name, samples in self._samples.items() if samples}

    @property
    def signals(self) -> dict[str, Signal]:
        """The signals by their name; force and position always, without samples if none has arrived."""
        return {
            name: Signal(
                channel._replace(name=name),
                np.array([sample.stamp for sample in self._samples[name]], dtype=np.int64),
                np.array([sample.value for sample in self._samples[name]], dtype=float),
                np.array([sample.sigma for sample in self._samples[name]], dtype=float),
            )
            for channel, name in self._names.items()
        }


def signals_of(messages: Iterable[tuple[str, Any]]) -> dict[str, Signal]:
    """Return the signals in recorded messages of `SIGNAL_TOPICS` by their name; see `SignalCollector`."""
    collector = SignalCollector()
    for topic, message in messages:
        collector.add(topic, message)
    return collector.signals
