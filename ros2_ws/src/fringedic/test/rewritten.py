"""A recording written again with some of its topics."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from fringedic.recording import BagReader, BagWriter


def copy_topics(bag: Path, target: Path, *, only: Collection[str] = (), without: Collection[str] = ()) -> Path:
    """Copy a recording with the topics `only`, or with all others than `without`, named relative to the rig."""
    reader = BagReader(bag)
    wanted = set(reader.find(*only).values() if only else reader.topics) - set(reader.find(*without).values())
    with BagWriter(target) as writer:
        for name in sorted(wanted):
            writer.add_recorded_topic(reader.topics[name])
        for message in reader.stored():
            if message.topic in wanted:
                writer.write(*message)
    return target
