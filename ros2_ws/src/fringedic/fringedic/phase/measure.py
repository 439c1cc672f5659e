"""Measures the phase of a step by phase stepping or from one image, after a check of its frames."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import xarray as xr

from fringedic.errors import ErrorCode, PhaseError, StepError
from fringedic.frames.exposures import ExposedStack, fill_saturated, merge_stacks, split_exposures
from fringedic.frames.noise import ROUNDING_NOISE, CameraNoise
from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic.phase.checks.stack import inspect_stack, step_error
from fringedic.phase.demodulation import absolute_phase
from fringedic.phase.findings import Finding, FindingKind
from fringedic.phase.fringe_order import unwrap_spatial
from fringedic.phase.harmonic_correction import fit_harmonic_error
from fringedic.phase.layout import layout_of, shift_angles
from fringedic.phase.lens_blur import correct_lens_blur
from fringedic.phase.noise import noise_of_exposures
from fringedic.phase.one_image import one_image_phase
from fringedic.phase.settings import DEFAULT_SETTINGS, PhaseSettings

# Part of the lines across the fringes in which the phase jumps by a turn. One fringe that covers the view makes no jump
# but at a few lines with noise or edges; fringes that repeat jump on every line.
_AMBIGUOUS_LINES = 0.05
_LINES = 240  # are looked at: 12 of them are enough
# Part of a coarsest fringe by which the absolute phase jumps where this fringe repeats; a step of the surface shifts
# the fringes by less, because the coarsest one covers the view.
_REPETITION = 0.75
_LIT = 0.3  # of the strongest modulation
_AGREEING = 0.5  # part of what is lit; phases that have nothing to do with each other agree at a few percent


def measure_phase(
    frames: np.ndarray,
    patterns: Sequence[ProjectedPattern],
    settings: PhaseSettings = DEFAULT_SETTINGS,
    *,
    exposure_times: Sequence[float] | None = None,
) -> tuple[xr.Dataset, list[Finding]]:
    """Check the frames of a step for faults and measure its phase.

    Parameters
    ----------
    frames
        Grey levels, uint8, uint16 or float32, shape (frame, row, column).
    patterns
        Pattern of each frame: see `absolute_phase`; or one fringe image, with uniform grey for its texture.
    settings
        Noise, limits, and the choice of method.
    exposure_times
        Of each frame [s]; several exposures of each pattern are merged, see `merge_exposures`. None for equal times.

    Returns
    -------
    result : Dataset
        As of `absolute_phase`, the phase with the attributes ``relative`` (0 or 1) and, from whole cycles of shifts,
        ``harmonic_error``: the RMS error by the harmonics of the response [fringe], NaN where it is not known. Sigma
        does not contain it.
    remarks : list of Finding
        What needs attention although the phase is measured; `describe` puts it into words.

    Raises
    ------
    PhaseError
        The frames give no phase, or a relative one only, which `settings` does not accept.
    ImageError
        Frames, patterns and exposure times do not belong together.
    StepError
        The frames are faulty, see `check_stack`.

    Examples
    --------
    >>> from fringedic.patterns import fringe_sequence
    >>> from fringedic.virtual_rig import VirtualRig
    >>> rig = VirtualRig.from_preset("plate", size="tiny")
    >>> rows, columns = rig.projector_shape
    >>> sequence = fringe_sequence(columns, rows, [columns, 40, 10], shifts=4)
    >>> frames = np.array([rig.expose(image, 0.0, index) for index, image in enumerate(sequence)])
    >>> result, remarks = measure_phase(frames, sequence.patterns)
    >>> truth = 2 * np.pi * (rig.truth(0.0).projector_column - (columns - 1) / 2) / 10
    >>> bool(abs(result.phase - truth).max() < 0.5), remarks
    (True, [])
    """
    exposures = split_exposures(frames, patterns, exposure_times)
    kinds = [each.kind for each in exposures[0].patterns]
    if settings.method == "one_image" or (settings.method == "auto" and kinds.count(PatternKind.FRINGES) == 1):
        if not settings.accept_relative:
            raise PhaseError(
                "one fringe image gives a phase up to whole fringes only: accept a relative phase, or show whole "
                "cycles of shifts at several pitches",
                code=ErrorCode.INVALID_SEQUENCE,
            )
        result, remarks = _from_one_image(exposures, settings)
    else:
        exposures = [each.without_grey() for each in exposures]
        with ThreadPoolExecutor(1) as beside:  # the kernel of the phase leaves this thread to the checks
            phase = beside.submit(_from_steps, exposures, settings)
            remarks = _check(exposures, settings)
            result = phase.result()
        remarks += _settle_orders(result, exposures[0], settings.accept_relative)
        pattern = exposures[0].patterns[-1]
        error = fit_harmonic_error(result.phase, pattern.shifts, pattern.orientation)
        if settings.correct_harmonics:
            result.phase.values[...] = error.correct(result.phase.values)
            error = fit_harmonic_error(result.phase, pattern.shifts, pattern.orientation)
        result.phase.attrs["harmonic_error"] = error.rms
        if error.rms > settings.largest_error:
            limit = settings.largest_error
            remarks.append(Finding(FindingKind.HARMONICS, patterns=(pattern,), value=error.rms, limit=limit))
    if settings.lens_blur > 0:
        corrected = correct_lens_blur(result.phase, result.modulation, settings.lens_blur)
        result["phase"] = result.phase.copy(data=corrected)
    return result, remarks


def _check(exposures: Sequence[ExposedStack], settings: PhaseSettings) -> list[Finding]:
    """Check every exposure; one of several may be too bright or too dark.

    Saturation is reported for the shortest exposure only.
    """
    remarks: list[Finding] = []
    unusable: list[Finding] = []
    for rank, exposure in enumerate(sorted(exposures, key=lambda each: each.time)):
        found = inspect_stack(exposure.frames, exposure.patterns, settings, numbers=exposure.numbers)
        if len(exposures) > 1:
            found = [replace(each, exposure_time=exposure.time) for each in found]
        for each in found:
            if each.fault and each.kind not in (FindingKind.SATURATED, FindingKind.DARK):
                raise step_error(each)
            if each.fault:
                unusable.append(each)
            if each.fault or rank == 0 or each.kind is not FindingKind.SATURATED:
                remarks.append(each)
    if len(unusable) == len(exposures):
        saturated = [each for each in unusable if each.kind is FindingKind.SATURATED]
        raise step_error(saturated[0] if saturated else unusable[-1])
    return remarks


def _from_steps(exposures: Sequence[ExposedStack], settings: PhaseSettings) -> xr.Dataset:
    patterns = exposures[0].patterns
    if len(exposures) == 1:
        return absolute_phase(
            exposures[0].frames,
            patterns,
            noise=settings.noise,
            saturation=settings.saturation,
            minimum_modulation=settings.minimum_modulation,
        )
    known = settings.noise or noise_of_exposures(exposures, settings.saturation)
    frames, sigma = merge_stacks(exposures, known or CameraNoise(ROUNDING_NOISE), settings.saturation)
    result = absolute_phase(frames, patterns, noise=sigma, minimum_modulation=settings.minimum_modulation)
    if known is None:
        result.sigma.values.fill(np.nan)
    fill_saturated(result.texture.values, exposures)
    return result


def _from_one_image(exposures: Sequence[ExposedStack], settings: PhaseSettings) -> tuple[xr.Dataset, list[Finding]]:
    frames, patterns, saturation = exposures[0].frames, exposures[0].patterns, settings.saturation
    if len(exposures) > 1:
        frames, _ = merge_stacks(exposures, settings.noise or CameraNoise(ROUNDING_NOISE), saturation)
        saturation = None  # saturated pixels of merged frames are infinite
    fringes = [index for index, each in enumerate(patterns) if each.kind == PatternKind.FRINGES]
    if not fringes:
        raise PhaseError("no frame shows fringes", code=ErrorCode.INVALID_SEQUENCE)
    grey = [index for index, each in enumerate(patterns) if each.kind == PatternKind.GREY]
    shown, number = patterns[fringes[-1]], exposures[0].numbers[fringes[-1]]
    try:
        result = one_image_phase(
            frames[fringes[-1]],
            white=frames[grey[-1]] if grey else None,
            orientation=shown.orientation,
            shift_angle=float(shift_angles([shown])[0]),
            noise=settings.noise,
            saturation=saturation,
        )
    except PhaseError as error:
        raise StepError(f"frame {number}: {error}", index=number, code=ErrorCode.WRONG_PATTERN) from error
    return result, [Finding(FindingKind.RELATIVE_ONE_IMAGE, patterns=(shown,))]


def _require_agreement(result: xr.Dataset, pitches: Sequence[float]) -> None:
    """Refuse phases of several pitches that agree at a small part of what is lit."""
    modulation = result.modulation.values
    lit = modulation > _LIT * np.percentile(modulation, 95)
    share = float(result.valid.values[lit].mean()) if lit.any() else 1.0
    if share < _AGREEING:
        named = ", ".join(f"{pitch:g}" for pitch in pitches)
        raise PhaseError(
            f"the phases of pitches {named} px agree at {100 * share:.0f} % of what is lit only: check the pitches, "
            "the order of the shifts, and that the surface stood still",
            code=ErrorCode.WRONG_PATTERN,
        )


def _settle_orders(result: xr.Dataset, stack: ExposedStack, accept_relative: bool) -> list[Finding]:
    """Unwrap over the image where the frames do not determine the orders; refuse orders that contradict each other."""
    layout = layout_of(stack.patterns)
    result.phase.attrs["relative"] = 0
    if layout.code:
        return []
    if layout.by_beats:
        _require_agreement(result, layout.pitches)
    across = stack.patterns[0].orientation == Orientation.VERTICAL
    values = result.phase.values if across else result.phase.values.T
    growth = np.diff(values[:: max(1, len(values) // _LINES)])
    known = np.isfinite(growth)
    pitch, finest = layout.unambiguous, layout.pitches[-1]
    turn = 2 * np.pi * pitch / finest  # of the coarsest fringes, or of the beats
    single = pitch == finest
    jumps = known & (np.abs(growth) > (0.5 if single else _REPETITION) * turn)
    lines = known.any(axis=1)
    if not lines.any() or np.mean(jumps.any(axis=1)[lines]) < _AMBIGUOUS_LINES:
        return []
    if not single:
        seen = np.abs(np.nansum(growth - turn * np.round(growth / turn), axis=1)).max() * pitch / turn
        what = "beats" if layout.by_beats else "coarsest fringes"
        raise PhaseError(
            f"the {what} of {pitch:g} px repeat in the view, their order is unknown: show a coarsest pitch of at "
            f"least {np.ceil(seen):g} px (the width of the projector's image always suffices), or a Gray code",
            code=ErrorCode.INVALID_SEQUENCE,
        )
    if not accept_relative:
        raise PhaseError(
            f"fringes of one pitch of {pitch:g} px repeat in view, their order is unknown: show coarser pitches or a "
            "Gray code too, or accept a relative phase",
            code=ErrorCode.INVALID_SEQUENCE,
        )
    phase = unwrap_spatial(result.phase)
    measured = np.isfinite(phase.values)
    result["phase"] = result.phase.copy(data=phase.values.astype(np.float32))
    result.phase.attrs["relative"] = 1
    result["sigma"] = result.sigma.where(measured)
    result["valid"] = result.valid & measured
    return [Finding(FindingKind.RELATIVE_ONE_PITCH, patterns=tuple(stack.patterns[-1:]))]
