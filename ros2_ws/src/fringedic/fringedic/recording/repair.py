"""Summarises recordings and repairs damaged ones."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fringedic.errors import RecordingError
from fringedic.recording.bag_files import beside
from fringedic.recording.reader import BagReader
from fringedic.recording.remote import is_remote, local_copy
from fringedic.recording.writer import ONE_FILE, BagWriter, Split


@dataclass(frozen=True)
class Content:
    """What can be read of a recording, and what cannot.

    Attributes
    ----------
    path
        The recording, or its address in an object store.
    counts
        Readable messages of each topic by its full name.
    missing
        Messages of each topic that are counted and cannot be read. They are known only if an index or ``metadata.yaml``
        is complete.
    damage
        Description of damaged and missing files; empty if there are none.
    unlisted
        Names of files that are read although ``metadata.yaml`` does not list them.
    parts
        Names of later parts of a run beside the recording, which are not read.
    """

    path: Path | str
    counts: dict[str, int]
    missing: dict[str, int]
    damage: str
    unlisted: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()

    @property
    def messages(self) -> int:
        """Number of readable messages."""
        return sum(self.counts.values())

    @property
    def whole(self) -> bool:
        """Whether nothing is damaged or missing."""
        return not (self.damage or self.missing or self.parts)


def recover(path: str | os.PathLike[str], output: str | os.PathLike[str] | None = None) -> Content:
    """Write a complete recording of all readable messages of a damaged one, which is not changed.

    Later parts of a run whose command was killed before it joined them follow.

    Parameters
    ----------
    path
        The damaged recording.
    output
        The new folder; by default beside the old one, with ``_recovered`` appended to its name.

    Returns
    -------
    Content
        The new recording, and what could not be read of the old one.

    Raises
    ------
    RecordingError
        There is no such recording, or the new one cannot be written.

    Examples
    --------
    >>> recover("recordings/plate-7/bag").missing
    {}
    """
    reader = BagReader(path, check=True)
    target = Path(output) if output is not None else beside(Path(path), "_recovered")
    if reader.parts:
        return join([reader.path, *reader.parts], target)
    with _whole_or_nothing(target, ONE_FILE) as writer:
        _append(writer, reader)
    return Content(target, dict(reader.counts), reader.missing, reader.damage, reader.unlisted)


def join(parts: Iterable[Path], target: Path, *, split: Split = ONE_FILE) -> Content:
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
    Content
        The new recording, and what could not be read of its parts.

    Raises
    ------
    RecordingError
        The parts define a topic differently, or the new recording cannot be written.
    """
    counts: Counter[str] = Counter()
    missing: Counter[str] = Counter()
    damage: list[str] = []
    unlisted: list[str] = []
    with _whole_or_nothing(target, split) as writer:
        for part in parts:
            try:
                reader = BagReader(part, check=True)
            except RecordingError as error:
                damage.append(str(error))
                continue
            _append(writer, reader)
            counts += Counter(reader.counts)
            missing += Counter(reader.missing)
            unlisted += reader.unlisted
            if reader.damage:
                damage.append(f"{part.name}: {reader.damage}")
    return Content(target, dict(counts), dict(missing), "; ".join(damage), tuple(unlisted))


@contextmanager
def _whole_or_nothing(target: Path, split: Split) -> Iterator[BagWriter]:
    """Write a recording; nothing is left of one that is interrupted, which would be taken for a complete one."""
    writer = BagWriter(target, split=split)
    try:
        with writer:
            yield writer
    except BaseException:
        shutil.rmtree(target, ignore_errors=True)
        raise


def _append(writer: BagWriter, reader: BagReader) -> None:
    for topic in reader.topics.values():
        writer.add_recorded_topic(topic)
    for message in reader.stored():
        writer.write(*message)


@dataclass(frozen=True, kw_only=True)
class BagInfo(Content):
    """Summary of a recording.

    Attributes
    ----------
    start_time, end_time
        Log times of the first and the last message [ns].
    size
        Of all its files [byte].
    types
        Of each topic.
    """

    start_time: int
    end_time: int
    size: int
    types: dict[str, str]


def info(path: str | os.PathLike[str]) -> BagInfo:
    """Return the summary of a recording; of one in an object store only the index is read.

    Raises
    ------
    RecordingError
        There is no such recording, or it has another format.
    """
    with local_copy(path, ()) as nearby:
        return _info(BagReader(nearby), str(path) if is_remote(path) else None)


def _info(reader: BagReader, address: str | None) -> BagInfo:
    return BagInfo(
        path=address or reader.path,
        start_time=reader.start_time,
        end_time=reader.end_time,
        size=sum(file.stat().st_size for file in reader.files),
        types={name: topic.type_name for name, topic in sorted(reader.topics.items())},
        counts=dict(reader.counts),
        missing=reader.missing,
        damage=reader.damage,
        unlisted=reader.unlisted,
        parts=tuple(part.name for part in reader.parts),
    )
