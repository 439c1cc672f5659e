"""The page for an auditor."""

from __future__ import annotations

from pathlib import Path

from fringedic.audit.parts import Result
from fringedic.audit.run import Audit
from fringedic.audit.sentences import LIMITS, verdict_sentence
from fringedic.report.templates import render_page, write_page


def write_audit_page(audit: Audit, path: Path) -> Path:
    """Write the page of an audit and return its path; it prints on A4.

    Raises
    ------
    DatasetError
        The file cannot be written.
    """
    verdict = verdict_sentence(audit).removeprefix("verdict: ")
    entries = [
        {
            "number": entry.number,
            "time": entry.time.replace("T", " ").replace("+00:00", " UTC"),
            "who": f"{entry.login} ({entry.name})" if entry.name else entry.login,
            "computer": entry.computer,
            "action": entry.action,
            "why": entry.why,
            "files": [_change_words(name, *change) for name, change in entry.files.items()],
            "software": ", ".join(f"{name} {version}" for name, version in entry.software.items()),
        }
        for entry in audit.entries
    ]
    page = render_page(
        "audit.html.j2",
        run=audit.run,
        created=f"{audit.time:%Y-%m-%d %H:%M} UTC",
        verdict=f"{verdict[:1].upper()}{verdict[1:]}.",
        holds=audit.holds,
        parts=audit.parts,
        bad=(Result.FAILS, Result.OPEN),
        entries=entries,
        limits=LIMITS,
    )
    return write_page(page, path)


def _change_words(name: str, before: str | None, after: str | None) -> tuple[str, str]:
    """Return a file, and what happened to it with its SHA-256."""
    if after is None:
        return name, f"removed, was {before}"
    if before is None:
        return name, after
    return name, f"{after}, unchanged" if after == before else f"{after}, before {before}"
