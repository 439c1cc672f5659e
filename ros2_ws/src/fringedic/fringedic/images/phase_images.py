"""Measures the phase from fringe images of any program, as a description says what they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import xarray as xr

from fringedic.configuration.fringe_images import FringeImageDescription, GrayCodeImages
from fringedic.errors import ErrorCode, PhaseError, StepError
from fringedic.frames.files import read_alike, require_size
from fringedic.frames.noise import CameraNoise
from fringedic.patterns.pattern import Orientation, ProjectedPattern
from fringedic.phase.beats import combine_beats
from fringedic.phase.checks.flicker_and_motion import LIGHT
from fringedic.phase.checks.gains import Gains
from fringedic.phase.checks.sample_noise import estimate_sample_noise
from fringedic.phase.checks.sampling import Sample, half_periods
from fringedic.phase.checks.stack import find_gains, inspect_stack
from fringedic.phase.demodulation import absolute_phase
from fringedic.phase.demodulation_kernel import add_gain_variance
from fringedic.phase.findings import Finding
from fringedic.phase.fringe_order import assign_orders, unwrap_spatial
from fringedic.phase.harmonic_correction import fit_harmonic_error
from fringedic.phase.layout import layout_of, nearly_alike, shift_angles, unambiguous_range
from fringedic.phase.sentences import describe
from fringedic.phase.settings import PhaseSettings

TURN = 2 * np.pi
_LARGEST_BLOCK = 0.75  # of a period: the middle of a block is then known to 3/8 of a period, less than half
_LARGEST_OFFSET = 0.25  # of a period, between fringes and Gray code
_LEAST_AGREEMENT = 0.7  # length of the mean of exp(i difference) of fringes and Gray code, over that of perfect ones
_BLOCK_EDGE = 0.05  # of a block: blur of its edges and noise change the number of the block
_LINES = 64  # jumps of the numbers of blocks are counted in so many lines of the image
_JUMPS = 0.5  # per line: a step of the surface gives one or two on some lines, interchanged bits on all
_CONTRAST = 5.0  # bright and dark of a clear bit differ by so many standard deviations


@dataclass(frozen=True)
class _Wave:
    """Wrapped phase of one period [rad], zero at column or row 0, and its standard deviation."""

    period: float
    phase: np.ndarray
    sigma: np.ndarray


def measure_phase_images(folder: Path, description: FringeImageDescription) -> xr.Dataset:
    """Measure the phase from the images of a folder.

    The frames are checked as those of a step. Where flickering light makes frames brighter or darker, their gains are
    fitted; sigma contains their uncertainty. Every pitch is demodulated (eq. 11). The order of the coarsest fringes is
    known where one of them covers the projector's image, or from the Gray code; where its blocks are too wide for the
    coarsest fringes, the beat of the two coarsest pitches is the coarsest wave (heterodyne). Otherwise the phase is
    unwrapped over the image and relative.

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
        correction, ``harmonics_corrected``, the range of the light over the frames of a pitch ``light_change``, and the
        RMS error of the phase [fringe] by uncertain gains ``light_error``.

    Raises
    ------
    ImageError
        An image is missing or has another size.
    StepError
        The images are faulty or not as described; the message names the image.
    PhaseError
        The pitches give no phase.

    References
    ----------
    C. Reich, R. Ritter, J. Thesing, "White light heterodyne principle for 3D-measurement", Proc. SPIE 3100 (1997)
    236-244.
    """
    entries = sorted(description.fringes, key=lambda each: -each.pitch_px)
    names = [name for each in entries for name in each.images]
    frames = np.array(read_alike([folder / name for name in names]))
    patterns = [each for entry in entries for each in entry.patterns(description.orientation)]
    settings = PhaseSettings(saturation=description.saturation, largest_error=description.maximum_error_fringe)
    gains = find_gains(frames, patterns, settings)
    fault = _find_fault(frames, patterns, settings, gains)
    if fault is not None:
        images = ", ".join(names[frame] for frame in fault.frames[:2]) or "the images"
        turned = _turned_pitches(frames, patterns, settings)
        advice = f"; they fit with the list of shifts of pitch {turned} px reversed" if turned else ""
        raise StepError(f"{images}: {describe(fault)}{advice}", code=fault.kind.code)
    layout = layout_of(patterns)
    noise = estimate_sample_noise(Sample.from_stack(frames, layout).with_light(gains.values))
    waves, maps = [], []
    for entry, where, covariance in zip(entries, layout.slices(), gains.covariance, strict=True):
        measured = _measure_pitch(frames[where], patterns[where], noise, description, (gains.values[where], covariance))
        maps.append(measured)
        origin = TURN * description.origin / entry.pitch_px
        waves.append(_Wave(entry.pitch_px, measured.phase.values + origin, measured.sigma.values))
    blocks = None
    if description.gray_code is not None:
        code = [folder / name for name in description.gray_code.images]
        bits = read_alike(code)
        require_size(code[0], bits[0], folder / names[0], frames.shape[1:])
        blocks = _blocks(np.array(bits, np.float32), description.gray_code, noise, frames, description.orientation)
    finest, measured = waves[-1], maps[-1]
    pitches = [wave.period for wave in waves]
    by_beats = blocks is None and nearly_alike(pitches) and unambiguous_range(pitches) >= description.projector_px
    if by_beats:
        absolute, sigma = _from_beats(waves, description)
    else:
        absolute, sigma = _absolute(waves, blocks, description), finest.sigma
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
        coarse = waves[-2]
        ratio = finest.period / coarse.period
        away = coarse.phase - absolute.values * ratio
        away -= TURN * np.round(away / TURN)
        # a weighted mean contains the coarse phase; that of the finest fringes alone does not
        variance = coarse.sigma**2 + (-1 if by_beats else 1) * (ratio * sigma) ** 2
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
        "harmonic_error": measured.phase.attrs["harmonic_error"],
        "harmonics_corrected": int(description.correct_harmonics),
        "light_change": gains.finding.light_change if gains.finding else 0.0,
        "light_error": gains.finding.value if gains.finding else 0.0,
    }
    return result


def _find_fault(
    frames: np.ndarray, patterns: list[ProjectedPattern], settings: PhaseSettings, gains: Gains
) -> Finding | None:
    """Return the fault that the fitted gains leave; by the name that it has without them unless that is the light."""

    def inspect(values: np.ndarray | None) -> Finding | None:
        return next((each for each in inspect_stack(frames, patterns, settings, gains=values) if each.fault), None)

    left = inspect(gains.values)
    if left is not None and gains.covers_flicker:  # of four frames, gains explain a part of other faults, too
        plain = inspect(None)
        left = left if plain is None or plain.kind in LIGHT else plain
    undetermined = gains.finding is not None and gains.finding.fault
    return gains.finding if undetermined and (left is None or left.kind in LIGHT) else left


def _turned_pitches(frames: np.ndarray, patterns: list[ProjectedPattern], settings: PhaseSettings) -> str:
    """Return the pitches [projector px] whose shifts run the other way, empty where this explains no fault."""
    slices = layout_of(patterns).slices()
    for chosen in [*([each] for each in slices), slices]:
        turned = list(patterns)
        for where in chosen:
            turned[where] = patterns[where][::-1]
        gains = find_gains(frames, turned, settings)
        if not any(each.fault for each in inspect_stack(frames, turned, settings, gains=gains.values)):
            return " and ".join(f"{patterns[where.start].pitch:g}" for where in chosen)
    return ""


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
    error = fit_harmonic_error(measured.phase, len(patterns), description.orientation)
    if description.correct_harmonics:
        measured["phase"] = measured.phase.copy(data=error.correct(measured.phase.values))
    measured.phase.attrs["harmonic_error"] = error.rms
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


def _absolute(waves: list[_Wave], blocks: np.ndarray | None, description: FringeImageDescription) -> xr.DataArray:
    """Return the absolute phase of the finest wave [rad], zero at column or row 0, or one that is relative."""
    levels = list(waves)
    block = description.gray_code.block_px if description.gray_code is not None else description.projector_px
    reach = block / _LARGEST_BLOCK if blocks is not None else float(description.projector_px)
    if levels[0].period < reach and len(levels) > 1:
        levels.insert(0, _beat(*levels[:2]))
    coarsest = levels[0]
    if coarsest.period < reach:
        if blocks is not None:
            raise PhaseError(
                f"blocks of {block:g} px do not determine the order of fringes of {coarsest.period:g} px: show fringes "
                f"of {reach:g} px or more, or a second pitch whose beat is that long",
                code=ErrorCode.INVALID_SEQUENCE,
            )
        return unwrap_spatial(waves[-1].phase)
    middle = np.asarray(0.5 if blocks is None else blocks + 0.5) * block - 0.5
    if blocks is not None:
        code = TURN * middle / coarsest.period
        # the code is that of the middle of each block
        least = _LEAST_AGREEMENT * float(np.sinc(block / coarsest.period))
        for sign in (1, -1):
            away = np.exp(1j * (sign * coarsest.phase - code))
            mean = complex(np.mean(away[np.isfinite(away)]))
            if abs(mean) > least:
                break
        else:
            raise StepError(
                "fringes and Gray code do not belong together: check pitches, shifts and width of the blocks",
                code=ErrorCode.WRONG_PATTERN,
            )
        if sign < 0:
            raise StepError(
                "the fringes grow against the Gray code: reverse the lists of shifts", code=ErrorCode.WRONG_PATTERN
            )
        offset = float(np.angle(mean)) / TURN
        if abs(offset) > _LARGEST_OFFSET:
            origin = description.origin - offset * coarsest.period
            raise StepError(
                f"the fringes are displaced by {offset * coarsest.period:.0f} px against the Gray code: origin_px "
                f"{origin:.0f} would fit",
                code=ErrorCode.WRONG_PATTERN,
            )
    phase = assign_orders(coarsest.phase, np.broadcast_to(TURN * middle / coarsest.period, coarsest.phase.shape))
    for coarse, fine in pairwise(levels):
        phase = assign_orders(fine.phase, phase.values * coarse.period / fine.period)
    return phase


def _from_beats(waves: list[_Wave], description: FringeImageDescription) -> tuple[xr.DataArray, np.ndarray]:
    """Return the absolute phase of the finest wave from all waves [rad], zero at column or row 0, and its deviation."""
    middle = 0.5 * (description.projector_px - 1)
    turned = [np.asarray(wave.phase) - TURN * middle / wave.period for wave in waves]
    wrapped = np.array([each - TURN * np.round(each / TURN) for each in turned], np.float32)
    sigmas = np.array([wave.sigma for wave in waves], np.float32)
    phase, sigma = combine_beats(wrapped, sigmas, [wave.period for wave in waves], known_noise=True)
    absolute = xr.DataArray(phase + TURN * middle / waves[-1].period, dims=("row", "column"), attrs={"relative": 0})
    return absolute, sigma


def _beat(coarse: _Wave, fine: _Wave) -> _Wave:
    """Return the difference of two waves, whose period is longer than both (heterodyne)."""
    period = 1 / (1 / fine.period - 1 / coarse.period)
    return _Wave(period, fine.phase - coarse.phase, np.hypot(fine.sigma, coarse.sigma))
