"""The key of the laboratory (Ed25519, RFC 8032), with which the logs of runs are signed."""

from __future__ import annotations

import base64
import binascii
import hashlib
import os
from contextlib import suppress
from pathlib import Path

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)

from fringedic.errors import EvidenceError
from fringedic.wording.causes import cause_of

KEY = "laboratory_key.pem"
PUBLIC = "laboratory_key.public.pem"


def key_folder() -> Path:
    """Return where the key of the laboratory is kept: ``fringedic`` in the user's folder for configuration."""
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "fringedic"


def laboratory_key() -> Ed25519PrivateKey:
    """Return the key of the laboratory; at the first use it is made, readable by its owner alone.

    Raises
    ------
    EvidenceError
        It cannot be read or made, is no Ed25519 key, or others can read it.
    """
    path = key_folder() / KEY
    try:
        if not path.exists():
            _make_key(path)
        if path.stat().st_mode & 0o077:
            raise EvidenceError(
                f"{path}: others can read the key of the laboratory; take it from them: chmod 600 {path}"
            )
        key = load_pem_private_key(path.read_bytes(), password=None)
    except OSError as error:
        raise EvidenceError(f"{path}: the key of the laboratory cannot be used: {cause_of(error)}") from error
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise EvidenceError(f"{path}: is no private key without a password; restore the file from a copy") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise EvidenceError(f"{path}: is no Ed25519 key; restore the file from a copy")
    return key


def _make_key(path: Path) -> None:
    """Make a key; when another process makes one at the same time, its key stays."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    key = Ed25519PrivateKey.generate()
    temporary = path.with_name(f".{KEY}.{os.getpid()}")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
            file.flush()
            os.fsync(file.fileno())
        with suppress(FileExistsError):
            os.link(temporary, path)
            path.with_name(PUBLIC).write_bytes(pem_of(raw_public(key)))
    finally:
        temporary.unlink()


def own_public_key() -> bytes | None:
    """Return the public key of this laboratory, 32 bytes; None if it has no key, which is not made."""
    return raw_public(laboratory_key()) if (key_folder() / KEY).exists() else None


def raw_public(key: Ed25519PrivateKey) -> bytes:
    """Return the public key of a private one, 32 bytes."""
    return key.public_key().public_bytes_raw()


def pem_of(public: bytes) -> bytes:
    """Return a public key as a PEM file, as ``openssl`` reads it."""
    key = Ed25519PublicKey.from_public_bytes(public)
    return key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)


def read_public_key(path: Path) -> bytes:
    """Return the public key in a PEM file, 32 bytes.

    Raises
    ------
    EvidenceError
        It cannot be read, or is no public Ed25519 key.
    """
    try:
        key = load_pem_public_key(path.read_bytes())
    except OSError as error:
        raise EvidenceError(f"{path}: cannot be read: {cause_of(error)}") from error
    except (ValueError, UnsupportedAlgorithm) as error:
        raise EvidenceError(f"{path}: is no public key; give the {PUBLIC} of the laboratory") from error
    if not isinstance(key, Ed25519PublicKey):
        raise EvidenceError(f"{path}: is no Ed25519 key; give the {PUBLIC} of the laboratory")
    return key.public_bytes_raw()


def is_signed(data: bytes, signature: bytes, public: bytes) -> bool:
    """Return whether a signature is that of the data by a key."""
    try:
        Ed25519PublicKey.from_public_bytes(public).verify(signature, data)
    except (InvalidSignature, ValueError):
        return False
    return True


def fingerprint(public: bytes) -> str:
    """Return the SHA-256 of a public key for people, who compare it with the one that the laboratory tells them.

    Examples
    --------
    >>> fingerprint(bytes(32))
    '66687aad f862bd77 6c8fc18b 8e9f8e20 08971485 6ee233b3 902a591d 0d5f2925'
    """
    digits = hashlib.sha256(public).hexdigest()
    return " ".join(digits[first : first + 8] for first in range(0, len(digits), 8))


def to_text(data: bytes) -> str:
    """Return bytes as base64."""
    return base64.b64encode(data).decode()


def from_text(text: str) -> bytes:
    """Return the bytes of `to_text`; nothing for another text."""
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        return b""
