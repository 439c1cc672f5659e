"""Finds and opens the files of a recording."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from fringedic.errors import RecordingError
from fringedic.recording.mcap_file import (
    DAMAGE,
    FOREIGN,
    MAGIC,
    McapFile,
    check_chunks,
    first_bytes,
    opened,
    read_index,
)
from fringedic.recording.mcap_scan import ends_with_magic, has_chunk, scan_file
from fringedic.wording.yaml_text import load_foreign_yaml

BAG = "bag"  # of a run
METADATA = "metadata.yaml"
STORED = (".mcap", ".mcap.zstd", ".db3", ".db3.zstd")  # ends of the names of files with messages


class BagFiles(NamedTuple):
    """Files of a recording.

    Attributes
    ----------
    present
        The MCAP files in their order.
    missing
        Names of files that ``metadata.yaml`` lists and that do not exist.
    counts
        Messages of each topic by ``metadata.yaml``; those of a recording that was not closed are not complete.
    damage
        Description of the damage of ``metadata.yaml``; empty if it is complete or does not exist.
    unlisted
        Names of MCAP files that ``metadata.yaml`` does not list; empty without a readable list.
    """

    present: list[Path]
    missing: list[str]
    counts: dict[str, int]
    damage: str
    unlisted: list[str]


def recording_of(path: Path) -> Path:
    """Return the recording that a path names: the folder of a run stands for the recording ``bag`` in it.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as run:
    ...     (Path(run) / "bag").mkdir()
    ...     recording_of(Path(run)).name
    'bag'
    """
    path = path if path.name else path.absolute()  # "." has no name
    inside = path / BAG
    if path.is_dir() and inside.is_dir() and not (path / METADATA).exists() and not any(path.glob("*.mcap")):
        return inside
    return path


def recorded_bytes(path: Path) -> int:
    """Return the size of the files with the messages of a recording [byte]; 0 if there is none."""
    files = [path] if path.is_file() else [file for file in path.glob("*") if file.name.endswith(STORED)]
    return sum(file.stat().st_size for file in files)


def convert_command(path: Path) -> str:
    """Return the command that writes a recording of other storage as MCAP; it is installed with fringedic.

    Examples
    --------
    >>> convert_command(Path("plate-7.bag"))
    'rosbags-convert --src plate-7.bag --dst plate-7_mcap --dst-storage mcap'
    """
    return f"rosbags-convert --src {path} --dst {path.with_name(f'{path.stem}_mcap')} --dst-storage mcap"


def numbered_parts(bag: Path) -> dict[int, Path]:
    """Return the parts bag-2, bag-3 ... beside a recording, in the order of their numbers."""
    parts = {part.name.removeprefix(f"{bag.name}-"): part for part in bag.parent.glob(f"{bag.name}-*")}
    return dict(sorted((int(number), part) for number, part in parts.items() if number.isdecimal()))


def parts_of_run(path: Path) -> list[Path]:
    """Return the later parts of the recording of a run, which its command joins in the end if it is not killed."""
    return [part for part in numbered_parts(path).values() if any(part.glob("*.mcap"))] if path.name == BAG else []


def beside(path: Path, ending: str) -> Path:
    """Return the absolute path beside a recording or dataset, with an ending appended to its name.

    A file and a Zarr folder lose their suffix; other folders keep the whole name, in which a dot may precede a number.

    Examples
    --------
    >>> beside(Path("/recordings/plate.7"), "_recovered").as_posix()
    '/recordings/plate.7_recovered'
    """
    whole = Path(os.path.abspath(path))  # "." and ".." have no name to append to
    name = whole.stem if whole.is_file() or whole.suffix == ".zarr" else whole.name
    return whole.parent / f"{name}{ending}"


def find_files(path: Path) -> BagFiles:
    """Find the MCAP files of a recording: all in its folder, also those that ``metadata.yaml`` does not list.

    Parameters
    ----------
    path
        A rosbag2 folder or one MCAP file.

    Raises
    ------
    RecordingError
        There is no such recording, it contains no MCAP file, or rosbag2 has compressed its messages or files.
    """
    if path.is_file():
        metadata = _read_metadata(path.parent)
        if path.name in (metadata.files or []):
            _refuse_compression(path, metadata)
        return BagFiles([path], [], {}, "", [])
    if not path.is_dir():
        raise RecordingError(f"{path}: no such recording")
    metadata = _read_metadata(path)
    _refuse_compression(path, metadata)
    listed = metadata.files or []
    found = [path / name for name in listed if (path / name).is_file()]
    others = [file for file in path.glob("*.mcap") if not file.name.startswith("._")]  # what macOS notes of a file
    others.sort(key=lambda file: [int(number) for number in re.findall(r"\d+", file.stem)])
    present = list(dict.fromkeys([*found, *others]))
    if not present:
        raise RecordingError(f"{path}: holds no .mcap file; convert other storage: {convert_command(path)}")
    missing = [name for name in listed if path / name not in present]
    unlisted = [] if metadata.files is None else [file.name for file in others if file.name not in listed]
    return BagFiles(present, missing, metadata.counts, metadata.damage, unlisted)


@dataclass
class _Metadata:
    """Content of ``metadata.yaml``: names of the files, messages of each topic, compression by rosbag2, damage."""

    files: list[str] | None = None
    counts: dict[str, int] = field(default_factory=dict)
    compression: str = ""
    damage: str = ""


def _read_metadata(folder: Path) -> _Metadata:
    """Return the readable part of ``metadata.yaml``; nothing if it does not exist."""
    found = _Metadata()
    if not (folder / METADATA).is_file():
        return found
    data = (folder / METADATA).read_bytes()
    try:
        content: dict[str, Any] = load_foreign_yaml(data.decode("utf-8"))["rosbag2_bagfile_information"]
        found.compression = str(content.get("compression_mode") or "")
        found.files = [Path(name).name for name in content["relative_file_paths"]]
        topics = content["topics_with_message_count"] or []
        found.counts = {str(each["topic_metadata"]["name"]): int(each["message_count"]) for each in topics}
    except Exception:  # every kind of damage has its own error
        found.damage = f"{METADATA} is damaged"
    return found


def _refuse_compression(path: Path, metadata: _Metadata) -> None:
    """Refuse a recording whose messages or files are compressed as a whole; MCAP compresses only its chunks."""
    if metadata.compression.upper() not in ("", "NONE"):
        raise RecordingError(
            f"{path}: its messages are compressed by rosbag2 (compression_mode {metadata.compression}); "
            f"convert it: {convert_command(path)}"
        )


def open_file(path: Path, *, check: bool) -> McapFile:
    """Return the chunks and channels of a file, by its index if it has one that is not damaged.

    Parameters
    ----------
    path
        The file.
    check
        Read every chunk and leave out those that are damaged. A file without an index is always checked.

    Returns
    -------
    McapFile
        Of another format, the file is `foreign`.

    Raises
    ------
    RecordingError
        The file cannot be read, or is written without chunks.
    """
    begins = MAGIC.startswith(first_bytes(path))
    damage = [] if begins else ["its first bytes are damaged"]
    file = None
    try:
        file = read_index(path)
    except DAMAGE:
        damage.append("its index is damaged and was rebuilt from the chunks")
    if file is None:
        with opened(path) as data:
            if not begins and not ends_with_magic(data) and not has_chunk(path, data):
                return McapFile(path, damage=[FOREIGN], foreign=True)
            file = scan_file(path, data)
    elif check:
        file = check_chunks(file)
    file.damage[:0] = damage
    return file
