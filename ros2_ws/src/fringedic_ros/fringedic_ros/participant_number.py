"""The number of a node's process in its ROS domain, from which Fast DDS derives the ports on which it receives."""

from __future__ import annotations

import os
from pathlib import Path

VARIABLE = "FRINGEDIC_PARTICIPANT"  # fastdds.xml contains it
AUTOMATIC = -1  # Fast DDS takes the lowest free number
NUMBERS = 32  # discovery on one computer asks so many
SHARED_MEMORY = Path("/dev/shm")
# DDS-RTPS 2.5, 9.6.2.3
_PORT_BASE = 7400
_DOMAIN_GAIN = 250
_PARTICIPANT_GAIN = 2
_META_UNICAST, _USER_UNICAST = 10, 11


def choose_participant_number(domain: int) -> int:
    """Choose a number whose port in shared memory no process has used lately, and return it; `AUTOMATIC` without one.

    It has an effect on the participant that this process creates first.

    By itself a process takes the lowest free number, and one that is started again that of its predecessor. The memory
    of a port counts as alive when its reader was killed neither while it waited nor while it processed a message
    (Fast DDS 2.14.5, SharedMemGlobal.hpp). Processes that sent to the predecessor then go on to write there, and the
    successor never receives their messages.
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
    return SHARED_MEMORY / f"fastrtps_port{port}"


def number_of_port(port: int) -> int:
    """Return the number of the participant with a UDP port; negative for the ports of all participants."""
    return ((port - _PORT_BASE) % _DOMAIN_GAIN - _META_UNICAST) // _PARTICIPANT_GAIN


def domain_of_port(port: int) -> int:
    """Return the ROS domain of a port."""
    return (port - _PORT_BASE) // _DOMAIN_GAIN
