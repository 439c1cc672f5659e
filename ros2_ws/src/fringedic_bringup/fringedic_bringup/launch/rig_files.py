"""Files that are installed with fringedic: rig files and the profile of the middleware."""

from __future__ import annotations

from pathlib import Path


def configuration(name: str) -> Path:
    """Return the path of an installed file of this package, such as a rig file."""
    # imported here, because a rig file given by its path needs no ROS
    from ament_index_python.packages import get_package_share_directory

    return Path(get_package_share_directory("fringedic_bringup"), "config", name)


def rig_files() -> Path:
    """Return the folder of the installed rig files."""
    return configuration("")
