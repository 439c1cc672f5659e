"""The number of a node's process in its ROS domain, from which Fast DDS derives the ports that it listens to."""

from __future__ import annotations

import os
from pathlib import Path

VARIABLE = "FRINGEDIC_PARTICIPANT"  # fastdds.xml contains it
AUTOMATIC = -1  # Fast DDS takes the lowest free number
NUMBERS = 32  # discovery on one computer asks so many
SHARED_MEMORY = Path("/dev/shm")


def choose_participant_number(domain: int) -> int:
    """Choose a number whose port in shared memory no process has used lately, and return it; `AUTOMATIC` without one.

    It has an effect on the participant that this process creates first.

    By itself a process takes the lowest free number, and one that is started again that of its predecessor. The memory
    of a port counts as alive when its reader was killed neither while it waited nor while it processed a message
    (Fast DDS 2.14.5, SharedMemGlobal.hpp). Those who sent to the predecessor then go on to write there, and the
    successor never hears them.
    """
    first = os.getpid()  # processes that start together begin at different numbers
    numbers = ((first + turn) % NUMBERS for turn in range(NUMBERS))
    number = next((number for number in numbers if not port_files(domain, number)), AUTOMATIC)
    os.environ[VARIABLE] = str(number)
    return number


def port_files(domain: int, number: int) -> list[Path]:
    """Return the files that exist of a port: its memory, and the lock of its reader."""
    port = 7400 + 250 * domain + 2 * number + 11  # for user data, DDS-RTPS 2.5, 9.6.2.3
    names = (f"fastrtps_port{port}", f"fastrtps_port{port}_el")
    return [path for path in (SHARED_MEMORY / name for name in names) if path.exists()]
