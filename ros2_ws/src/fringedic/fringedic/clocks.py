"""The clock of a camera or a testing machine against this computer's."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from fringedic.errors import ClockJumpError

_LARGEST_DRIFT = 1e-4  # of two quartz clocks [s/s]: what makes an old sample less sure
_BLOCK = 16  # frames of which the quickest counts for the drift
_SET_NS = 20_000_000  # between two frames a computer's clock is not slewed by more, beside _SLEW of their distance
_SLEW = 1e-3
_JUMP_NS = 1_000_000_000  # no frame is delivered so much quicker than all before
_KNOWN = 10  # frames after which the quickest way here is known well enough to say so


@dataclass(frozen=True)
class ClockEstimate:
    """How a device's clock runs against this computer's.

    Attributes
    ----------
    stamp_ns
        Of the latest frame, on this computer's clock [ns].
    offset
        Device clock minus this computer's, less its first value [s].
    drift
        Growth of the offset [s/s]; NaN until it can be told.
    drift_sigma
        Its standard uncertainty [s/s]; NaN with less than three samples.
    samples
        Blocks of frames that drift and sigma are of.
    """

    stamp_ns: int
    offset: float
    drift: float
    drift_sigma: float
    samples: int


def _wall_minus_steady() -> int:
    return time.time_ns() - time.monotonic_ns()


class DeviceClock:
    """Turns the time stamps of a device into time on this computer's clock.

    A frame arrives after its stamp by the clocks' offset plus a delay that varies from frame to frame. The smallest
    difference so far is the offset plus the shortest delay, so that what a busy network or computer adds does not reach
    the stamps; it is allowed to grow with time as fast as two quartz clocks can drift apart. The drift itself is the
    slope of a line through the smallest differences of each 16 frames.

    Parameters
    ----------
    device
        Whose clock it is, in messages.
    wall_minus_steady
        This computer's clock minus a clock of it that nobody sets [ns].
    """

    def __init__(self, device: str = "camera", wall_minus_steady: Callable[[], int] = _wall_minus_steady) -> None:
        self._device = device
        self._wall_minus_steady = wall_minus_steady
        self._wall = wall_minus_steady()
        self._line = _Line()
        self._frames = 0
        self._device_ns = 0  # of the latest frame
        self._smallest = 0  # difference, as it would be now
        self._origin = 0, 0  # device time and difference that the line counts from
        self._first = 0  # difference that the offset counts from
        self._quickest = 0, 0  # device time and difference, of the present block

    @property
    def estimate(self) -> ClockEstimate | None:
        """What is known now; None before the first frame, and after a clock has jumped."""
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

    def arrival(self, device_ns: int, arrived_ns: int) -> int:
        """When a frame would have arrived without varying delay, on this computer's clock [ns].

        Parameters
        ----------
        device_ns
            Time stamp of the device [ns].
        arrived_ns
            When the first data of the frame arrived here [ns].

        Raises
        ------
        ClockJumpError
            One of the two clocks was set since the frame before. All starts anew with the next frame.
        """
        difference = arrived_ns - device_ns
        try:
            self._refuse_jump(device_ns, difference)
        except ClockJumpError:
            self._restart()
            raise
        if self._frames:
            grown = self._smallest + round(_LARGEST_DRIFT * (device_ns - self._device_ns))
            self._smallest = min(difference, grown)
        else:
            self._smallest = difference
        self._device_ns = device_ns
        self._frames += 1
        self._add_to_block(device_ns, difference)
        return device_ns + self._smallest

    def _refuse_jump(self, device_ns: int, difference: int) -> None:
        last, self._wall = self._wall, self._wall_minus_steady()
        if not self._frames:
            return
        passed = device_ns - self._device_ns
        changed = self._wall - last
        if abs(changed) > _SET_NS + _SLEW * abs(passed):
            raise ClockJumpError(_words("this computer's clock", changed))
        faster = self._smallest - difference
        if passed <= 0:
            raise ClockJumpError(_words(f"the {self._device}'s clock", min(faster, passed)))
        if self._frames >= _KNOWN and faster > _JUMP_NS + _LARGEST_DRIFT * passed:
            raise ClockJumpError(_words(f"the {self._device}'s clock", faster))

    def _add_to_block(self, device_ns: int, difference: int) -> None:
        if self._frames == 1:
            self._first, self._origin = difference, (device_ns, difference)
        if self._frames % _BLOCK == 1 or difference < self._quickest[1]:
            self._quickest = device_ns, difference
        if self._frames % _BLOCK == 0:
            at, quickest = self._quickest
            self._line.add(1e-9 * (at - self._origin[0]), 1e-9 * (quickest - self._origin[1]))
            if self._line.points == 1:
                self._first = quickest  # the very first frame may have been late

    def _restart(self) -> None:
        self._line = _Line()
        self._frames = 0


class _Line:
    """Straight line through points that come one by one: ordinary least squares by running means."""

    def __init__(self) -> None:
        self.points = 0
        self._mean_x = self._mean_y = 0.0
        self._xx = self._xy = self._yy = 0.0  # sums of products of distances from the means

    def add(self, x: float, y: float) -> None:
        """Take one more point."""
        self.points += 1
        from_mean_x, from_mean_y = x - self._mean_x, y - self._mean_y
        self._mean_x += from_mean_x / self.points
        self._mean_y += from_mean_y / self.points
        self._xx += from_mean_x * (x - self._mean_x)
        self._xy += from_mean_x * (y - self._mean_y)
        self._yy += from_mean_y * (y - self._mean_y)

    def slope(self) -> tuple[float, float]:
        """Slope and its standard uncertainty; NaN with less than two and three points."""
        if self.points < 2 or self._xx <= 0:
            return math.nan, math.nan
        slope = self._xy / self._xx
        if self.points < 3:
            return slope, math.nan
        residual = max(self._yy - slope * self._xy, 0.0)
        return slope, math.sqrt(residual / (self.points - 2) / self._xx)


def _words(clock: str, change_ns: int) -> str:
    direction = "forward" if change_ns > 0 else "back"
    return f"{clock} jumped {direction} by {1e-9 * abs(change_ns):.3g} s between two frames; take the step again"
