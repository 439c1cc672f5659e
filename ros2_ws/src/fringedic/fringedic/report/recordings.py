"""Sentences about the completeness of a recording."""

from __future__ import annotations

from fringedic.recording.repair import Recovery


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


def grouped(number: int) -> str:
    """Return a number with its digits in groups of three.

    Examples
    --------
    >>> grouped(12345)
    '12 345'
    """
    return f"{number:,}".replace(",", " ")
