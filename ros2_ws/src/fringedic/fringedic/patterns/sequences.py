"""Sequences of patterns: phase-shifted fringes, Gray code, single images."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from fringedic.errors import PatternError
from fringedic.patterns.pattern import UNIFORM, Orientation, PatternKind, ProjectedPattern
from fringedic.patterns.render import check_pattern, render_pattern
from fringedic.patterns.response import ResponseCurve
from fringedic.wording.arguments import check_arguments, either, number, several, text, whole

MOST_FRAMES = 10_000  # a larger number of one pitch or period is a typing error
FringeOrder = Literal["pitches", "gray_code", "one_image"]


@dataclass(frozen=True)
class PatternSequence:
    """The patterns of one step; iterating yields their 8-bit images of shape (height, width).

    Attributes
    ----------
    width, height
        Size of the projector [px].
    patterns
        Pattern of each frame: pitches coarse to fine, within a pitch k = 1..n q.
    response
        Response curve for which the images are pre-compensated, None for a linear projector and camera.

    Examples
    --------
    >>> sequence = fringe_sequence(800, 600, [800, 80, 10], shifts=4)
    >>> len(sequence), sequence.frame(0).shape
    (12, (600, 800))
    >>> print(sequence.patterns[5])
    vertical fringes, pitch 80 px, shift 2 of 4
    """

    width: int
    height: int
    patterns: tuple[ProjectedPattern, ...]
    response: ResponseCurve | None = None

    def __len__(self) -> int:
        return len(self.patterns)

    def __iter__(self) -> Iterator[np.ndarray]:
        return map(self.image, self.patterns)

    def frame(self, index: int) -> np.ndarray:
        """Return frame `index` of the sequence, uint8 of shape (height, width)."""
        return self.image(self.patterns[index])

    def image(self, pattern: ProjectedPattern) -> np.ndarray:
        """Return the image of any pattern at this projector's size, uint8 of shape (height, width)."""
        return render_pattern(pattern, self.width, self.height, response=self.response)


@check_arguments(
    PatternError,
    width=whole(),
    height=whole(),
    pitches=several(number()),
    shifts=either(list, either(tuple, whole(high=MOST_FRAMES))),
    orientation=text,
    periods=whole(high=MOST_FRAMES),
)
def fringe_sequence(
    width: int,
    height: int,
    pitches: Sequence[float],
    shifts: int | Sequence[int],
    orientation: str = "vertical",
    *,
    periods: int = 1,
    response: ResponseCurve | None = None,
) -> PatternSequence:
    """Return the n x q phase-shifted frames of every pitch.

    Parameters
    ----------
    width, height
        Size of the projector [px].
    pitches
        Fringe pitches [projector px], coarse to fine. The coarsest has to be at least as wide as the part of the
        projector's image that the camera sees; otherwise the absolute phase is ambiguous.
    shifts
        q of eq. 11, at least 3: one number, or one for each pitch.
    orientation
        "vertical": fringes along y, the phase grows with the column; "horizontal": along x, it grows upwards.
    periods
        n of eq. 11: number of cycles of q frames.
    response
        Response curve for which the images are pre-compensated.

    Returns
    -------
    PatternSequence
        Frames in the order of `pitches`, within a pitch k = 1..n q.

    Raises
    ------
    PatternError
        A pitch, a number of shifts or the size cannot be shown, or the pitches do not become finer.

    References
    ----------
    J. Molimard, G. Boyer, H. Zahouani, "Frequency-based image analysis of random patterns: an alternative way to
    classical stereocorrelation", eq. 11.

    Examples
    --------
    >>> sequence = fringe_sequence(800, 600, [800, 80, 10], [4, 4, 8])
    >>> len(sequence)
    16
    >>> sequence.frame(15).dtype
    dtype('uint8')
    """
    direction = _direction(orientation)
    if not pitches:
        raise PatternError("a fringe sequence needs at least one pitch")
    if periods < 1:
        raise PatternError(f"{periods} periods of shifts: show at least one")
    of_each = [shifts] * len(pitches) if isinstance(shifts, int) else list(shifts)
    if len(of_each) != len(pitches):
        raise PatternError(f"{len(of_each)} numbers of shifts for {len(pitches)} pitches: give one for each")
    if any(fine >= coarse for coarse, fine in pairwise(pitches)):
        raise PatternError(f"pitches {list(pitches)} px have to become finer from each to the next")
    patterns = tuple(
        ProjectedPattern(PatternKind.FRINGES, direction, float(pitch), shift, count)
        for pitch, count in zip(pitches, of_each, strict=True)
        for shift in range(1, periods * count + 1)
    )
    return _checked(PatternSequence(width, height, patterns, response))


