"""The camera's clock against this computer's."""

from __future__ import annotations

import math
from collections import deque

_WINDOW = 200  # frames: long enough to meet a quick one, short enough that clocks have not drifted apart


class DeviceClock:
    """Turns the time stamps of a device into time on this computer's clock.

    A frame arrives after its stamp by the clocks' offset plus a delay that varies from frame to frame. The smallest
    difference of the latest frames is the offset plus the shortest delay, so that what a busy network or computer adds
    does not reach the stamps. The offset's change over the whole time is the drift of the clocks.
    """

    def __init__(self) -> None:
        self._latest: deque[int] = deque(maxlen=_WINDOW)
        self._first: tuple[int, int] | None = None  # (device time, offset) at the first full window
        self._drift = math.nan

    @property
    def drift(self) -> float:
        """How much faster this computer's clock runs than the device's [s/s]; NaN until it can be told."""
        return self._drift

    def arrival(self, device_ns: int, arrived_ns: int) -> int:
        """When a frame would have arrived without varying delay, on this computer's clock [ns].

        Parameters
        ----------
        device_ns
            Time stamp of the device [ns].
        arrived_ns
            When the first data of the frame arrived here [ns].
        """
        self._latest.append(arrived_ns - device_ns)
        offset = min(self._latest)
        if len(self._latest) == _WINDOW:
            if self._first is None:
                self._first = device_ns, offset
            elif device_ns > self._first[0]:
                self._drift = (offset - self._first[1]) / (device_ns - self._first[0])
        return device_ns + offset
