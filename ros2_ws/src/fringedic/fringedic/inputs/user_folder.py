"""A folder for caches and logs of a user whose home folder cannot be written."""

from __future__ import annotations

import os
import tempfile


def replacement_of(folder: str) -> str | None:
    """Return a temporary folder for files that usually are in a folder of the user.

    Parameters
    ----------
    folder
        The usual folder; it is made if it does not exist.

    Returns
    -------
    str or None
        None when the usual folder can be written. Otherwise the same temporary folder for all processes of this user,
        which others cannot write: files such as compiled functions are executed.

    Raises
    ------
    ImportError
        No temporary folder can be written either; it is asked for while packages are imported.
    """
    try:
        os.makedirs(folder, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        user = os.getuid() if hasattr(os, "getuid") else 0
        try:
            temporary = os.path.join(tempfile.gettempdir(), f"fringedic-{user}")
        except FileNotFoundError:
            raise ImportError(
                f"neither {folder} nor a temporary folder can be written; set TMPDIR to one that can"
            ) from None
        os.makedirs(temporary, mode=0o700, exist_ok=True)
        return temporary if os.stat(temporary).st_uid == user else tempfile.mkdtemp(prefix="fringedic-")
    return None
