"""Sentences about the projector: its timing, and its response curve together with the camera."""

from __future__ import annotations

import math

import numpy as np

from fringedic.configuration.forecast import FRAME_TIME
from fringedic.patterns.response import ResponseCurve
from fringedic.phase.checks.harmonic_error import HarmonicError
from fringedic.rig_setup.response import Correction, assess_correction, is_uneven
from fringedic.rig_setup.timing import ProjectorTiming
from fringedic.settings.experiment import MOVING_ONE_WAY, SequenceSettings

_SLOW = 1e-4  # [s], time constant from which on the rise and fall of the light are worth a sentence


def timing_sentences(
    timing: ProjectorTiming, exposure_time: float, settle_time: float, sequence: SequenceSettings | None = None
) -> list[str]:
    """Return what was measured, and what it means for a rig.

    Parameters
    ----------
    timing
        The measurement.
    exposure_time, settle_time
        Of the rig's frames [s].
    sequence
        Its patterns; None for those that follow a motion in either direction.
    """
    if math.isnan(timing.delay):
        sentence = (
            f"A pattern is visible less than {1e3 * max(timing.earliest, 0.0):.1f} ms after the request: before the "
            "camera can begin an exposure."
        )
    else:
        sentence = (
            f"A pattern is visible {1e3 * timing.delay:.2f} ms after the request (standard uncertainty "
            f"{1e3 * timing.delay_sigma:.2f} ms); the standard deviation between patterns is "
            f"{1e3 * timing.jitter:.2f} ms."
        )
        if max(timing.rise, timing.fall) > _SLOW:
            sentence += (
                f" Its light rises with a time constant of {1e3 * timing.rise:.1f} ms and falls with one of "
                f"{1e3 * timing.fall:.1f} ms."
            )
    refresh = timing.refresh
    light = "The light is steady."
    if refresh is not None:
        whole = timing.whole_exposure(exposure_time)
        remaining = max(100 * timing.beat(whole), 0.01)
        light = (
            f"The light pulses at {refresh.frequency:.2f} Hz: an exposure of {1e3 * exposure_time:.4g} ms is up to "
            f"{100 * timing.beat(exposure_time):.2g} % brighter or darker than the mean, one of {1e3 * whole:.4f} ms "
            f"({round(whole / refresh.period)} x {1e3 * refresh.period:.4f} ms) by less than {remaining:.1g} %."
        )
    needed = 1e3 * timing.settled()
    if settle_time < timing.settled():
        settling = (
            f"A settle time of {1e3 * settle_time:.4g} ms is too short: a pattern needs {needed:.1f} ms to appear "
            "completely, and earlier exposures show the previous pattern."
        )
    else:
        settling = f"A settle time of {1e3 * settle_time:.4g} ms is enough; a pattern needs {needed:.1f} ms."
    rate = 1 / (FRAME_TIME + exposure_time + max(settle_time, timing.settled()))
    sequence = sequence or SequenceSettings()
    part = sequence.fastest_motion
    left = float(np.sinc(part * rate * exposure_time))
    motion = (
        f"With these times about {rate:.0f} frames per second are taken: a test without holds follows a surface that "
        f"moves by up to {part:.2f} fringes from frame to frame, {part * rate:.1f} fringes per second (condition "
        f"{sequence.moving_plan().condition:.1f}; motion blur leaves {100 * left:.0f} % of the modulation)."
    )
    if part < MOVING_ONE_WAY:
        motion += (
            f" Where the direction is known, sequence.motion_fringes [0, {MOVING_ONE_WAY}] or [-{MOVING_ONE_WAY}, 0] "
            f"allows {MOVING_ONE_WAY * rate:.1f} fringes per second."
        )
    return [sentence, light, settling, motion]


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
    correction = assess_correction(before, after)
    if correction is Correction.UNNECESSARY:
        advice = "The response is linear enough; no correction is needed."
    elif correction is Correction.HARMFUL:
        advice = "Corrected patterns increase the error: the curve does not belong to these fringes. Measure again."
    elif shifts == 3:
        advice = "Three shifts need the correction: without it, this error is in every shape."
    else:
        advice = (
            f"With the {shifts} shifts of the rig file the error is smaller than with three. The correction takes no "
            "time and also improves the coarse pitches."
        )
    return [*sentences, advice]
