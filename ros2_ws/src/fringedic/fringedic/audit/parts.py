"""Parts of an audit: what was checked, the result in one sentence, and what to do."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from cryptography.x509 import Certificate

from fringedic.errors import EvidenceError, FringedicError
from fringedic.evidence.keys import PUBLIC, fingerprint, own_public_key
from fringedic.evidence.log import LOG, SIGNATURE, TIME_STAMP, Entry, SignedLog, digests
from fringedic.evidence.time_stamps import check_time_stamp
from fringedic.recording.sentences import verification_sentences
from fringedic.recording.verification import verify
from fringedic.wording.numbers import counted

CALIBRATION = "calibration"
"""Action of the first entry of the log of a calibration."""
CALIBRATION_OF_RUN = "calibration"
"""Name of the part about the calibration of a run."""
RUN = "run"
"""Action of the first entry of the log of a run that was signed at its end."""
_SHOWN = 5  # names in a sentence


class Result(StrEnum):
    """Result of a part."""

    HOLDS = "holds"
    NOTE = "note"
    """Nothing contradicts the data, but the reader has to know it."""
    OPEN = "not proven"
    FAILS = "fails"


@dataclass(frozen=True)
class Part:
    """A part of an audit.

    Attributes
    ----------
    name
        What was checked.
    result, found
        The result, and the finding as a sentence.
    action
        What to do; empty if nothing.
    """

    name: str
    result: Result
    found: str
    action: str = ""


def check_signature(log: SignedLog, keys: Collection[bytes]) -> Part:
    """Check that every state of a log was signed by a known key.

    Parameters
    ----------
    log
        The log.
    keys
        Public keys that are known from elsewhere, 32 bytes each; empty: the one of this computer.
    """
    name = "signature"
    if log.unsigned:
        after = ", ".join("the whole" if n > len(log.entries) - 1 else f"before entry {n}" for n in log.unsigned)
        return Part(
            name,
            Result.FAILS,
            f"{SIGNATURE} does not fit {LOG} ({after}): one of them was changed, or its writing was interrupted",
            "restore log, signature and key from a copy, and find out who changed them",
        )
    own = own_public_key()
    known = set(keys) or ({own} if own else set())
    others = sorted(log.keys - known)
    if others:
        return Part(
            name,
            Result.FAILS if keys else Result.OPEN,
            f"signed with a key that {'is none of those given' if keys else 'is not that of this computer'}: "
            f"{'; '.join(map(fingerprint, others))}",
            f"compare the fingerprint with the one that the laboratory tells you, or give its {PUBLIC} with --key",
        )
    return Part(name, Result.HOLDS, f"signed with the key {'; '.join(map(fingerprint, sorted(log.keys)))}")


def check_log(log: SignedLog) -> Part:
    """Check that each entry continues the one before."""
    if log.faults or not log.entries:
        found = "; ".join(log.faults) or f"{LOG} is empty"
        return Part("log", Result.FAILS, found, "compare with a copy; do not rely on what was changed")
    first = log.entries[0]
    since = f"since {first.time} by {first.login} on {first.computer}"
    return Part("log", Result.HOLDS, f"{len(log.entries)} entries {since}" if log.entries[1:] else f"1 entry {since}")


def check_files(run: Path, log: SignedLog) -> Part:
    """Compare the files of a run with the last state in its log."""
    noted, found = log.files, digests(run, [run])
    problems = [
        ("changed", sorted(name for name in noted.keys() & found.keys() if noted[name] != found[name])),
        ("missing", sorted(noted.keys() - found.keys())),
        ("not in the log", sorted(found.keys() - noted.keys())),
    ]
    words = [f"{kind}: {_listed(names)}" for kind, names in problems if names]
    if words:
        return Part(
            "files",
            Result.FAILS,
            "; ".join(words),
            f"restore them from a copy; or, if the change was meant, state it: fringedic note {run} WHY --file FILE",
        )
    return Part("files", Result.HOLDS, f"all {len(found)} files are those of the log")


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return f"{', '.join(names[:_SHOWN])}{more}"


def check_recording(bag: Path) -> Part:
    """Check that a recording is complete, as `fringedic verify` does."""
    name = "raw data"
    try:
        verification = verify(bag)
    except FringedicError as error:
        return Part(name, Result.FAILS, str(error), f"fringedic recover {bag} saves what is readable")
    _, *sentences = verification_sentences(verification)
    if not verification.complete:
        return Part(name, Result.FAILS, "; ".join(sentences), f"fringedic verify {bag} lists it; use a copy")
    if not verification.manifest.present:
        return Part(name, Result.OPEN, "; ".join(sentences), "the recording was not closed, or by an earlier version")
    return Part(name, Result.HOLDS, "; ".join(sentences))


def check_end(entries: Sequence[Entry]) -> Part:
    """Tell how a run ended."""
    name = "end of the run"
    states = [entry for entry in entries if "interrupted" in entry.details]
    if entries[0].action == CALIBRATION:
        verdict = "GO" if entries[0].details.get("go") else "NO-GO"
        return Part(name, Result.NOTE, f"calibration, {verdict}")
    if not states or entries[0].action != RUN:
        return Part(
            name,
            Result.NOTE,
            f"signed later, at {entries[0].time}: the run was interrupted, or made by an earlier version",
            "changes before that time cannot be found, except in the raw data",
        )
    last: dict[str, Any] = states[-1].details
    words = []
    if last.get("interrupted"):
        words.append("interrupted by a person or a signal")
    if last.get("ended_early"):
        words.append(f"ended before its last step: {last['ended_early']}")
    if last.get("failed_steps"):
        words.append(f"{counted(last['failed_steps'], 'step')} failed")
    if words:
        return Part(name, Result.NOTE, "; ".join(words))
    return Part(name, Result.HOLDS, "all steps of the programme were done, and the run was signed at its end")


def check_time_stamps(log: SignedLog, authorities: list[Certificate]) -> Part:
    """Check the time stamps of a log against the certificates of authorities."""
    name = "time stamp"
    stamps = [entry for entry in log.entries if entry.action == TIME_STAMP]
    if not stamps:
        return Part(
            name,
            Result.NOTE,
            "none: times are those of the computer, and whoever has the key can sign another log",
            "fringedic note RUN --time-stamp SERVER has an authority confirm the present log",
        )
    servers = ", ".join(sorted({str(entry.details.get("server")) for entry in stamps}))
    if not authorities:
        return Part(
            name,
            Result.OPEN,
            f"{counted(len(stamps), 'time stamp')} of {servers}, not checked",
            "give the root certificate of the authority with --authority",
        )
    try:
        times = [check_time_stamp(entry, log.before(entry.number), authorities) for entry in stamps]
    except EvidenceError as error:
        return Part(name, Result.FAILS, str(error), "ask the authority for its root certificate")
    last = stamps[-1].number
    more = len(log.entries) - 1 - last
    after = f"; {more} later entries have none" if more else ""
    return Part(
        name, Result.HOLDS, f"the first {last} entries existed at {times[-1]:%Y-%m-%d %H:%M:%S} UTC ({servers}){after}"
    )


def check_changes(log: SignedLog) -> Part:
    """Tell what was done after the end of a run, by the log."""
    later = log.entries[1:]
    if not later:
        return Part("later changes", Result.HOLDS, "none")
    words = "; ".join(entry_words(entry) for entry in later)
    return Part("later changes", Result.NOTE, words)


def entry_words(entry: Entry) -> str:
    """Return who did what when and why, as one line."""
    who = f"{entry.login} ({entry.name})" if entry.name else entry.login
    why = f", because: {entry.why}" if entry.why else ", without a reason"
    files = f", {_listed(sorted(entry.files))}" if entry.files else ""
    return f"{entry.number}: {entry.time} {who}: {entry.action}{files}{why}"
