"""One owner per rig: two commands that start its nodes would move the machine of the same test."""

from __future__ import annotations

import errno
import json
import os
import socket
import sys
import threading
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Self

from fringedic.errors import ProcessError

_LONGEST_COMMAND = 200  # characters that a message repeats
_LONGEST_ADDRESS = 107  # bytes, of Linux
_ANSWER_S = 2.0


class RigLease:
    """The right to start the nodes of a rig on this computer, until the end of a `with` block or of the process.

    The owner binds an abstract Unix socket, which is one for all users of the computer and its network, and describes
    itself to every process that connects. The system frees the socket with the process, however it ends.

    Parameters
    ----------
    domain, namespace
        ROS domain and namespace of the rig.
    folder
        What the owner works on, for the message to others.

    Raises
    ------
    ProcessError
        On entry: another process has the rig; the message names it.
    """

    def __init__(self, domain: int, namespace: str, folder: Path) -> None:
        self._domain, self._namespace, self._folder = domain, namespace or "/", folder
        self._address = f"\0fringedic-rig-{domain}-{namespace.strip('/')}".encode()[:_LONGEST_ADDRESS]

    def __enter__(self) -> Self:
        self._socket = socket.socket(socket.AF_UNIX)  # nodes do not inherit it
        try:
            self._socket.bind(self._address)
        except OSError as error:
            self._socket.close()
            if error.errno != errno.EADDRINUSE:
                raise
            raise ProcessError(
                f"rig '{self._namespace}' in ROS domain {self._domain} is in use by {_owner_in_words(self._address)}; "
                "wait until it has ended, or choose another namespace or ROS_DOMAIN_ID"
            ) from None
        self._socket.listen()
        since = datetime.now().astimezone().isoformat(" ", "seconds")
        owner = {"pid": os.getpid(), "command": sys.argv, "folder": str(self._folder), "since": since}
        arguments = (self._socket, json.dumps(owner).encode())
        self._thread = threading.Thread(target=_describe, args=arguments, name="rig lease", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # ends the thread; closing alone would not
        self._thread.join()
        self._socket.close()


def _describe(listening: socket.socket, owner: bytes) -> None:
    """Send the description of the owner to each process that connects, until the socket is shut down."""
    while True:
        try:
            connection, _ = listening.accept()
        except OSError:
            return
        with connection, suppress(OSError):  # that process may have ended
            connection.sendall(owner)


def _owner_in_words(address: bytes) -> str:
    try:
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(_ANSWER_S)
            connection.connect(address)
            with connection.makefile() as description:
                owner = json.load(description)
    except (OSError, ValueError):
        return "another process, which has just started or does not answer"
    command = " ".join([Path(owner["command"][0]).name, *owner["command"][1:]])[:_LONGEST_COMMAND]
    return f"process {owner['pid']} ({command}) since {owner['since']}, folder {owner['folder']}"
