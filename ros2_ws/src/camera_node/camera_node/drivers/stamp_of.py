"""Which moment of an exposure somebody else's time stamp means."""

from __future__ import annotations

from enum import StrEnum


class StampOf(StrEnum):
    """Moment of the exposure that a camera's time stamp is of."""

    START = "start"
    MIDDLE = "middle"
    END = "end"  # or of the arrival, which follows it

    def start_ns(self, stamp_ns: int, exposure_time: float) -> int:
        """When the exposure of `exposure_time` [s] with this stamp began [ns]."""
        return stamp_ns - round(1e9 * exposure_time * _PASSED[self])

    def middle_ns(self, stamp_ns: int, exposure_time: float) -> int:
        """When the middle of the exposure of `exposure_time` [s] with this stamp was [ns]."""
        return stamp_ns + round(1e9 * exposure_time * (0.5 - _PASSED[self]))


_PASSED = {StampOf.START: 0.0, StampOf.MIDDLE: 0.5, StampOf.END: 1.0}  # of the exposure time at the stamp
