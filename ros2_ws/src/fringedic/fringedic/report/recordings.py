"""Sentences about the completeness of a recording."""

from __future__ import annotations

from collections.abc import Iterator

from fringedic.recording.manifest import MANIFEST, ManifestCheck
from fringedic.recording.repair import Recovery
from fringedic.recording.verification import Verification


def recovery_sentences(recovery: Recovery) -> list[str]:
    """Return what a recovery has written, and what it could not read.

    Examples
    --------
    >>> from pathlib import Path
    >>> recovery_sentences(Recovery(Path("saved"), 12345, {}, ""))
    ['recording: saved', 'written: 12 345 messages', 'lost: nothing, the recording was complete']
    """
    return [
        f"recording: {recovery.path}",
        f"written: {grouped(recovery.messages)} messages",
        f"lost: {recovery.lost or 'nothing, the recording was complete'}",
    ]


def verification_sentences(verification: Verification) -> Iterator[str]:
    """Yield the outcome of a verification; the last sentence counts the frames."""
    files, messages = verification.files, grouped(verification.messages)
    yield f"recording: {verification.path}, {messages} messages in {files} file{'s' if files != 1 else ''}"
    yield f"files: {_manifest(verification.manifest)}"
    yield f"chunks: {verification.damage or 'all fit their checksums'}"
    gaps = ", ".join(f"{grouped(count)} of {name}" for name, count in sorted(verification.gaps.items()))
    yield f"publishers' counts: {f'missing are {gaps}' if gaps else 'no message is missing'}"
    for (experiment, step), (recorded, frames) in verification.unfinished_steps.items():
        name = f"step {step} of {experiment or 'no experiment'}"
        yield f"{name}: no successful end recorded, {recorded} of {frames} frames"
    if verification.dropped:
        yield f"camera: dropped {grouped(verification.dropped)} frames before it published them"
    exposed = verification.frames + verification.lost_frames
    yield f"{grouped(verification.frames)} of {grouped(exposed)} frames, {grouped(verification.lost_frames)} lost"


def _manifest(check: ManifestCheck) -> str:
    if not check.present:
        return f"no {MANIFEST}, because the recording was not closed or an earlier version wrote it"
    if check.fits:
        return f"all {len(check.equal)} fit {MANIFEST}"
    problems = [f"{name} has changed since the recording was closed" for name in check.changed]
    problems += [f"{name} is missing" for name in check.missing]
    if check.unreadable:
        problems.append(f"{MANIFEST} is damaged")
    return "; ".join(problems)


def grouped(number: int) -> str:
    """Return a number with its digits in groups of three.

    Examples
    --------
    >>> grouped(12345)
    '12 345'
    """
    return f"{number:,}".replace(",", " ")
