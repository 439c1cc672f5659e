"""Clocks that drift, frames that arrive late, and jumps, with exactly known times."""

from __future__ import annotations

import numpy as np
import pytest

from fringedic.errors import ClockJumpError
from fringedic.frames.clocks import DeviceClock, wall_minus_monotonic_ns

SECOND = 1_000_000_000
START_NS = 1_700_000_000 * SECOND  # of the wall clock, when the device's shows 5 s


class Clocks:
    """A device whose clock runs faster by `drift`, read over a network with a delay of 2 ms or more."""

    def __init__(self, drift: float) -> None:
        self.drift = drift
        self.set_by_ns = 0
        self.clock = DeviceClock(wall_minus_monotonic=lambda: START_NS + self.set_by_ns)
        self._random = np.random.default_rng(3)

    def device_ns(self, at_s: float) -> int:
        return round(5e9 + 1e9 * at_s * (1 + self.drift))

    def arrival_error_s(self, at_s: float, late_s: float | None = None, device_jump_s: float = 0.0) -> float:
        """Return the error of the arrival time of a frame that the device stamps at a time [s]."""
        late = self._random.exponential(3e-3) if late_s is None else late_s
        exact = START_NS + self.set_by_ns + round(1e9 * at_s) + 2_000_000
        device = self.device_ns(at_s) + round(1e9 * device_jump_s)
        return 1e-9 * (self.clock.arrival(device, exact + round(1e9 * late)) - exact)


@pytest.mark.parametrize("drift", [4e-5, -4e-5])
@pytest.mark.parametrize("period_s", [1 / 30, 2.0])
def test_late_frames_do_not_move_stamps_and_the_drift_is_found(drift: float, period_s: float) -> None:
    """Also with rare frames, between which the clocks drift apart by more than the jitter of the network."""
    clocks = Clocks(drift)
    errors = np.array([clocks.arrival_error_s(period_s * number) for number in range(1600)])
    estimate = clocks.clock.estimate
    assert estimate is not None
    tail = 1e3 * errors[100:]
    error = estimate.drift - drift
    assert tail.min() >= -1e-3, "never before a frame with the shortest delay"
    assert tail.mean() < (0.5 if period_s < 1 else 2.5)
    assert estimate.samples == 100
    assert abs(error) < 4 * estimate.drift_sigma < 4e-5
    grown = drift * 1600 * period_s
    assert estimate.offset == pytest.approx(grown, abs=4e-3), f"offset {estimate.offset} s, exact {grown} s"
    assert estimate.stamp_ns == pytest.approx(START_NS + 1e9 * period_s * 1599, abs=20e6)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"device_jump_s": -30.0}, "the camera's clock jumped back by 30 s"),
        ({"device_jump_s": 30.0}, "the camera's clock jumped forward by 30 s"),
        ({"set_by_ns": -3600 * SECOND}, "this computer's clock jumped back by 3600 s"),
        ({"set_by_ns": 2 * SECOND}, "this computer's clock jumped forward by 2 s"),
    ],
)
def test_clock_that_is_set_is_told_once(fault: dict, words: str) -> None:
    clocks = Clocks(1e-5)
    for number in range(50):
        clocks.arrival_error_s(0.1 * number)
    clocks.set_by_ns = fault.get("set_by_ns", 0)
    jump = fault.get("device_jump_s", 0.0)
    with pytest.raises(ClockJumpError, match=words):
        clocks.arrival_error_s(5.0, device_jump_s=jump)
    assert clocks.clock.estimate is None
    error = clocks.arrival_error_s(5.1, late_s=0.0, device_jump_s=jump)
    assert error == pytest.approx(0.0, abs=1e-6)


def test_shortest_delay_is_known_after_ten_frames_and_again_after_a_pause() -> None:
    clocks = Clocks(0.0)
    settled = []
    for pause_s in (0.0, 100.0, 200.0):
        if pause_s == 200.0:
            with pytest.raises(ClockJumpError):
                clocks.arrival_error_s(pause_s, device_jump_s=-500.0)
        for number in range(10):
            settled.append(clocks.clock.settled)
            clocks.arrival_error_s(pause_s + 0.1 * number)
    unsettled = [False] * 10
    assert settled == [*unsettled, True, *unsettled[1:], *unsettled]
    assert clocks.clock.settled


def test_process_that_was_stopped_is_no_jump() -> None:
    """Frames that waited seconds for this process keep their stamps."""
    clocks = Clocks(0.0)
    for number in range(50):
        clocks.arrival_error_s(0.1 * number)
    assert clocks.arrival_error_s(5.0, late_s=7.0) == pytest.approx(0.0, abs=2e-3)


def test_little_is_known_of_few_frames() -> None:
    clocks = Clocks(0.0)
    assert clocks.clock.estimate is None
    clocks.arrival_error_s(0.0, late_s=0.5)
    clocks.arrival_error_s(0.1, late_s=0.0)  # the first frame was late: no jump
    estimate = clocks.clock.estimate
    assert estimate is not None
    assert estimate.samples == 0
    assert np.isnan(estimate.drift)
    assert np.isnan(estimate.drift_sigma)


class BusyComputer:
    """Stands in for the module `time` of a process that other processes interrupt between two reads of a clock."""

    def __init__(self) -> None:
        self.passed_ns = 0
        self.interruptions_ns: list[int] = []  # after each of the next reads

    def monotonic_ns(self) -> int:
        return self._read(self.passed_ns)

    def time_ns(self) -> int:
        return self._read(START_NS + self.passed_ns)

    def _read(self, shown: int) -> int:
        self.passed_ns += self.interruptions_ns.pop(0) if self.interruptions_ns else 100
        return shown


@pytest.mark.parametrize("reads_before", [0, 1])
def test_interruption_between_two_reads_of_the_clock_is_no_jump(
    reads_before: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 284 ms, as seen on a busy computer: the next frame failed, as the clock seemed to be set."""
    computer = BusyComputer()
    monkeypatch.setattr("fringedic.frames.clocks.time", computer)
    clock = DeviceClock()
    arrivals = []
    for number in range(3):
        computer.interruptions_ns = [100] * reads_before + [284_000_000] if number == 1 else []
        device_ns = SECOND * number + 5
        arrivals.append(clock.arrival(device_ns, START_NS + device_ns))
    assert np.diff(arrivals).tolist() == [SECOND] * 2


def test_computer_that_always_interrupts_is_compared_with_its_shortest_interruption(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    computer = BusyComputer()
    computer.interruptions_ns = [90_000_000] * 6 + [1_000_000] * 3 + [50_000_000] * 1000
    monkeypatch.setattr("fringedic.frames.clocks.time", computer)
    assert abs(wall_minus_monotonic_ns() - START_NS) <= 1_000_000
