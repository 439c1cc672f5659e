"""The log of a run: entries of which each contains the digest of the one before, and the signature of the whole."""

from __future__ import annotations

import fcntl
import getpass
import hashlib
import json
import os
import pwd
import socket
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict, ValidationError

from fringedic.errors import EvidenceError
from fringedic.evidence.keys import from_text, is_signed, laboratory_key, pem_of, raw_public, to_text
from fringedic.provenance import processor, software_identity
from fringedic.recording.manifest import checksum, write_whole
from fringedic.wording.causes import cause_of

LOG = "evidence.log"
SIGNATURE = "evidence.log.sig"
PUBLIC_KEY = "evidence.pem"
OF_THE_LOG = {LOG, SIGNATURE, PUBLIC_KEY}
"""Names of the files that the log does not list, because they contain it, its signature and the key of that."""
TIME_STAMP = "time stamp"
CALIBRATION_SOURCE = "calibration_file"
"""Detail of the entry of a run: file of the calibration that the rig file named."""
CALIBRATION_SOURCES = "calibration_files"
"""The same of several sensors, by their names."""


class Change(NamedTuple):
    """SHA-256 of a file before and after an entry; None where it did not exist."""

    before: str | None
    after: str | None


class SignedBefore(BaseModel):
    """Signature of all lines before an entry, as it was when the entry was added, and its public key; in base64."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    key: str
    signature: str


class Entry(BaseModel):
    """One line of the log.

    Attributes
    ----------
    number, previous
        Position from 0, and SHA-256 of the line before, empty for the first.
    time
        UTC of the computer, ISO 8601.
    login, name, computer
        Who: the login, its name (that of the operator for a run), and the computer.
    action, why
        What was done, and the reason that was given.
    files
        Changed files by their path in the run.
    details
        What belongs to the action, such as the settings of a dataset.
    software
        Versions and processor.
    signed
        The signature of the lines before; None for the first.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    number: int
    previous: str
    time: str
    login: str
    name: str
    computer: str
    action: str
    why: str
    files: dict[str, tuple[str | None, str | None]]
    details: dict[str, Any]
    software: dict[str, str]
    signed: SignedBefore | None


@dataclass(frozen=True)
class SignedLog:
    """A log as it was found.

    Attributes
    ----------
    entries
        The readable entries.
    faults
        What contradicts an append-only log, as sentences.
    unsigned
        Numbers of the entries up to which, without them, no signature fits; the number of entries for the whole log.
    keys
        Public keys of the signatures, 32 bytes each.
    text
        The file.
    """

    entries: list[Entry]
    faults: list[str]
    unsigned: list[int]
    keys: frozenset[bytes]
    text: bytes

    @property
    def files(self) -> dict[str, str]:
        """The SHA-256 of every file after the last entry."""
        return _files_after(self.entries)

    def before(self, number: int) -> bytes:
        """Return the lines before an entry, which a time stamp in it confirms."""
        return b"".join(self.text.splitlines(keepends=True)[:number])


def has_log(run: Path) -> bool:
    """Return whether a run has a log."""
    return (run / LOG).is_file()


def read_log(run: Path) -> SignedLog:
    """Read and check the log of a run.

    Raises
    ------
    EvidenceError
        There is none, or it cannot be read.
    """
    try:
        text = (run / LOG).read_bytes()
        signature = _content(run / SIGNATURE)
        public = _content(run / PUBLIC_KEY)
    except OSError as error:
        raise EvidenceError(f"{run / LOG}: cannot be read: {cause_of(error)}") from error
    lines = text.splitlines(keepends=True)
    entries, faults = _parse(lines)
    faults += _broken_links(lines, entries)
    unsigned, keys = [], set()
    for number, (entry, begun) in enumerate(zip(entries, _beginnings(lines), strict=False)):
        if entry.signed is None:
            continue
        key = from_text(entry.signed.key)
        keys.add(key)
        if not is_signed(begun, from_text(entry.signed.signature), key):
            unsigned.append(number)
    last = _raw_key(public)
    if not is_signed(text, signature, last):
        unsigned.append(len(lines))
    return SignedLog(entries, faults, unsigned, frozenset(keys | {last}), text)


def _content(path: Path) -> bytes:
    """Return a small file; nothing if it does not exist."""
    try:
        with path.open("rb") as file:
            return file.read(10_000)
    except FileNotFoundError:
        return b""


def _raw_key(pem: bytes) -> bytes:
    """Return the key in the file that the log's writer made, byte by byte; nothing for any other content."""
    encoded = b"".join(pem.splitlines()[1:-1]).decode("ascii", errors="replace")
    raw = from_text(encoded)[-32:]
    return raw if len(raw) == 32 and pem_of(raw) == pem else b""


def _parse(lines: list[bytes]) -> tuple[list[Entry], list[str]]:
    entries: list[Entry] = []
    for number, line in enumerate(lines):
        try:
            entries.append(Entry.model_validate_json(line))
        except ValidationError:
            return entries, [f"line {number + 1} of {LOG} is damaged, so that it and those after it cannot be read"]
    return entries, []


