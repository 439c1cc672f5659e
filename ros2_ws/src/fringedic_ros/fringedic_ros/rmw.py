"""Which middleware this computer uses: the RMW implementation of ROS 2.

This module does not import rclpy, whose import ends the process when the requested middleware is not installed.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

from ament_index_python import get_resources

from fringedic.errors import ProcessError

VARIABLE = "RMW_IMPLEMENTATION"
DEFAULT = "rmw_fastrtps_cpp"  # of Jazzy, Kilted and Lyrical
FAST_DDS = frozenset({"rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp"})
DDS = FAST_DDS | {"rmw_cyclonedds_cpp", "rmw_connextdds", "rmw_gurumdds_cpp"}
_LOADER = "rmw_implementation"  # registers itself like those that it loads


def rmw_implementation(environment: Mapping[str, str] = os.environ) -> str:
    """Return the name of the RMW implementation that processes with an environment load.

    It is the one of ``RMW_IMPLEMENTATION``; else the default of ROS 2, or the first that is installed where that one is
    not (rmw_implementation, functions.cpp).

    Raises
    ------
    ProcessError
        It is not installed.

    Examples
    --------
    >>> rmw_implementation({})
    'rmw_fastrtps_cpp'
    """
    installed = sorted(get_resources("rmw_typesupport").keys() - {_LOADER})
    requested = environment.get(VARIABLE, "")
    if requested in installed:
        return requested
    if not installed:
        raise ProcessError("no RMW implementation of ROS 2 is installed: run `make setup`, or source ROS 2")
    if requested:
        raise ProcessError(
            f"{VARIABLE}={requested} is not installed, but {', '.join(installed)}: install its package of your ROS 2 "
            "distribution and source it again, or unset the variable"
        )
    return DEFAULT if DEFAULT in installed else installed[0]


def is_fast_dds(environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether processes with an environment use Fast DDS; errors as of `rmw_implementation`."""
    return rmw_implementation(environment) in FAST_DDS
