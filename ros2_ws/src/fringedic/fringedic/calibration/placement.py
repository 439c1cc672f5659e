"""Angles and heights of the reference plane, as they were entered; names of the images."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from fringedic.errors import CalibrationError, ImageError

FEWEST_PLANES = 3  # of a fit; the closed form needs two
LARGEST_ANGLE = math.radians(70)  # larger angles are probably in degree
SMALLEST_TURN = math.radians(0.05)  # planes closer to each other than this carry no information
SMALLEST_MOVE = 20e-6  # the same for translated planes [m]


class PlaneKind(IntEnum):
    """The object in front of the camera, numbered as in ``fringedic_msgs/ReferencePlane``."""

    GRID = 0
    PLANE = 1
    SPECIMEN = 2


def apart(turn: float, lift: float) -> bool:
    """Return whether planes are at different positions whose angles [rad] and heights [m] differ by this much.

    Stages do not reach a position exactly, and report what they reached.
    """
    return bool(abs(turn) > SMALLEST_TURN or abs(lift) > SMALLEST_MOVE)


@dataclass(frozen=True, eq=False)
class Placement:
    """Where the planes are, as far as it is known.

    Attributes
    ----------
    angles, heights : (plane,)
        As stated [rad], [m].
    """

    angles: np.ndarray
    heights: np.ndarray

    @classmethod
    def stated(cls, count: int, angles: Sequence[float] | None, heights: Sequence[float] | None) -> Placement:
        """Return the placement of `count` planes; None stands for 0 everywhere.

        Raises
        ------
        CalibrationError
            A number is not finite, or the angles cannot be radians.
        ImageError
            The lists have other lengths.
        """
        turn = np.zeros(count) if angles is None else np.asarray(angles, float)
        lift = np.zeros(count) if heights is None else np.asarray(heights, float)
        for name, values in (("angles", turn), ("heights", lift)):
            if values.shape != (count,):
                raise ImageError(f"{values.size} {name} for {count} phase maps: give one for each")
            if not np.isfinite(values).all():
                raise CalibrationError(f"{name} are {values}: they have to be finite numbers")
        if count and np.abs(turn).max() > LARGEST_ANGLE:
            largest = turn[np.argmax(np.abs(turn))]
            raise CalibrationError(
                f"an angle of {largest:g} rad is {math.degrees(largest):.0f} degree; the camera does not see such a "
                "plane. Angles are expected in radian: were they given in degree?"
            )
        return cls(turn, lift)

    def name(self, index: int) -> str:
        """Return the name of an image for people: "image 3 (angle +5 degree)"."""
        height = f", height {1e3 * self.heights[index]:+g} mm" if np.any(self.heights) else ""
        return f"image {index + 1} (angle {math.degrees(self.angles[index]):+.4g} degree{height})"

    def of(self, planes: Sequence[int], values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Return angles [rad] and heights [m] of some planes, including their errors among the parameters."""
        some = list(planes)
        return (
            self.angles[some] + [values.get(angle_error(index), 0.0) for index in some],
            self.heights[some] + [values.get(height_error(index), 0.0) for index in some],
        )

    def apart(self, first: int, second: int) -> bool:
        """Return whether two planes are at different positions."""
        return apart(self.angles[first] - self.angles[second], self.heights[first] - self.heights[second])

    def turned(self, planes: Sequence[int]) -> bool:
        """Return whether some planes have different angles."""
        return bool(np.ptp(self.angles[list(planes)]) > SMALLEST_TURN)

    def check_positions(self, planes: Sequence[int]) -> None:
        """Raise an error unless the planes have enough different positions for a fit.

        Raises
        ------
        CalibrationError
            There are fewer than three planes, angles or heights.
        """
        if len(planes) < FEWEST_PLANES:
            raise CalibrationError(
                f"{len(planes)} planes to fit: at least {FEWEST_PLANES} at different angles are needed, better 7"
            )
        chosen = list(planes)
        different = max(
            _count_different(self.angles[chosen], SMALLEST_TURN), _count_different(self.heights[chosen], SMALLEST_MOVE)
        )
        if different < FEWEST_PLANES:
            raise CalibrationError(
                f"the planes have {different} different positions only: at least {FEWEST_PLANES} angles "
                f"(more than {math.degrees(SMALLEST_TURN):g} degree apart) or as many heights are needed"
            )


def angle_error(index: int) -> str:
    """Return the name of the parameter that is the error of a plane's angle [rad]."""
    return f"angle_error_{index + 1}"


def height_error(index: int) -> str:
    """Return the name of the parameter that is the error of a plane's height [m]."""
    return f"height_error_{index + 1}"


def _count_different(values: np.ndarray, apart: float) -> int:
    """Return how many values differ from each other by more than `apart`."""
    count, last = 0, -math.inf
    for value in np.sort(values):
        if value - last > apart:
            count, last = count + 1, value
    return count
