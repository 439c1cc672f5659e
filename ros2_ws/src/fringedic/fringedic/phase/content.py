"""Whether every frame shows its pattern: each has to fit the others of its pitch, and each pitch the coarser ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations, pairwise

import numpy as np
from scipy.special import chdtri

from fringedic.errors import FramesOutOfOrderError, WrongPatternError
from fringedic.phase.layout import Layout
from fringedic.phase.noise import ROUNDING_NOISE, CameraNoise
from fringedic.phase.sample import Sample, fit_wave, wave_levels

_LARGEST_MISMATCH = 0.7  # median [rad] between one pitch and the next; without relation it would be pi/2
_LARGEST_RESIDUAL = 0.08  # of the fit over the modulation, beyond noise; worth asking for the frames' order
_LARGEST_STEP = 0.15  # of the mean of three frames against the other pitches, over the modulation; as above
_LARGEST_UNEVENNESS = 0.2  # of the only pitch, see _unevenness: 0.04 in good stacks, from 0.33 on with an alien frame
_EXPLAINED = 0.3  # of the misfit remains when the right explanation is found
_STRANGE = 0.3  # of the modulation; a frame that differs less from what it should show is not alien

Misfit = Callable[[Sequence[np.ndarray], Sequence[np.ndarray]], float]


def check_patterns(sample: Sample, camera: CameraNoise, numbers: Sequence[int]) -> None:
    """Raise when frames are in another order than recorded, or show something else.

    Parameters
    ----------
    sample
        Pixels that are lit and modulated.
    camera
        Noise of a grey level.
    numbers
        Number of each frame of the stack within its step, for the words.

    Raises
    ------
    FramesOutOfOrderError, WrongPatternError
        ``index`` is the number of the frame, of the first one where there are several.
    """
    layout, levels, fits, angles = sample.layout, sample.groups(), sample.fits, sample.angles
    camera = CameraNoise(min(camera.read, 2 * ROUNDING_NOISE))  # an estimate from this stack would contain its faults

    alone = len(fits) == 1 and sample.has_many_fringes

    def misfit(trial: Sequence[np.ndarray], fitted: Sequence[np.ndarray]) -> float:
        between = [float(np.median(np.abs(each))) for each in _chain(fitted, layout.pitches)]
        within = [_residual(*each, camera) for each in zip(trial, fitted, angles, strict=True)]
        uneven = _unevenness(fitted[0]) if alone else 0.0
        return sum(value**2 for value in (*between, *within, *_steps(fitted, layout, camera), uneven))

    mismatch = [float(np.median(np.abs(each))) for each in _chain(fits, layout.pitches)]
    residual = [_residual(*each, camera) for each in zip(levels, fits, angles, strict=True)]
    uneven = alone and _unevenness(fits[0]) > _LARGEST_UNEVENNESS
    if (
        max(mismatch, default=0.0) < _LARGEST_MISMATCH
        and max(residual) < _LARGEST_RESIDUAL
        and max(_steps(fits, layout, camera)) < _LARGEST_STEP
        and not uneven
    ):
        return
    recorded = misfit(levels, fits)
    best, index, words = _best_order(sample, misfit, numbers)
    if best < _EXPLAINED * recorded:
        raise FramesOutOfOrderError(words, index=index)
    alien = _alien_frame(sample, misfit, recorded)
    if alien is not None:
        group, frame = alien
        index = numbers[layout.slices()[group].start + frame]
        raise WrongPatternError(does_not_show(index, layout.periods[group][frame]), index=index)
    for group, value in enumerate(mismatch, start=1):
        if value > _LARGEST_MISMATCH:
            raise WrongPatternError(_about_pitch(sample, group), index=numbers[layout.slices()[group].start])
    if layout.counts == [3] and uneven:
        first, last = numbers[layout.code], numbers[-1]
        raise WrongPatternError(
            f"one of frames {first} to {last} does not show its fringes of pitch {layout.pitches[0]:g} px; three "
            "cannot tell which: show four shifts or more",
            index=first,
        )


def does_not_show(index: int, pattern: object) -> str:
    """Say that a frame is not what it should be."""
    return (
        f"frame {index} does not show what it should ({pattern}): the projector showed another pattern, or the frame "
        "was taken while it changed: settle_ms is shorter than the projector's delay (fringedic timing measures it)"
    )


def _chain(fits: Sequence[np.ndarray], pitches: Sequence[float]) -> list[np.ndarray]:
    """Return how far the wrapped phase of each pitch is from what the coarser ones say [rad], from the second on."""
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
    """Return the typical misfit of one pitch over its modulation, noise taken off.

    So is the second harmonic, which a bent response (gamma) gives to all frames alike.
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


