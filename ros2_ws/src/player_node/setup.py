"""Packaging as written in the library's setup.py, for the package.xml and setup.cfg of this folder."""

import runpy
from pathlib import Path

runpy.run_path(str(Path(__file__).resolve().parents[1] / "fringedic" / "setup.py"))
