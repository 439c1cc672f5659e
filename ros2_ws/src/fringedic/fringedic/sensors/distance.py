"""A known distance between two balls that different sensors measured: the test of a registration."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from fringedic.rig.model import RigModel
from fringedic.sensors.features import Feature
from fringedic.sensors.registration import Registration

_SIGMAS = 3.0  # a distance may deviate by so many standard uncertainties
_SAME = 0.5  # two balls nearer to each other than this part of the known distance are the same ball


@dataclass(frozen=True)
class DistanceAcross:
    """Distance of two balls of which one sensor measured one, and another sensor the other.

    Attributes
    ----------
    step
        Of the recording.
    sensors
        Names of both.
    distance, sigma
        Measured distance and its standard uncertainty by noise, calibrations and poses [m].
    expected, expected_sigma
        Known distance and its standard uncertainty [m].
    """

    step: int
    sensors: tuple[str, str]
    distance: float
    sigma: float
    expected: float
    expected_sigma: float = 0.0

    @property
    def error(self) -> float:
        """Measured minus known distance [m]."""
        return self.distance - self.expected

    @property
    def score(self) -> float:
        """Error over its standard uncertainty."""
        return self.error / math.hypot(self.sigma, self.expected_sigma)

    @property
    def holds(self) -> bool:
        """Whether the error is within 3 standard uncertainties."""
        return abs(self.score) <= _SIGMAS


def distances_across(
    balls: Sequence[Feature],
    models: Mapping[str, RigModel],
    registration: Registration,
    expected: float,
    *,
    expected_sigma: float = 0.0,
    step: int = 0,
) -> list[DistanceAcross]:
    """Return the distances of the two balls of a bar across sensors.

    Parameters
    ----------
    balls
        Of one place of the bar, by all sensors, in any order; from `measure_balls`.
    models
        Calibrations of the sensors.
    registration
        Their poses.
    expected, expected_sigma
        Distance of the centres and its standard uncertainty, of the certificate [m].
    step
        Number of the place.

    Returns
    -------
    list of DistanceAcross
        One for each pair of balls that two sensors measured; empty if one sensor measured all.

    Raises
    ------
    CalibrationError
        A sensor has no pose, or was calibrated again since it was registered.
    """
    registration.require({each.sensor: models[each.sensor].identifier for each in balls})
    found = []
    for first, other in _pairs(balls):
        centres = [registration.poses[each.sensor].apply(each.position) for each in (first, other)]
        away = centres[1] - centres[0]
        distance = float(np.linalg.norm(away))
        if distance < _SAME * expected:
            continue
        direction = away / distance
        variance, common = 0.0, np.zeros(len(registration.common_covariance))
        for sign, each in ((-1.0, first), (1.0, other)):
            own = registration.poses[each.sensor].matrix.T @ direction
            variance += float(own @ each.covariance @ own)
            errors = registration.position_errors(each.sensor, models[each.sensor], each.position[:, None])
            common += sign * direction @ errors[..., 0]
        variance += float(common @ registration.common_covariance @ common)
        sensors = (first.sensor, other.sensor)
        found.append(DistanceAcross(step, sensors, distance, math.sqrt(variance), expected, expected_sigma))
    return found


def _pairs(balls: Sequence[Feature]) -> Iterator[tuple[Feature, Feature]]:
    return ((first, other) for first, other in combinations(balls, 2) if first.sensor != other.sensor)
