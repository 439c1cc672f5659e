"""What all processes of a rig share on this computer: middleware settings, ROS domains, shared memory."""

from __future__ import annotations

import fcntl
import itertools
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from fringedic.errors import ProcessError
from fringedic_bringup.launch.address import own_address
from fringedic_bringup.launch.rig_files import configuration
from fringedic_ros.participant_number import AUTOMATIC, SHARED_MEMORY, VARIABLE, domain_of_port

# Of each node, for the images that it sends. A container may have only 64 MB for all nodes of two runs.
SEGMENT_BYTES = 16_000_000
SEGMENTS = 32
BETWEEN_CHECKS_S = 0.2
_SEGMENT = re.compile(r"(?:sem\.)?(?P<name>fastrtps_(?:port\d+|[0-9a-f]{16}))(?:(?P<lock>_[es]l)|_mutex)?")
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
        With other computers, and the address of this one cannot be chosen.
    """
    environment = dict(os.environ)
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    environment.setdefault(_profile_variable(environment), str(configuration("fastdds.xml")))
    environment.setdefault("FRINGEDIC_SEGMENT_BYTES", str(_segment_bytes()))
    environment.setdefault("FRINGEDIC_ADDRESS", own_address(environment["ROS_AUTOMATIC_DISCOVERY_RANGE"]))
    environment |= {
        VARIABLE: str(AUTOMATIC),  # until a node chooses it
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


def _profile_variable(environment: Mapping[str, str]) -> str:
    """Return the variable that names the profile of Fast DDS: version 2 is that of Jazzy, later ones have version 3."""
    return f"FAST{'RTPS' if environment.get('ROS_DISTRO', 'jazzy') == 'jazzy' else 'DDS'}_DEFAULT_PROFILES_FILE"


def _segment_bytes() -> int:
    """Return the size of a node's shared memory, which Fast DDS allocates at once, so that all nodes have enough."""
    try:
        whole = shutil.disk_usage(SHARED_MEMORY).total
    except OSError:  # not Linux
        return SEGMENT_BYTES
    return min(SEGMENT_BYTES, whole // SEGMENTS)


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


def remove_stale_segments() -> set[str]:
    """Remove this user's Fast DDS shared memory that no process uses, and return the names of the segments.

    Killed processes leave their segments behind, others their ports. A segment is in use when a process has mapped it
    or locked one of its files (``_el``: exclusively, ``_sl``: shared). It is removed when it is unused twice in
    succession, because a process maps a new segment only after it was created. A client may open the port of one that
    was killed, and would receive nothing on a removed one: the ports of a domain stay as long as a process uses one of
    them.
    """
    stale = _unused_segments()
    if stale:
        time.sleep(BETWEEN_CHECKS_S)
        stale = {path: name for path, name in _unused_segments().items() if path in stale}
    for path in stale:
        path.unlink(missing_ok=True)
    return set(stale.values())


def _unused_segments() -> dict[Path, str]:
    """Return the files of this user's segments that no process has mapped or locked, with the names of the segments."""
    files = [(found, path) for path in SHARED_MEMORY.iterdir() if (found := _SEGMENT.fullmatch(path.name))]
    mapped = mapped_segments()
    domains = {_domain_of(name) for name in mapped} - {None}
    unmapped = [
        (found, path)
        for found, path in files
        if found["name"] not in mapped and _domain_of(found["name"]) not in domains and _is_mine(path)
    ]
    # only these are tried: a process that starts must find its own locks free
    locked = {found["name"] for found, path in unmapped if found["lock"] and _is_locked(path)}
    return {path: found["name"] for found, path in unmapped if found["name"] not in locked}


def _domain_of(name: str) -> int | None:
    """Return the ROS domain of a port; None for the memory of a process."""
    port = name.removeprefix("fastrtps_port")
    return domain_of_port(int(port)) if port != name else None


def mapped_segments() -> set[str]:
    """Return the segments that are mapped by processes whose memory map this user may read."""
    names: set[str] = set()
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with suppress(OSError):
            names.update(re.findall(r"/dev/shm/(?:sem\.)?(fastrtps_(?:port\d+|[0-9a-f]{16}))", maps.read_text()))
    return names


def _is_locked(path: Path) -> bool:
    # a shared lock conflicts with an exclusive one, but not with that of another process that runs this check
    kind = fcntl.LOCK_SH if path.name.endswith("_el") else fcntl.LOCK_EX
    try:
        with path.open("ab") as file:
            fcntl.flock(file, kind | fcntl.LOCK_NB)
    except OSError:
        return True
    return False


def _is_mine(path: Path) -> bool:
    with suppress(OSError):
        return path.stat().st_uid == os.getuid()
    return False
