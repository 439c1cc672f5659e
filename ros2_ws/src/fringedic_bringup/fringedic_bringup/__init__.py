"""The graph of a rig and the `fringedic` command."""

import os

from fringedic import replacement_of

# linear algebra on one thread, as in the nodes: the desk's numbers are theirs, bit by bit. Set before NumPy is loaded.
for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

if not {"ROS_LOG_DIR", "ROS_HOME"} & os.environ.keys():
    _logs = replacement_of(os.path.expanduser("~/.ros"))  # ROS 2 does not start when it cannot write there
    if _logs is not None:
        os.environ["ROS_LOG_DIR"] = _logs
