"""Read by every Python process that has this folder on its PYTHONPATH: imports of ROS and of the nodes fail."""

from __future__ import annotations

import sys
from importlib.abc import MetaPathFinder

NAMES = ("ament_index_python", "launch", "launch_ros", "rclpy", "rpyutils")
ENDINGS = ("_interfaces", "_msgs", "_node", "_ros", "_srvs")


class NoRos(MetaPathFinder):
    """Finds no module of ROS."""

    def find_spec(self, fullname: str, *_: object) -> None:
        """Raise an error for modules of ROS."""
        top = fullname.partition(".")[0]
        if top in NAMES or top.endswith(ENDINGS):
            raise ModuleNotFoundError(f"No module named {fullname!r}: ROS is blocked", name=fullname)


sys.meta_path.insert(0, NoRos())
