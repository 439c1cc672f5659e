"""What a source of a signal is, also one of a laboratory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol


class Reading(NamedTuple):
    """One reading.

    Attributes
    ----------
    stamp_ns
        Time of acquisition on the clock of this computer [ns].
    value
        In the unit of the declaration; NaN is not measured.
    name
        Of the signal, for sources of several signals; empty for the only one.
    """

    stamp_ns: int
    value: float
    name: str = ""


class Source(Protocol):
    """Gives readings; an error is a `FringedicError`, whose message is reported, and the source is read again."""

    def read(self) -> Sequence[Reading]:
        """Wait for readings, a fifth of a second at most, and return them."""
        ...

    def close(self) -> None:
        """Release the device."""
        ...
