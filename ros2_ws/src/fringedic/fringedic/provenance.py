"""Version and commit of the software that writes a file, and everything else that decides the bits of a result."""

from __future__ import annotations

import importlib.metadata
import json
import platform
import subprocess
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from fringedic import __version__

UNKNOWN = "unknown"
_TIMEOUT = 10  # [s]
_COMPUTING = ("numpy", "scipy", "numba", "llvmlite", "opencv-python-headless", "scikit-image", "zarr", "numcodecs")


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
    # a process that is killed meanwhile leaves no .git/index.lock
    command = ["git", "--no-optional-locks", "-C", str(folder), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=_TIMEOUT)
    return done.stdout.strip()


def _installed_commit() -> str:
    """Return the commit from the record of the installer (PEP 610)."""
    try:
        noted = importlib.metadata.distribution("fringedic").read_text("direct_url.json")
        return str(json.loads(noted or "")["vcs_info"]["commit_id"])
    except (importlib.metadata.PackageNotFoundError, ValueError, KeyError):
        return UNKNOWN


@cache
def software_identity() -> dict[str, str]:
    """Return version and commit of this library, and the versions of Python and of the packages that compute."""
    installed = {each.metadata["Name"] for each in importlib.metadata.distributions()}
    versions = {name: importlib.metadata.version(name) for name in _COMPUTING if name in installed}
    return {"fringedic": software(), "commit": git_commit(), "python": platform.python_version(), **versions}


def differences(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Return what differs between two identities, for a message.

    Examples
    --------
    >>> differences({"numpy": "2.1.0", "numba": "0.61"}, {"numpy": "2.2.0", "numba": "0.61"})
    'numpy 2.1.0 instead of 2.2.0'
    """
    names = [name for name in {**one, **other} if one.get(name) != other.get(name)]
    return ", ".join(f"{name} {one.get(name, '-')} instead of {other.get(name, '-')}" for name in names)


@cache
def processor() -> str:
    """Return the kind of processor that Numba compiles for: another one can change the last bits of a result."""
    from llvmlite.binding import get_host_cpu_name

    return str(get_host_cpu_name())
