"""Messages to signals; the only place that knows which message contains which signal."""

from __future__ import annotations

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


def signals_of(messages: Iterable[tuple[str, Any]]) -> dict[str, Signal]:
    """Return the signals in recorded messages by their name.

    Parameters
    ----------
    messages
        Name of a topic in `SIGNAL_TOPICS`, and a message.

    Returns
    -------
    dict
        Force and position always, without samples if none was recorded. Of two sources with one name, the second is
        called ``name_source``.

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> header = Message(stamp=Message(sec=1, nanosec=0))
    >>> signals = signals_of([("load_frame/state", Message(header=header, force=250.0, position=1e-3))])
    >>> {name: signal.values.tolist() for name, signal in signals.items()}
    {'force': [250.0], 'position': [0.001]}
    """
    samples: dict[Channel, dict[str, list[Sample]]] = {FORCE: {}, POSITION: {}}
    for topic, message in messages:
        for sample in SIGNAL_TOPICS[topic](message):
            samples.setdefault(sample.channel, {}).setdefault(topic, []).append(sample)
    signals: dict[str, Signal] = {}
    for channel, by_topic in samples.items():
        chosen = next((by_topic[topic] for topic in reversed(SIGNAL_TOPICS) if topic in by_topic), [])
        name = channel.name if channel.name not in signals else f"{channel.name}_{channel.source}"
        signals[name] = Signal(
            channel._replace(name=name),
            np.array([sample.stamp for sample in chosen], dtype=np.int64),
            np.array([sample.value for sample in chosen], dtype=float),
            np.array([sample.sigma for sample in chosen], dtype=float),
        )
    return signals
