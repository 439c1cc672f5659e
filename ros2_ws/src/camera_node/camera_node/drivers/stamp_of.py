"""Meaning of the time stamps of a camera."""

from __future__ import annotations

from enum import StrEnum


class StampOf(StrEnum):
    """Moment of the exposure to which a time stamp belongs."""

    START = "start"
    MIDDLE = "middle"
    END = "end"  # also for stamps of the arrival, which follows it

    def start_ns(self, stamp_ns: int, exposure_time: float) -> int:
        """Return the start of the exposure of `exposure_time` [s] with this stamp [ns]."""
        return stamp_ns - round(1e9 * exposure_time * _PASSED[self])

    def middle_ns(self, stamp_ns: int, exposure_time: float) -> int:
        """Return the middle of the exposure of `exposure_time` [s] with this stamp [ns]."""
        return stamp_ns + round(1e9 * exposure_time * (0.5 - _PASSED[self]))


_PASSED = {StampOf.START: 0.0, StampOf.MIDDLE: 0.5, StampOf.END: 1.0}  # elapsed part of the exposure time at the stamp
