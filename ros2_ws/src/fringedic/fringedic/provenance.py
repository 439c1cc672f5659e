"""Which software made a file."""

from __future__ import annotations

import importlib.metadata
import json
import subprocess
from functools import cache
from pathlib import Path

from fringedic import __version__

UNKNOWN = "unknown"
_SECONDS = 10


def software() -> str:
    """Return name and version of this library."""
    return f"fringedic {__version__}"


@cache
def git_commit() -> str:
    """Return the commit of the source that runs, as known to git or to the installer.

    Returns
    -------
    str
        Forty hexadecimal digits, followed by ``, with changes`` when files differ from that commit; ``unknown`` for an
        installation that does not tell.
    """
    folder = Path(__file__).resolve().parent
    try:
        # a repository that happens to lie around an installation knows nothing of this file
        _git(folder, "ls-files", "--error-unmatch", "provenance.py")
        commit = _git(folder, "rev-parse", "HEAD")
        changed = _git(folder, "status", "--porcelain", "--untracked-files=no", "--", ".")
    except (OSError, subprocess.SubprocessError):
        return _installed_commit()
    return f"{commit}, with changes" if changed else commit


def _git(folder: Path, *words: str) -> str:
    done = subprocess.run(
        ["git", "-C", str(folder), *words], capture_output=True, text=True, check=True, timeout=_SECONDS
    )
    return done.stdout.strip()


def _installed_commit() -> str:
    """Return the commit that an installer noted (PEP 610)."""
    try:
        noted = importlib.metadata.distribution("fringedic").read_text("direct_url.json")
        return str(json.loads(noted or "")["vcs_info"]["commit_id"])
    except (importlib.metadata.PackageNotFoundError, ValueError, KeyError):
        return UNKNOWN
