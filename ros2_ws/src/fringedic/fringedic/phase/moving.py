"""Phase stepping on a surface that moves: every frame is aligned to the material points, and the phase drifts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import xarray as xr

from fringedic.errors import ErrorCode, ImageError, PhaseError, StepError
from fringedic.frames.interpolation import INVERSE, WEIGHTS
from fringedic.frames.interpolation_kernels import BORDER, fit_spline
from fringedic.frames.noise import ROUNDING_NOISE, CameraNoise, saturation_level
from fringedic.patterns.pattern import UNIFORM_KINDS, ProjectedPattern, moving_frames
from fringedic.phase.demodulation_kernel import CONFIDENCE
from fringedic.phase.layout import Layout, check_frames, layout_of, pixels, shift_angles
from fringedic.phase.moving_kernel import CELL, align_frame, find_orders, fit_drifting, fit_known_drift
from fringedic.phase.moving_model import (
    LARGEST_CONDITION,
    DriftRange,
    Shown,
    at_cells,
    find_drift,
    interpolation_gain,
    spread,
    tabulate_cells,
)
from fringedic.phase.moving_residuals import Residuals, residuals_of
from fringedic.phase.noise import noise_of_residuals
from fringedic.phase.settings import DEFAULT_SETTINGS, PhaseSettings
from fringedic.wording.arguments import array, check_arguments, grey_levels, number, of_type, optional, several

f4 = np.float32

FEWEST_FRAMES = 5
"""Of the finest pitch: four parameters and one residual."""

_LARGEST_REST = 0.7  # [rad] by which a pixel's phase may leave that of its cell's drift at the first and last frame
_LARGEST_RELATIVE = 0.15  # residuals over modulation, where the noise is not known
_ONE_FRAME = 0.7  # of the way from an equal share of the residuals to all of them
_SMALLEST_CONTRAST = 0.5  # that motion blur leaves
_LARGEST_DRIFT = 100.0  # [rad] between two frames: sixteen fringes, whose motion no frame would resolve
_LATTICE = 4  # [px] between the pixels whose orders are compared
_FEWEST_POINTS = 100  # of it
_AWAY = 0.25  # fringes from a whole number, from which on a point contradicts
_CONTRADICTED = 0.25  # part of the points: it is a half where the phase is another one
_NEIGHBOURS = 2 * CELL + 1  # [px]: the noise of their mean drift does not matter


@dataclass(frozen=True)
class ImageMotion:
    """Motion of the material points in the image: the point at pixel p at time 0 is at p + v t + a t^2 / 2.

    Attributes
    ----------
    velocity
        v, to the right and down [px/s], float32, shape (2, row, column); NaN where it is not known.
    acceleration
        a [px/s^2], the same shape; None for none.

    Examples
    --------
    >>> ImageMotion.uniform((4, 6), 2.0, -1.0).velocity[:, 0, 0]
    array([ 2., -1.], dtype=float32)
    """

    velocity: np.ndarray
    acceleration: np.ndarray | None = None

    @classmethod
    def uniform(cls, shape: tuple[int, int], right: float, down: float) -> ImageMotion:
        """Return the motion of all points of an image with the same velocity [px/s]."""
        return cls(np.broadcast_to(np.array([right, down], f4)[:, None, None], (2, *shape)))


@check_arguments(
    PhaseError,
    frames=grey_levels(3),
    times=array(1),
    patterns=several(of_type(ProjectedPattern)),
    displacement=of_type(ImageMotion),
    settings=of_type(PhaseSettings),
    drift=number(),
    exposure_time=number(low=0.0),
    prediction=optional(of_type(xr.Dataset)),
)
def demodulate_moving(
    frames: np.ndarray,
    times: np.ndarray,
    patterns: Sequence[ProjectedPattern],
    displacement: ImageMotion,
    settings: PhaseSettings = DEFAULT_SETTINGS,
    *,
    drift: float = 0.0,
    exposure_time: float = 0.0,
    prediction: xr.Dataset | None = None,
) -> xr.Dataset:
    """Measure the absolute phase and its drift from frames between which the surface moves.

    Every frame is interpolated where the material points are at its time. At a material point the frames of a pitch
    are ``A + B cos(phi + omega t + alpha t^2 / 2 - delta_k)``: mean A, modulation B, phase phi and drift omega of each
    point are fitted by least squares, and the acceleration alpha of tiles of the image where the residuals contain one.
    Time 0 is the middle of the frames of the finest pitch. The phases of coarser pitches, seen at other times, are
    moved to it with the drift before they number the fringes. See `docs/moving.md` for the equations.

    Parameters
    ----------
    frames
        Grey levels, uint8, uint16 or float32, shape (frame, row, column).
    times
        Of the middle of each exposure [s], rising.
    patterns
        Pattern of each frame: fringes of one orientation, pitches coarse to fine, whole cycles of q >= 3 shifts, at
        least 5 frames of the finest pitch. Frames of white or grey light next to the finest pitch add to the texture;
        others are ignored.
    displacement
        Motion of the material points; its time 0 is the middle of the frames of the finest pitch.
    settings
        Its ``noise``, ``saturation``, ``minimum_modulation`` and ``largest_misfit`` are used. Without a noise it is
        estimated from the residuals, and the check of the motion is less sensitive.
    drift
        Predicted drift of the phase at the finest pitch [rad/s], the middle of the range that is searched. Needed where
        the surface outruns the shifts, see `plan_shifts`.
    exposure_time
        Of each frame [s]: from it follows how much modulation the motion blurs.
    prediction
        ``phase`` and ``sigma`` [rad at the finest pitch] at the material points at time 0, such as of the stack before,
        see `predict_phase`. The orders are those next to it; coarser pitches have to agree.

    Returns
    -------
    Dataset
        As of `absolute_phase` at the material points at time 0, with ``drift`` [rad/s], ``sigma_drift``, the
        ``covariance`` of the errors of phase and drift [rad^2/s], and the ``condition`` number of the fit. Phase, drift
        and their errors are NaN where the condition exceeds 10. Attributes: ``time`` [s], on the clock of `times`;
        ``misfit``, variance of the residuals over that of the noise, NaN if that is estimated; ``accelerated``, 1 where
        an acceleration is fitted; ``contrast``, part of the modulation that motion blur leaves.

    Raises
    ------
    PhaseError
        The patterns are not a sequence as described above, or the shifts follow the predicted motion.
    ImageError
        Frames, times, patterns and motion do not belong together.
    StepError
        One frame does not show its pattern (`WRONG_PATTERN`); the motion is not that of the model or blurs the fringes
        (`SURFACE_MOVED`); the shifts follow the motion (`INVALID_SEQUENCE`).

    References
    ----------
    J. E. Greivenkamp, "Generalized data reduction for heterodyne interferometry", Optical Engineering 23 (1984)
    350-352: least squares for any shifts.

    Examples
    --------
    A wall with fringes of 40 px that moves by 1 px per frame to the left and carries no texture.

    >>> from fringedic.patterns.pattern import PatternKind
    >>> patterns = [ProjectedPattern(PatternKind.FRINGES, pitch=40.0, shift=k, shifts=8) for k in range(1, 9)]
    >>> column = np.arange(200.0) - np.zeros((40, 1))
    >>> frames = [100 + 50 * np.cos(2 * np.pi * (column / 40 - k / 8)) for k in range(1, 9)]
    >>> motion = ImageMotion.uniform((40, 200), -1.0, 0.0)
    >>> measured = demodulate_moving(np.array(frames, np.float32), np.arange(8.0), patterns, motion)
    >>> round(float(measured.drift[20, 100]) * 40 / (2 * np.pi), 3)
    -1.0
    """
    times = times.astype(np.float64)
    fringes = np.array([each.kind not in UNIFORM_KINDS for each in patterns], bool)
    _check(frames, times, patterns, displacement)
    layout = layout_of([each for each in patterns if each.kind not in UNIFORM_KINDS])
    _check_layout(layout)
    stack = _align(np.asarray(frames)[fringes], times[fringes], layout, displacement, settings.saturation)
    if not abs(drift) * stack.unit < _LARGEST_DRIFT:
        raise PhaseError(
            f"a drift of {drift:.3g} rad/s is {drift * stack.unit:.3g} rad between two frames: is it in rad/s?"
        )
    within = DriftRange.around(stack.shown[-1], drift * stack.unit)
    if within is None:
        raise PhaseError(
            "the shifts follow the predicted motion, so that the frames do not change: shift the fringes the other "
            "way, or by another part of a fringe",
            code=ErrorCode.INVALID_SEQUENCE,
        )
    fit = _fit_finest(stack, within, settings.noise)
    exposure = exposure_time / stack.unit
    _check_fit(fit, settings, exposure)
    phase, good = _unwrap(stack, fit, settings.minimum_modulation, prediction)
    around = _uniform_around(patterns)
    uniform = _align_frames(np.asarray(frames)[around], times[around] - stack.time, displacement, settings.saturation)
    texture = _texture(_mean_with_even_drift(fit), layout.counts[-1], uniform)
    return _dataset(phase, texture, good, stack, fit, exposure_time / stack.unit)


def _check(
    frames: np.ndarray, times: np.ndarray, patterns: Sequence[ProjectedPattern], displacement: ImageMotion
) -> None:
    check_frames(frames, patterns)
    if len(times) != len(frames) or np.any(np.diff(times) <= 0):
        raise ImageError(f"{len(times)} times for {len(frames)} frames: expected one of each, rising")
    for name in ("velocity", "acceleration"):
        values = getattr(displacement, name)
        if values is not None and values.shape != (2, *frames.shape[1:]):
            raise ImageError(f"{name} of shape {values.shape} for frames of {frames.shape[1:]} pixels")
    if min(frames.shape[1:]) < 2 * CELL:
        raise ImageError(f"frames of {frames.shape[1:]} pixels: a moving surface needs {2 * CELL} along each side")


def _check_layout(layout: Layout) -> None:
    if layout.code or layout.by_beats:
        raise PhaseError(
            "a moving surface needs pitches that become finer by a factor of two or more, without a Gray code",
            code=ErrorCode.INVALID_SEQUENCE,
        )
    if layout.counts[-1] < FEWEST_FRAMES:
        raise PhaseError(
            f"{layout.counts[-1]} frames of the finest pitch: a moving surface needs {FEWEST_FRAMES} or more",
            code=ErrorCode.INVALID_SEQUENCE,
        )


@dataclass(frozen=True)
class _Aligned:
    """Aligned frames of a stack, pitch after pitch.

    Attributes
    ----------
    frames
        Grey levels, float32 (frame, row, column).
    layout
        Their pitches.
    shown
        Times and shifts of each pitch; of the coarser ones about their own middle.
    middles
        Of each pitch [intervals], 0 for the finest.
    gains
        Variance of an aligned grey level over that before, (cell row, cell column, frame).
    time
        Time 0 [s].
    unit
        Mean interval of the frames of the finest pitch [s].
    """

    frames: np.ndarray
    layout: Layout
    shown: list[Shown]
    middles: list[float]
    gains: np.ndarray
    time: float
    unit: float

    @property
    def finest(self) -> np.ndarray:
        """Frames of the finest pitch."""
        return self.frames[self.layout.slices()[-1]]


def _align(
    frames: np.ndarray, times: np.ndarray, layout: Layout, displacement: ImageMotion, saturation: float | None
) -> _Aligned:
    finest = times[layout.slices()[-1]]
    time, unit = float(finest.mean()), float((finest[-1] - finest[0]) / (len(finest) - 1))
    relative = times - time
    aligned = _align_frames(frames, relative, displacement, saturation)
    speed = np.nan_to_num(at_cells(np.ascontiguousarray(displacement.velocity, f4)))
    change = np.zeros_like(speed)
    if displacement.acceleration is not None:
        change = np.nan_to_num(at_cells(np.ascontiguousarray(displacement.acceleration, f4)))
    gains = np.stack([interpolation_gain(speed * t + 0.5 * change * t**2) for t in relative], axis=-1)
    angles = [shift_angles(period) for period in layout.periods]
    middles = [float(relative[where].mean()) / unit for where in layout.slices()]
    shown = [
        Shown(relative[where] / unit - middle, angle)
        for where, middle, angle in zip(layout.slices(), middles, angles, strict=True)
    ]
    return _Aligned(aligned, layout, shown, middles, gains, time, unit)


def _align_frames(
    frames: np.ndarray, relative: np.ndarray, displacement: ImageMotion, saturation: float | None
) -> np.ndarray:
    """Return frames where the material points are at their times relative to time 0 [s]; NaN where saturated."""
    shape = frames.shape[1:]
    velocity = np.ascontiguousarray(displacement.velocity, f4)
    none = np.zeros((2, 0, 0), f4)
    acceleration = none if displacement.acceleration is None else np.ascontiguousarray(displacement.acceleration, f4)
    limit = saturation_level(frames, saturation)
    aligned = np.empty(frames.shape, f4)
    coefficients = np.full((shape[0] + 2 * BORDER, shape[1] + 2 * BORDER), np.nan, f4)
    for frame, moment, out in zip(frames, relative, aligned, strict=True):
        fit_spline(frame.astype(f4), INVERSE, coefficients)
        align_frame(np.ascontiguousarray(frame), coefficients, WEIGHTS, velocity, acceleration, moment, limit, out)
    return aligned


def _uniform_around(patterns: Sequence[ProjectedPattern]) -> list[int]:
    """Return the numbers of the frames of uniform light next to those of the finest pitch; empty without both."""
    finest = moving_frames(patterns)
    if not finest:
        return []
    uniform = [k for k, each in enumerate(patterns) if each.kind in UNIFORM_KINDS]
    return [max(k for k in uniform if k < finest[0]), min(k for k in uniform if k > finest[-1])]


def _texture(mean: np.ndarray, count: int, uniform: np.ndarray) -> np.ndarray:
    """Return the mean of the frames of the finest pitch, weighted by their number, and of uniform light around them.

    All are symmetric about time 0, so that an error of the velocity does not displace the texture. Uniform light is
    brighter than the mean of fringes: it is worth two of their frames or more.

    Parameters
    ----------
    mean
        Of the frames of the finest pitch [grey level].
    count
        Their number.
    uniform
        Aligned frames of uniform light; none or two.
    """
    if not len(uniform):
        return mean
    light = uniform.sum(axis=0)
    known = np.isfinite(light) & (mean > 0)
    if not known.any():
        return mean
    brightness = f4(np.median(light[known] / mean[known]))
    mixed: np.ndarray = np.where(np.isfinite(light), (f4(count) * mean + light) / (f4(count) + brightness), mean)
    return mixed.astype(f4)


@dataclass(frozen=True)
class _Fit:
    """Fit of the finest pitch.

    Attributes
    ----------
    maps
        From `fit_drifting`, with the whole drift [rad/interval] as the fourth.
    condition
        Number of each pixel.
    usable
        Pixels at which the model is close to linear and the condition good.
    cell_drift, curvature, sigma_curvature
        Of the cells [rad/interval, rad/interval^2].
    deviation
        Standard deviation of a grey level at each pixel; it contains the misfit.
    residuals
        None where hardly a pixel is measured.
    misfit
        Variance of the residuals over that of the noise; NaN where the noise is estimated from them.
    accelerated
        Whether an acceleration is fitted.
    """

    maps: np.ndarray
    condition: np.ndarray
    usable: np.ndarray
    cell_drift: np.ndarray
    curvature: np.ndarray
    sigma_curvature: np.ndarray
    deviation: np.ndarray
    residuals: Residuals | None
    misfit: float
    accelerated: bool

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviation of the phase [rad]."""
        return np.asarray(self.deviation * np.sqrt(np.maximum(self.maps[4], 0)) / np.maximum(self.maps[1], f4(1e-6)))


