"""Rig files that are installed with fringedic, by their names."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path

from fringedic.errors import ConfigurationError

GROUP = "fringedic.rig_files"  # entry points: functions that return a folder with rig files


def rig_path_of(rig: Path) -> Path:
    """Return a rig file as given, or the installed one of this name.

    Raises
    ------
    ConfigurationError
        There is neither.
    """
    if rig.exists() or rig.parent != Path():
        return rig
    installed = {file.stem: file for each in entry_points(group=GROUP) for file in sorted(each.load()().glob("*.yaml"))}
    if rig.stem in installed:
        return Path(installed[rig.stem])
    names = f"installed with fringedic are {', '.join(sorted(installed))}" if installed else "give the path of one"
    raise ConfigurationError(f"{rig}: no such rig file; {names}")
