"""Environments of the programs that fringedic is compared with, apart from the project's own.

They are made on first use in `~/.cache/fringedic/rivals` (or where FRINGEDIC_RIVALS says), from the pinned versions in
this folder.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent


def rival_python(name: str) -> Path | None:
    """Python of the environment of `requirements-NAME.txt`, made if need be; None where it cannot be installed."""
    requirements = FOLDER / f"requirements-{name}.txt"
    version = hashlib.sha256(requirements.read_bytes() + sys.version.encode()).hexdigest()[:12]
    home = Path(os.environ.get("FRINGEDIC_RIVALS", Path.home() / ".cache" / "fringedic" / "rivals"))
    environment = home / f"{name}-{version}"
    python = environment / "bin" / "python"
    if python.exists():
        return python
    print(f"installing {name} in {environment}", file=sys.stderr, flush=True)
    unfinished = environment.with_name(environment.name + ".part")
    shutil.rmtree(unfinished, ignore_errors=True)
    made = subprocess.run([sys.executable, "-m", "venv", str(unfinished)], check=False)
    if made.returncode:
        return None
    pip = [str(unfinished / "bin" / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    if subprocess.run([*pip, "-r", str(requirements)], check=False, env=_plain()).returncode:
        shutil.rmtree(unfinished, ignore_errors=True)
        return None
    unfinished.rename(environment)
    return python


def _plain() -> dict[str, str]:
    """The process environment without what points Python at the project's own packages."""
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}


def run_in(python: Path, script: str, folder: Path) -> bool:
    """Run a script in a rival's environment on the jobs of a folder; False and a word on stderr if it fails."""
    done = subprocess.run([str(python), str(FOLDER / script), str(folder)], check=False, env=_plain(), cwd=folder)
    if done.returncode:
        print(f"{script} ended with exit code {done.returncode}", file=sys.stderr)
    return done.returncode == 0