@check_arguments(
    PatternError,
    width=whole(),
    height=whole(),
    pitch=number(),
    shifts=whole(high=MOST_FRAMES),
    orientation=text,
    periods=whole(high=MOST_FRAMES),
)
def gray_code_sequence(
    width: int,
    height: int,
    pitch: float,
    shifts: int,
    orientation: str = "vertical",
    *,
    periods: int = 1,
    response: ResponseCurve | None = None,
) -> PatternSequence:
    """Return a Gray code that numbers the fringes of one pitch, followed by their n x q phase-shifted frames.

    The code numbers half periods, which takes one bit more than the fringe orders need. Its edges lie a quarter of a
    period away from the positions where the order changes, so that a blurred edge of a bit never gives a wrong order.

    Parameters
    ----------
    width, height, pitch, shifts, orientation, periods, response
        See `fringe_sequence`; there is one pitch.

    Returns
    -------
    PatternSequence
        The bits, coarsest first, then the fringes k = 1..n q.

    Raises
    ------
    PatternError
        The pitch, the number of shifts or the size cannot be shown.

    References
    ----------
    G. Sansoni, M. Carocci, R. Rodella, "Three-dimensional vision based on a combination of gray-code and phase-shift
    light projection", Applied Optics 38 (1999) 6565-6573.

    Examples
    --------
    >>> sequence = gray_code_sequence(800, 600, 10, shifts=4)
    >>> [pattern.kind.name for pattern in sequence.patterns].count("GRAY_CODE")
    8
    """
    direction = _direction(orientation)
    if periods < 1:
        raise PatternError(f"{periods} periods of shifts: show at least one")
    fringes = ProjectedPattern(PatternKind.FRINGES, direction, float(pitch), 1, shifts)
    check_pattern(fringes, width, height)
    length = width if direction == Orientation.VERTICAL else height
    bits = max(2, math.ceil(math.log2(length / pitch + 2)) + 1)
    code = [ProjectedPattern(PatternKind.GRAY_CODE, direction, float(pitch), bit, bits) for bit in range(1, bits + 1)]
    steps = [replace(fringes, shift=shift) for shift in range(1, periods * shifts + 1)]
    return PatternSequence(width, height, (*code, *steps), response)


@check_arguments(PatternError, width=whole(), height=whole(), pitch=number(), orientation=text)
def one_image_sequence(
    width: int,
    height: int,
    pitch: float,
    orientation: str = "vertical",
    *,
    grey: bool = False,
    response: ResponseCurve | None = None,
) -> PatternSequence:
    """Return one fringe image, for events that are too fast for phase stepping (see `one_image_phase`).

    Parameters
    ----------
    width, height, pitch, orientation, response
        See `fringe_sequence`; there is one pitch.
    grey
        Show uniform grey first, as bright as the mean of the fringes, for the texture of the surface.

    Returns
    -------
    PatternSequence
        The grey image if requested, then the fringes.

    Raises
    ------
    PatternError
        The pitch or the size cannot be shown.

    Examples
    --------
    >>> [str(pattern) for pattern in one_image_sequence(800, 600, 10, grey=True).patterns]
    ['uniform grey of 1/2', 'vertical fringes, pitch 10 px, shift 1 of 1']
    """
    fringes = ProjectedPattern(PatternKind.FRINGES, _direction(orientation), float(pitch), 1, 1)
    plain = (ProjectedPattern(PatternKind.GREY, shift=1, shifts=2),) if grey else ()
    return _checked(PatternSequence(width, height, (*plain, fringes), response))


