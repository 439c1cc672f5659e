"""Fast DDS: its profile, the ports of its processes, and the shared memory that they leave behind."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from fringedic_ros.middleware.address import own_address

VARIABLE = "FRINGEDIC_PARTICIPANT"  # the profiles contain it
AUTOMATIC = -1  # Fast DDS takes the lowest free number
NUMBERS = 32  # discovery on one computer asks so many
SHARED_MEMORY = Path("/dev/shm")
# Of each node, for the images that it sends. A container may have only 64 MB for all nodes of two runs.
SEGMENT_BYTES = 16_000_000
SEGMENTS = 32
BETWEEN_CHECKS_S = 0.2
_SEGMENT = re.compile(r"(?:sem\.)?(?P<name>fast(?:rtps|dds)_(?:port\d+|[0-9a-f]{16}))(?:(?P<lock>_[es]l)|_mutex)?")
# DDS-RTPS 2.5, 9.6.2.3
_PORT_BASE = 7400
_DOMAIN_GAIN = 250
_PARTICIPANT_GAIN = 2
_META_UNICAST, _USER_UNICAST = 10, 11


def settings(environment: Mapping[str, str], profiles: Path) -> dict[str, str]:
    """Return the variables of the profile and of what it contains, except those that the environment has.

    Parameters
    ----------
    environment
        Of the nodes.
    profiles
        Folder of the profiles. A version rejects the whole profile of another one, because an element has another name.

    Raises
    ------
    ProcessError
        With other computers, and the address of this one cannot be chosen.
    """
    version = name_of_version(environment)
    variables = {
        f"{version.upper()}_DEFAULT_PROFILES_FILE": lambda: str(profiles / f"{version}.xml"),
        "FRINGEDIC_SEGMENT_BYTES": lambda: str(_segment_bytes()),
        "FRINGEDIC_ADDRESS": lambda: own_address(environment["ROS_AUTOMATIC_DISCOVERY_RANGE"]),
    }
    missing = {name: value() for name, value in variables.items() if name not in environment}
    return missing | {VARIABLE: str(AUTOMATIC)}  # until a node chooses it


def name_of_version(environment: Mapping[str, str]) -> str:
    """Return how Fast DDS names its files and variables: version 2, which Jazzy has, otherwise than later ones."""
    return "fastrtps" if environment.get("ROS_DISTRO", "jazzy") == "jazzy" else "fastdds"


def _segment_bytes() -> int:
    """Return the size of a node's shared memory, which Fast DDS allocates at once, so that all nodes have enough."""
    try:
        whole = shutil.disk_usage(SHARED_MEMORY).total
    except OSError:  # not Linux
        return SEGMENT_BYTES
    return min(SEGMENT_BYTES, whole // SEGMENTS)


def choose_participant_number(domain: int) -> int:
    """Choose a number whose port in shared memory no process has used lately, and return it; `AUTOMATIC` without one.

    It has an effect on the participant that this process creates first.

    By itself a process takes the lowest free number, and one that is started again that of its predecessor. The memory
    of a port counts as alive when its reader was killed neither while it waited nor while it processed a message
    (Fast DDS 2.14.5 and 3.2.3, SharedMemGlobal.hpp). Processes that sent to the predecessor then go on to write there,
    and the successor never receives their messages.
    """
    first = os.getpid()  # processes that start together begin at different numbers
    numbers = ((first + turn) % NUMBERS for turn in range(NUMBERS))
    number = next((number for number in numbers if not port_exists(domain, number)), AUTOMATIC)
    os.environ[VARIABLE] = str(number)
    return number


def port_exists(domain: int, number: int) -> bool:
    """Return whether a process has the port for user data of a number, or left its memory or the lock of its reader."""
    memory = memory_of_port(domain, number)
    return any(memory.with_name(memory.name + lock).exists() for lock in ("", "_el"))


def memory_of_port(domain: int, number: int) -> Path:
    """Return the shared memory of the port for user data of a number."""
    port = _PORT_BASE + _DOMAIN_GAIN * domain + _PARTICIPANT_GAIN * number + _USER_UNICAST
    return SHARED_MEMORY / f"{name_of_version(os.environ)}_port{port}"


def number_of_port(port: int) -> int:
    """Return the number of the participant with a UDP port; negative for the ports of all participants."""
    return ((port - _PORT_BASE) % _DOMAIN_GAIN - _META_UNICAST) // _PARTICIPANT_GAIN


def domain_of_port(port: int) -> int:
    """Return the ROS domain of a port."""
    return (port - _PORT_BASE) // _DOMAIN_GAIN


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
    _, is_port, port = name.partition("_port")
    return domain_of_port(int(port)) if is_port else None


def mapped_segments() -> set[str]:
    """Return the segments that are mapped by processes whose memory map this user may read."""
    names: set[str] = set()
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with suppress(OSError):
            names.update(
                re.findall(r"/dev/shm/(?:sem\.)?(fast(?:rtps|dds)_(?:port\d+|[0-9a-f]{16}))", maps.read_text())
            )
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
