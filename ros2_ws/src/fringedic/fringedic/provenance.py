"""Version and commit of the software that writes a file."""

from __future__ import annotations

import importlib.metadata
import json
import subprocess
from functools import cache
from pathlib import Path

from fringedic import __version__

UNKNOWN = "unknown"
_TIMEOUT = 10  # [s]


def software() -> str:
    """Return name and version of this library."""
    return f"fringedic {__version__}"


@cache
def git_commit() -> str:
    """Return the commit of the running source, from git or from the installer.

    Returns
    -------
    str
        Forty hexadecimal digits, followed by ``, with changes`` when files differ from that commit; ``unknown`` where
        the installation does not contain it.
    """
    folder = Path(__file__).resolve().parent
    try:
        # refuses a repository that contains the installation by chance, but not this file
        _git(folder, "ls-files", "--error-unmatch", "provenance.py")
        commit = _git(folder, "rev-parse", "HEAD")
        changed = _git(folder, "status", "--porcelain", "--untracked-files=no", "--", ".")
    except (OSError, subprocess.SubprocessError):
        return _installed_commit()
    return f"{commit}, with changes" if changed else commit


def _git(folder: Path, *words: str) -> str:
    done = subprocess.run(
        ["git", "-C", str(folder), *words], capture_output=True, text=True, check=True, timeout=_TIMEOUT
    )
    return done.stdout.strip()


def _installed_commit() -> str:
    """Return the commit from the record of the installer (PEP 610)."""
    try:
        noted = importlib.metadata.distribution("fringedic").read_text("direct_url.json")
        return str(json.loads(noted or "")["vcs_info"]["commit_id"])
    except (importlib.metadata.PackageNotFoundError, ValueError, KeyError):
        return UNKNOWN
