"""One owner per rig: two commands that start its nodes would move the machine of the same test."""

from __future__ import annotations

import fcntl
import json
import os
import sys
import tempfile
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Self

from fringedic.errors import ProcessError

_LONGEST_COMMAND = 200  # characters that a message repeats


class RigLease:
    """The right to start the nodes of a rig on this computer, until the end of a `with` block or of the process.

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
        name = f"fringedic-rig-{domain}-{namespace.strip('/').replace('/', '-')}.{os.getuid()}.lock"
        self._path = Path(tempfile.gettempdir()) / name

    def __enter__(self) -> Self:
        # the system drops the lock with the process, however it ends; nodes do not inherit it
        self._file = self._path.open("a+")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._file.seek(0)
            owner = _owner_in_words(self._file.read())
            self._file.close()
            raise ProcessError(
                f"rig '{self._namespace}' in ROS domain {self._domain} is in use by {owner}; wait until it has ended, "
                "or choose another namespace or ROS_DOMAIN_ID"
            ) from None
        self._file.truncate(0)
        since = datetime.now().astimezone().isoformat(" ", "seconds")
        json.dump({"pid": os.getpid(), "command": sys.argv, "folder": str(self._folder), "since": since}, self._file)
        self._file.flush()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._file.close()


def _owner_in_words(text: str) -> str:
    try:
        owner = json.loads(text)
    except ValueError:
        return "another process, which has just started"
    command = " ".join([Path(owner["command"][0]).name, *owner["command"][1:]])[:_LONGEST_COMMAND]
    return f"process {owner['pid']} ({command}) since {owner['since']}, folder {owner['folder']}"
