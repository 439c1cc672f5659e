"""What all processes of a rig share on this computer: environment and ROS domain."""

from __future__ import annotations

import fcntl
import itertools
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from fringedic.errors import ProcessError
from fringedic_bringup.launch.rig_files import configuration
from fringedic_ros import middleware

# The ports of domains above 101 overlap those that Linux assigns to outgoing connections.
PRIVATE_DOMAINS = range(62, 102)
_taken = itertools.count(os.getpid())


def domain_of(environment: Mapping[str, str]) -> int:
    """Return the ROS domain of processes with an environment."""
    return int(environment.get("ROS_DOMAIN_ID") or 0)


def node_environment(domain: int | None = None) -> dict[str, str]:
    """Return the environment of nodes: that of this process, with the settings that reproducible results need.

    Raises
    ------
    ProcessError
        The middleware is not installed; or with other computers, the address of this one cannot be chosen.
    """
    environment = dict(os.environ)
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    environment |= middleware.settings(environment, configuration(""))
    environment |= {
        "OPENBLAS_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
        "PYTHONUNBUFFERED": "1",
        "PYTHONFAULTHANDLER": "1",  # a crash of compiled code is found in the log
        "RCUTILS_COLORIZED_OUTPUT": "0",
    }
    # memory that a process keeps between steps need not be cleared again by the kernel
    for name, value in (("ARENA_MAX", 1), ("MMAP_THRESHOLD_", 1 << 30), ("TRIM_THRESHOLD_", 1 << 32)):
        environment.setdefault(f"MALLOC_{name}", str(value))
    if domain is not None:
        environment["ROS_DOMAIN_ID"] = str(domain)
    return environment


@contextmanager
def private_domain() -> Iterator[int]:
    """Reserve a ROS domain that no other replay on this machine uses, and yield its number.

    Each search starts one domain further, because a killed process stays in the graph of its domain for 20 s.

    Raises
    ------
    ProcessError
        All of these domains are in use.
    """
    first = next(_taken)
    for turn in range(len(PRIVATE_DOMAINS)):
        domain = PRIVATE_DOMAINS[(first + turn) % len(PRIVATE_DOMAINS)]
        if str(domain) == os.environ.get("ROS_DOMAIN_ID"):
            continue
        path = Path(tempfile.gettempdir()) / f"fringedic-domain-{domain}.{os.getuid()}.lock"
        with path.open("a") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            yield domain
            return
    raise ProcessError(
        f"all ROS domains from {PRIVATE_DOMAINS[0]} to {PRIVATE_DOMAINS[-1]} are used by other replays; wait until one "
        "has ended"
    )
