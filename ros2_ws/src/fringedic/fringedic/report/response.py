"""Sentences about the response curve of projector and camera."""

from __future__ import annotations

from fringedic.patterns.response import ResponseCurve
from fringedic.phase.checks.harmonic_error import HarmonicError
from fringedic.rig_setup.response_correction import Correction, assess_correction, is_uneven


def response_sentences(curve: ResponseCurve, before: HarmonicError, after: HarmonicError, shifts: int) -> list[str]:
    """Return what was measured, and whether the patterns should be corrected.

    Parameters
    ----------
    curve
        Response of projector and camera together.
    before, after
        Harmonic error of the phase of patterns without and with the correction.
    shifts
        Shifts of the rig's sequence.
    """
    sentences = [
        f"Projector and camera together: gamma {curve.gamma:.2f} (1 is linear); standard deviation over the image "
        f"{100 * curve.sigma:.1f} %."
    ]
    if is_uneven(curve):
        sentences.append(
            "The curve differs too much over the image: the light or the surface changed, or the room light is strong. "
            "Measure again."
        )
    sentences += [
        f"Harmonic phase error with {each} shifts: {before.rms(each):.5f} fringe without correction, "
        f"{after.rms(each):.5f} fringe with corrected patterns."
        for each in before.error
    ]
    return [*sentences, _recommendation(assess_correction(before, after), shifts)]


def _recommendation(correction: Correction, shifts: int) -> str:
    if correction is Correction.UNNECESSARY:
        return "The response is linear enough; no correction is needed."
    if correction is Correction.HARMFUL:
        return "Corrected patterns increase the error: the curve does not belong to these fringes. Measure again."
    if shifts == 3:
        return "Three shifts need the correction: without it, this error is in every shape."
    return (
        f"With the {shifts} shifts of the rig file the error is smaller than with three. The correction takes no time "
        "and also improves the coarse pitches."
    )
