"""Compiles the numerical kernels once and keeps the machine code, so that no step of a test waits for the compiler.

`python -m fringedic.warm_up` does it after an installation. Commands and nodes do it when it was forgotten, or when the
library, Numba or the processor have changed since.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent
_MARKER, _LOCK = "fringedic-warm-up", "fringedic-warm-up.lock"


def require_kernels(say: Callable[[str], object]) -> None:
    """Compile the kernels in a process of their own, unless that was done; other processes wait meanwhile.

    Parameters
    ----------
    say
        Receives a sentence before the compilation, and one if it fails: kernels are then compiled when they are needed.
    """
    folder, wanted = _cache_folder(), _fingerprint()
    if _marked(folder) == wanted:
        return
    say("the numerical kernels are being compiled, once after each installation; this takes a minute or two")
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / _LOCK).open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if _marked(folder) == wanted:
            return
        done = subprocess.run([sys.executable, "-m", __name__], capture_output=True, text=True, check=False)
    if done.returncode:
        say(f"the kernels could not be compiled ({done.stderr.strip()[-300:]}); the first step takes longer")


def forget_kernels() -> None:
    """Delete the machine code beside the sources: Numba compares a kernel's own file, not those that it calls."""
    for pattern in ("*.nbi", "*.nbc"):
        for file in _PACKAGE.rglob(pattern):
            file.unlink(missing_ok=True)


def mark_compiled() -> None:
    """Note that the kernels are compiled for this installation and this processor."""
    folder = _cache_folder()
    folder.mkdir(parents=True, exist_ok=True)
    (folder / _MARKER).write_text(_fingerprint())


def _marked(folder: Path) -> str:
    try:
        return (folder / _MARKER).read_text()
    except OSError:
        return ""


def _cache_folder() -> Path:
    """Return a folder beside the machine code, where Numba keeps it: as chosen, beside the sources, or of the user."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return Path(chosen)
    if os.access(_PACKAGE, os.W_OK):
        return _PACKAGE / "__pycache__"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "numba"


def _fingerprint() -> str:
    """Return a number for all that Numba compares: versions, processor, time and size of the files with kernels."""
    from llvmlite.binding import get_host_cpu_name  # not at the top: most processes never ask

    parts = [sys.version, version("numba"), version("llvmlite"), get_host_cpu_name()]
    for file in sorted(_PACKAGE.rglob("*.py")):
        if b"numba" in file.read_bytes():
            state = file.stat()
            parts.append(f"{file.relative_to(_PACKAGE)} {state.st_mtime_ns} {state.st_size}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()
