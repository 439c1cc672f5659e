"""Simulated testing machine: a crosshead with speed ramps, a specimen that relaxes, grips with play."""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

import numpy as np

from fringedic.errors import CrossheadRangeError
from fringedic.virtual_rig.configuration import LoadFrameConfiguration


class CrossheadState(Enum):
    """What the crosshead of the simulated machine does."""

    IDLE = "idle"
    MOVING = "moving"
    HOLDING = "holding"


class LoadSample(NamedTuple):
    """One reading of the machine: state of the crosshead, force [N] (tension positive), crosshead position [m]."""

    state: CrossheadState
    force: float
    position: float


class SimulatedLoadFrame:
    """Simulated testing machine without a clock: the caller advances its time.

    The force is that of a standard linear solid, ``stiffness * ((1 - relaxation) x + q)`` with q the part that decays
    with the relaxation time; x is the travel of the specimen's end, which lags behind the crosshead by the play.

    Parameters
    ----------
    configuration
        Ranges, stiffness, relaxation, play and noise.
    seed
        Seed of the force noise; the same calls give the same samples.

    Examples
    --------
    >>> machine = SimulatedLoadFrame(LoadFrameConfiguration(force_noise_n=0.0))
    >>> machine.move_to(1e-3, speed=1e-3)
    >>> machine.advance(5.0)
    >>> machine.sample().state.name, machine.sample().position
    ('HOLDING', 0.001)
    """

    def __init__(self, configuration: LoadFrameConfiguration, seed: int = 0) -> None:
        self._configuration = configuration
        self._rng = np.random.default_rng(seed)
        self._state = CrossheadState.IDLE
        self._position = 0.0
        self._speed = 0.0
        self._target = 0.0
        self._cruise = 0.0
        self._travel = 0.0
        self._relaxing = 0.0

    @property
    def maximum_position(self) -> float:
        """Largest crosshead position [m]; the smallest is 0."""
        return 1e-3 * self._configuration.maximum_position_mm

    @property
    def maximum_speed(self) -> float:
        """Largest crosshead speed [m/s]."""
        return 1e-3 * self._configuration.maximum_speed_mm_per_s

    def move_to(self, position: float, speed: float) -> None:
        """Start moving to `position` [m] at `speed` [m/s] with the machine's ramps, then hold there.

        Raises
        ------
        CrossheadRangeError
            The position or the speed is outside the machine's range; the motion of the machine is not changed.
        """
        if not 0.0 <= position <= self.maximum_position * (1.0 + 1e-9):
            raise CrossheadRangeError(
                f"crosshead position {position * 1e3:g} mm is outside 0 to {self.maximum_position * 1e3:g} mm"
            )
        if not 0.0 < speed <= self.maximum_speed * (1.0 + 1e-9):
            raise CrossheadRangeError(
                f"crosshead speed {speed * 1e3:g} mm/s is outside 0 to {self.maximum_speed * 1e3:g} mm/s"
            )
        self._target = position
        self._cruise = speed
        self._state = CrossheadState.MOVING

    def hold(self) -> None:
        """Stop with the machine's ramp and hold."""
        ramp = 1e-3 * self._configuration.acceleration_mm_per_s2
        self._target = self._within_range(self._position + math.copysign(self._speed**2 / (2.0 * ramp), self._speed))
        self._state = CrossheadState.MOVING if self._speed else CrossheadState.HOLDING

    def advance(self, time_s: float) -> None:
        """Advance the time by `time_s` [s].

        Raises
        ------
        ValueError
            The time is negative or not finite.
        """
        if not 0.0 <= time_s < math.inf:
            raise ValueError(f"time can only advance by a finite number of seconds, not {time_s}")
        while self._state is CrossheadState.MOVING and time_s > 0.0:
            ramp = 1e-3 * self._configuration.acceleration_mm_per_s2
            distance = self._target - self._position
            sign = math.copysign(1.0, distance)
            way, speed = abs(distance), sign * self._speed
            braking = speed * speed / (2.0 * ramp)
            if speed < 0.0 or speed > self._cruise * (1.0 + 1e-12) or braking > way * (1.0 + 1e-9):
                # away from the target, too fast or past the point of braking: slow down first
                goal = 0.0 if speed < 0.0 or braking > way * (1.0 + 1e-9) else self._cruise
                duration, change = abs(speed - goal) / ramp, math.copysign(ramp, goal - speed)
            elif way - braking > 1e-9 * way + 1e-15:
                # speed up until it is time to brake, or cruise until then
                peak = min(self._cruise, math.sqrt(ramp * way + 0.5 * speed * speed))
                if speed < peak * (1.0 - 1e-12):
                    duration, change = (peak - speed) / ramp, ramp
                else:
                    duration, change = (way - braking) / speed, 0.0
            else:
                duration, change = speed / ramp, -ramp
            last = duration <= time_s
            step = min(duration, time_s)
            travelled = speed * step + 0.5 * change * step * step
            self._speed = sign * (speed + change * step)
            position = self._within_range(self._position + sign * travelled)
            if last and abs(position - self._target) < 1e-9 and abs(self._speed) < 1e-9:
                position, self._speed, self._state = self._target, 0.0, CrossheadState.HOLDING
            self._pass(step, position - self._position)
            self._position = position
            time_s -= step
        self._pass(time_s, 0.0)

    def sample(self) -> LoadSample:
        """Return state, force (with noise) and position."""
        c = self._configuration
        force = 1e3 * c.stiffness_n_per_mm * ((1.0 - c.relaxation) * self._travel + self._relaxing)
        return LoadSample(self._state, force + c.force_noise_n * self._rng.standard_normal(), self._position)

    def _within_range(self, position: float) -> float:
        """Return a position without the rounding error by which a ramp may end outside of the machine's range."""
        return min(max(position, 0.0), self.maximum_position)

    def _pass(self, time_s: float, travel: float) -> None:
        """Strain and relax the specimen while the crosshead moves by `travel` [m] in `time_s` [s]."""
        c = self._configuration
        position = self._position + travel
        end = min(max(self._travel, position - 1e-3 * c.play_mm), position)
        ratio = time_s / c.relaxation_time_s
        decay = math.exp(-ratio)
        # constant rate over the interval: the mean of the decay weights the new strain
        mean = -math.expm1(-ratio) / ratio if ratio > 0.0 else 1.0
        self._relaxing = self._relaxing * decay + c.relaxation * (end - self._travel) * mean
        self._travel = end
