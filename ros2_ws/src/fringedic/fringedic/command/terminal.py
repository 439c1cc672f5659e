"""Output of a command whose terminal may be closed while it runs."""

from __future__ import annotations

import errno
import io
from typing import Any


class Terminal(io.FileIO):
    """A terminal that may be closed: what is written to it then is lost, without an error."""

    @classmethod
    def opened(cls, number: int) -> io.TextIOWrapper:
        """Return the stream of a file descriptor as text."""
        return io.TextIOWrapper(io.BufferedWriter(cls(number, "w", closefd=False)), line_buffering=True)

    def write(self, data: Any) -> int:
        """Write bytes and return their number."""
        try:
            return super().write(data)
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            return len(data)
