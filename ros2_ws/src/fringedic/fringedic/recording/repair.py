"""Summarises recordings and repairs damaged ones."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from fringedic.errors import RecordingError
from fringedic.recording.reader import BagReader
from fringedic.recording.writer import ONE_FILE, BagWriter, Split


@dataclass(frozen=True)
class Recovery:
    """Outcome of a recovery.

    Attributes
    ----------
    path
        The new recording.
    messages
        Messages in it.
    missing
        Messages of each topic that the damaged recording counts and that could not be read. They are known only if its
        index or its ``metadata.yaml`` is complete.
    lost
        Description of the damage; empty if the recording was complete.
    """

    path: Path
    messages: int
    missing: dict[str, int]
    lost: str


def recover(path: str | os.PathLike[str], output: str | os.PathLike[str] | None = None) -> Recovery:
    """Write a complete recording of all readable messages of a damaged one, which is not changed.

    Parameters
    ----------
    path
        The damaged recording.
    output
        The new folder; by default beside the old one, with ``_recovered`` appended to its name.

    Returns
    -------
    Recovery
        The new recording, and what could not be read.

    Raises
    ------
    RecordingError
        There is no such recording, or the new one cannot be written.

    Examples
    --------
    >>> recover("recordings/plate-7/bag").missing  # doctest: +SKIP
    {'/rig/camera/image_raw': 1}
    """
    reader = BagReader(path, check=True)
    source = Path(path)
    target = Path(output) if output is not None else source.with_name(f"{source.stem}_recovered")
    with BagWriter(target) as writer:
        _append(writer, reader)
        return Recovery(target, writer.message_count, reader.missing, reader.lost)


def join(parts: Iterable[Path], target: Path, *, split: Split = ONE_FILE) -> Recovery:
    """Write one recording of the readable messages of several, which are not changed.

    Parameters
    ----------
    parts
        The recordings in their order; one that cannot be read is left out.
    target
        Folder of the new one.
    split
        When it continues in its next file.

    Returns
    -------
    Recovery
        The new recording, and what could not be read.

    Raises
    ------
    RecordingError
        The parts define a topic differently, or the new recording cannot be written.
    """
    missing: Counter[str] = Counter()
    damage = []
    with BagWriter(target, split=split) as writer:
        for part in parts:
            try:
                reader = BagReader(part, check=True)
            except RecordingError as error:
                damage.append(str(error))
                continue
            _append(writer, reader)
            missing += Counter(reader.missing)
            if reader.lost:
                damage.append(f"{part.name}: {reader.lost}")
        return Recovery(target, writer.message_count, dict(missing), "; ".join(damage))


def _append(writer: BagWriter, reader: BagReader) -> None:
    for topic in reader.topics.values():
        writer.add_recorded_topic(topic)
    for message in reader.stored():
        writer.write(*message)


@dataclass(frozen=True)
class BagInfo:
    """Summary of a recording.

    Attributes
    ----------
    path
        The recording.
    start_time, end_time
        Log times of the first and the last message [ns].
    size
        Of all its files [byte].
    topics
        Full name -> (type, number of messages).
    lost
        Description of the damage; empty for a complete recording.
    """

    path: Path
    start_time: int
    end_time: int
    size: int
    topics: dict[str, tuple[str, int]]
    lost: str


def info(path: str | os.PathLike[str]) -> BagInfo:
    """Return the summary of a recording.

    Raises
    ------
    RecordingError
        There is no such recording, or it has another format.
    """
    reader = BagReader(path)
    return BagInfo(
        path=reader.path,
        start_time=reader.start_time,
        end_time=reader.end_time,
        size=sum(file.stat().st_size for file in reader.files),
        topics={name: (topic.type_name, reader.counts[name]) for name, topic in sorted(reader.topics.items())},
        lost=reader.lost,
    )
