"""What the processes of a rig need of the middleware before they start, when they start and after they have ended."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fringedic_ros.middleware import fast_dds
from fringedic_ros.rmw import is_fast_dds


def settings(environment: Mapping[str, str], profiles: Path) -> dict[str, str]:
    """Return the variables that nodes with an environment need further; those of the environment are not changed.

    Parameters
    ----------
    environment
        Of the nodes.
    profiles
        Folder of the profiles of Fast DDS.

    Raises
    ------
    ProcessError
        The middleware is not installed; or with other computers, the address of this one cannot be chosen.
    """
    return fast_dds.settings(environment, profiles) if is_fast_dds(environment) else {}


def enter(domain: int) -> None:
    """Prepare this process for a ROS domain, before it creates its first node.

    Raises
    ------
    ProcessError
        The middleware is not installed.
    """
    if is_fast_dds():
        fast_dds.choose_participant_number(domain)


def remove_leftovers() -> set[str]:
    """Remove what killed nodes of this user have left on this computer, and return the names of it."""
    return fast_dds.remove_stale_segments() if is_fast_dds() else set()
