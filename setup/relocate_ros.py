"""Replace the builders' paths in the CMake files of the ROS 2 wheels by those of this Python and its NumPy.

Without this, CMake refuses the imported targets, because the include folders they name do not exist here.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np

PYTHON_INCLUDE = re.compile(r"/opt/python/cp\d+-cp\d+/include/python\d+\.\d+")
NUMPY_INCLUDE = re.compile(r"/opt/python/cp\d+-cp\d+/lib/python\d+\.\d+/site-packages/numpy/_?core/include")


def main() -> None:
    """Rewrite ``share/**/*.cmake`` of this Python's environment; the argument is its include folder."""
    python_include = sys.argv[1]
    changed = 0
    for file in Path(sys.prefix, "share").rglob("*.cmake"):
        text = file.read_text()
        relocated = NUMPY_INCLUDE.sub(np.get_include(), PYTHON_INCLUDE.sub(python_include, text))
        if relocated != text:
            file.write_text(relocated)
            changed += 1
    print(f"{changed} files")


if __name__ == "__main__":
    main()
