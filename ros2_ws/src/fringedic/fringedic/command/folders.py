"""Folders for the files of procedures."""

from __future__ import annotations

import os
from pathlib import Path

from fringedic.errors import ConfigurationError


def output_folder(folder: Path) -> Path:
    """Return a folder after a check that it can be created and written, before anything is measured.

    Raises
    ------
    ConfigurationError
        It cannot.
    """
    place = folder.absolute()
    while not place.exists():
        place = place.parent
    if not place.is_dir():
        raise ConfigurationError(f"--output {folder}: {place} is a file; choose another folder")
    if not os.access(place, os.W_OK | os.X_OK):
        raise ConfigurationError(f"--output {folder}: {place} cannot be written; choose another folder")
    return folder


def unused_folder(folder: Path) -> Path:
    """Return the first folder of demo, demo-2, demo-3 ... that does not exist.

    Raises
    ------
    ConfigurationError
        It cannot be created.
    """
    candidate, number = folder, 1
    while candidate.exists():
        number += 1
        candidate = folder.with_name(f"{folder.name}-{number}")
    return output_folder(candidate)
