"""How the cause of an error of another library or of the operating system is written in a sentence."""

from __future__ import annotations

_LONGEST = 200  # characters; HDF5 and object stores append pages of their state


def cause_of(error: BaseException) -> str:
    """Return why something failed: the text of the operating system, that of the error in one line, or its type.

    Parameters
    ----------
    error
        Of a library or of the operating system.

    Examples
    --------
    >>> cause_of(PermissionError(13, "Permission denied", "results.nc"))
    'Permission denied'
    >>> cause_of(OSError("unable to open   the file"))
    'unable to open the file'
    >>> cause_of(KeyError())
    'KeyError'
    """
    text = getattr(error, "strerror", None) or " ".join(str(error).split())[:_LONGEST]
    return text or type(error).__name__