def _cell_samples(frames: np.ndarray) -> np.ndarray:
    """Return four pixels of each cell, (cell row, cell column, 4, frame)."""
    _, rows, columns = frames.shape
    steps = []
    for down in (CELL // 4, 3 * CELL // 4):
        for right in (CELL // 4, 3 * CELL // 4):
            r = np.minimum(np.arange(-(-rows // CELL)) * CELL + down, rows - 1)
            c = np.minimum(np.arange(-(-columns // CELL)) * CELL + right, columns - 1)
            steps.append(frames[:, r[:, None], c])
    return np.moveaxis(np.stack(steps), (0, 1), (2, 3))


def _fit_finest(stack: _Aligned, within: DriftRange, noise: CameraNoise | None) -> _Fit:
    shown, frames = stack.shown[-1], stack.finest
    gain = stack.gains[..., stack.layout.slices()[-1]]
    found = find_drift(_cell_samples(frames), shown, within)
    known = np.isfinite(found)
    cell_drift = np.where(known, found, np.median(found[known]) if known.any() else np.mean(within.drifts))
    curvature = sigma_curvature = np.zeros_like(cell_drift)
    accelerated = False
    shape = frames.shape[1:]
    maps = np.empty((8, *shape), f4)
    reach = float(np.abs(shown.times).max())
    mean_gain = spread(gain.mean(axis=-1), shape)
    for _ in range(3):
        tables = tabulate_cells(shown, cell_drift, curvature, gain, free_drift=True)
        fit_drifting(frames, tables, maps)
        with np.errstate(invalid="ignore"):
            usable = spread(known, shape) & (np.abs(maps[3]) * reach < _LARGEST_REST)
        maps[3] += spread(cell_drift, shape).astype(f4)
        condition = within.condition_at(maps[3]).astype(f4)
        usable &= condition < LARGEST_CONDITION
        deviation, residuals, misfit = _assess(frames, shown, maps, spread(curvature, shape), mean_gain, noise, usable)
        if residuals is None:
            break
        rest = residuals.curvature()
        change, sigma_curvature = rest.at_cells(cell_drift.shape)
        if not rest.significant:
            break
        curvature, accelerated = curvature + change, True
    return _Fit(
        maps,
        condition,
        usable,
        cell_drift,
        curvature,
        sigma_curvature,
        deviation,
        residuals,
        misfit,
        accelerated,
    )


def _assess(
    frames: np.ndarray,
    shown: Shown,
    maps: np.ndarray,
    curvature: np.ndarray,
    gain: np.ndarray,
    noise: CameraNoise | None,
    usable: np.ndarray,
) -> tuple[np.ndarray, Residuals | None, float]:
    """Return the standard deviation of a grey level at each pixel, the residuals and their misfit."""
    camera = noise or CameraNoise(ROUNDING_NOISE)
    texture = np.maximum(np.nan_to_num(maps[0]), 0)
    variance = camera.read**2 + camera.shot * texture
    with np.errstate(invalid="ignore"):
        lit = usable & (maps[1] > CONFIDENCE * np.sqrt(np.maximum(maps[4], 0) * variance))
    course = (maps[3], curvature)
    if noise is not None:
        residuals = residuals_of(frames, shown, maps, course, variance * gain, lit)
        misfit = residuals.misfit() if residuals is not None else np.nan
        sigma: np.ndarray = np.sqrt(variance * max(misfit, 1.0) if misfit == misfit else variance)
        return sigma, residuals, misfit
    residuals = residuals_of(frames, shown, maps, course, np.full(usable.shape, np.nan), lit)
    if residuals is None:
        return np.sqrt(variance), None, np.nan
    estimated = noise_of_residuals(residuals.texture, residuals.unexplained, residuals.freedom)
    return np.sqrt((estimated.read**2 + estimated.shot * texture) / np.median(gain)), residuals, np.nan


def _contrast(fit: _Fit, exposure: float) -> np.ndarray:
    """Return the part of the modulation that the motion leaves during an exposure [intervals]."""
    contrast: np.ndarray = np.sinc(fit.maps[3] * exposure / (2 * np.pi))
    return contrast


def _check_fit(fit: _Fit, settings: PhaseSettings, exposure: float) -> None:
    """Raise `StepError` where the model is not that of the frames."""
    with np.errstate(invalid="ignore"):
        bright = fit.maps[1] > max(settings.minimum_modulation, 2 * CONFIDENCE * float(np.nanmedian(fit.deviation)))
    bad = bright & ~(fit.condition < LARGEST_CONDITION)
    if fit.residuals is None or bad.sum() > 0.5 * max(bright.sum(), 1):
        raise StepError(
            "the shifts follow the motion, so that phase and brightness cannot be told apart: shift the fringes the "
            "other way, or by another part of a fringe",
            code=ErrorCode.INVALID_SEQUENCE,
        )
    residuals = fit.residuals
    if np.isfinite(fit.misfit):
        wrong = fit.misfit > settings.largest_misfit
    else:
        wrong = np.isfinite(settings.largest_misfit) and residuals.relative() > _LARGEST_RELATIVE
    if wrong:
        shares = residuals.frame_shares()
        equal = 1 / residuals.freedom
        if residuals.freedom > 1 and shares.max() > equal + _ONE_FRAME * (1 - equal):
            number = int(shares.argmax())
            raise StepError(
                f"frame {number + 1} of the finest pitch does not show its pattern, or the surface was elsewhere",
                index=number,
                code=ErrorCode.WRONG_PATTERN,
            )
        raise StepError(
            "the surface does not move as the frames are aligned: measure its motion anew, move it more evenly, or "
            "take fewer frames",
            code=ErrorCode.SURFACE_MOVED,
        )
    contrast = float(np.median(_contrast(fit, exposure)[fit.usable])) if exposure else 1.0
    if contrast < _SMALLEST_CONTRAST:
        raise StepError(
            f"the motion blurs the fringes: {100 * contrast:.0f} % of their modulation are left; expose for a shorter "
            "time, move more slowly or project coarser fringes",
            code=ErrorCode.SURFACE_MOVED,
        )


def _unwrap(
    stack: _Aligned, fit: _Fit, minimum_modulation: float, prediction: xr.Dataset | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the absolute phase at time 0, and where it is valid."""
    layout, shape = stack.layout, fit.condition.shape
    deviation, (_, modulation, wrapped, drift, *_) = fit.deviation.astype(f4), fit.maps
    sigma = fit.sigma
    sigma_drift = deviation * np.sqrt(np.maximum(fit.maps[5], 0)) / np.maximum(modulation, f4(1e-6))
    with np.errstate(invalid="ignore"):
        good = fit.usable & (modulation > max(minimum_modulation, 0)) & (CONFIDENCE * sigma < 1)
    phases, variances = [], []
    for pitch, (where, shown, middle) in enumerate(
        zip(layout.slices()[:-1], stack.shown[:-1], stack.middles[:-1], strict=True)
    ):
        ratio = layout.pitches[-1] / layout.pitches[pitch]
        tables = tabulate_cells(
            shown,
            ratio * (fit.cell_drift + fit.curvature * middle),
            ratio * fit.curvature,
            stack.gains[..., where],
            free_drift=False,
        )
        maps = np.empty((4, *shape), f4)
        fit_known_drift(stack.frames[where], tables, maps)
        path = drift * f4(middle) + spread(fit.curvature, shape).astype(f4) * f4(middle**2 / 2)
        own = deviation * np.sqrt(np.maximum(maps[3], 0)) / np.maximum(maps[1], f4(1e-6))
        uncertain = spread(fit.sigma_curvature, shape).astype(f4) * f4(middle**2 / 2)
        phases.append(maps[2] - f4(ratio) * path)
        variances.append(own**2 + f4(ratio**2) * ((sigma_drift * f4(middle)) ** 2 + uncertain**2))
        with np.errstate(invalid="ignore"):
            good &= (maps[1] > max(minimum_modulation, 0)) & (CONFIDENCE * own < 1)
    if phases:
        phases[0] = phases[0] - f4(2 * np.pi) * np.round(phases[0] / f4(2 * np.pi))
    pitches = layout.pitches
    ratios = [1.0, *(coarse / fine for coarse, fine in pairwise(pitches))]
    phases.append(wrapped)
    variances.append(sigma**2)
    phase = np.empty(shape, f4)
    _check_coarse_pitches(phases, variances, ratios, good)
    find_orders(np.stack(phases), np.stack(variances), np.array(ratios), good, phase)
    if prediction is not None:
        phase = _follow(phase, sigma, good, prediction, absolute=len(pitches) > 1)
    return phase, good


def _check_coarse_pitches(
    phases: Sequence[np.ndarray], variances: Sequence[np.ndarray], ratios: Sequence[float], good: np.ndarray
) -> None:
    """Raise `StepError` where the finest pitch is not that of the coarser ones, on pixels of a lattice.

    Beyond the motion that its shifts follow, a wave has the same frames as one that runs the other way.
    """
    if len(phases) < 2:
        return
    lattice = (slice(None, None, _LATTICE), slice(None, None, _LATTICE))
    coarser, known = np.empty(good[lattice].shape, f4), good[lattice].copy()
    levels = range(len(phases) - 1)
    find_orders(
        np.stack([phases[k][lattice] for k in levels]),
        np.stack([variances[k][lattice] for k in levels]),
        np.array(ratios[:-1]),
        known,
        coarser,
    )
    finer = ratios[-1]
    turns = (coarser * f4(finer) - phases[-1][lattice]) / f4(2 * np.pi)
    doubt = CONFIDENCE * np.sqrt(finer**2 * variances[-2][lattice] + variances[-1][lattice])
    with np.errstate(invalid="ignore"):
        known &= doubt < np.pi / 2
    away = np.abs(turns - np.round(turns))[known] > _AWAY
    if away.size >= _FEWEST_POINTS and away.mean() > _CONTRADICTED:
        raise StepError(
            f"the coarser fringes contradict the finest ones on {100 * away.mean():.0f} % of the surface: it moves the "
            "other way than the shifts are for (sequence.motion_fringes), or faster than they follow",
            code=ErrorCode.SURFACE_MOVED,
        )


def _mean_with_even_drift(fit: _Fit) -> np.ndarray:
    """Return the mean of the finest pitch for the drift that neighbours share: it is less noisy than their own."""
    around = (_NEIGHBOURS, _NEIGHBOURS)
    drift = np.where(fit.usable, fit.maps[3], f4(0))
    shared = cv2.blur(drift, around) / np.maximum(cv2.blur(fit.usable.astype(f4), around), 1e-3)
    mean: np.ndarray = np.where(fit.usable, fit.maps[0] + fit.maps[7] * (shared - fit.maps[3]), fit.maps[0])
    return mean.astype(f4)


def _follow(
    phase: np.ndarray, sigma: np.ndarray, good: np.ndarray, prediction: xr.Dataset, *, absolute: bool
) -> np.ndarray:
    """Return the phase of the order next to the predicted one; mark in `good` where it is certain."""
    expected, doubt = (prediction[name].values.astype(f4) for name in ("phase", "sigma"))
    if expected.shape != phase.shape:
        raise ImageError(f"a prediction of {expected.shape} pixels for frames of {phase.shape}")
    turn = f4(2 * np.pi)
    orders = np.round((expected - phase) / turn)
    near: np.ndarray = phase + turn * orders
    with np.errstate(invalid="ignore"):
        good &= np.abs(near - expected) + f4(CONFIDENCE) * np.hypot(doubt, sigma) < np.pi
        if absolute:
            good &= orders == 0
    return near


def _dataset(
    phase: np.ndarray, texture: np.ndarray, good: np.ndarray, stack: _Aligned, fit: _Fit, exposure: float
) -> xr.Dataset:
    image = ("row", "column")
    per_modulation = fit.deviation / np.maximum(fit.maps[1], 1e-6)
    rate = 1 / stack.unit

    def measured(values: np.ndarray, units: str, name: str) -> tuple[tuple[str, str], np.ndarray, dict[str, str]]:
        return image, np.where(good, values, np.nan).astype(f4), {"units": units, "long_name": name}

    contrast = float(np.median(_contrast(fit, exposure)[fit.usable])) if exposure else 1.0
    return xr.Dataset(
        {
            "phase": measured(phase, "rad", "phase of the fringes"),
            "sigma": measured(fit.sigma, "rad", "standard deviation of the phase"),
            "drift": measured(fit.maps[3] * rate, "rad/s", "drift of the phase of a material point"),
            "sigma_drift": measured(
                np.sqrt(np.maximum(fit.maps[5], 0)) * per_modulation * rate, "rad/s", "standard deviation of the drift"
            ),
            "covariance": measured(
                fit.maps[6] * per_modulation**2 * rate, "rad2/s", "covariance of the errors of phase and drift"
            ),
            "condition": (image, fit.condition, {"long_name": "condition number of the fit"}),
            "modulation": (
                image,
                fit.maps[1].copy(),
                {"units": "grey level", "long_name": "modulation of the finest fringes"},
            ),
            "texture": (image, texture, {"units": "grey level", "long_name": "surface without fringes, at time 0"}),
            "valid": (image, good, {"long_name": "where the phase is measured"}),
        },
        coords=pixels(good.shape),
        attrs={
            "time": stack.time,
            "misfit": fit.misfit,
            "accelerated": int(fit.accelerated),
            "contrast": contrast,
        },
    )
