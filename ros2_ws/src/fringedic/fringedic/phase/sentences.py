"""Sentences about the findings of the checks of a stack."""

from __future__ import annotations

import math
from collections.abc import Callable

from fringedic.phase.findings import Finding, FindingKind

_LAG = "settle_ms is shorter than the projector's delay (fringedic timing measures it)"
_RAISE = "raise settle_ms above the projector's delay (fringedic timing measures it)"
_SAME_PITCH = 0.1  # fringes whose pitch differs by less are displaced, not of another pitch


def describe(finding: Finding) -> str:
    """Return the sentence about a finding.

    Examples
    --------
    >>> describe(Finding(FindingKind.MOTION_ACROSS, fault=True, value=0.5, limit=0.2))
    'the surface moved by 0.50 px across the image while its frames were taken; 0.2 is allowed'
    """
    words = _WORDS[finding.kind](finding)
    if finding.fault and not math.isnan(finding.limit) and not math.isinf(finding.value):
        words += f"; {finding.limit:g} is allowed"
    if finding.exposure_time is not None:
        return f"exposed for {1e3 * finding.exposure_time:g} ms: {words}"
    return words


def _saturated(finding: Finding) -> str:
    words = f"{finding.value:.0%} of the image saturates"
    return f"{words}: shorten the exposure, close the aperture or dim the projector" if finding.fault else words


def _interchanged(finding: Finding) -> str:
    first, second = finding.frames
    patterns = " and ".join(str(each) for each in finding.patterns)
    return (
        f"frames {first} and {second} are interchanged ({patterns}): frames are out of order, or some show an earlier "
        f"pattern because {_LAG}"
    )


def _unrelated_pitch(finding: Finding) -> str:
    fine, coarse = finding.patterns[0], finding.coarser
    assert coarse is not None
    words = f"fringes of pitch {fine.pitch:g} px do not continue those of pitch {coarse.pitch:g} px"
    if coarse.shifts == 3:
        words += " (three shifts do not detect gamma: measure the response curve or show four)"
    if finding.value < 0:
        return (
            f"{words}: one of them grows the wrong way, so frames are out of order, the projector's image is mirrored, "
            f"or {_LAG}"
        )
    if abs(finding.value / fine.pitch - 1) > _SAME_PITCH:
        return (
            f"{words}: in the image their pitch is {finding.value:.3g} px if the other is right; the projector shows "
            f"another pattern than recorded or scales its image, or {_LAG}"
        )
    return f"{words}: they are displaced; the projector shows other shifts than recorded, or {_LAG}"


def _unidentified_frame(finding: Finding) -> str:
    frames = f"frames {finding.frames[0]} to {finding.frames[-1]}"
    pitch = f"fringes of pitch {finding.patterns[0].pitch:g} px"
    if len(finding.frames) == 3:
        return (
            f"one of {frames} does not show its {pitch}; with three shifts the check cannot identify it: "
            "show four shifts or more"
        )
    return (
        f"{frames} do not show their {pitch}, and no single frame explains it: they were taken while the projector "
        "changed, because settle_ms is shorter than its delay (fringedic timing measures it), or show another object"
    )


def _gains(finding: Finding) -> str:
    words = f"the light changes by {100 * finding.light_change:.1f} % between the frames (flicker)"
    if math.isinf(finding.value):
        return (
            f"{words}, and the gains of the frames cannot be fitted, because the fringes of pitch "
            f"{finding.patterns[0].pitch:g} px in view do not have all phases: show finer fringes, or steady the light"
        )
    return f"{words}; the gain of each frame is fitted, which leaves a phase error of {finding.value:.4f} fringe"


