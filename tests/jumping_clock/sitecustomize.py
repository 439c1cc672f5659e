"""Read by every Python process that has this folder on its PYTHONPATH: at SIGUSR1 its clock jumps back by a minute."""

import signal
import time

BACK_S = 60
_true_nanoseconds, _true_seconds = time.time_ns, time.time


def _jump(*_: object) -> None:
    from rclpy.clock import Clock
    from rclpy.time import Time

    true_now = Clock.now

    def now(clock: Clock) -> Time:
        true = true_now(clock)
        back = max(true.nanoseconds - BACK_S * 1_000_000_000, 0)  # a clock without /clock stands at 0
        return Time(nanoseconds=back, clock_type=true.clock_type)

    Clock.now = now
    time.time_ns = lambda: _true_nanoseconds() - BACK_S * 1_000_000_000
    time.time = lambda: _true_seconds() - BACK_S


signal.signal(signal.SIGUSR1, _jump)
