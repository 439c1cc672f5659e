"""Measures the phase from fringe images of any program, as a description says what they show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from pathlib import Path

import numpy as np
import xarray as xr

from fringedic.configuration.fringe_images import FringeImageDescription, GrayCodeImages
from fringedic.errors import ErrorCode, FringedicError, PhaseError, StepError
from fringedic.frames.files import read_alike, require_size
from fringedic.frames.noise import CameraNoise, saturation_level
from fringedic.images.wave_orders import TURN, Wave, WaveOrders, solve_orders
from fringedic.patterns.pattern import Orientation, ProjectedPattern
from fringedic.phase.checks.flicker_and_motion import LIGHT
from fringedic.phase.checks.gains import Gains
from fringedic.phase.checks.sample_noise import estimate_sample_noise
from fringedic.phase.checks.sampling import Sample, half_periods
from fringedic.phase.checks.stack import find_gains, inspect_stack
from fringedic.phase.demodulation import absolute_phase
from fringedic.phase.demodulation_kernel import add_gain_variance
from fringedic.phase.findings import Finding, FindingKind
from fringedic.phase.harmonic_correction import HarmonicError
from fringedic.phase.layout import layout_of, shift_angles
from fringedic.phase.sentences import describe
from fringedic.phase.settings import PhaseSettings
from fringedic.phase.sinusoids import fit_wave

_BLOCK_EDGE = 0.05  # of a block: blur of its edges and noise change the number of the block
_LINES = 64  # jumps of the numbers of blocks are counted in so many lines of the image
_JUMPS = 0.5  # per line: a step of the surface gives one or two on some lines, interchanged bits on all
_CONTRAST = 5.0  # bright and dark of a clear bit differ by so many standard deviations
_NO_PATTERN = (ErrorCode.FLICKER, ErrorCode.SATURATED, ErrorCode.DARK)  # no other patterns explain these faults
_OTHER_LISTS: dict[str, Callable[[list[ProjectedPattern]], list[ProjectedPattern]]] = {
    "reversed": lambda listed: listed[::-1],
    "begun with the last one": lambda listed: [*listed[-1:], *listed[:-1]],
    "reversed but for the last one": lambda listed: [*listed[-2::-1], listed[-1]],
}


def measure_phase_images(folder: Path, description: FringeImageDescription) -> xr.Dataset:
    """Measure the phase from the images of a folder.

    The frames are checked as those of a step. Where flickering light makes frames brighter or darker, their gains are
    fitted; sigma contains their uncertainty. Every pitch is demodulated (eq. 11). The order of the coarsest fringes is
    known where one of them covers the projector's image, or from the Gray code; where its blocks are too wide for the
    coarsest fringes, the beat of the two coarsest pitches is the coarsest wave (heterodyne). Otherwise the phase is
    unwrapped over the image and relative.

    The harmonics of a nonlinear response are fitted to the difference of the phases of a coarse pitch and the next
    finer one, and the orders are freed of them. Points whose order the noise, or what is left, makes uncertain are left
    out: normal errors give a wrong order at fewer than 6e-7 of the points.

    Parameters
    ----------
    folder
        Where the images are.
    description
        What they show.

    Returns
    -------
    Dataset
        ``phase`` [rad at the finest pitch], zero at the origin of the description, and ``sigma`` [rad];
        ``coordinate``, the column or row of the projector [projector px]; ``modulation``, ``texture`` [grey level];
        ``valid``; from two pitches on ``closure``, the phase of the next coarser pitch minus that of the finest one
        [rad at the coarser pitch] in units of its standard deviation; with a Gray code ``other_block``, where the code
        gives another block than the fringes, more than 5 % of a block away from its edges; ``gain`` of each frame (its
        image) with ``gain_sigma``, 1 and 0 without flicker. The phase has the attribute ``relative``; attributes of the
        dataset are ``direction``, ``pitch_px`` of the finest fringes, their ``harmonic_error`` [fringe] before a
        correction, ``harmonics_corrected``, the range of the light over the frames of a pitch ``light_change``, the RMS
        error of the phase [fringe] by uncertain gains ``light_error``, and ``uncertain_orders``, the part of the points
        measured at all pitches that is left out.

    Raises
    ------
    ImageError
        An image is missing or has another size.
    StepError
        The images are faulty or not as described; the message names the image.
    PhaseError
        The pitches give no phase, or leave the orders of most points uncertain.

    References
    ----------
    C. Reich, R. Ritter, J. Thesing, "White light heterodyne principle for 3D-measurement", Proc. SPIE 3100 (1997)
    236-244.
    """
    entries = sorted(description.fringes, key=lambda each: -each.pitch_px)
    names = [name for each in entries for name in each.images]
    patterns = [each for entry in entries for each in entry.patterns(description.orientation)]
    stack = _Stack(np.array(read_alike([folder / name for name in names])), patterns, folder, description)
    gains = stack.find_gains()
    fault = stack.find_fault(gains)
    if fault is None:
        try:
            solution = _solve(stack, gains)
        except PhaseError as error:
            listed = _list_that_fits(stack)
            if not listed:
                raise
            raise StepError(listed, code=ErrorCode.WRONG_PATTERN) from error
    else:
        foreign = fault.kind.code in _NO_PATTERN
        explained = None if foreign else _explained(stack, gains)
        if explained is None:
            listed = "" if foreign else _list_that_fits(stack)
            # two frames interchanged may look like a list that runs backwards; other faults do not
            if listed and fault.kind is not FindingKind.INTERCHANGED:
                raise StepError(listed, code=ErrorCode.WRONG_PATTERN)
            images = ", ".join(names[frame] for frame in fault.frames[:2]) or "the images"
            raise StepError(f"{images}: {describe(fault)}{f'; {listed}' if listed else ''}", code=fault.kind.code)
        solution = explained
    waves, measured, blocks, orders = solution.waves, solution.measured, solution.blocks, solution.orders
    absolute, sigma, finest = orders.phase, orders.sigma, waves[-1]
    origin = TURN * description.origin / finest.period
    image = ("row", "column")
    valid = np.isfinite(absolute.values)
    coordinate = absolute.values * finest.period / TURN
    result = measured[["modulation", "texture"]].assign(
        phase=(image, (absolute.values - origin).astype(np.float32), {"units": "rad", **absolute.attrs}),
        sigma=(image, np.where(valid, sigma, np.nan).astype(np.float32), {"units": "rad"}),
        coordinate=(image, coordinate.astype(np.float32), {"units": "projector px"}),
        valid=(image, valid),
    )
    if len(waves) > 1:
        coarse = waves[-2].corrected(orders.harmonics[-2]) if description.correct_harmonics else waves[-2]
        ratio = finest.period / coarse.period
        away = coarse.phase - absolute.values * ratio
        away -= TURN * np.round(away / TURN)
        # a weighted mean contains the coarse phase; that of the finest fringes alone does not
        variance = coarse.sigma**2 + (-1 if orders.by_beats else 1) * (ratio * sigma) ** 2
        result["closure"] = (image, (away / np.sqrt(variance)).astype(np.float32))
    if blocks is not None and description.gray_code is not None:
        inside = valid & np.isfinite(blocks)
        place = coordinate / description.gray_code.block_px
        clear = np.abs(place - np.round(place)) > _BLOCK_EDGE
        result["other_block"] = (image, inside & clear & (np.floor(place) != blocks))
    deviation = np.sqrt(np.concatenate([np.diagonal(each) for each in gains.covariance]))
    result = result.assign(gain=("frame", gains.values), gain_sigma=("frame", deviation)).assign_coords(frame=names)
    result.attrs = {
        "direction": description.direction,
        "pitch_px": finest.period,
        "harmonic_error": orders.harmonics[-1].rms,
        "harmonics_corrected": int(description.correct_harmonics),
        "light_change": gains.finding.light_change if gains.finding else 0.0,
        "light_error": gains.finding.value if gains.finding else 0.0,
        "uncertain_orders": orders.uncertain,
    }
    return result


@dataclass(frozen=True)
class _Stack:
    """Fringe images with the patterns that they show, or may show."""

    frames: np.ndarray
    patterns: list[ProjectedPattern]
    folder: Path
    description: FringeImageDescription

    @property
    def settings(self) -> PhaseSettings:
        """Of the checks."""
        chosen = self.description
        return PhaseSettings(saturation=chosen.saturation, largest_error=chosen.maximum_error_fringe)

    def find_gains(self) -> Gains:
        return find_gains(self.frames, self.patterns, self.settings)

    def find_fault(self, gains: Gains) -> Finding | None:
        """Return the fault that the gains leave; by the name that it has without them unless that is the light."""

        def inspect(values: np.ndarray | None) -> Finding | None:
            found = inspect_stack(self.frames, self.patterns, self.settings, gains=values)
            return next((each for each in found if each.fault), None)

        left = inspect(gains.values)
        if left is not None and gains.covers_flicker:  # of four frames, gains explain a part of other faults, too
            plain = inspect(None)
            left = left if plain is None or plain.kind in LIGHT else plain
        undetermined = gains.finding is not None and gains.finding.fault
        return gains.finding if undetermined and (left is None or left.kind in LIGHT) else left

    def without_harmonics(self, errors: list[HarmonicError]) -> _Stack:
        """Return the images without the harmonics of the response that change the phase of each pitch."""
        frames = self.frames.astype(np.float32)
        level = int(saturation_level(self.frames, self.settings.saturation))
        for where, error in zip(layout_of(self.patterns).slices(), errors, strict=True):
            if not error.ratio or np.isnan(error.ratio):
                continue
            angles = shift_angles(self.patterns[where])
            _, cosine, sine = fit_wave(frames[where].reshape(len(angles), -1), angles)
            phase = error.correct(np.arctan2(sine, cosine))
            strength = np.hypot(cosine, sine) / np.abs(1 + error.ratio * np.exp(-1j * error.shifts * phase))
            for frame, angle in zip(frames[where], angles, strict=True):
                harmonic = error.ratio * strength * np.cos((error.shifts - 1) * (phase - angle))
                frame -= np.where(frame < level, harmonic.reshape(frame.shape), 0).astype(np.float32)
        return replace(self, frames=frames, description=self.description.model_copy(update={"saturation": level}))


@dataclass(frozen=True)
class _Solution:
    """Phases of all pitches, maps of the finest one, blocks of the Gray code, and the orders."""

    waves: list[Wave]
    measured: xr.Dataset
    blocks: np.ndarray | None
    orders: WaveOrders

    def grows(self, orientation: Orientation) -> bool:
        """Whether the phase grows to the right or downwards in the image."""
        across = 1 if orientation == Orientation.VERTICAL else 0
        return float(np.nanmedian(np.diff(self.orders.phase.values, axis=across))) > 0


def _solve(stack: _Stack, gains: Gains) -> _Solution:
    """Demodulate all pitches and solve their orders."""
    description, layout = stack.description, layout_of(stack.patterns)
    noise = estimate_sample_noise(Sample.from_stack(stack.frames, layout).with_light(gains.values))
    waves, maps = [], []
    for where, covariance in zip(layout.slices(), gains.covariance, strict=True):
        patterns = stack.patterns[where]
        light = (gains.values[where], covariance)
        measured = _measure_pitch(stack.frames[where], patterns, noise, description, light)
        maps.append(measured)
        pitch, shifts = patterns[0].pitch, patterns[0].shifts
        origin = TURN * description.origin / pitch
        waves.append(Wave(pitch, measured.phase.values + origin, measured.sigma.values, shifts, origin))
    blocks = None
    if description.gray_code is not None:
        code = [stack.folder / name for name in description.gray_code.images]
        bits = read_alike(code)
        fringes = max(description.fringes, key=lambda each: each.pitch_px).images[0]
        require_size(code[0], bits[0], stack.folder / fringes, stack.frames.shape[1:])
        blocks = _blocks(
            np.array(bits, np.float32), description.gray_code, noise, stack.frames, description.orientation
        )
    return _Solution(waves, maps[-1], blocks, solve_orders(waves, blocks, description))


def _explained(stack: _Stack, gains: Gains) -> _Solution | None:
    """Return the solution of images without a fault beside the harmonics of the response; None for others."""
    try:
        solution = _solve(stack, gains)
    except FringedicError:
        return None
    if stack.find_fault(gains) is None:
        return solution
    if solution.orders.phase.attrs["relative"]:
        return None
    linear = stack.without_harmonics(solution.orders.harmonics)
    return solution if linear.find_fault(linear.find_gains()) is None else None


def _list_that_fits(stack: _Stack) -> str:
    """Return with which lists of shifts the images fit, empty for none.

    Lists that run backwards and lists that begin with the last shift are tried, of all pitches and of each. Of several
    that fit, one is taken with which the phase grows to the right or downwards in the image.
    """
    slices = layout_of(stack.patterns).slices()
    several = ([slices] if len(slices) > 1 else []) + [[each] for each in slices]
    best = ""
    for chosen, (words, turn) in product(several, _OTHER_LISTS.items()):
        patterns = list(stack.patterns)
        for where in chosen:
            patterns[where] = turn(patterns[where])
        other = replace(stack, patterns=patterns)
        solution = _explained(other, other.find_gains())
        if solution is None:
            continue
        pitches = " and ".join(f"{patterns[where.start].pitch:g}" for where in chosen)
        shifts = " and ".join(dict.fromkeys(str([each.shift for each in patterns[where]]) for where in chosen))
        found = f"the images fit with the list of shifts of pitch {pitches} px {words}: shifts {shifts}"
        if solution.grows(stack.description.orientation):
            return found
        best = best or found
    return best


def _measure_pitch(
    frames: np.ndarray,
    patterns: list[ProjectedPattern],
    noise: CameraNoise,
    description: FringeImageDescription,
    light: tuple[np.ndarray, np.ndarray],
) -> xr.Dataset:
    """Return phase, sigma, modulation and texture of one pitch; `light`: gains of its frames and their covariance."""
    gains, covariance = light
    measured = absolute_phase(
        frames,
        patterns,
        noise=noise,
        saturation=description.saturation,
        minimum_modulation=description.minimum_modulation,
        gains=gains,
    )
    if covariance.any():
        phase, modulation, texture = (measured[name].values for name in ("phase", "modulation", "texture"))
        add_gain_variance(phase, modulation, texture, shift_angles(patterns), covariance, measured.sigma.values)
    return measured


def _blocks(
    images: np.ndarray, code: GrayCodeImages, noise: CameraNoise, fringes: np.ndarray, orientation: Orientation
) -> np.ndarray:
    """Return the number of the block at each pixel, NaN where a bit is neither dark nor bright."""
    other = images[1::2] if code.inverted else fringes.astype(np.float32).mean(axis=0)[None]
    away = (images[::2] if code.inverted else images) - other
    level = np.maximum(0.5 * (images[::2] + other if code.inverted else images + other), 0)
    certain = (np.abs(away) > _CONTRAST * np.sqrt(2 * noise.variance(level))).all(axis=0)
    _check_bits(away > 0, certain, code, orientation)
    numbers = half_periods((away > 0).reshape(len(away), -1)).reshape(away.shape[1:])
    return np.where(certain, numbers, np.nan)


def _check_bits(bits: np.ndarray, certain: np.ndarray, code: GrayCodeImages, orientation: Orientation) -> None:
    """Raise `StepError` when the numbers of neighbours jump, and jump less with two of the bits interchanged."""
    axes = (0, 1, 2) if orientation == Orientation.VERTICAL else (0, 2, 1)
    skip = max(1, bits.shape[axes[1]] // _LINES)
    lines, known = bits.transpose(axes)[:, ::skip], certain.transpose([each - 1 for each in axes[1:]])[::skip]

    def jumps(order: Sequence[int]) -> int:
        numbers = half_periods(lines[list(order)].reshape(len(bits), -1)).reshape(known.shape)
        both = known[:, 1:] & known[:, :-1]
        return int(np.sum(both & (np.abs(np.diff(numbers, axis=1)) > 1)))

    recorded = list(range(len(bits)))
    found = jumps(recorded)
    if found <= _JUMPS * len(known):
        return
    for first, second in combinations(recorded, 2):
        order = list(recorded)
        order[first], order[second] = second, first
        if jumps(order) < 0.5 * found:
            step = 2 if code.inverted else 1
            raise StepError(
                f"{code.images[step * first]} and {code.images[step * second]} of the Gray code are interchanged: its "
                "blocks follow each other when they are exchanged",
                code=ErrorCode.FRAMES_OUT_OF_ORDER,
            )