def step_sequence(
    width: int,
    height: int,
    pitches: Sequence[float],
    shifts: Sequence[int],
    orientation: str = "vertical",
    fringe_order: FringeOrder = "pitches",
    *,
    grey_frame: bool = False,
) -> PatternSequence:
    """Return the sequence of one step as a rig's settings describe it.

    Parameters
    ----------
    width, height, pitches, orientation
        See `fringe_sequence`.
    shifts
        q of each pitch.
    fringe_order
        Source of the fringe orders. ``pitches``: each pitch gives the order of the next finer one; ``gray_code``: a
        Gray code, of the finest pitch alone; ``one_image``: none, the step is one image of the finest pitch.
    grey_frame
        With one image, show uniform grey first, for the texture of the surface.

    Returns
    -------
    PatternSequence
        See `fringe_sequence`, `gray_code_sequence` and `one_image_sequence`.

    Raises
    ------
    PatternError
        See `fringe_sequence`.

    Examples
    --------
    >>> len(step_sequence(800, 600, [800, 80, 10], [4, 4, 4], fringe_order="gray_code"))
    12
    """
    if fringe_order == "gray_code":
        return gray_code_sequence(width, height, pitches[-1], shifts[-1], orientation)
    if fringe_order == "one_image":
        return one_image_sequence(width, height, pitches[-1], orientation, grey=grey_frame)
    return fringe_sequence(width, height, pitches, shifts, orientation)


@check_arguments(
    PatternError,
    width=whole(),
    height=whole(),
    pitches=several(number()),
    shifts=several(whole(high=MOST_FRAMES)),
    orientation=text,
    order=several(whole()),
    parts=whole(low=3),
)
def moving_sequence(
    width: int,
    height: int,
    pitches: Sequence[float],
    shifts: Sequence[int],
    orientation: str = "vertical",
    *,
    order: Sequence[int],
    parts: int,
) -> PatternSequence:
    """Return the sequence of a surface that moves: uniform light before and after the finest pitch shows the motion.

    Parameters
    ----------
    width, height, pitches, shifts, orientation
        See `fringe_sequence`; the shifts are those of the coarser pitches.
    order, parts
        Shift k of each frame of the finest pitch, and q, from `fringedic.phase.plan_shifts`.

    Returns
    -------
    PatternSequence
        The coarser pitches, uniform light, the finest pitch, uniform light.

    Raises
    ------
    PatternError
        See `fringe_sequence`.

    Examples
    --------
    >>> sequence = moving_sequence(800, 600, [800, 80], [4], order=[3, 2, 1, 4, 3, 2, 1, 4], parts=4)
    >>> len(sequence), str(sequence.patterns[4])
    (14, 'uniform grey of 50/51')
    """
    finest = ProjectedPattern(PatternKind.FRINGES, _direction(orientation), float(pitches[-1]), 1, parts)
    coarse = fringe_sequence(width, height, pitches[:-1], list(shifts), orientation).patterns if shifts else ()
    fine = tuple(replace(finest, shift=shift) for shift in order)
    uniform = replace(UNIFORM, orientation=finest.orientation, pitch=finest.pitch)  # every frame names its fringes
    return _checked(PatternSequence(width, height, (*coarse, uniform, *fine, uniform)))


def _direction(orientation: str) -> Orientation:
    if orientation.upper() not in Orientation.__members__:
        raise PatternError(f"orientation '{orientation}' is unknown: use 'vertical' or 'horizontal'")
    return Orientation[orientation.upper()]


def _checked(sequence: PatternSequence) -> PatternSequence:
    for pattern in sequence.patterns:
        check_pattern(pattern, sequence.width, sequence.height)
    return sequence
