"""``python -m fringedic``: the ``fringedic`` command, where it is installed beside the library."""

import sys
from importlib.metadata import entry_points

for command in entry_points(group="console_scripts", name="fringedic"):
    sys.exit(command.load()())
sys.exit("the library is installed without the command fringedic; it belongs to the package fringedic_bringup")
