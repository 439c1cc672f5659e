"""YAML files of measured numbers with a hash: a changed digit is noticed, and an edited file says that it is one."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Mapping
from functools import cache
from typing import Any

from fringedic.wording.yaml_text import InvalidYamlError

HASH, EDITED = "checksum", "edited"
"""Keys of the hash, and of the word of a person who has changed the file."""
EDITED_WORDS = "edited by hand"


class ChangedFileError(InvalidYamlError):
    """The content of a file differs from its hash; the message is one sentence without the name of the file."""


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of a file with the hash of all its keys and values; order and layout do not matter.

    Examples
    --------
    >>> file = sealed({"k1": -0.0005})
    >>> unsealed(file, "lens.yaml")
    ({'k1': -0.0005}, False)
    >>> unsealed(file | {"k1": -0.3}, "lens.yaml")
    Traceback (most recent call last):
    fringedic.wording.sealed_yaml.ChangedFileError: its content has changed since it was written (checksum differs): ...
    >>> unsealed(file | {"k1": -0.3, "edited": True}, "lens.yaml")
    ({'k1': -0.3}, True)
    """
    return {HASH: _hash(content), **content}  # first: the beginning of a shortened file is not taken for an older one


def unsealed(content: Any, place: str) -> tuple[Any, bool]:
    """Return the content of a file without its hash, and whether a person has edited it.

    A file without a hash, of an earlier version or written by hand, is accepted, and the log states that it has none.

    Parameters
    ----------
    content
        Of the file, from `fringedic.wording.yaml_text.load_yaml`.
    place
        The file, for the log.

    Raises
    ------
    ChangedFileError
        The content differs from its hash, and no key ``edited: true`` says that this was intended.
    InvalidYamlError
        The value of ``edited`` is neither true nor false.
    """
    if not isinstance(content, dict):
        return content, False
    plain = {name: value for name, value in content.items() if name not in (HASH, EDITED)}
    edited = content.get(EDITED, False)
    if not isinstance(edited, bool):
        raise InvalidYamlError(f"{EDITED}: {edited!r}: write true if the file was edited by hand, or remove the key")
    if edited:
        _log(f"{place}: was {EDITED_WORDS}")
    elif HASH not in content:
        _log(f"{place}: contains no hash of its numbers, so that a changed digit is not noticed")
    elif content[HASH] != _hash(plain):
        raise ChangedFileError(
            f"its content has changed since it was written ({HASH} differs): restore it from a copy, or measure again; "
            f"if it was {EDITED_WORDS} on purpose, add the line '{EDITED}: true'"
        )
    return plain, edited


def _hash(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


@cache
def _log(sentence: str) -> None:
    logging.getLogger("fringedic").warning(sentence)
