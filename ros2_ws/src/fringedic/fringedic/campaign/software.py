"""The process that computes a unit."""

from __future__ import annotations

import os
import socket


def worker_name() -> str:
    """Return computer and process."""
    return f"{socket.gethostname()}:{os.getpid()}"
