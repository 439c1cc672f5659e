"""Recordings in an object store: only the index and the chunks that are needed are fetched, by exact ranges."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fringedic.errors import FringedicError, RecordingError
from fringedic.recording.bag_files import BAG, METADATA, open_file
from fringedic.recording.mcap_file import MAGIC, ChunkPlace, McapFile, index_start
from fringedic.wording.causes import cause_of
from fringedic.wording.optional_packages import optional_import

_TAIL = 1_000_000  # [byte] of a file that usually contain its index
_GAP = 16_384  # [byte] between chunks that are fetched rather than asked for separately: their message indices
_BATCH = 64_000_000  # [byte] in memory


@dataclass(frozen=True)
class RemoteFile:
    """One MCAP file of a remote recording.

    Attributes
    ----------
    place
        Its path in the object store.
    size
        Of the file [byte].
    tail
        Its last bytes, which contain the index.
    start
        Where the index begins in the file.
    """

    place: str
    size: int
    tail: bytes
    start: int

    @property
    def name(self) -> str:
        """Its name."""
        return self.place.rpartition("/")[2]

    @property
    def offset(self) -> int:
        """Where the tail begins in the file."""
        return self.size - len(self.tail)

    @property
    def index(self) -> bytes:
        """The index."""
        return self.tail[self.start - self.offset :]


def is_remote(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is the address of an object store.

    Examples
    --------
    >>> is_remote("s3://laboratory/plate-7"), is_remote("recordings/plate-7")
    (True, False)
    """
    return "://" in str(path)


def find_remote(pattern: str) -> list[str]:
    """Return the addresses of the recordings that a pattern matches or contains: folders with MCAP files.

    Raises
    ------
    RecordingError
        The object store cannot be read.
    """
    with named_errors(pattern):
        files, root = file_system(pattern)
        files.invalidate_cache()
        matches = files.glob(root) if "*" in root else [root.rstrip("/")]
        found = {name.rpartition("/")[0] for match in matches for name in files.find(match) if name.endswith(".mcap")}
        return sorted(str(files.unstrip_protocol(name)) for name in found)


@contextmanager
def local_copy(path: str | os.PathLike[str], topics: Iterable[str]) -> Iterator[Path]:
    """Return a recording on this computer: itself, or a temporary copy of what is needed of one in an object store.

    Parameters
    ----------
    path
        The recording; ``s3://...`` or another address that fsspec knows for one in an object store.
    topics
        Names of the needed topics relative to the rig's namespace. Without a topic only the index is copied.

    Raises
    ------
    RecordingError
        See `RemoteRecording`.
    """
    if not is_remote(path):
        yield Path(path)
        return
    with RemoteRecording(str(path)).copied(topics) as nearby:
        yield nearby


