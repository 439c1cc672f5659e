"""Findings about the frames of a step, as data; `fringedic.phase.sentences` puts them into words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from fringedic.errors import ErrorCode
from fringedic.patterns.pattern import ProjectedPattern


class FindingKind(Enum):
    """What was found, with the error code of a step that fails for it."""

    SATURATED = "saturated", ErrorCode.SATURATED
    DARK = "dark", ErrorCode.DARK
    FROZEN = "the projector does not change its pattern", ErrorCode.WRONG_PATTERN
    INTERCHANGED = "two frames are interchanged", ErrorCode.FRAMES_OUT_OF_ORDER
    LATE = "every frame shows the pattern of the frame before", ErrorCode.FRAMES_OUT_OF_ORDER
    DOUBLED = "a frame shows the pattern before, and those after it are late", ErrorCode.FRAMES_OUT_OF_ORDER
    MISSING = "a frame is missing, and those after it come too early", ErrorCode.FRAMES_OUT_OF_ORDER
    PARTLY_LATE = "every frame shows a part of the pattern before", ErrorCode.WRONG_PATTERN
    OTHER_PATTERN = "one frame does not show its pattern", ErrorCode.WRONG_PATTERN
    UNRELATED_PITCH = "the fringes of a pitch do not continue the coarser ones", ErrorCode.WRONG_PATTERN
    REPEATING = "no pitch covers the view", ErrorCode.INVALID_SEQUENCE
    UNIDENTIFIED_FRAME = "one frame of a pitch does not show its pattern", ErrorCode.WRONG_PATTERN
    CODE_DISAGREES = "Gray code and fringes disagree", ErrorCode.WRONG_PATTERN
    FLICKER = "the projector's light changes", ErrorCode.FLICKER
    GAINS = "the projector's light changes, and the gains of the frames are fitted", ErrorCode.FLICKER
    UNEVEN_LIGHT = "the projector's light changes from row to row", ErrorCode.FLICKER
    ROOM_LIGHT = "the room's light changes", ErrorCode.FLICKER
    DISPLACED_FRAME = "the fringes of one frame are displaced", ErrorCode.WRONG_PATTERN
    MOTION_ACROSS = "the surface moves across the image", ErrorCode.SURFACE_MOVED
    MOTION_ALONG = "the surface moves along the projector's light", ErrorCode.SURFACE_MOVED
    HARMONICS = "the harmonics of the response bend the phase", None
    RELATIVE_ONE_IMAGE = "a relative phase from one image", None
    RELATIVE_ONE_PITCH = "a relative phase, unwrapped over the image", None

    @property
    def code(self) -> ErrorCode | None:
        """Error code of a step that fails for it."""
        code: ErrorCode | None = self.value[1]
        return code


@dataclass(frozen=True)
class Finding:
    """One finding about the frames of a step.

    Attributes
    ----------
    kind
        What was found.
    fault
        Whether no phase may be measured from these frames.
    frames
        Numbers of the frames concerned, first to last; empty where none in particular is.
    patterns
        Their patterns.
    value, limit
        Size of the effect and the largest one allowed: the part of the image (SATURATED, CODE_DISAGREES) or of the
        pattern before (PARTLY_LATE), the typical grey level (DARK), the error of the phase [fringe] (FLICKER,
        UNEVEN_LIGHT, ROOM_LIGHT, DISPLACED_FRAME, MOTION_ALONG, HARMONICS; GAINS: what remains of it, infinite if
        unknown), the motion [px] (MOTION_ACROSS), the pitch in the image if the coarser one is right [projector px],
        negative where it grows the wrong way (UNRELATED_PITCH), the number of the coarsest fringes in view
        (REPEATING). NaN where there is none.
    light_change
        Range of the light over the frames, relative (FLICKER, GAINS, UNEVEN_LIGHT, ROOM_LIGHT).
    coarser
        Pattern of the next coarser pitch (UNRELATED_PITCH).
    exposure_time
        Of the frames [s], where the step has several exposure times.
    """

    kind: FindingKind
    fault: bool = False
    frames: tuple[int, ...] = ()
    patterns: tuple[ProjectedPattern, ...] = ()
    value: float = float("nan")
    limit: float = float("nan")
    light_change: float = float("nan")
    coarser: ProjectedPattern | None = None
    exposure_time: float | None = None

    @classmethod
    def of_pitch(cls, kind: FindingKind, where: slice, patterns: Sequence[ProjectedPattern]) -> Finding:
        """Return the fault that all frames of a pitch share; `where` are its frames in the stack."""
        return cls(kind, True, tuple(range(where.start, where.stop)), tuple(patterns[where]))
