"""The rig files that were opened on this computer by the operator's page."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from fringedic.recording.manifest import write_whole

MOST_RIGS = 50


def _list_file() -> Path:
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "fringedic" / "rigs.txt"


def known_rigs() -> list[Path]:
    """Return the rig files that are still there, the one that was opened last first."""
    try:
        lines = _list_file().read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return []
    return [Path(line) for line in lines if line and Path(line).is_file()]


def remember_rig(rig_file: Path) -> None:
    """Put a rig file at the begin of the list; a list that cannot be written is left as it is."""
    own = rig_file.absolute()
    known = [own, *(each for each in known_rigs() if each != own)][:MOST_RIGS]
    with suppress(OSError):
        _list_file().parent.mkdir(parents=True, exist_ok=True)
        write_whole(_list_file(), "".join(f"{each}\n" for each in known))
