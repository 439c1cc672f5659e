"""What is wrong with a stack of frames, in words: looked for in a few thousand pixels before anything is measured.

Three kinds of evidence, each blind to what the others see: (1) the brightness and modulation of the frames; (2) whether
the sinusoids of a pitch fit, and whether the fringes of each pitch continue those of the coarser one, which order and
content of the frames decide; (3) what single frames have in common over all pixels: a frame that is brighter
(flicker), one whose fringes are displaced (the surface moved along the light), or one whose texture is displaced.
The harmonics of a projector without correction spoil the fit too, but are the same for all frames, so (3) passes them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from scipy.stats import chi2

from fringedic.errors import (
    DarkStackError,
    FlickerError,
    FramesOutOfOrderError,
    MovedSurfaceError,
    SaturatedStackError,
    WrongPatternError,
)
from fringedic.phase.layout import Layout, layout_of, shift_angles
from fringedic.phase.noise import ROUNDING_NOISE, CameraNoise, saturation_level
from fringedic.phase.steps import CONFIDENCE
from fringedic.sequence import Orientation, Projection

_SAMPLES = 6000  # pixels that are looked at
_FEWEST = 200  # of them, for a statement about single frames
_FEW = 0.02  # part of the image; what is measured on less is no surface
_LEAST_CONTRAST = 0.03  # modulation over mean; fringes that are there have more
_DARK = 0.03  # of full scale
_LARGEST_MISMATCH = 0.7  # median [rad] between one pitch and the next; without relation it would be pi/2
_LARGEST_RESIDUAL = 0.08  # of the fit over the modulation, beyond noise; worth asking for the frames' order
_EXPLAINED = 0.3  # of the misfit remains when the right explanation is found
_NOTICED = 0.2  # part of the error allowed from which the operator is told
_NOTICED_FLICKER = 0.02  # change of the light from which the operator is told
_CUT_FRINGES = 0.02  # what C/A keeps of the fringes when they do not cover all phases equally
_FEWEST_FRINGES = 5.0  # in view, for a statement about single frames
_SPREAD = 0.35  # largest mean of exp(i phi) over the pixels for which frames can be told apart


@dataclass(frozen=True)
class _Sample:
    """Grey levels of some pixels, at the pixel and one pixel to the right, left, below and above; (frame, pixel)."""

    levels: np.ndarray
    right: np.ndarray
    left: np.ndarray
    below: np.ndarray
    above: np.ndarray
    x: np.ndarray  # position in the image, -1 to 1
    y: np.ndarray
    size: tuple[int, int]  # rows and columns of the image

    def only(self, which: np.ndarray) -> _Sample:
        return _Sample(
            levels=self.levels[:, which],
            right=self.right[:, which],
            left=self.left[:, which],
            below=self.below[:, which],
            above=self.above[:, which],
            x=self.x[which],
            y=self.y[which],
            size=self.size,
        )


def check_stack(
    frames: np.ndarray,
    projections: Sequence[Projection],
    *,
    noise: CameraNoise | None = None,
    saturation: float | None = None,
    largest_error: float = 0.003,
    largest_motion: float = 0.2,
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

    Returns
    -------
    list of str
        What is not wrong enough for an error but should be known.

    Raises
    ------
    SaturatedStackError, DarkStackError
        Hardly a pixel is measurable because the image is too bright or too dark.
    WrongPatternError
        The projector showed something else: the same image all the time, another pitch, or a frame without its pattern.
    FramesOutOfOrderError
        The frames are not in the order of their projections.
    FlickerError
        The light changed from frame to frame.
    MovedSurfaceError
        The surface moved while its frames were taken.
    """
    layout = layout_of(projections)
    ceiling = saturation_level(frames, saturation)
    sample = _sample(frames)
    brightest = sample.levels.max(axis=0)
    camera = noise if noise is not None else CameraNoise(ROUNDING_NOISE)
    fits = [_fit(sample.levels[where], shift_angles(period)) for where, period in _groups(layout)]
    saturated = brightest >= ceiling
    usable = _brightness(sample, layout, fits, saturated, ceiling)
    if usable.sum() < _FEWEST:
        return []
    glare = [f"{saturated.mean():.0%} of the image saturates"] if saturated.mean() > _FEW else []
    sample = sample.only(usable)
    fits = [each[:, usable] for each in fits]
    _order(sample, layout, fits, projections, camera)
    return glare + _frames_alike(sample, layout, camera, largest_error, largest_motion)


