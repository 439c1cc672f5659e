"""What the results of a unit depend on beside its input: version, commit and the packages that compute."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import socket
from functools import cache
from typing import Any

from fringedic.provenance import git_commit, software

_COMPUTING = ("numpy", "scipy", "numba", "llvmlite", "opencv-python-headless", "scikit-image", "zarr", "numcodecs")


@cache
def software_identity() -> dict[str, str]:
    """Return version and commit of this library, and the versions of Python and of the packages that compute."""
    installed = {each.metadata["Name"] for each in importlib.metadata.distributions()}
    versions = {name: importlib.metadata.version(name) for name in _COMPUTING if name in installed}
    return {"fringedic": software(), "commit": git_commit(), "python": platform.python_version(), **versions}


def differences(one: dict[str, Any], other: dict[str, Any]) -> str:
    """Return what differs between two identities, for a message.

    Examples
    --------
    >>> differences({"numpy": "2.1.0", "numba": "0.61"}, {"numpy": "2.2.0", "numba": "0.61"})
    'numpy 2.1.0 instead of 2.2.0'
    """
    names = [name for name in {**one, **other} if one.get(name) != other.get(name)]
    return ", ".join(f"{name} {one.get(name, '-')} instead of {other.get(name, '-')}" for name in names)


def worker_name() -> str:
    """Return computer and process."""
    return f"{socket.gethostname()}:{os.getpid()}"


@cache
def processor() -> str:
    """Return the kind of processor that Numba compiles for: another one can change the last bits of a result."""
    from llvmlite.binding import get_host_cpu_name

    return str(get_host_cpu_name())