def _broken_links(lines: list[bytes], entries: list[Entry]) -> list[str]:
    """Return where entries are not the continuation of those before."""
    faults, previous = [], ""
    files: dict[str, str] = {}
    for number, (line, entry) in enumerate(zip(lines, entries, strict=False)):
        if entry.number != number or entry.previous != previous:
            faults.append(f"entry {number} does not continue the one before: lines were changed, removed or inserted")
        previous = hashlib.sha256(line).hexdigest()
        other = sorted(name for name, (before, _) in entry.files.items() if files.get(name) != before)
        if other:
            faults.append(f"before entry {number} something that the log does not name changed {', '.join(other)}")
        files = _files_after([entry], files)
    return faults


def _files_after(entries: list[Entry], files: Mapping[str, str] | None = None) -> dict[str, str]:
    files = dict(files or {})
    for entry in entries:
        for name, (_, after) in entry.files.items():
            if after is None:
                files.pop(name, None)
            else:
                files[name] = after
    return files


def _beginnings(lines: list[bytes]) -> Iterator[bytes]:
    """Yield the lines before each line."""
    begun = b""
    for line in lines:
        yield begun
        begun += line


@dataclass(frozen=True)
class Note:
    """What a new entry says.

    Attributes
    ----------
    action, why, operator, details
        As of `Entry`; without an operator the name is that of the login.
    """

    action: str
    why: str = ""
    operator: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)


def append(run: Path, note: Note, files: Mapping[str, Change]) -> None:
    """Add an entry to the log of a run, which is begun if there is none, and sign the log.

    Parameters
    ----------
    run
        Folder of the run.
    note
        What the entry says.
    files
        Changed files by their path in the run.

    Raises
    ------
    EvidenceError
        The log cannot be written, or the key of the laboratory cannot be used.
    """
    key = laboratory_key()
    try:
        with (run / LOG).open("a+b") as log:
            fcntl.flock(log, fcntl.LOCK_EX)
            log.seek(0)
            before = log.read()
            if before and not before.endswith(b"\n"):  # its writer was killed: the next line begins after the damage
                before += b"\n"
                log.write(b"\n")
            lines = before.splitlines(keepends=True)
            entry = Entry(
                number=len(lines),
                previous=hashlib.sha256(lines[-1]).hexdigest() if lines else "",
                time=datetime.now(UTC).isoformat(timespec="seconds"),
                login=_login(),
                name=note.operator or _full_name(),
                computer=socket.gethostname(),
                action=note.action,
                why=note.why,
                files={name: (files[name].before, files[name].after) for name in sorted(files)},
                details=dict(note.details),
                software={**software_identity(), "processor": processor()},
                signed=_signature_of(run) if lines else None,
            )
            line = json.dumps(entry.model_dump(), separators=(",", ":"), default=str).encode() + b"\n"
            log.write(line)
            log.flush()
            os.fsync(log.fileno())
            write_whole(run / PUBLIC_KEY, pem_of(raw_public(key)))
            write_whole(run / SIGNATURE, key.sign(before + line))
    except OSError as error:
        raise EvidenceError(f"{run / LOG}: cannot be written: {cause_of(error)}") from error


def _signature_of(run: Path) -> SignedBefore:
    """Return the present signature of a log, whether it fits or not."""
    return SignedBefore(key=to_text(_raw_key(_content(run / PUBLIC_KEY))), signature=to_text(_content(run / SIGNATURE)))


def _login() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # a user identifier without an account, as in containers
        return str(os.getuid())


def _full_name() -> str:
    """Return the name of the user in the accounts of the computer; empty without one."""
    with suppress(KeyError):
        return pwd.getpwuid(os.getuid()).pw_gecos.partition(",")[0]
    return ""


def digests(run: Path, paths: list[Path]) -> dict[str, str]:
    """Return the SHA-256 of files, and of all files in folders, by their path in the run.

    Raises
    ------
    EvidenceError
        A file cannot be read.
    """
    found: dict[str, str] = {}
    try:
        for path in paths:
            for file in [path] if path.is_file() else sorted(path.rglob("*")):
                name = file.relative_to(run).as_posix()
                if file.is_file() and name not in OF_THE_LOG:
                    found[name] = checksum(file)
    except OSError as error:
        raise EvidenceError(f"{error.filename or run}: cannot be read: {cause_of(error)}") from error
    return found


def changes(before: Mapping[str, str], after: Mapping[str, str]) -> dict[str, Change]:
    """Return the change of every file that existed before or exists after; also of those that stayed the same.

    Examples
    --------
    >>> changes({"a": "0f"}, {"b": "1e"})
    {'a': Change(before='0f', after=None), 'b': Change(before=None, after='1e')}
    """
    return {name: Change(before.get(name), after.get(name)) for name in sorted({*before, *after})}
