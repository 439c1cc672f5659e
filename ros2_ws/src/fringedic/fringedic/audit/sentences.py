"""The result of an audit in words."""

from __future__ import annotations

from fringedic.audit.parts import CALIBRATION_OF_RUN, Part, Result
from fringedic.audit.run import Audit

LIMITS = (
    "An unchanged log shows that files are as they were when it was signed, not that the measurement was right.",
    "Whoever has the key of the laboratory can sign another log. A time stamp of an authority, or a copy of the log "
    "elsewhere, excludes that for the time before.",
    "The first entry contains the state at the end of the run: what was changed before cannot be found, except in the "
    "raw data, whose checksums are written while they are recorded.",
)
"""What an audit does not prove."""


def part_sentence(part: Part) -> str:
    """Return a part as one line.

    Examples
    --------
    >>> part_sentence(Part("files", Result.HOLDS, "all 12 files are those of the log"))
    'holds       files: all 12 files are those of the log'
    """
    return f"{part.result:<11} {part.name}: {part.found}"


def verdict_sentence(audit: Audit) -> str:
    """Return the verdict over all parts."""
    failed = [part.name for part in audit.parts if part.result is Result.FAILS]
    unproven = [part.name for part in audit.parts if part.result is Result.OPEN]
    if failed:
        return f"verdict: the files do not support the results, because of {', '.join(failed)}"
    if unproven:
        return f"verdict: nothing contradicts the results, but not proven: {', '.join(unproven)}"
    noted = [
        f"{part.name}: {part.found}"
        for part in audit.parts
        if part.name == CALIBRATION_OF_RUN and part.result is Result.NOTE
    ]
    return f"verdict: the files support the results; {'; '.join(noted) or 'every part holds'}"
