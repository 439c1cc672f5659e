"""Checksums of the files of a recording, in the form that ``sha256sum --check`` reads."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fringedic.recording.bag_files import METADATA, find_files

MANIFEST = "manifest.sha256"
_LINE = re.compile(r"([0-9a-f]{64}) [ *](.+)")


@dataclass(frozen=True)
class ManifestCheck:
    """Comparison of the files of a recording with its manifest.

    Attributes
    ----------
    present
        Whether there is a manifest; a recording that was not closed, or that an earlier version wrote, has none.
    equal, changed, missing
        Names of the files with the checksum of the manifest, with another one, and of those that do not exist.
    unlisted
        Names of the MCAP files and of ``metadata.yaml`` that the manifest does not list; without a manifest, of the
        MCAP files that ``metadata.yaml`` does not list.
    unreadable
        Lines of the manifest that are not in its form.
    """

    present: bool
    equal: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    unlisted: tuple[str, ...] = ()
    unreadable: int = 0

    @property
    def fits(self) -> bool:
        """Whether nothing contradicts the manifest."""
        return not (self.changed or self.missing or self.unlisted or self.unreadable)


def write_manifest(folder: Path, checksums: Mapping[str, str]) -> None:
    """Write the manifest of a recording.

    Parameters
    ----------
    folder
        The recording.
    checksums
        SHA-256 of each file in hexadecimal digits, by its name.
    """
    write_whole(folder / MANIFEST, "".join(f"{checksum}  {name}\n" for name, checksum in checksums.items()))


def check_manifest(folder: Path) -> ManifestCheck:
    """Compare the files of a recording with its manifest; without one, their names with ``metadata.yaml``.

    Parameters
    ----------
    folder
        The recording.

    Raises
    ------
    OSError
        A file cannot be read.
    RecordingError
        See `find_files`.
    """
    path = folder / MANIFEST
    if not path.is_file():
        return ManifestCheck(present=False, unlisted=tuple(find_files(folder).unlisted))
    lines = path.read_text("utf-8", errors="replace").splitlines()
    stated = {match[2]: match[1] for match in map(_LINE.fullmatch, lines) if match}
    files = {name: folder / Path(name).name for name in stated}
    found = {name: checksum(file) for name, file in files.items() if file.is_file()}
    return ManifestCheck(
        present=True,
        equal=tuple(name for name in found if found[name] == stated[name]),
        changed=tuple(name for name in found if found[name] != stated[name]),
        missing=tuple(name for name in stated if name not in found),
        unlisted=tuple(sorted(file.name for file in _recorded(folder) if file.name not in stated)),
        unreadable=len(lines) - len(stated),
    )


def _recorded(folder: Path) -> list[Path]:
    """Return the files that a closed recording lists in its manifest."""
    return [file for file in folder.iterdir() if file.suffix == ".mcap" or file.name == METADATA]


def checksum(file: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal digits."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file so that it is complete at any time, also after a power cut; text as UTF-8."""
    temporary = path.with_name(f"{path.name}.writing")
    with open(temporary, "wb") as file:
        file.write(content.encode() if isinstance(content, str) else content)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)
