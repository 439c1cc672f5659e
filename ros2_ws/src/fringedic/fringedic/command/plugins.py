"""Commands and procedures of other packages, such as those that start the nodes of a rig and need ROS.

A package adds subcommands by an entry point of the group ``fringedic.commands``, a module that adds them when imported.
A procedure that starts nodes for a command of the library is an entry point of the group ``fringedic.procedures``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import entry_points
from typing import Any

from fringedic.errors import ConfigurationError

COMMANDS, PROCEDURES = "fringedic.commands", "fringedic.procedures"
ROS = ("ament_index_python", "launch", "launch_ros", "rclpy")
ENDINGS_OF_ROS = ("_interfaces", "_msgs", "_node", "_ros", "_srvs")
INSTALL = "install ROS 2 with the packages of fringedic, or source their set-up file (docs/installation.md)"


@cache
def load_commands() -> bool:
    """Import the subcommands of other packages, and return whether there are any.

    Raises
    ------
    ConfigurationError
        A package cannot be imported.
    """
    found = entry_points(group=COMMANDS)
    for each in found:
        try:
            each.load()
        except Exception as error:
            package = each.dist.name if each.dist else each.value
            raise ConfigurationError(
                f"the commands of the package {package} cannot be imported: {error}; repair or uninstall it"
            ) from error
    return bool(found)


def rig_procedure(name: str) -> Any:
    """Return a procedure that starts the nodes of a rig.

    Raises
    ------
    ConfigurationError
        No package with this procedure is installed.
    """
    for each in entry_points(group=PROCEDURES, name=name):
        return each.load()
    raise ConfigurationError(f"the nodes of a rig are needed, and the package fringedic_bringup is missing: {INSTALL}")


@contextmanager
def ros_as_sentence() -> Iterator[None]:
    """Turn the failed import of a module of ROS into one sentence.

    Raises
    ------
    ConfigurationError
        A module of ROS or of the nodes is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if module not in ROS and not module.endswith(ENDINGS_OF_ROS):
            raise
        raise ConfigurationError(f"ROS 2 is needed, and its module {module} is missing: {INSTALL}") from error
