"""Courses of the crosshead while frames are exposed: constant rate, ramp, sine, creep, stick-slip."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol


class Motion(Protocol):
    """Crosshead position as a function of time."""

    def position(self, time: float) -> float:
        """Return the position [m] at a time [s]."""
        ...


@dataclass(frozen=True)
class ConstantRate:
    """Position that grows evenly.

    Attributes
    ----------
    start
        Position at time 0 [m].
    rate
        [m/s]

    Examples
    --------
    >>> ConstantRate(start=1.0, rate=0.25).position(10.0)
    3.5
    """

    start: float
    rate: float

    def position(self, time: float) -> float:
        """Return the position [m] at a time [s]."""
        return self.start + self.rate * time


@dataclass(frozen=True)
class Ramp:
    """Start from rest at time 0 with constant acceleration up to a rate.

    Attributes
    ----------
    start
        Position before the start [m].
    rate
        Rate that is reached [m/s].
    acceleration
        [m/s^2], of the sign of the rate.

    Examples
    --------
    >>> [Ramp(0.0, rate=2.0, acceleration=1.0).position(time) for time in (-1.0, 1.0, 3.0)]
    [0.0, 0.5, 4.0]
    """

    start: float
    rate: float
    acceleration: float

    def position(self, time: float) -> float:
        """Return the position [m] at a time [s]."""
        rising = self.rate / self.acceleration
        early = min(max(time, 0.0), rising)
        return self.start + 0.5 * self.acceleration * early**2 + self.rate * max(time - rising, 0.0)


@dataclass(frozen=True)
class Sine:
    """Breathing: a sine about a mean position.

    Attributes
    ----------
    mean, amplitude
        [m]
    frequency
        [Hz]

    Examples
    --------
    >>> Sine(mean=1.0, amplitude=0.5, frequency=0.25).position(1.0)
    1.5
    """

    mean: float
    amplitude: float
    frequency: float

    def position(self, time: float) -> float:
        """Return the position [m] at a time [s]."""
        return self.mean + self.amplitude * math.sin(2 * math.pi * self.frequency * time)


@dataclass(frozen=True)
class Creep:
    """Load step at time 0 and creep afterwards, by a standard linear solid (Zener).

    Attributes
    ----------
    start
        Position before the step [m].
    step
        Elastic part, at once [m].
    creep
        Delayed part, after a long time [m].
    duration
        Retardation time [s].

    Examples
    --------
    >>> course = Creep(start=0.0, step=1.0, creep=0.5, duration=2.0)
    >>> [round(course.position(time), 3) for time in (-1.0, 0.0, 2.0, 100.0)]
    [0.0, 1.0, 1.316, 1.5]
    """

    start: float
    step: float
    creep: float
    duration: float

    def position(self, time: float) -> float:
        """Return the position [m] at a time [s]."""
        if time < 0:
            return self.start
        return self.start + self.step - self.creep * math.expm1(-time / self.duration)


@dataclass(frozen=True)
class StickSlip:
    """Motion in jumps: at rest for most of each period, then a slip at constant speed.

    Attributes
    ----------
    start
        Position at time 0 [m].
    slip
        Length of a slip [m].
    period
        Time from slip to slip [s].
    slip_time
        Duration of a slip at the end of each period [s].

    Examples
    --------
    >>> course = StickSlip(start=0.0, slip=1.0, period=2.0, slip_time=0.5)
    >>> [course.position(time) for time in (0.0, 1.5, 1.75, 2.0, 3.75)]
    [0.0, 0.0, 0.5, 1.0, 1.5]
    """

    start: float
    slip: float
    period: float
    slip_time: float

    def position(self, time: float) -> float:
        """Return the position [m] at a time [s]."""
        number = math.floor(time / self.period)
        slipping = max(time - number * self.period - (self.period - self.slip_time), 0.0) / self.slip_time
        return self.start + self.slip * (number + slipping)
