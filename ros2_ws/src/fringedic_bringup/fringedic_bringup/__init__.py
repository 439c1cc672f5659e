"""The graph of a rig, and the commands that start its nodes."""

import os

import fringedic.command  # noqa: F401 (linear algebra on one thread, set before NumPy is loaded)
from fringedic import replacement_of

if not {"ROS_LOG_DIR", "ROS_HOME"} & os.environ.keys():
    _logs = replacement_of(os.path.expanduser("~/.ros"))  # ROS 2 does not start when it cannot write there
    if _logs is not None:
        os.environ["ROS_LOG_DIR"] = _logs