def _groups(layout: Layout) -> Iterator[tuple[slice, tuple[Projection, ...]]]:
    return zip(layout.slices(), layout.periods, strict=True)


def _sample(frames: np.ndarray) -> _Sample:
    _, rows, columns = frames.shape
    skip = max(3, math.ceil(math.sqrt(rows * columns / _SAMPLES)))
    height, width = max(rows - 2, 0), max(columns - 2, 0)

    def at(down: int, right: int) -> np.ndarray:
        part = frames[:, 1 + down : 1 + down + height : skip, 1 + right : 1 + right + width : skip]
        return part.reshape(len(frames), -1).astype(np.float32)

    y, x = np.meshgrid(np.linspace(-1, 1, height)[::skip], np.linspace(-1, 1, width)[::skip], indexing="ij")
    return _Sample(at(0, 0), at(0, 1), at(0, -1), at(1, 0), at(-1, 0), x.ravel(), y.ravel(), (rows, columns))


def _fit(levels: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return mean, B cos(phi) and B sin(phi) of the sinusoid through frames at these angles; shape (3, pixel)."""
    waves = np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles)], axis=1)
    return np.asarray((np.linalg.pinv(waves) @ levels).astype(np.float32))


def _model(fit: np.ndarray, angles: np.ndarray) -> np.ndarray:
    waves = np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles)], axis=1)
    return np.asarray((waves @ fit).astype(np.float32))


def _brightness(
    sample: _Sample, layout: Layout, fits: list[np.ndarray], saturated: np.ndarray, ceiling: float
) -> np.ndarray:
    """Return which pixels can be looked at; raise when there are hardly any.

    Noise estimated from a stack contains its faults, so fringes are told from noise by what neighbours have in common.
    """
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
    noisy = [number for number in range(len(fits)) if _coherence(sample, layout, number, fits, ~saturated) < 0.4]
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
            "its pattern, or camera and projector are not synchronised"
        )
    return usable


def _slopes(sample: _Sample, layout: Layout, number: int) -> np.ndarray:
    """Return exp(i d) of each pixel, d being the growth of the phase over two pixels, in the fringes' direction."""
    where, period = list(_groups(layout))[number]
    vertical = period[0].orientation == Orientation.VERTICAL
    ends = (sample.right, sample.left) if vertical else (sample.above, sample.below)
    after, before = (_fit(each[where], shift_angles(period)) for each in ends)
    turned = (after[1] + 1j * after[2]) * (before[1] - 1j * before[2])
    return np.asarray(turned / np.maximum(np.abs(turned), np.float32(1e-6)))


def _coherence(sample: _Sample, layout: Layout, number: int, fits: list[np.ndarray], allowed: np.ndarray) -> float:
    """Return how much neighbours agree on the phase's growth where the modulation is strongest, 0 (noise) to 1."""
    strength = np.where(allowed, np.hypot(fits[number][1], fits[number][2]), 0)
    strong = strength > np.quantile(strength, 0.8)
    return float(np.abs(np.mean(_slopes(sample, layout, number)[strong]))) if strong.any() else 0.0


def _chain(fits: Sequence[np.ndarray], pitches: Sequence[float]) -> list[np.ndarray]:
    """Return how far the wrapped phase of each pitch is from what the coarser ones say [rad], from the second on."""
    mismatch = []
    phase = np.arctan2(fits[0][2], fits[0][1])
    for fit, (coarse, fine) in zip(fits[1:], pairwise(pitches), strict=True):
        expected = phase * (coarse / fine)
        wrapped = np.arctan2(fit[2], fit[1])
        away = np.angle(np.exp(1j * (wrapped - expected)))
        mismatch.append(away)
        phase = expected + away
    return mismatch


def _residual(levels: np.ndarray, fit: np.ndarray, angles: np.ndarray, camera: CameraNoise) -> float:
    """Return the typical misfit of one pitch over its modulation, noise taken off."""
    freedom = len(levels) - 3
    if freedom < 1:
        return 0.0
    squared = np.sum((levels - _model(fit, angles)) ** 2, axis=0) / chi2.median(freedom) - camera.variance(fit[0])
    return math.sqrt(max(float(np.median(squared / np.maximum(fit[1] ** 2 + fit[2] ** 2, 1e-6))), 0.0))


def _order(
    sample: _Sample, layout: Layout, fits: list[np.ndarray], projections: Sequence[Projection], camera: CameraNoise
) -> None:
    """Raise when frames are in another order than recorded, or show something else."""
    camera = CameraNoise(min(camera.read, 2 * ROUNDING_NOISE))  # an estimate from this stack would contain its faults
    angles = [shift_angles(period) for period in layout.periods]
    levels = [sample.levels[where] for where in layout.slices()]

    def misfit(trial: Sequence[np.ndarray], fitted: Sequence[np.ndarray]) -> float:
        between = [float(np.median(np.abs(each))) for each in _chain(fitted, layout.pitches)]
        within = [_residual(*each, camera) for each in zip(trial, fitted, angles, strict=True)]
        return sum(value**2 for value in (*between, *within))

    mismatch = [float(np.median(np.abs(each))) for each in _chain(fits, layout.pitches)]
    residual = [_residual(*each, camera) for each in zip(levels, fits, angles, strict=True)]
    if max(mismatch, default=0.0) < _LARGEST_MISMATCH and max(residual) < _LARGEST_RESIDUAL:
        return
    recorded = misfit(levels, fits)
    best, words = _best_order(layout, levels, angles, fits, misfit, [each.shift for each in projections])
    if best < _EXPLAINED * recorded:
        raise FramesOutOfOrderError(words)
    alien = _alien_frame(layout, levels, angles, fits, misfit, recorded)
    if alien is not None:
        group, frame = alien
        projection = layout.periods[group][frame]
        raise WrongPatternError(
            f"frame {layout.slices()[group].start + frame} does not show what it should ({projection}): the projector "
            "showed another pattern, or the frame was taken while it changed"
        )
    for group, value in enumerate(mismatch, start=1):
        if value > _LARGEST_MISMATCH:
            raise WrongPatternError(_about_pitch(sample, layout, group))


def _best_order(
    layout: Layout,
    levels: list[np.ndarray],
    angles: list[np.ndarray],
    fits: list[np.ndarray],
    misfit: Callable[[Sequence[np.ndarray], Sequence[np.ndarray]], float],
    shifts: Sequence[int],
) -> tuple[float, str]:
    """Return the misfit of the best other order of the frames, and which order that is in words."""
    best, words = math.inf, ""
    whole = np.concatenate(levels)
    late = [
        np.roll(whole, -1, axis=0)[where.start - layout.code : where.stop - layout.code] for where in layout.slices()
    ]
    late[-1] = late[-1][:-1]
    late_angles = [*angles[:-1], angles[-1][:-1]]
    if len(late) > 1 and len(late[-1]) >= 3:
        fitted = [_fit(*each) for each in zip(late, late_angles, strict=True)]
        late[-1] = np.concatenate([late[-1], _model(fitted[-1], angles[-1][-1:])])
        best = misfit(late, fitted)
        words = (
            "every frame shows the pattern of the frame before: the camera is one frame ahead of the projector; raise "
            "settle_ms"
        )
    for group, (stack, angle) in enumerate(zip(levels, angles, strict=True)):
        for first, second in combinations(range(len(stack)), 2):
            order = np.arange(len(stack))
            order[[first, second]] = second, first
            trial, fitted = list(levels), list(fits)
            trial[group] = stack[order]
            fitted[group] = _fit(trial[group], angle)
            value = misfit(trial, fitted)
            if value < best:
                start = layout.slices()[group].start
                best, words = (
                    value,
                    f"frames {start + first} and {start + second} are interchanged (shifts {shifts[start + first]} and "
                    f"{shifts[start + second]} of pitch {layout.pitches[group]:g} px): frames are out of order",
                )
    return best, words


def _alien_frame(
    layout: Layout,
    levels: list[np.ndarray],
    angles: list[np.ndarray],
    fits: list[np.ndarray],
    misfit: Callable[[Sequence[np.ndarray], Sequence[np.ndarray]], float],
    recorded: float,
) -> tuple[int, int] | None:
    """Return pitch and frame without which everything fits, None when there is no such frame."""
    found: list[tuple[float, int, int]] = []
    for group, (stack, angle) in enumerate(zip(levels, angles, strict=True)):
        if len(stack) == 3:
            continue
        for frame in range(len(stack)):
            others = np.arange(len(stack)) != frame
            trial, fitted = list(levels), list(fits)
            fitted[group] = _fit(stack[others], angle[others])
            trial[group] = np.where(others[:, None], stack, _model(fitted[group], angle))
            amplitude = np.maximum(np.hypot(*fitted[group][1:]), 1e-3)
            strange = np.median(np.abs(stack[frame] - trial[group][frame]) / amplitude)
            if strange > 0.3:
                found.append((misfit(trial, fitted), group, frame))
    if not found or min(found)[0] > _EXPLAINED * recorded:
        return None
    return min(found)[1:]


def _about_pitch(sample: _Sample, layout: Layout, group: int) -> str:
    """Say what is wrong with fringes that do not continue the coarser ones."""
    slopes = [float(np.angle(np.mean(_slopes(sample, layout, number)))) for number in (group - 1, group)]
    coarse, fine = layout.pitches[group - 1 : group + 1]
    text = f"fringes of pitch {fine:g} px do not continue those of pitch {coarse:g} px"
    if layout.counts[group - 1] == 3:
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


def _frames_alike(
    sample: _Sample, layout: Layout, camera: CameraNoise, largest_error: float, largest_motion: float
) -> list[str]:
    """Raise or tell when the light or the surface changed between the frames of the finest fringes.

    A frame k that is brighter by g, displaced by e [rad] and whose texture is displaced by d [px] differs from its
    sinusoid by ``g I + e B sin(phi - 2 pi k/q) - I d . grad(ln A)``. The sinusoid's own fit takes part of that away,
    the same part for all pixels: Q = 1 - (hat matrix). So g, e (with its slopes over the image) and d of all frames
    follow from one linear least-squares problem whose normal matrix is the pixels' sum of products, times Q.
    """
    where, period = list(_groups(layout))[-1]
    angles = shift_angles(period)
    count = len(angles)
    if count < 4:
        return []
    levels = sample.levels[where]
    fit = _fit(levels, angles)
    strength = np.hypot(fit[1], fit[2])
    phase = np.arctan2(fit[2], fit[1])
    if _fringes_in_view(sample, layout) < _FEWEST_FRINGES or any(
        abs(np.mean(np.exp(1j * order * phase))) > _SPREAD for order in (1, 2, 3)
    ):
        return []
    model = _model(fit, angles)
    wave = strength * np.sin(phase - angles[:, None])
    along = 0.5 * (sample.right[where].mean(axis=0) - sample.left[where].mean(axis=0))
    down = 0.5 * (sample.below[where].mean(axis=0) - sample.above[where].mean(axis=0))
    parts = [model, wave, wave * sample.x, wave * sample.y, -model * along / fit[0], -model * down / fit[0]]
    weight = 1 / np.sqrt(camera.variance(fit[0]))
    parts = [np.asarray(part, np.float64) for part in parts]
    weighted = [part * weight for part in parts]
    rest = (levels - model) * weight
    waves = np.stack([np.ones(count), np.cos(angles), np.sin(angles)], axis=1)
    left = np.eye(count) - waves @ np.linalg.pinv(waves)
    pixels = levels.shape[1]
    normal = np.block([[left * (one @ other.T) for other in weighted] for one in weighted])
    right = np.concatenate([np.sum(part * rest, axis=1) for part in weighted])
    # Light that changes like cos(2 pi k/q) looks like displaced fringes to every single pixel; but it gives all pixels
    # the same C/A, whose mean over fringes of all phases is 0 otherwise. The taper keeps cut fringes out of that mean.
    taper = (1 - sample.x**2) ** 2 * (1 - sample.y**2) ** 2
    for number, course in ((1, np.cos(angles)), (2, np.sin(angles))):
        course = np.pad(2 / count * course, (0, len(right) - count))
        offset = float(np.average(fit[number] / fit[0], weights=taper))
        normal += normal[0, 0] * np.outer(course, course)
        right += normal[0, 0] * course * (offset if abs(offset) > _CUT_FRINGES else 0.0)
    inverse = np.linalg.pinv(normal, rcond=1e-6, hermitian=True)
    found = inverse @ right
    covariance = inverse * float(np.sum(rest**2)) / (pixels * (count - 3))
    light, lifted, across, along_rows = (
        found[:count],
        found[count : 4 * count],
        found[4 * count : 5 * count],
        found[5 * count :],
    )

    bent = np.sum(2 / count * np.sin(angles[:, None] - phase) / strength * light[:, None] * parts[0], axis=0)  # eq. 11
    wander = lifted.reshape(3, count) - lifted.reshape(3, count).mean(axis=1, keepdims=True)
    lift = np.sqrt(np.mean(wander[0] ** 2) + (np.mean(wander[1] ** 2) + np.mean(wander[2] ** 2)) / 3) / (2 * np.pi)
    motion = float(np.hypot(np.ptp(across), np.ptp(along_rows)))
    bend = float(np.std(bent)) / (2 * np.pi)
    remarks = []
    for value, limit, part, kind, words in (
        (
            bend,
            largest_error,
            slice(0, count),
            FlickerError,
            f"the light changes by {100 * np.ptp(light):.1f} % between the frames (flicker), which bends the phase by "
            f"{bend:.4f} fringe",
        ),
        (
            motion,
            largest_motion,
            slice(4 * count, None),
            MovedSurfaceError,
            f"the surface moved by {motion:.2f} px across the image while its frames were taken",
        ),
        (
            float(lift),
            largest_error,
            slice(count, 4 * count),
            MovedSurfaceError,
            f"the surface moved along the projector's light while its frames were taken: the fringes wander by "
            f"{lift:.4f} fringe",
        ),
    ):
        noticed = value > _NOTICED * limit or (kind is FlickerError and np.ptp(light) > _NOTICED_FLICKER)
        if not noticed or not _significant(found[part], covariance[part, part]):
            continue
        if value > limit:
            raise kind(f"{words}; {limit:g} is allowed")
        remarks.append(words)
    return remarks


def _fringes_in_view(sample: _Sample, layout: Layout) -> float:
    """Return how many of the finest fringes lie between the outermost pixels that are looked at."""
    vertical = layout.periods[0][0].orientation == Orientation.VERTICAL
    reach = (
        0.5 * float(np.ptp(sample.x)) * sample.size[1] if vertical else 0.5 * float(np.ptp(sample.y)) * sample.size[0]
    )
    per_pixel = 0.5 * float(np.median(np.abs(np.angle(_slopes(sample, layout, len(layout.pitches) - 1))))) / (2 * np.pi)
    return reach * per_pixel


def _significant(found: np.ndarray, covariance: np.ndarray) -> bool:
    """Whether these values together are more than what noise makes of nothing."""
    inverse = np.linalg.pinv(covariance, rcond=1e-6, hermitian=True)
    freedom = int(np.linalg.matrix_rank(covariance, rtol=1e-6, hermitian=True))
    return bool(found @ inverse @ found > freedom + CONFIDENCE * math.sqrt(2 * max(freedom, 1)) + CONFIDENCE**2)
