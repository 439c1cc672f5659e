"""Checks a stack of frames for faults in a few thousand pixels, before a phase is measured.

Three independent kinds of evidence: (1) brightness and modulation of the frames; (2) whether the sinusoids of a pitch
fit, and whether the fringes of each pitch continue those of the coarser one, which depends on order and content of the
frames; (3) deviations that a single frame has in common over all pixels: a brighter frame (flicker), displaced fringes
(the surface moved along the light), or a displaced texture (it moved across the image). The harmonics of a projector
without correction also spoil the fit, but they are the same for all frames and do not contribute to (3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fringedic.errors import ErrorCode, StepError
from fringedic.frames.noise import ROUNDING_NOISE, CameraNoise, saturation_level
from fringedic.patterns.pattern import ProjectedPattern
from fringedic.phase.checks.flicker_and_motion import check_flicker_and_motion
from fringedic.phase.checks.gray_code import check_code
from fringedic.phase.checks.pattern_check import check_patterns
from fringedic.phase.checks.projector_lag import check_projector_lag
from fringedic.phase.checks.sampling import Sample
from fringedic.phase.demodulation_kernel import CONFIDENCE
from fringedic.phase.layout import check_frames, layout_of
from fringedic.phase.settings import DEFAULT_SETTINGS, PhaseSettings

# test_saturated_and_dark_stacks_are_named, test_a_projector_that_stands_still_is_named and
# test_too_small_images_are_left_alone fix these limits
_FEWEST_PIXELS = 200  # for a check of single frames
_SMALLEST_PART = 0.02  # of the image, with a modulation: less is not a surface
_LEAST_CONTRAST = 0.03  # modulation over mean of visible fringes
_DARK = 0.03  # of full scale
_LEAST_COHERENCE = 0.4  # of the growth of the phase at neighbouring pixels: 0 for noise, 1 for fringes


def check_stack(
    frames: np.ndarray,
    patterns: Sequence[ProjectedPattern],
    settings: PhaseSettings = DEFAULT_SETTINGS,
    *,
    numbers: Sequence[int] | None = None,
    report_saturation: bool = True,
) -> list[str]:
    """Check a stack for faults that would give a wrong phase or none.

    Parameters
    ----------
    frames, patterns
        See `absolute_phase`.
    settings
        Noise of the camera, level of saturation, and the largest error and motion that are allowed. Without a noise
        model the noise of rounding is assumed; an estimate from these frames would contain their faults.
    numbers
        Number of each frame within its step, where the stack is a part of it.
    report_saturation
        Whether to report that a part of the image saturates; not useful where a shorter exposure covers it.

    Returns
    -------
    list of str
        Faults that are too small for an error.

    Raises
    ------
    PhaseError
        No phase can be measured from such a sequence.
    StepError
        With the code SATURATED or DARK: hardly a pixel is measurable; WRONG_PATTERN: the projector showed the same
        image all the time, another pitch, a frame without its pattern, or part of the pattern before in every frame;
        FRAMES_OUT_OF_ORDER: the frames are not in the order of their patterns; FLICKER: the light changed from frame to
        frame; SURFACE_MOVED: the surface moved while its frames were taken. ``index`` is the number of the first
        faulty frame where it is known.

    Examples
    --------
    >>> from fringedic.patterns import fringe_sequence
    >>> from fringedic.virtual_rig import VirtualRig
    >>> rig = VirtualRig.from_preset("plate", size="tiny")
    >>> rows, columns = rig.projector_shape
    >>> sequence = fringe_sequence(columns, rows, [columns, 40, 10], shifts=4)
    >>> frames = np.array([rig.expose(image, 0.0, index) for index, image in enumerate(sequence)])
    >>> check_stack(frames, sequence.patterns)
    []
    >>> frames[[1, 2]] = frames[[2, 1]]
    >>> check_stack(frames, sequence.patterns)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    fringedic.errors.StepError: frames 1 and 2 are interchanged (shifts 2 and 3 of pitch 100 px): ...
    """
    layout = layout_of(patterns)
    check_frames(frames, patterns)
    ceiling = saturation_level(frames, settings.saturation)
    counted = range(len(patterns)) if numbers is None else numbers
    sample = Sample.from_stack(frames, layout)
    camera = settings.noise if settings.noise is not None else CameraNoise(ROUNDING_NOISE)
    saturated = sample.levels.max(axis=0) >= ceiling
    usable = _usable_pixels(sample, saturated, ceiling, counted)
    if usable.sum() < _FEWEST_PIXELS:
        return []
    remarks = []
    if report_saturation and saturated.mean() > _SMALLEST_PART:
        remarks.append(f"{saturated.mean():.0%} of the image saturates")
    sample = sample.select(usable)
    check_projector_lag(sample, settings.largest_error, counted)
    check_patterns(sample, camera, counted)
    check_code(sample, frames, patterns, counted)
    return remarks + check_flicker_and_motion(sample, camera, settings.largest_error, settings.largest_motion)


def _usable_pixels(sample: Sample, saturated: np.ndarray, ceiling: float, numbers: Sequence[int]) -> np.ndarray:
    """Return the pixels that are lit and modulated; raise `StepError` when there are hardly any.

    Noise estimated from a stack contains its faults. Fringes are therefore distinguished from noise by the coherence of
    neighbouring pixels.
    """
    layout, fits = sample.layout, sample.fits
    mean = np.mean([fit[0] for fit in fits], axis=0)
    modulated = [
        np.hypot(fit[1], fit[2])
        > np.maximum(CONFIDENCE * math.sqrt(2 / count) * ROUNDING_NOISE, _LEAST_CONTRAST * mean)
        for fit, count in zip(fits, layout.counts, strict=True)
    ]
    usable = np.asarray(np.logical_and.reduce(modulated) & ~saturated)
    if saturated.mean() > 0.5 and usable.mean() < _SMALLEST_PART:
        raise StepError(
            f"{saturated.mean():.0%} of the image saturates: shorten the exposure, close the aperture or dim the "
            "projector",
            code=ErrorCode.SATURATED,
        )
    noisy = [number for number in range(len(fits)) if _coherence(sample, number, ~saturated) < _LEAST_COHERENCE]
    if usable.mean() >= _SMALLEST_PART and not noisy:
        return usable
    full_scale = ceiling if math.isfinite(ceiling) else float(mean.max(initial=0))
    if np.mean(~saturated & (mean > _DARK * full_scale)) < _SMALLEST_PART:
        raise StepError(
            f"the image is dark, grey level {np.median(mean):.1f} at most pixels: check that the projector is on, the "
            "lens open and the exposure long enough",
            code=ErrorCode.DARK,
        )
    if noisy:
        raise StepError(
            f"all frames of pitch {layout.pitches[noisy[0]]:g} px show the same image: the projector does not change "
            "its pattern, or its delay exceeds settle_ms (fringedic timing measures the delay)",
            index=numbers[layout.slices()[noisy[0]].start],
            code=ErrorCode.WRONG_PATTERN,
        )
    return usable


def _coherence(sample: Sample, number: int, allowed: np.ndarray) -> float:
    """Return how well neighbours agree in the growth of the phase where the modulation is largest, 0 (noise) to 1."""
    strength = np.where(allowed, np.hypot(*sample.fits[number][1:]), 0)
    # equal strengths are all among the largest: fringes without noise on a plane have no others
    strong = (strength >= np.quantile(strength, 0.8)) & (strength > 0)
    return float(np.abs(np.mean(sample.growth(number)[strong]))) if strong.any() else 0.0
