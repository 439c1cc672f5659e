"""Relates the clock of a camera or a testing machine to that of this computer."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from fringedic.errors import ClockJumpError
from fringedic.wording.numbers import number_text

# the tests in test_clocks.py fix these limits
_LARGEST_DRIFT = 1e-4  # [s/s]: each of two quartz clocks is specified to 50 ppm or better
_BLOCK = 16  # the frame with the shortest delay of so many counts for the drift
_SET_NS = 20_000_000  # a computer's clock is not slewed by more between two frames, besides _SLEW of their distance
_SLEW = 1e-3  # [s/s] twice the largest slew rate of adjtime and NTP (RFC 5905: 500 ppm)
_JUMP_NS = 1_000_000_000  # no frame arrives so much faster than all before
_KNOWN = 10  # after so many frames the shortest delay is known well enough
_PAUSE_NS = 10_000_000_000  # the clocks may drift apart by 1 ms in this time
_CLOSE_NS = 20_000  # between two reads of a clock in one process: 100 times as long as without an interruption
_TRIES = 10


@dataclass(frozen=True)
class ClockEstimate:
    """Estimate of a device's clock relative to this computer's.

    Attributes
    ----------
    stamp_ns
        Of the latest frame, on this computer's clock [ns].
    offset
        Device clock minus this computer's clock, relative to its first value [s].
    drift
        Growth of the offset [s/s]; NaN with fewer than two samples.
    drift_sigma
        Its standard uncertainty [s/s]; NaN with fewer than three samples.
    samples
        Number of blocks of frames from which drift and sigma are estimated.
    """

    stamp_ns: int
    offset: float
    drift: float
    drift_sigma: float
    samples: int


def wall_minus_monotonic_ns() -> int:
    """Return this computer's clock minus its monotonic clock [ns].

    The clock is read between two reads of the monotonic clock. A busy computer may interrupt the process between the
    reads for 0.1 s and longer. The reads are repeated until those of the monotonic clock are close together; after
    10 tries the closest ones count. The error is at most half the time between them.
    """
    tries = []
    for _ in range(_TRIES):
        before, wall, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        tries.append((after - before, wall - (before + after) // 2))
        if after - before <= _CLOSE_NS:
            break
    return min(tries)[1]


class DeviceClock:
    """Converts the time stamps of a device to this computer's clock.

    The arrival time of a frame minus its stamp is the offset of the clocks plus a delay that varies between frames. The
    smallest difference so far is the offset plus the shortest delay, so that delays of a busy network or computer
    do not change the stamps. This smallest difference may grow as fast as two quartz clocks can drift apart. The drift
    is the slope of a line through the smallest differences of every 16 frames.

    Parameters
    ----------
    device
        Name of the device in messages.
    wall_minus_monotonic
        Returns this computer's clock minus its monotonic clock [ns].

    Examples
    --------
    >>> clock = DeviceClock(wall_minus_monotonic=lambda: 0)
    >>> clock.arrival(device_ns=1_000, arrived_ns=51_000)
    51000
    >>> clock.arrival(device_ns=2_000_000, arrived_ns=2_090_000)  # arrived 40 us late
    2050200
    """

    def __init__(
        self, device: str = "camera", wall_minus_monotonic: Callable[[], int] = wall_minus_monotonic_ns
    ) -> None:
        self._device = device
        self._wall_minus_monotonic = wall_minus_monotonic
        self._wall = wall_minus_monotonic()
        self._line = _Line()
        self._frames = 0
        self._without_pause = 0  # latest frames
        self._device_ns = 0  # of the latest frame
        self._smallest = 0  # difference, extrapolated to the latest frame
        self._origin = 0, 0  # device time and difference at the origin of the line
        self._first = 0  # difference at which the offset is 0
        self._quickest = 0, 0  # device time and difference, of the present block

    @property
    def estimate(self) -> ClockEstimate | None:
        """Present estimate; None before the first frame and after a jump of a clock."""
        if self._frames == 0:
            return None
        slope, sigma = self._line.slope()
        return ClockEstimate(
            stamp_ns=self._device_ns + self._smallest,
            offset=1e-9 * (self._first - self._smallest),
            drift=-slope,
            drift_sigma=sigma,
            samples=self._line.points,
        )

    @property
    def settled(self) -> bool:
        """Whether the shortest delay is known: from 10 frames or more, no two of them 10 s apart."""
        return self._without_pause >= _KNOWN

    def arrival(self, device_ns: int, arrived_ns: int) -> int:
        """Return the time at which a frame would have arrived with the shortest delay, on this computer's clock [ns].

        Parameters
        ----------
        device_ns
            Time stamp of the device [ns].
        arrived_ns
            When the first data of the frame arrived [ns].

        Raises
        ------
        ClockJumpError
            One of the two clocks was set since the frame before. The estimate restarts with the next frame.
        """
        difference = arrived_ns - device_ns
        try:
            last, self._wall = self._wall, self._wall_minus_monotonic()
            if self._frames:
                passed = device_ns - self._device_ns
                changed = self._wall - last
                if abs(changed) > _SET_NS + _SLEW * abs(passed):
                    raise ClockJumpError(_words("this computer's clock", changed))
                faster = self._smallest - difference
                if passed <= 0:
                    raise ClockJumpError(_words(f"the {self._device}'s clock", min(faster, passed)))
                if self._frames >= _KNOWN and faster > _JUMP_NS + _LARGEST_DRIFT * passed:
                    raise ClockJumpError(_words(f"the {self._device}'s clock", faster))
        except ClockJumpError:
            self._line = _Line()
            self._frames = self._without_pause = 0
            raise
        passed = device_ns - self._device_ns
        if self._frames:
            self._smallest = min(difference, self._smallest + round(_LARGEST_DRIFT * passed))
        else:
            self._smallest = difference
        self._without_pause = self._without_pause + 1 if passed < _PAUSE_NS else 1
        self._device_ns = device_ns
        self._frames += 1
        if self._frames == 1:
            self._first, self._origin = difference, (device_ns, difference)
        if self._frames % _BLOCK == 1 or difference < self._quickest[1]:
            self._quickest = device_ns, difference
        if self._frames % _BLOCK == 0:
            at, quickest = self._quickest
            self._line.add(1e-9 * (at - self._origin[0]), 1e-9 * (quickest - self._origin[1]))
            if self._line.points == 1:
                self._first = quickest  # the very first frame may have been late
        return device_ns + self._smallest


class _Line:
    """Straight line through points added one by one: ordinary least squares with running means (Welford 1962)."""

    def __init__(self) -> None:
        self.points = 0
        self._mean_x = self._mean_y = 0.0
        self._xx = self._xy = self._yy = 0.0  # sums of products of distances from the means

    def add(self, x: float, y: float) -> None:
        """Add one point."""
        self.points += 1
        from_mean_x, from_mean_y = x - self._mean_x, y - self._mean_y
        self._mean_x += from_mean_x / self.points
        self._mean_y += from_mean_y / self.points
        self._xx += from_mean_x * (x - self._mean_x)
        self._xy += from_mean_x * (y - self._mean_y)
        self._yy += from_mean_y * (y - self._mean_y)

    def slope(self) -> tuple[float, float]:
        """Return the slope and its standard uncertainty; NaN with fewer than two and three points."""
        if self.points < 2 or self._xx <= 0:
            return math.nan, math.nan
        slope = self._xy / self._xx
        if self.points < 3:
            return slope, math.nan
        residual = max(self._yy - slope * self._xy, 0.0)
        return slope, math.sqrt(residual / (self.points - 2) / self._xx)


def _words(clock: str, change_ns: int) -> str:
    direction = "forward" if change_ns > 0 else "back"
    jump = number_text(1e-9 * abs(change_ns), 3)
    return f"{clock} jumped {direction} by {jump} s between two frames; take the step again"