class RemoteRecording:
    """A recording in an object store.

    Parameters
    ----------
    address
        Of its folder, such as ``s3://laboratory/plate-7/bag``, or of its run.

    Raises
    ------
    RecordingError
        There is no such recording, it cannot be read, or a file has no index because its recording was cut off: such a
        file is not scanned over the network.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        with named_errors(address):
            self._files, self._root = file_system(address)
            self._files.invalidate_cache()
            names = sorted(name for name in self._files.find(self._root) if name.endswith(".mcap"))
            folders = {name.rpartition("/")[0] for name in names} - {self._root.rstrip("/").rpartition("/")[0]}
            self._root = next((root for root in self._possible_roots() if root in folders), self._root)
            names = [name for name in names if self._root in (name, name.rpartition("/")[0])]
            self.files = [self._with_index(name) for name in names]
        if not self.files and folders:
            raise RecordingError(f"{address}: holds several recordings; give the folder of one, such as {min(folders)}")
        if not self.files:
            raise RecordingError(f"{address}: holds no .mcap file; give the folder of a recording")

    def _possible_roots(self) -> tuple[str, str]:
        """Return the paths at which the files of a recording lie: the address itself, or the ``bag`` of a run."""
        root = self._root.rstrip("/")
        return root, f"{root}/{BAG}"

    @contextmanager
    def copied(self, topics: Iterable[str], *, first: bool = False) -> Iterator[Path]:
        """Copy what is needed into files with holes, which the readers of local recordings read.

        Parameters
        ----------
        topics
            Names of the needed topics relative to the rig's namespace; other messages are in the copy only if they
            share a chunk with them.
        first
            Only the first chunk of each topic.

        Yields
        ------
        Path
            The copy in a temporary folder, with the name of the recording; it is removed afterwards.
        """
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder, *self._name_parts)
            target.mkdir(parents=True)
            with named_errors(self._address):
                metadata = f"{self._root.rstrip('/')}/{METADATA}"
                if self._files.exists(metadata):
                    (target / METADATA).write_bytes(self._files.cat_file(metadata))
                for file in self.files:
                    self._copy_file(file, target / file.name, tuple(topics), first)
            yield target

    @property
    def _name_parts(self) -> list[str]:
        parts = [part for part in self._root.split("/") if part]
        return parts[-2:] if parts[-1] == BAG else parts[-1:]

    def _with_index(self, place: str) -> RemoteFile:
        size = int(self._files.size(place))
        offset = max(0, size - _TAIL)
        tail = self._files.cat_file(place, start=offset, end=size)
        start = index_start(tail, size)
        if start is None:
            raise RecordingError(
                f"{self._address}: {place.rpartition('/')[2]} has no index because its recording was cut off: run "
                "'fringedic recover' on the computer where it lies"
            )
        if start < offset:
            tail = self._files.cat_file(place, start=start, end=offset) + tail
        return RemoteFile(place, size, tail, start)

    def _copy_file(self, file: RemoteFile, target: Path, topics: tuple[str, ...], first: bool) -> None:
        with target.open("wb") as stream:
            stream.truncate(file.size)
            stream.write(MAGIC)
            stream.seek(file.offset)
            stream.write(file.tail)
            stream.flush()
            needed = _needed(open_file(target, check=False), topics, first)
            chunks = [chunk for chunk in needed if chunk.offset < file.offset]
            for batch in _batches(_ranges(chunks)):
                starts, ends = zip(*batch, strict=True)
                parts = self._files.cat_ranges([file.place] * len(batch), list(starts), list(ends), max_gap=None)
                for start, data in zip(starts, parts, strict=True):
                    stream.seek(start)
                    stream.write(data)


def _needed(file: McapFile, topics: tuple[str, ...], first: bool) -> list[ChunkPlace]:
    """Return the chunks with messages of some topics, in the order of their bytes."""
    numbers = {
        topic: {number for number, channel in file.channels.items() if f"/{channel.topic}".endswith(f"/{topic}")}
        for topic in topics
    }
    needed = {topic: [chunk for chunk in file.chunks if chunk.channels & known] for topic, known in numbers.items()}
    if first:
        needed = {topic: sorted(chunks)[:1] for topic, chunks in needed.items()}
    return sorted({chunk for chunks in needed.values() for chunk in chunks}, key=lambda chunk: chunk.offset)


def _ranges(chunks: Iterable[ChunkPlace]) -> Iterator[tuple[int, int]]:
    """Yield the first and the last byte of neighbouring chunks together."""
    begin, end = -1, -1
    for chunk in chunks:
        if begin >= 0 and chunk.offset - end <= _GAP and chunk.offset + chunk.length - begin <= _BATCH:
            end = chunk.offset + chunk.length
            continue
        if begin >= 0:
            yield begin, end
        begin, end = chunk.offset, chunk.offset + chunk.length
    if begin >= 0:
        yield begin, end


def _batches(ranges: Iterable[tuple[int, int]]) -> Iterator[list[tuple[int, int]]]:
    """Yield ranges together as long as they fit into the memory for them."""
    batch: list[tuple[int, int]] = []
    for begin, end in ranges:
        if batch and sum(last - first for first, last in batch) + end - begin > _BATCH:
            yield batch
            batch = []
        batch.append((begin, end))
    if batch:
        yield batch


def file_system(address: str) -> tuple[Any, str]:
    """Return the file system of an address, and the path in it.

    Raises
    ------
    RecordingError
        The address is of no known kind.
    FringedicError
        A package of the extra ``campaign`` is not installed.
    """
    with optional_import("campaign"):
        import fsspec
    try:
        files, root = fsspec.core.url_to_fs(address)
    except (ValueError, ImportError) as error:
        raise RecordingError(f"{address}: is no known kind of address: {error}") from error
    return files, str(root)


@contextmanager
def named_errors(address: str) -> Iterator[None]:
    """Raise every error of an object store as RecordingError, which names the address."""
    try:
        yield
    except FringedicError:
        raise
    except Exception as error:  # every kind of object store has its own errors
        reason = cause_of(error)
        raise RecordingError(
            f"{address}: cannot be read: {reason}; check the address, the end point and the credentials"
        ) from error