_WORDS: dict[FindingKind, Callable[[Finding], str]] = {
    FindingKind.SATURATED: _saturated,
    FindingKind.DARK: lambda finding: (
        f"the image is dark, grey level {finding.value:.1f} at most pixels: check that the projector is on, the lens "
        "open, the exposure long enough and settle_ms longer than the projector's delay (fringedic timing measures it)"
    ),
    FindingKind.FROZEN: lambda finding: (
        f"all frames of pitch {finding.patterns[0].pitch:g} px show the same image: the projector does not change its "
        "pattern, or its delay exceeds settle_ms (fringedic timing measures the delay)"
    ),
    FindingKind.INTERCHANGED: _interchanged,
    FindingKind.LATE: lambda _: (
        "every frame shows the pattern of the frame before: the camera is one frame ahead of the projector; " + _RAISE
    ),
    FindingKind.DOUBLED: lambda finding: (
        f"frame {finding.frames[0]} shows the pattern of the frame before, and all frames after it are late by one: a "
        f"frame was delivered twice, or {_LAG}"
    ),
    FindingKind.MISSING: lambda finding: (
        f"frame {finding.frames[0]} is missing: it and all frames after it show the pattern of the frame after; the "
        f"camera or its driver dropped a frame, or {_LAG}"
    ),
    FindingKind.PARTLY_LATE: lambda finding: (
        f"every frame shows {finding.value:.0%} of the pattern before: its exposure begins before the projector has "
        f"changed; {_RAISE}"
    ),
    FindingKind.OTHER_PATTERN: lambda finding: (
        f"frame {finding.frames[0]} does not show its pattern ({finding.patterns[0]}): the projector showed another "
        f"one, or the frame was taken while the pattern changed, because {_LAG}"
    ),
    FindingKind.UNRELATED_PITCH: _unrelated_pitch,
    FindingKind.REPEATING: lambda finding: (
        f"no pitch covers the view: {finding.value:.1f} of the coarsest fringes, of {finding.patterns[0].pitch:g} px, "
        "are seen, and their order is unknown; show a coarser pitch (the width of the projector's image always "
        "suffices), pitches that differ by less than a factor of two, or a Gray code"
    ),
    FindingKind.UNIDENTIFIED_FRAME: _unidentified_frame,
    FindingKind.CODE_DISAGREES: lambda finding: (
        f"Gray code and fringes disagree at {finding.value:.0%} of the image: the projector showed other patterns than "
        f"recorded, or {_LAG}"
    ),
    FindingKind.FLICKER: lambda finding: (
        f"the light changes by {finding.light_change:.1%} between the frames (flicker), which causes a phase error of "
        f"{finding.value:.4f} fringe"
    ).replace("%", " %", 1),
    FindingKind.GAINS: _gains,
    FindingKind.UNEVEN_LIGHT: lambda finding: (
        f"the light changes by {finding.light_change:.1%} between the frames, from row to row differently, as "
        f"flickering light does with a rolling shutter, which causes a phase error of {finding.value:.4f} fringe: "
        "expose for whole periods of the light"
    ).replace("%", " %", 1),
    FindingKind.ROOM_LIGHT: lambda finding: (
        f"the light of the room changes by {finding.light_change:.1%} between the frames, which causes a phase error "
        f"of {finding.value:.4f} fringe"
    ).replace("%", " %", 1),
    FindingKind.DISPLACED_FRAME: lambda finding: (
        f"the fringes of frame {finding.frames[0]} are displaced against those of the other frames "
        f"({finding.patterns[0]}), by {finding.value:.4f} fringe RMS over all frames: it shows another shift than "
        "recorded, or the surface moved and came back"
    ),
    FindingKind.MOTION_ACROSS: lambda finding: (
        f"the surface moved by {finding.value:.2f} px across the image while its frames were taken"
    ),
    FindingKind.MOTION_ALONG: lambda finding: (
        "the surface moved along the projector's light while its frames were taken: the fringes shift by "
        f"{finding.value:.4f} fringe"
    ),
    FindingKind.HARMONICS: lambda finding: (
        f"the response of projector and camera is not linear: with {finding.patterns[0].shifts} shifts its harmonics "
        f"cause a phase error of {finding.value:.4f} fringe RMS; measure the response curve (fringedic response), "
        "show more shifts or set correct_harmonics"
    ),
    FindingKind.RELATIVE_ONE_IMAGE: lambda _: (
        "the phase of one image is relative: true up to the same number of whole fringes everywhere"
    ),
    FindingKind.RELATIVE_ONE_PITCH: lambda finding: (
        f"the phase of one pitch of {finding.patterns[0].pitch:g} px is relative: unwrapped over the image, true up to "
        "whole fringes, and wrong behind steps and shadows"
    ),
}
