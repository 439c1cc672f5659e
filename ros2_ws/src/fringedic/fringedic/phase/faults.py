"""What is wrong with a stack of frames, in words: looked for in a few thousand pixels before anything is measured.

Three kinds of evidence, each blind to what the others see: (1) the brightness and modulation of the frames; (2) whether
the sinusoids of a pitch fit, and whether the fringes of each pitch continue those of the coarser one, which order and
content of the frames decide; (3) what single frames have in common over all pixels: a frame that is brighter
(flicker), one whose fringes are displaced (the surface moved along the light), or one whose texture is displaced.
The harmonics of a projector without correction spoil the fit too, but are the same for all frames, so (3) passes them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fringedic.errors import DarkStackError, SaturatedStackError, WrongPatternError
from fringedic.phase.content import check_patterns
from fringedic.phase.gray_code import check_code
from fringedic.phase.late import check_change
from fringedic.phase.layout import layout_of
from fringedic.phase.noise import ROUNDING_NOISE, CameraNoise, saturation_level
from fringedic.phase.sample import Sample
from fringedic.phase.steadiness import check_steadiness
from fringedic.phase.steps import CONFIDENCE
from fringedic.sequence import Projection

_FEWEST = 200  # pixels, for a statement about single frames
_FEW = 0.02  # part of the image; what is measured on less is no surface
_LEAST_CONTRAST = 0.03  # modulation over mean; fringes that are there have more
_DARK = 0.03  # of full scale
_LEAST_COHERENCE = 0.4  # of what neighbours say about the growth of the phase; 0 is noise, 1 is fringes


def check_stack(
    frames: np.ndarray,
    projections: Sequence[Projection],
    *,
    noise: CameraNoise | None = None,
    saturation: float | None = None,
    largest_error: float = 0.003,
    largest_motion: float = 0.2,
    numbers: Sequence[int] | None = None,
    tell_glare: bool = True,
) -> list[str]:
    """Look for faults that would give a wrong phase or none, and name them.

    Parameters
    ----------
    frames, projections, saturation
        See `absolute_phase`.
    noise
        Noise of the camera where it is known; an estimate from these frames would contain their faults.
    largest_error
        Error of the phase, RMS over the image [fringe], that flicker or motion along the light may cause.
    largest_motion
        Motion across the image during the finest fringes [px] that is allowed.
    numbers
        Number of each frame within its step, where the stack is a part of it.
    tell_glare
        Whether a part of the image that saturates should be known: not where a shorter exposure shows it.

    Returns
    -------
    list of str
        What is not wrong enough for an error but should be known.

    Raises
    ------
    SaturatedStackError, DarkStackError
        Hardly a pixel is measurable because the image is too bright or too dark.
    WrongPatternError
        The projector showed something else: the same image all the time, another pitch, a frame without its pattern,
        whose number is the error's ``index``, or some of the pattern before in every frame.
    FramesOutOfOrderError
        The frames are not in the order of their projections; ``index`` is the first that is not.
    FlickerError
        The light changed from frame to frame.
    MovedSurfaceError
        The surface moved while its frames were taken.
    """
    layout = layout_of(projections)
    ceiling = saturation_level(frames, saturation)
    counted = range(len(projections)) if numbers is None else numbers
    sample = Sample.of(frames, layout)
    camera = noise if noise is not None else CameraNoise(ROUNDING_NOISE)
    saturated = sample.levels.max(axis=0) >= ceiling
    usable = _brightness(sample, saturated, ceiling, counted)
    if usable.sum() < _FEWEST:
        return []
    glare = [f"{saturated.mean():.0%} of the image saturates"] if tell_glare and saturated.mean() > _FEW else []
    sample = sample.only(usable)
    check_change(sample, largest_error, counted)
    check_patterns(sample, camera, counted)
    check_code(sample, frames, projections, counted)
    return glare + check_steadiness(sample, camera, largest_error, largest_motion)


def _brightness(sample: Sample, saturated: np.ndarray, ceiling: float, numbers: Sequence[int]) -> np.ndarray:
    """Return which pixels can be looked at; raise when there are hardly any.

    Noise estimated from a stack contains its faults, so fringes are told from noise by what neighbours have in common.
    """
    layout, fits = sample.layout, sample.fits
    mean = np.mean([fit[0] for fit in fits], axis=0)
    modulated = [
        np.hypot(fit[1], fit[2])
        > np.maximum(CONFIDENCE * math.sqrt(2 / count) * ROUNDING_NOISE, _LEAST_CONTRAST * mean)
        for fit, count in zip(fits, layout.counts, strict=True)
    ]
    usable = np.asarray(np.logical_and.reduce(modulated) & ~saturated)
    if saturated.mean() > 0.5 and usable.mean() < _FEW:
        raise SaturatedStackError(
            f"{saturated.mean():.0%} of the image saturates: shorten the exposure, close the aperture or dim the "
            "projector"
        )
    noisy = [number for number in range(len(fits)) if _coherence(sample, number, ~saturated) < _LEAST_COHERENCE]
    if usable.mean() >= _FEW and not noisy:
        return usable
    full_scale = ceiling if math.isfinite(ceiling) else float(mean.max(initial=0))
    if np.mean(~saturated & (mean > _DARK * full_scale)) < _FEW:
        raise DarkStackError(
            f"the image is dark, grey level {np.median(mean):.1f} at most pixels: is the projector on, the lens open, "
            "the exposure long enough?"
        )
    if noisy:
        raise WrongPatternError(
            f"all frames of pitch {layout.pitches[noisy[0]]:g} px show the same image: the projector does not change "
            "its pattern, or is later than settle_ms (fringedic timing measures its delay)",
            index=numbers[layout.slices()[noisy[0]].start],
        )
    return usable


def _coherence(sample: Sample, number: int, allowed: np.ndarray) -> float:
    """Return how much neighbours agree on the phase's growth where the modulation is strongest, 0 (noise) to 1."""
    strength = np.where(allowed, np.hypot(*sample.fits[number][1:]), 0)
    strong = strength > np.quantile(strength, 0.8)
    return float(np.abs(np.mean(sample.growth(number)[strong]))) if strong.any() else 0.0
