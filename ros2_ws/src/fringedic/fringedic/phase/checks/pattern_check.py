"""Checks that every frame shows its pattern: it has to fit the others of its pitch, and each pitch the coarser ones."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from fringedic.errors import ErrorCode, StepError
from fringedic.frames.noise import ROUNDING_NOISE, CameraNoise
from fringedic.patterns.pattern import ProjectedPattern
from fringedic.phase.checks.sampling import Sample, fit_wave, wave_levels
from fringedic.phase.layout import Layout

# test_stack.py fixes these limits with good and faulty stacks; where a constant gives figures they are from there
_LARGEST_MISMATCH = 0.7  # median [rad] between one pitch and the next; without relation it would be pi/2
_LARGEST_RESIDUAL = 0.08  # of the fit over the modulation, beyond noise; from here on other orders are tried
_LARGEST_STEP = 0.15  # of the mean of three frames against the other pitches, over the modulation; as above
_LARGEST_UNEVENNESS = 0.2  # of the only pitch, see _unevenness: 0.04 in good stacks, from 0.33 on with a wrong frame
_EXPLAINED = 0.3  # part of the misfit that remains at most with the right explanation
_SMALLEST_DEVIATION = 0.3  # of a wrong frame from its pattern, over the modulation

Levels = Sequence[np.ndarray]
"""Grey levels of each pitch, shape (frame, pixel)."""
Fits = Sequence[np.ndarray]
"""Mean, B cos(phi) and B sin(phi) of each pitch, shape (3, pixel)."""


def check_patterns(sample: Sample, camera: CameraNoise, numbers: Sequence[int]) -> None:
    """Raise `StepError` when frames are in another order than recorded, or show another pattern.

    Parameters
    ----------
    sample
        Pixels that are lit and modulated.
    camera
        Noise of a grey level.
    numbers
        Number of each frame of the stack within its step.

    Raises
    ------
    StepError
        With the code FRAMES_OUT_OF_ORDER or WRONG_PATTERN; ``index`` is the number of the faulty frame, of the first
        one where there are several.
    """
    misfit = _Misfit(sample, camera)
    if misfit.is_small():
        return
    recorded = misfit(sample.groups(), sample.fits)
    best = _best_order(sample, misfit, numbers)
    if best.misfit < _EXPLAINED * recorded:
        raise StepError(best.words, index=best.first_frame, code=ErrorCode.FRAMES_OUT_OF_ORDER)
    _check_single_frames(sample, misfit, recorded, numbers)
    _check_pitches(sample, misfit, numbers)
    _check_three_frames(sample, misfit, numbers)


class _Misfit:
    """Measures how far a stack is from sinusoids whose pitches continue each other.

    Parameters
    ----------
    sample
        The stack as recorded.
    camera
        Noise of a grey level.
    """

    def __init__(self, sample: Sample, camera: CameraNoise) -> None:
        self._sample, self._layout = sample, sample.layout
        # a noise estimated from this stack would contain its faults
        self._camera = CameraNoise(min(camera.read, 2 * ROUNDING_NOISE))
        self._one_pitch = len(sample.fits) == 1 and sample.has_many_fringes

    def __call__(self, levels: Levels, fits: Fits) -> float:
        """Return the sum of squares of all deviations."""
        uneven = _unevenness(fits[0]) if self._one_pitch else 0.0
        deviations = (*self.mismatch(fits), *self._residuals(levels, fits), *self._steps(fits), uneven)
        return sum(value**2 for value in deviations)

    def is_small(self) -> bool:
        """Return whether the stack as recorded is free of faults."""
        levels, fits = self._sample.groups(), self._sample.fits
        return (
            max(self.mismatch(fits), default=0.0) < _LARGEST_MISMATCH
            and max(self._residuals(levels, fits)) < _LARGEST_RESIDUAL
            and max(self._steps(fits)) < _LARGEST_STEP
            and not self.is_uneven()
        )

    def is_uneven(self) -> bool:
        """Return whether phases and contrast of the only pitch, as recorded, are unevenly distributed."""
        return self._one_pitch and _unevenness(self._sample.fits[0]) > _LARGEST_UNEVENNESS

    def mismatch(self, fits: Fits) -> list[float]:
        """Return the median mismatch of each pitch with the coarser ones [rad], from the second pitch on."""
        return [float(np.median(np.abs(each))) for each in _mismatch(fits, self._layout.pitches)]

    def _residuals(self, levels: Levels, fits: Fits) -> list[float]:
        return [_residual(*each, self._camera) for each in zip(levels, fits, self._sample.angles, strict=True)]

    def _steps(self, fits: Fits) -> list[float]:
        return _steps(fits, self._layout, self._camera)


class _Order(NamedTuple):
    """Another order of the frames: its misfit, the number of the first frame concerned, and a message about it."""

    misfit: float
    first_frame: int
    words: str


def _check_single_frames(sample: Sample, misfit: _Misfit, recorded: float, numbers: Sequence[int]) -> None:
    found = _wrong_frame(sample, misfit, recorded)
    if found is not None:
        group, frame = found
        index = numbers[sample.layout.slices()[group].start + frame]
        raise wrong_frame_error(index, sample.layout.periods[group][frame])


def _check_pitches(sample: Sample, misfit: _Misfit, numbers: Sequence[int]) -> None:
    for group, value in enumerate(misfit.mismatch(sample.fits), start=1):
        if value > _LARGEST_MISMATCH:
            index = numbers[sample.layout.slices()[group].start]
            raise StepError(_describe_pitch(sample, group), index=index, code=ErrorCode.WRONG_PATTERN)


def _check_three_frames(sample: Sample, misfit: _Misfit, numbers: Sequence[int]) -> None:
    if sample.layout.counts == [3] and misfit.is_uneven():
        first, last = numbers[sample.layout.code], numbers[-1]
        raise StepError(
            f"one of frames {first} to {last} does not show its fringes of pitch {sample.layout.pitches[0]:g} px; with "
            "three shifts the check cannot identify it: show four shifts or more",
            index=first,
            code=ErrorCode.WRONG_PATTERN,
        )


def wrong_frame_error(index: int, pattern: ProjectedPattern) -> StepError:
    """Return the error about a frame that does not show its pattern."""
    return StepError(
        f"frame {index} does not show its pattern ({pattern}): the projector showed another one, or the frame was "
        "taken while the pattern changed, because settle_ms is shorter than the projector's delay (fringedic timing "
        "measures it)",
        index=index,
        code=ErrorCode.WRONG_PATTERN,
    )


def _mismatch(fits: Fits, pitches: Sequence[float]) -> list[np.ndarray]:
    """Return the difference of each wrapped phase but the first from the one that the coarser pitches predict [rad]."""
    mismatch = []
    phase = np.arctan2(fits[0][2], fits[0][1])
    for fit, (coarse, fine) in zip(fits[1:], pairwise(pitches), strict=True):
        expected = phase * (coarse / fine)
        away = np.arctan2(fit[2], fit[1]) - expected
        away -= np.float32(2 * np.pi) * np.round(away / np.float32(2 * np.pi))
        mismatch.append(away)
        phase = expected + away
    return mismatch


def _residual(levels: np.ndarray, fit: np.ndarray, angles: np.ndarray, camera: CameraNoise) -> float:
    """Return the typical residual of one pitch over its modulation, without the contribution of noise.

    The second harmonic is also removed: a non-linear response (gamma) gives it to all frames alike.
    """
    freedom = len(levels) - 3
    if freedom < 1:
        return 0.0
    rest = levels - wave_levels(fit, angles)
    strength = np.maximum(np.hypot(fit[1], fit[2]), np.float32(1e-6))
    double = (fit[1] ** 2 - fit[2] ** 2) / strength, 2 * fit[1] * fit[2] / strength  # B cos(2 phi), B sin(2 phi)
    harmonic = np.outer(np.cos(2 * angles), double[0]) + np.outer(np.sin(2 * angles), double[1])
    rest -= np.vdot(harmonic, rest) / np.vdot(harmonic, harmonic) * harmonic
    squared = np.einsum("kp,kp->p", rest, rest) / chdtri(freedom, 0.5) - camera.variance(fit[0])
    return _over_modulation(squared, fit)


def _steps(fits: Fits, layout: Layout, camera: CameraNoise) -> list[float]:
    """Return the difference of the mean of each pitch from that of the others over its modulation, without noise.

    Three frames fit any sinusoid; only their mean can be checked, as all pitches are equally bright. More than three
    frames are checked by their residuals.
    """
    found = []
    for number, (fit, count) in enumerate(zip(fits, layout.counts, strict=True)):
        if count > 3 or len(fits) == 1:
            found.append(0.0)
            continue
        scatter = 1 / count + 1 / (sum(layout.counts) - count)
        away = fit[0] - _mean_of_others(fits, layout, number)
        found.append(_over_modulation(away**2 / chdtri(1, 0.5) - scatter * camera.variance(fit[0]), fit))
    return found


def _unevenness(fit: np.ndarray) -> float:
    """Return how unevenly phases and contrast of many fringes are distributed, 0 to about 1.

    They are distributed evenly where all frames show their patterns, also with gamma, whose error with three shifts
    varies with 3 phi. A frame with another pattern causes errors that vary with phi and 2 phi.
    """
    mean, cosine, sine = fit
    strength = np.maximum(np.hypot(cosine, sine), np.float32(1e-6))
    turns = (cosine + 1j * sine) / strength
    contrast = strength / np.maximum(mean, np.float32(1e-6))
    swing = np.clip(contrast / np.median(contrast), 0.0, 2.0)
    swing -= np.mean(swing)
    return math.hypot(*(abs(np.mean(part * each)) for part in (1.0, 2 * swing) for each in (turns, turns**2)))


def _over_modulation(squared: np.ndarray, fit: np.ndarray) -> float:
    return math.sqrt(max(float(np.median(squared / np.maximum(fit[1] ** 2 + fit[2] ** 2, 1e-6))), 0.0))


def _mean_of_others(fits: Fits, layout: Layout, number: int) -> np.ndarray:
    """Return the mean grey level of all pitches but one."""
    others = [(fit[0], count) for k, (fit, count) in enumerate(zip(fits, layout.counts, strict=True)) if k != number]
    return np.asarray(np.average([mean for mean, _ in others], axis=0, weights=[count for _, count in others]))


def _best_order(sample: Sample, misfit: _Misfit, numbers: Sequence[int]) -> _Order:
    """Return the best other order of the frames: all one frame late, or two of a pitch interchanged."""
    best = _one_frame_late(sample, misfit, numbers)
    for group, (stack, angle) in enumerate(zip(sample.groups(), sample.angles, strict=True)):
        for first, second in combinations(range(len(stack)), 2):
            order = np.arange(len(stack))
            order[[first, second]] = second, first
            levels, fits = sample.groups(), list(sample.fits)
            levels[group] = stack[order]
            fits[group] = fit_wave(levels[group], angle)
            value = misfit(levels, fits)
            if value < best.misfit:
                best = _Order(value, *_describe_exchange(sample.layout, group, (first, second), numbers))
    return best


def _one_frame_late(sample: Sample, misfit: _Misfit, numbers: Sequence[int]) -> _Order:
    """Return the order in which every frame shows the pattern of the frame before."""
    layout, angles = sample.layout, sample.angles
    whole = np.concatenate(sample.groups())
    shifted = [
        np.roll(whole, -1, axis=0)[where.start - layout.code : where.stop - layout.code] for where in layout.slices()
    ]
    shifted[-1] = shifted[-1][:-1]  # the last pattern was not taken: the sinusoid of the others replaces it
    shifted_angles = [*angles[:-1], angles[-1][:-1]]
    if len(shifted) == 1 or len(shifted[-1]) < 3:
        return _Order(math.inf, 0, "")
    fits = [fit_wave(*each) for each in zip(shifted, shifted_angles, strict=True)]
    shifted[-1] = np.concatenate([shifted[-1], wave_levels(fits[-1], angles[-1][-1:])])
    return _Order(
        misfit(shifted, fits),
        numbers[0],
        "every frame shows the pattern of the frame before: the camera is one frame ahead of the projector; raise "
        "settle_ms above the projector's delay (fringedic timing measures it)",
    )


def _describe_exchange(layout: Layout, group: int, frames: tuple[int, int], numbers: Sequence[int]) -> tuple[int, str]:
    """Return the number of the first of two interchanged frames of a pitch, and a message about both."""
    start, period = layout.slices()[group].start, layout.periods[group]
    first, second = (numbers[start + frame] for frame in frames)
    shifts = " and ".join(str(period[frame].shift) for frame in frames)
    return first, (
        f"frames {first} and {second} are interchanged (shifts {shifts} of pitch {layout.pitches[group]:g} px): frames "
        "are out of order, or some show an earlier pattern because settle_ms is shorter than the projector's delay "
        "(fringedic timing measures it)"
    )


def _wrong_frame(sample: Sample, misfit: _Misfit, recorded: float) -> tuple[int, int] | None:
    """Return pitch and frame without which all others fit; None when there is no such frame."""
    found = []
    for group, (stack, angle) in enumerate(zip(sample.groups(), sample.angles, strict=True)):
        for frame, fit in _without_each(sample, group):
            trial, fitted = sample.groups(), list(sample.fits)
            fitted[group] = fit
            model = wave_levels(fit, angle[frame : frame + 1])[0]
            trial[group] = stack.copy()
            trial[group][frame] = model
            amplitude = np.maximum(np.hypot(fit[1], fit[2]), 1e-3)
            if np.median(np.abs(stack[frame] - model) / amplitude) > _SMALLEST_DEVIATION:
                found.append((misfit(trial, fitted), group, frame))
    if not found or min(found)[0] > _EXPLAINED * recorded:
        return None
    return min(found)[1:]


def _without_each(sample: Sample, group: int) -> Iterator[tuple[int, np.ndarray]]:
    """Fit the sinusoid of a pitch without each of its frames; for two remaining ones with the mean of other pitches."""
    stack, angle = sample.groups()[group], sample.angles[group]
    if len(stack) == 3 and len(sample.fits) == 1:
        return
    for frame in range(len(stack)):
        others = np.arange(len(stack)) != frame
        if len(stack) > 3:
            yield frame, fit_wave(stack[others], angle[others])
            continue
        mean = _mean_of_others(sample.fits, sample.layout, group)
        waves = np.stack([np.cos(angle[others]), np.sin(angle[others])], axis=1)
        yield frame, np.concatenate([mean[None], np.linalg.pinv(waves) @ (stack[others] - mean)]).astype(np.float32)


def _describe_pitch(sample: Sample, group: int) -> str:
    """Return the message about fringes that do not continue the coarser ones."""
    slopes = [float(np.angle(np.mean(sample.growth(number)))) for number in (group - 1, group)]
    coarse, fine = sample.layout.pitches[group - 1 : group + 1]
    text = f"fringes of pitch {fine:g} px do not continue those of pitch {coarse:g} px"
    if sample.layout.counts[group - 1] == 3:
        text += " (three shifts do not detect gamma: measure the response curve or show four)"
    if slopes[0] * slopes[1] < 0:
        return (
            f"{text}: one of them grows the wrong way, so frames are out of order or the projector's image is mirrored"
        )
    measured = coarse * abs(slopes[0] / slopes[1]) if slopes[1] else math.inf
    if abs(measured / fine - 1) > 0.1:
        return (
            f"{text}: in the image their pitch is {measured:.3g} px if the other is right; the projector shows another "
            "pattern than recorded, or scales its image"
        )
    return f"{text}: they are displaced; the projector shows other shifts than recorded, or frames are out of order"
