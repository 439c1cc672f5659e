"""``python -m fringedic``: the ``fringedic`` command, where it is installed beside the library."""

import sys
from importlib.metadata import entry_points
from typing import Any


def main() -> Any:
    """Run the command."""
    for command in entry_points(group="console_scripts", name="fringedic"):
        return command.load()()
    return "the library is installed without the command fringedic; it belongs to the package fringedic_bringup"


if __name__ == "__main__":
    sys.exit(main())
