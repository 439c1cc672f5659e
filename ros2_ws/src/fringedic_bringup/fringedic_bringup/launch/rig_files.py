"""Files that are installed with fringedic: rig files and the profile of the middleware."""

from __future__ import annotations

from pathlib import Path

from fringedic.errors import ConfigurationError


def configuration(name: str) -> Path:
    """Return the path of an installed file of this package, such as a rig file."""
    # imported here, because a rig file given by its path needs no ROS
    from ament_index_python.packages import get_package_share_directory

    return Path(get_package_share_directory("fringedic_bringup"), "config", name)


def rig_path_of(rig: Path) -> Path:
    """Return a rig file as given, or the installed one of this name.

    Raises
    ------
    ConfigurationError
        There is neither.
    """
    if rig.exists() or rig.parent != Path():
        return rig
    installed = configuration(f"{rig.stem}.yaml")
    if installed.exists():
        return installed
    names = ", ".join(sorted(path.stem for path in installed.parent.glob("*.yaml")))
    raise ConfigurationError(f"{rig}: no such rig file; installed with fringedic are {names}")
