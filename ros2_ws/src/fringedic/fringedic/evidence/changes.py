"""Entries about what a command changes in a run after its end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from fringedic.errors import EvidenceError, FringedicError

_LOG = "evidence.log"  # as in `log`, which loads cryptography: most datasets belong to no run with a log
_reason: ContextVar[str] = ContextVar("reason", default="")
_noting: ContextVar[Mapping[Path, dict[str, Any]]] = ContextVar("noting", default={})  # noqa: B039 (not changed)


@contextmanager
def because(reason: str) -> Iterator[None]:
    """State why something is done, for the entries of `noted` in the `with` block."""
    token = _reason.set(reason)
    try:
        yield
    finally:
        _reason.reset(token)


def run_of(path: Path) -> Path | None:
    """Return the folder with the log of the run that a path belongs to, None if there is none."""
    path = path.absolute()
    return next((folder for folder in (path, *path.parents) if (folder / _LOG).is_file()), None)


def begin_log(run: Path, action: str, *, why: str = "", operator: str = "", details: Mapping[str, Any]) -> None:
    """Begin the log of a run with all its files, and sign it.

    Parameters
    ----------
    run
        Folder of the run.
    action, why, operator, details
        As of `fringedic.evidence.Entry`.

    Raises
    ------
    EvidenceError
        There is a log already, a file cannot be read, the log cannot be written, or the key of the laboratory cannot
        be used.
    """
    from fringedic.evidence.log import LOG, Note, append, changes, digests, has_log

    run = run.absolute()
    if has_log(run):
        raise EvidenceError(f"{run / LOG} exists already; 'fringedic note {run}' adds an entry")
    append(run, Note(action, why, operator, details), changes({}, digests(run, [run])))


@contextmanager
def noted(path: Path, action: str, *, details: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Add an entry about the files that the `with` block writes to the log of their run, if it has one.

    Of nested blocks in one run the outermost adds the entry, with the details of all.

    Parameters
    ----------
    path
        File or folder that is written.
    action
        What is done.
    details
        What belongs to it, such as the settings of a dataset.

    Raises
    ------
    EvidenceError
        The log cannot be written. What the block has written stays.
    """
    run, path = run_of(path), path.absolute()
    if run is None:
        yield
        return
    if run in _noting.get():
        _merge(_noting.get()[run], details or {})
        yield
        return
    from fringedic.evidence.log import Note, append, changes, digests

    before = digests(run, [path])
    merged: dict[str, Any] = {}
    _merge(merged, details or {})
    token = _noting.set({**_noting.get(), run: merged})
    note = Note(action, _reason.get(), details=merged)
    try:
        yield
    except BaseException:
        with suppress(FringedicError):  # the error of the block is the one to report
            changed = {name: each for name, each in changes(before, digests(run, [path])).items() if each[0] != each[1]}
            if changed:
                append(run, note, changed)
        raise
    else:
        if changed := changes(before, digests(run, [path])):
            append(run, note, changed)
    finally:
        _noting.reset(token)


def _merge(details: dict[str, Any], more: Mapping[str, Any]) -> None:
    """Add details; those that are tables of their own keep their other rows."""
    for name, value in more.items():
        known = details.get(name)
        details[name] = {**known, **value} if isinstance(known, dict) and isinstance(value, Mapping) else value


def add_note(run: Path, text: str, files: Sequence[Path] = ()) -> None:
    """Add a note to the log of a run, with files that were changed, added or removed by hand.

    Parameters
    ----------
    run
        Folder of the run.
    text
        The note, or why the files were changed.
    files
        Files or folders in the run.

    Raises
    ------
    EvidenceError
        A file is not in the run, or nothing is known of it; or the log cannot be written.
    """
    from fringedic.evidence.log import Note, append, changes, digests, read_log

    run = run.absolute()
    paths = [path.absolute() for path in files]
    for path in paths:
        if run not in path.parents:
            raise EvidenceError(f"{path} is not in {run}; give the path of a file in the run")
    names = [path.relative_to(run).as_posix() for path in paths]
    before = {
        name: digest
        for name, digest in (read_log(run).files if names else {}).items()
        if any(name == each or name.startswith(f"{each}/") for each in names)
    }
    after = digests(run, paths)
    unknown = [
        name for name in names if not any(each == name or each.startswith(f"{name}/") for each in {*before, *after})
    ]
    if unknown:
        raise EvidenceError(f"{run}: contains no {', '.join(unknown)}, neither now nor in the log; give another --file")
    append(run, Note("note", text), changes(before, after))