def _steps(fits: Sequence[np.ndarray], layout: Layout, camera: CameraNoise) -> list[float]:
    """Return how far the mean of each pitch is from that of the others, over its modulation, noise taken off.

    Three frames fit any sinusoid; that all pitches are equally bright is what proves them. More prove themselves.
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
    """Return how far phases and contrast of many fringes are from being spread evenly, 0 to about 1.

    They are spread evenly where all frames show their patterns, gamma or not: with three shifts that bends them with
    3 phi. A frame that shows something else bends them with phi and 2 phi.
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


def _mean_of_others(fits: Sequence[np.ndarray], layout: Layout, number: int) -> np.ndarray:
    """Return the mean grey level of all pitches but one."""
    others = [(fit[0], count) for k, (fit, count) in enumerate(zip(fits, layout.counts, strict=True)) if k != number]
    return np.asarray(np.average([mean for mean, _ in others], axis=0, weights=[count for _, count in others]))


def _best_order(sample: Sample, misfit: Misfit, numbers: Sequence[int]) -> tuple[float, int, str]:
    """Return the misfit of the best other order of the frames, the first frame concerned, and the order in words."""
    layout, levels, angles, fits = sample.layout, sample.groups(), sample.angles, sample.fits
    best, index, words = math.inf, 0, ""
    whole = np.concatenate(levels)
    late = [
        np.roll(whole, -1, axis=0)[where.start - layout.code : where.stop - layout.code] for where in layout.slices()
    ]
    late[-1] = late[-1][:-1]
    late_angles = [*angles[:-1], angles[-1][:-1]]
    if len(late) > 1 and len(late[-1]) >= 3:
        fitted = [fit_wave(*each) for each in zip(late, late_angles, strict=True)]
        late[-1] = np.concatenate([late[-1], wave_levels(fitted[-1], angles[-1][-1:])])
        best, index = misfit(late, fitted), numbers[0]
        words = (
            "every frame shows the pattern of the frame before: the camera is one frame ahead of the projector; raise "
            "settle_ms above the projector's delay (fringedic timing measures it)"
        )
    for group, (stack, angle) in enumerate(zip(levels, angles, strict=True)):
        for first, second in combinations(range(len(stack)), 2):
            order = np.arange(len(stack))
            order[[first, second]] = second, first
            trial, fitted = list(levels), list(fits)
            trial[group] = stack[order]
            fitted[group] = fit_wave(trial[group], angle)
            value = misfit(trial, fitted)
            if value < best:
                start, period = layout.slices()[group].start, layout.periods[group]
                best, index = value, numbers[start + first]
                words = (
                    f"frames {index} and {numbers[start + second]} are interchanged (shifts {period[first].shift} and "
                    f"{period[second].shift} of pitch {layout.pitches[group]:g} px): frames are out of order"
                )
    return best, index, words


def _alien_frame(sample: Sample, misfit: Misfit, recorded: float) -> tuple[int, int] | None:
    """Return pitch and frame without which everything fits, None when there is no such frame."""
    found = []
    for group, (stack, angle) in enumerate(zip(sample.groups(), sample.angles, strict=True)):
        for frame, fit in _without_each(sample, group):
            trial, fitted = sample.groups(), list(sample.fits)
            fitted[group] = fit
            model = wave_levels(fit, angle[frame : frame + 1])[0]
            trial[group] = stack.copy()
            trial[group][frame] = model
            amplitude = np.maximum(np.hypot(fit[1], fit[2]), 1e-3)
            if np.median(np.abs(stack[frame] - model) / amplitude) > _STRANGE:
                found.append((misfit(trial, fitted), group, frame))
    if not found or min(found)[0] > _EXPLAINED * recorded:
        return None
    return min(found)[1:]


def _without_each(sample: Sample, group: int) -> Iterator[tuple[int, np.ndarray]]:
    """Fit the sinusoid of a pitch without each of its frames; two that are left take their mean from other pitches."""
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


def _about_pitch(sample: Sample, group: int) -> str:
    """Say what is wrong with fringes that do not continue the coarser ones."""
    slopes = [float(np.angle(np.mean(sample.growth(number)))) for number in (group - 1, group)]
    coarse, fine = sample.layout.pitches[group - 1 : group + 1]
    text = f"fringes of pitch {fine:g} px do not continue those of pitch {coarse:g} px"
    if sample.layout.counts[group - 1] == 3:
        text += " (three shifts see no gamma: measure the response curve or show four)"
    if slopes[0] * slopes[1] < 0:
        return (
            f"{text}: one of them grows the wrong way, so frames are out of order or the projector's image is mirrored"
        )
    measured = coarse * abs(slopes[0] / slopes[1]) if slopes[1] else math.inf
    if abs(measured / fine - 1) > 0.1:
        return (
            f"{text}: as seen, their pitch is {measured:.3g} px if the other is right; the projector shows another "
            "pattern than recorded, or scales its image"
        )
    return f"{text}: they are displaced; the projector shows other shifts than recorded, or frames are out of order"
