"""Time stamps of an authority (RFC 3161) for the log of a run."""

from __future__ import annotations

import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from cryptography.x509 import Certificate, load_pem_x509_certificates

from fringedic.errors import EvidenceError
from fringedic.evidence.keys import from_text, to_text
from fringedic.evidence.log import LOG, TIME_STAMP, Entry, Note, append
from fringedic.wording.causes import cause_of
from fringedic.wording.optional_packages import optional_import

_TIMEOUT_S = 30.0
_LARGEST = 1_000_000  # bytes of an answer; usual are some thousands


def add_time_stamp(run: Path, server: str, why: str = "") -> datetime:
    """Have the present log of a run stamped by an authority, and add the stamp to the log.

    Parameters
    ----------
    run
        Folder of the run, with a log.
    server
        Address of the authority, ``http://`` or ``https://``.
    why
        As of `fringedic.evidence.Entry`.

    Returns
    -------
    datetime
        Time of the authority. Its certificate is not checked; see `check_time_stamp`.

    Raises
    ------
    EvidenceError
        The authority does not answer or refuses, its stamp is of something else, or the log cannot be written.
    FringedicError
        The package of the extra ``timestamp`` is not installed.
    """
    with optional_import("timestamp"):
        from rfc3161_client import HashAlgorithm, TimestampRequestBuilder, decode_timestamp_response
    if not server.startswith(("http://", "https://")):
        raise EvidenceError(f"{server}: is no address of a time-stamp server; give http://... or https://...")
    text = (run / LOG).read_bytes()
    request = TimestampRequestBuilder().data(text).hash_algorithm(HashAlgorithm.SHA256).build()
    answer = _ask(server, request.as_bytes())
    with _named(server):
        response = decode_timestamp_response(answer)
        stamped = response.tst_info.message_imprint.message
        when, nonce = response.tst_info.gen_time, response.tst_info.nonce
    if stamped != request.message_imprint.message or nonce != request.nonce:
        raise EvidenceError(f"{server}: its time stamp is not of this log; try again or use another server")
    append(run, Note(TIME_STAMP, why, details={"server": server, "token": to_text(answer)}), {})
    return when


def _ask(server: str, request: bytes) -> bytes:
    headers = {"Content-Type": "application/timestamp-query"}
    try:
        asked = urllib.request.Request(server, request, headers)
        with urllib.request.urlopen(asked, timeout=_TIMEOUT_S) as answer:
            return bytes(answer.read(_LARGEST))
    except (urllib.error.URLError, OSError, ValueError) as error:
        cause = getattr(error, "reason", error)
        words = cause_of(cause) if isinstance(cause, BaseException) else str(cause)
        raise EvidenceError(
            f"{server}: gives no time stamp: {words}; check the address or use another server"
        ) from error


@contextmanager
def _named(server: str) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # of a library in Rust, which names none of its classes for this
        raise EvidenceError(f"{server}: its answer is no time stamp ({error}); use another server") from error


def check_time_stamp(entry: Entry, stamped: bytes, roots: list[Certificate]) -> datetime:
    """Return the time of the stamp in an entry after a check against the certificates of authorities.

    Parameters
    ----------
    entry
        With the action ``time stamp``.
    stamped
        The lines of the log before it.
    roots
        Root certificates that are trusted.

    Raises
    ------
    EvidenceError
        The stamp is not of these lines, or of none of these authorities.
    FringedicError
        The package of the extra ``timestamp`` is not installed.
    """
    with optional_import("timestamp"):
        from rfc3161_client import VerificationError, VerifierBuilder, decode_timestamp_response
    server = str(entry.details.get("server"))
    with _named(server):
        response = decode_timestamp_response(from_text(str(entry.details.get("token"))))
        when = response.tst_info.gen_time
    try:
        VerifierBuilder(roots=roots).build().verify_message(response, stamped)
    except (VerificationError, ValueError) as error:
        raise EvidenceError(f"the time stamp of entry {entry.number} is not confirmed: {error}") from error
    return when


def read_certificates(path: Path) -> list[Certificate]:
    """Return the certificates in a PEM file.

    Raises
    ------
    EvidenceError
        It cannot be read, or contains none.
    """
    try:
        return load_pem_x509_certificates(path.read_bytes())
    except OSError as error:
        raise EvidenceError(f"{path}: cannot be read: {cause_of(error)}") from error
    except ValueError as error:
        raise EvidenceError(f"{path}: contains no certificate; give the root certificate of the authority") from error
