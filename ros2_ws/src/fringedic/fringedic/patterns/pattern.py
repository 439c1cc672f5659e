"""The pattern of one frame: its kind, and pitch, shift and orientation of its fringes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol, TypeVar

from fringedic.errors import PatternError

T = TypeVar("T")


class PatternKind(IntEnum):
    """What the projector shows during an exposure, with the numbers of ``fringedic_msgs/Exposure``."""

    WHITE = 0
    FRINGES = 1
    OTHER = 2
    GRAY_CODE = 3
    GREY = 4


PHASE_KINDS = frozenset({PatternKind.FRINGES, PatternKind.GRAY_CODE, PatternKind.GREY})  # frames of a fringe step
UNIFORM_KINDS = frozenset({PatternKind.WHITE, PatternKind.GREY})


class Orientation(IntEnum):
    """Direction of the fringes, with the numbers of ``fringedic_msgs/Exposure``.

    ``VERTICAL`` fringes run along y and their phase grows with x. ``HORIZONTAL`` fringes run along x and their phase
    grows with y.
    """

    VERTICAL = 0
    HORIZONTAL = 1


@dataclass(frozen=True)
class ProjectedPattern:
    """The pattern of one frame; fringes are ``I = A + B cos(phi - 2 pi shift / shifts)``.

    Attributes
    ----------
    kind
        White light, fringes, one bit of a Gray code that numbers fringes, uniform grey, or a set-up pattern.
    orientation
        Direction of the fringes.
    pitch
        Fringe pitch [projector px], 0 without fringes; of uniform light in a stack in motion the finest one.
    shift
        Fringes: k of eq. 11, from 1 on. Gray code: number of the bit, 1 for the coarsest. Uniform grey: numerator of
        the brightness shift / shifts. Otherwise 0.
    shifts
        Fringes: q of eq. 11. Gray code: number of bits. Uniform grey: denominator of the brightness. Otherwise 0.

    Examples
    --------
    >>> print(ProjectedPattern(PatternKind.FRINGES, pitch=10.0, shift=2, shifts=4))
    vertical fringes, pitch 10 px, shift 2 of 4
    """

    kind: PatternKind
    orientation: Orientation = Orientation.VERTICAL
    pitch: float = 0.0
    shift: int = 0
    shifts: int = 0

    def __str__(self) -> str:
        if self.kind == PatternKind.GREY:
            return f"uniform grey of {self.shift}/{self.shifts}"
        if self.kind == PatternKind.GRAY_CODE:
            fringes = f"{self.orientation.name.lower()} fringes of pitch {self.pitch:g} px"
            return f"bit {self.shift} of {self.shifts} of the Gray code for {fringes}"
        if self.kind != PatternKind.FRINGES:
            return self.kind.name.lower()
        return f"{self.orientation.name.lower()} fringes, pitch {self.pitch:g} px, shift {self.shift} of {self.shifts}"


WHITE = ProjectedPattern(PatternKind.WHITE)
UNIFORM = ProjectedPattern(PatternKind.GREY, shift=50, shifts=51)  # as bright as the brightest fringe, 250 of 255
SETUP = ProjectedPattern(PatternKind.OTHER)  # one of the named set-up patterns


def moving_frames(patterns: Sequence[ProjectedPattern]) -> list[int]:
    """Return the numbers of the frames of the finest pitch in the stack of a moving surface.

    Such a stack contains frames of uniform light before and after those of its finest pitch, which show the motion
    between them. The middle of the finest pitch is the time of all results.

    Parameters
    ----------
    patterns
        Pattern of each frame.

    Returns
    -------
    list of int
        Empty for the stack of a surface at rest.

    Examples
    --------
    >>> fringes = [ProjectedPattern(PatternKind.FRINGES, pitch=10.0, shift=k, shifts=4) for k in range(1, 5)]
    >>> moving_frames([UNIFORM, *fringes, UNIFORM]), moving_frames([UNIFORM, *fringes])
    ([1, 2, 3, 4], [])
    """
    pitches = [each.pitch for each in patterns if each.kind == PatternKind.FRINGES]
    finest = [k for k, each in enumerate(patterns) if each.kind == PatternKind.FRINGES and each.pitch == min(pitches)]
    uniform = [k for k, each in enumerate(patterns) if each.kind in UNIFORM_KINDS]
    around = finest and uniform and uniform[0] < finest[0] and uniform[-1] > finest[-1]
    return finest if around else []


def middle_two(finest: Sequence[T]) -> tuple[T, T]:
    """Return the two frames around the middle of the finest pitch, during which signals hardly curve.

    Examples
    --------
    >>> middle_two([4, 5, 6, 7]), middle_two([4, 5, 6])
    ((5, 6), (4, 6))
    """
    return finest[(len(finest) - 1) // 2 - (len(finest) % 2)], finest[len(finest) // 2 + (len(finest) % 2)]


class PatternMessage(Protocol):
    """Fields that describe a pattern in an exposure, a request or any other message."""

    kind: int
    orientation: int
    pitch: float
    shift: int
    shifts: int


def pattern_of_message(message: PatternMessage) -> ProjectedPattern:
    """Return the pattern that a message describes.

    Parameters
    ----------
    message
        Any object with the fields kind, orientation, pitch, shift and shifts of ``fringedic_msgs/Exposure``.

    Raises
    ------
    PatternError
        Kind or orientation is not one of the defined numbers.
    """
    try:
        kind, orientation = PatternKind(message.kind), Orientation(message.orientation)
    except ValueError as error:
        raise PatternError(f"{error}; check which program published this message") from None
    return ProjectedPattern(kind, orientation, message.pitch, message.shift, message.shifts)
