"""Checks a stack of frames for faults in a few thousand pixels, before a phase is measured.

Three independent kinds of evidence: (1) brightness and modulation of the frames; (2) whether the sinusoids of a pitch
fit, and whether the fringes of each pitch continue those of the coarser one, which depends on order and content of the
frames; (3) deviations that a single frame has in common over all pixels: a brighter frame (flicker), displaced fringes
(the surface moved along the light), or a displaced texture (it moved across the image). The harmonics of a nonlinear
response, which all pixels share too, are fitted with (2) and (3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fringedic.errors import StepError
from fringedic.frames.noise import CameraNoise, saturation_level
from fringedic.patterns.pattern import ProjectedPattern
from fringedic.phase.checks.code_jumps import CodeJumps
from fringedic.phase.checks.flicker_and_motion import find_changes
from fringedic.phase.checks.frame_order import check_order, find_contradiction
from fringedic.phase.checks.gains import Gains, fit_gains
from fringedic.phase.checks.misfit import Misfit
from fringedic.phase.checks.projector_lag import find_lag
from fringedic.phase.checks.sample_noise import estimate_sample_noise
from fringedic.phase.checks.sampling import SAMPLES, Sample
from fringedic.phase.demodulation_kernel import CONFIDENCE
from fringedic.phase.findings import Finding, FindingKind
from fringedic.phase.layout import Layout, check_frames, layout_of
from fringedic.phase.sentences import describe
from fringedic.phase.settings import DEFAULT_SETTINGS, PhaseSettings
from fringedic.phase.sinusoids import fit_wave

# test_saturated_and_dark_stacks_are_named, test_a_projector_that_stands_still_is_named and
# test_too_small_images_are_left_alone fix these limits
_SMALLEST_SIDE = 3  # [px]: a check needs a pixel and its neighbours
_FEWEST_PIXELS = 200  # a check of single frames needs so many
_SMALLEST_PART = 0.02  # a surface has a modulation on at least this part of the image
_LEAST_CONTRAST = 0.03  # visible fringes have at least this modulation over their mean
_DARK = 0.03  # a pixel below this part of full scale is dark
_LEAST_COHERENCE = 0.4  # neighbours along the fringes agree by 0 for noise and 1 for fringes
_SPARSE = 0.5  # where less of the image is usable, more pixels are sampled
_DENSEST = 8.0  # at most so many times more pixels are sampled
_SAME_AREA = 0.5  # this part of the pixels with fringes of one pitch has those of each other pitch, too


def check_stack(
    frames: np.ndarray,
    patterns: Sequence[ProjectedPattern],
    settings: PhaseSettings = DEFAULT_SETTINGS,
    *,
    numbers: Sequence[int] | None = None,
    report_saturation: bool = True,
) -> list[Finding]:
    """Check a stack for faults that would give a wrong phase or none.

    Parameters
    ----------
    frames, patterns
        See `absolute_phase`.
    settings
        Noise of the camera, level of saturation, the largest error and motion that are allowed, and the region of the
        specimen. Without a noise model the noise is estimated from differences of neighbouring pixels.
    numbers
        Number of each frame within its step, where the stack is a part of it.
    report_saturation
        Whether to report that a part of the image saturates; not useful where a shorter exposure covers it.

    Returns
    -------
    list of Finding
        Faults that are too small for an error; `describe` puts them into words.

    Raises
    ------
    PhaseError
        No phase can be measured from such a sequence.
    ImageError
        The frames do not have the size of the region.
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
    fringedic.errors.StepError: frames 1 and 2 are interchanged (vertical fringes, pitch 100 px, ...
    """
    found = inspect_stack(frames, patterns, settings, numbers=numbers)
    for each in found:
        if each.fault:
            raise step_error(each)
    return [each for each in found if report_saturation or each.kind is not FindingKind.SATURATED]


def inspect_stack(
    frames: np.ndarray,
    patterns: Sequence[ProjectedPattern],
    settings: PhaseSettings = DEFAULT_SETTINGS,
    *,
    numbers: Sequence[int] | None = None,
    gains: np.ndarray | None = None,
) -> list[Finding]:
    """Return what `check_stack` finds, the fault that it raises included.

    Parameters
    ----------
    frames, patterns, settings, numbers
        See `check_stack`.
    gains
        Of the frames, see `find_gains`, by which their grey levels are divided.

    Returns
    -------
    list of Finding
        At most one of them, the last, is a fault.
    """
    counted = range(len(patterns)) if numbers is None else numbers
    found = _find(frames, patterns, settings, np.ones(len(patterns)) if gains is None else gains)
    return [replace(each, frames=tuple(counted[frame] for frame in each.frames)) for each in found]


def find_gains(
    frames: np.ndarray, patterns: Sequence[ProjectedPattern], settings: PhaseSettings = DEFAULT_SETTINGS
) -> Gains:
    """Return the gains by which flickering light makes the frames brighter or darker, see `fit_gains`.

    Parameters
    ----------
    frames, patterns, settings
        See `check_stack`.
    """
    layout = layout_of(patterns)
    check_frames(frames, patterns)
    none = Gains(np.ones(len(patterns)), [np.zeros((count, count)) for count in layout.counts], None)
    if min(frames.shape[1:]) < _SMALLEST_SIDE:
        return none
    sample, _, usable = _sample_pixels(frames, layout, settings)
    if 0 < usable.mean() < _SPARSE:
        sample, _, usable = _sample_pixels(frames, layout, settings, float(usable.mean()))
    if usable.sum() < _FEWEST_PIXELS:
        return none
    sample = sample.select(usable)
    return fit_gains(sample, _estimate_noise(sample, settings), settings.largest_error)


def step_error(fault: Finding) -> StepError:
    """Return the error of a step that fails for a fault."""
    return StepError(describe(fault), index=fault.frames[0] if fault.frames else None, code=fault.kind.code)


def _find(
    frames: np.ndarray, patterns: Sequence[ProjectedPattern], settings: PhaseSettings, gains: np.ndarray
) -> list[Finding]:
    """Return all findings up to the first fault, with frames by their position in the stack."""
    layout = layout_of(patterns)
    check_frames(frames, patterns)
    if min(frames.shape[1:]) < _SMALLEST_SIDE:
        return []
    sample, saturated, usable = _sample_pixels(frames, layout, settings)
    if settings.region is not None and usable.sum() < _FEWEST_PIXELS:  # the specimen has moved out of the region
        return _find(frames, patterns, replace(settings, region=None), gains)
    ceiling = saturation_level(frames, settings.saturation)
    bad = _find_bad_exposure(sample, saturated, usable, ceiling, settings, patterns)
    if bad is not None:
        return [bad]
    if 0 < usable.mean() < _SPARSE:
        sample, saturated, usable = _sample_pixels(frames, layout, settings, float(usable.mean()))
    if usable.sum() < _FEWEST_PIXELS:
        fault = _find_contradiction(sample, saturated, settings, patterns)
        return [] if fault is None else [fault]
    found = [Finding(FindingKind.SATURATED, value=saturated.mean())] if saturated.mean() > _SMALLEST_PART else []
    sample = sample.select(usable)
    if np.ptp(gains):
        sample = sample.with_light(gains)
    noise = _estimate_noise(sample, settings)
    evidence = Misfit(sample, noise)(range(len(patterns)))
    jumps = CodeJumps(frames, layout, vertical=sample.is_vertical)
    for fault in (
        check_order(sample, evidence, noise, jumps, patterns),
        find_lag(sample, settings.largest_error * layout.periods[-1][0].shifts),
    ):
        if fault is not None:
            return [*found, fault]
    changes = find_changes(sample, noise, settings.largest_error, settings.largest_motion)
    if changes:
        return found + changes
    fault = find_contradiction(evidence.residual, layout.slices(), patterns)
    return found if fault is None else [*found, fault]


def _sample_pixels(
    frames: np.ndarray, layout: Layout, settings: PhaseSettings, share: float = 1.0
) -> tuple[Sample, np.ndarray, np.ndarray]:
    """Return a sample, its saturated pixels, and its usable ones, which are lit and modulated at every pitch.

    Where a share of the pixels is usable, the sample is denser, so that it has about as many usable ones.
    """
    region = None if settings.region is None else settings.region.mask_for(frames.shape[1:])
    sample = Sample.from_stack(frames, layout, round(SAMPLES * min(1 / share, _DENSEST)), region)
    saturated = sample.levels.max(axis=0) >= saturation_level(frames, settings.saturation)
    modulated = np.logical_and.reduce(_modulated_pixels(sample, settings))
    return sample, saturated, np.asarray(modulated & ~saturated)


def _modulated_pixels(sample: Sample, settings: PhaseSettings) -> list[np.ndarray]:
    """Return the pixels that are lit and modulated, for each pitch."""
    noise = _estimate_noise(sample, settings)
    mean = np.mean([fit[0] for fit in sample.fits], axis=0)
    deviation = np.sqrt(noise.variance(np.maximum(mean, 0)))
    least = np.maximum(_LEAST_CONTRAST * mean, settings.minimum_modulation)
    return [
        np.hypot(fit[1], fit[2]) > np.maximum(CONFIDENCE * math.sqrt(2 / count) * deviation, least)
        for fit, count in zip(sample.fits, sample.layout.counts, strict=True)
    ]


def _find_bad_exposure(
    sample: Sample,
    saturated: np.ndarray,
    usable: np.ndarray,
    ceiling: float,
    settings: PhaseSettings,
    patterns: Sequence[ProjectedPattern],
) -> Finding | None:
    """Return the fault of a stack that is too bright, too dark, always the same or contradicts itself everywhere.

    Noise can look like fringes of some modulation. Fringes are distinguished from it by the coherence of neighbouring
    pixels.
    """
    if saturated.mean() > 0.5 and usable.mean() < _SMALLEST_PART:
        return Finding(FindingKind.SATURATED, True, value=saturated.mean())
    noisy = [number for number in range(len(sample.fits)) if _coherence(sample, number, ~saturated) < _LEAST_COHERENCE]
    if usable.mean() >= _SMALLEST_PART and not noisy:
        return None
    mean = np.mean([fit[0] for fit in sample.fits], axis=0)
    full_scale = ceiling if math.isfinite(ceiling) else float(mean.max(initial=0))
    if np.mean(~saturated & (mean > _DARK * full_scale)) < _SMALLEST_PART:
        return Finding(FindingKind.DARK, True, value=float(np.median(mean)))
    if not noisy:
        return _find_contradiction(sample, saturated, settings, patterns)
    return Finding.of_pitch(FindingKind.FROZEN, sample.layout.slices()[noisy[0]], patterns)


def _coherence(sample: Sample, number: int, allowed: np.ndarray) -> float:
    """Return how well neighbours along the fringes agree in phase, weighted by modulation, 0 (noise) to 1."""
    where, angles = sample.layout.slices()[number], sample.angles[number]
    first, second = (fit_wave(each[where][:, allowed], angles) for each in sample.along_fringes())
    together = np.sum(first[1] * second[1] + first[2] * second[2])
    apart = np.sum(np.hypot(first[1], first[2]) * np.hypot(second[1], second[2]))
    return float(together / apart) if apart else 0.0


def _estimate_noise(sample: Sample, settings: PhaseSettings) -> CameraNoise:
    return settings.noise if settings.noise is not None else estimate_sample_noise(sample)


def _find_contradiction(
    sample: Sample, saturated: np.ndarray, settings: PhaseSettings, patterns: Sequence[ProjectedPattern]
) -> Finding | None:
    """Return the pitch whose frames no sinusoid fits, or that is not seen where another one is.

    For stacks in which hardly a pixel is usable.
    """
    slices = sample.layout.slices()
    exposed = sample.select(~saturated)
    misfit = Misfit(exposed, _estimate_noise(exposed, settings))
    fault = find_contradiction(misfit.residuals(range(len(patterns))), slices, patterns)
    if fault is not None:
        return fault
    seen = [np.count_nonzero(each) for each in _modulated_pixels(exposed, settings)]
    if max(seen) < _FEWEST_PIXELS or min(seen) > _SAME_AREA * max(seen):
        return None
    return Finding.of_pitch(FindingKind.FROZEN, slices[int(np.argmin(seen))], patterns)
