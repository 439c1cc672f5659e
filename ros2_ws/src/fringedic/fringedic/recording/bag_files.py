"""Finds and opens the files of a recording."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from fringedic.errors import RecordingError
from fringedic.recording.mcap_file import DAMAGE, MAGIC, McapFile, check_chunks, opened, read_index
from fringedic.recording.mcap_scan import scan_file

BAG = "bag"  # of a run
METADATA = "metadata.yaml"
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster, where PyYAML has it


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
    """

    present: list[Path]
    missing: list[str]
    counts: dict[str, int]
    damage: str


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
    inside = path / BAG
    if path.is_dir() and inside.is_dir() and not (path / METADATA).exists() and not any(path.glob("*.mcap")):
        return inside
    return path


def find_files(path: Path) -> BagFiles:
    """Find the MCAP files of a recording: all in its folder, also those that ``metadata.yaml`` does not list.

    Parameters
    ----------
    path
        A rosbag2 folder or one MCAP file.

    Raises
    ------
    RecordingError
        There is no such recording, or it contains no MCAP file.
    """
    if path.is_file():
        return BagFiles([path], [], {}, "")
    if not path.is_dir():
        raise RecordingError(f"{path}: no such recording")
    listed: list[str] = []
    counts: dict[str, int] = {}
    damage = ""
    if (path / METADATA).is_file():
        try:
            listed, counts = _listed(path)
        except (yaml.YAMLError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            damage = f"{METADATA} is damaged"
    found = [path / name for name in listed if (path / name).is_file()]
    others = sorted(path.glob("*.mcap"), key=lambda file: [int(number) for number in re.findall(r"\d+", file.stem)])
    present = list(dict.fromkeys([*found, *others]))
    if not present:
        raise RecordingError(f"{path}: holds no .mcap file; convert other storage with 'ros2 bag convert'")
    return BagFiles(present, [name for name in listed if path / name not in present], counts, damage)


def _listed(path: Path) -> tuple[list[str], dict[str, int]]:
    """Return names of the files and counts of the topics in ``metadata.yaml``."""
    content: dict[str, Any] = yaml.load((path / METADATA).read_text("utf-8"), _LOADER)["rosbag2_bagfile_information"]
    topics = content["topics_with_message_count"] or []
    counts = {str(each["topic_metadata"]["name"]): int(each["message_count"]) for each in topics}
    return [Path(name).name for name in content["relative_file_paths"]], counts


def open_file(path: Path, *, check: bool) -> McapFile:
    """Return the chunks and channels of a file, by its index if it has one that is not damaged.

    Parameters
    ----------
    path
        The file.
    check
        Read every chunk and leave out those that are damaged. A file without an index is always checked.

    Raises
    ------
    RecordingError
        The file cannot be read or is not a file of this format.
    """
    with opened(path) as data:
        damage = [] if data[: len(MAGIC)] == MAGIC[: len(data)] else ["its first bytes are damaged"]
        file = None
        try:
            file = read_index(path, data)
        except DAMAGE:
            damage.append("its index is damaged and was rebuilt from the chunks")
        if file is None:
            file = scan_file(path, data)
        elif check:
            file = check_chunks(file, data)
        file.damage[:0] = damage
        return file
