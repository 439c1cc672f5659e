"""The phase of a step by the method that its frames call for: phase stepping, or one image; absolute, or relative."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import xarray as xr

from fringedic.errors import (
    DarkStackError,
    InvalidSequenceError,
    NoFringesError,
    SaturatedStackError,
    StepError,
    WrongPatternError,
)
from fringedic.phase.blur import correct_lens_blur
from fringedic.phase.exposures import (
    ExposedStack,
    fill_glare,
    merge_stacks,
    noise_of_exposures,
    split_exposures,
)
from fringedic.phase.faults import check_stack
from fringedic.phase.gray_code import check_code_order
from fringedic.phase.layout import layout_of, shift_angles
from fringedic.phase.noise import ROUNDING_NOISE, CameraNoise
from fringedic.phase.one_image import one_image_phase
from fringedic.phase.order import unwrap_spatial
from fringedic.phase.steps import absolute_phase
from fringedic.sequence import Orientation, PatternKind, Projection

_AMBIGUOUS_LINES = 0.05  # of the lines across the fringes; more jump by a turn when one fringe does not cover the view

Method = Literal["auto", "steps", "one_image"]


def measure_phase(
    frames: np.ndarray,
    projections: Sequence[Projection],
    *,
    method: Method = "auto",
    accept_relative: bool = False,
    exposure_times: Sequence[float] | None = None,
    noise: CameraNoise | None = None,
    saturation: float | None = None,
    minimum_modulation: float = 0.0,
    lens_blur: float = 0.0,
    largest_error: float = 0.003,
    largest_motion: float = 0.2,
) -> tuple[xr.Dataset, list[str]]:
    """Measure the phase of a step, having looked for faults of its frames.

    Parameters
    ----------
    frames
        Grey levels, shape (frame, row, column).
    projections
        What each frame showed: see `absolute_phase`; or one fringe image, and uniform grey if its texture is to be
        taken out.
    method
        ``steps``: phase stepping; ``one_image``: from the last fringe image alone; ``auto``: from one image when there
        is only one.
    accept_relative
        Whether a phase that is true up to whole fringes only is a result: that of one image, and that of one pitch
        without a code that repeats in view. Refused otherwise.
    exposure_times
        Of each frame [s]; several of each pattern are merged, see `merge_exposures`. By default all are alike.
    noise, saturation, minimum_modulation
        See `absolute_phase`; grey levels are those of the first frame's exposure time.
    lens_blur
        Blur of the camera's lens to correct for [px], see `correct_lens_blur`; 0 corrects nothing.
    largest_error, largest_motion
        See `check_stack`.

    Returns
    -------
    result : Dataset
        As `absolute_phase` returns, the phase with the attribute ``relative`` (0 or 1).
    remarks : list of str
        What should be known about this result.

    Raises
    ------
    InvalidSequenceError
        The frames give no phase, or only a relative one that is not accepted.
    SaturatedStackError, DarkStackError, WrongPatternError, FramesOutOfOrderError, FlickerError, MovedSurfaceError
        See `check_stack`.
    """
    exposures = split_exposures(frames, projections, exposure_times)
    kinds = [each.kind for each in exposures[0].projections]
    if method == "one_image" or (method == "auto" and kinds.count(PatternKind.FRINGES) == 1):
        if not accept_relative:
            raise InvalidSequenceError(
                "one fringe image gives a phase up to whole fringes only: accept a relative phase, or show whole "
                "cycles of shifts at several pitches"
            )
        result, remarks = _from_one_image(exposures, noise, saturation)
    else:
        exposures = [each.without_grey() for each in exposures]
        remarks = _check(exposures, noise, saturation, largest_error, largest_motion)
        result = _from_steps(exposures, noise, saturation, minimum_modulation)
        remarks += _settle_orders(result, exposures[0], accept_relative)
    if lens_blur > 0:
        relative = result.phase.attrs["relative"]
        result["phase"] = result.phase.copy(data=correct_lens_blur(result.phase, result.modulation, lens_blur))
        result.phase.attrs["relative"] = relative
    return result, remarks


def _check(
    exposures: Sequence[ExposedStack],
    noise: CameraNoise | None,
    saturation: float | None,
    largest_error: float,
    largest_motion: float,
) -> list[str]:
    """Look for faults in every exposure that shows something; one of several may be too bright or too dark.

    The shortest one alone tells how much saturates.
    """
    remarks: list[str] = []
    useless: list[SaturatedStackError | DarkStackError] = []
    for rank, exposure in enumerate(sorted(exposures, key=lambda each: each.time)):
        words = f"exposed for {1e3 * exposure.time:g} ms: " if len(exposures) > 1 else ""
        try:
            found = check_stack(
                exposure.frames,
                exposure.projections,
                noise=noise,
                saturation=saturation,
                largest_error=largest_error,
                largest_motion=largest_motion,
                numbers=exposure.numbers,
                tell_glare=rank == 0,
            )
        except (SaturatedStackError, DarkStackError) as error:
            useless.append(error)
            found = [str(error)]
        except StepError as error:
            raise type(error)(f"{words}{error}", index=error.index) from error
        remarks += [f"{words}{each}" for each in found]
    if len(useless) == len(exposures):
        raise useless[0] if isinstance(useless[0], SaturatedStackError) else useless[-1]
    return remarks


def _from_steps(
    exposures: Sequence[ExposedStack], noise: CameraNoise | None, saturation: float | None, minimum_modulation: float
) -> xr.Dataset:
    shown = exposures[0].projections
    if len(exposures) == 1:
        return absolute_phase(
            exposures[0].frames, shown, noise=noise, saturation=saturation, minimum_modulation=minimum_modulation
        )
    known = noise or noise_of_exposures(exposures, saturation)
    frames, sigma = merge_stacks(exposures, known or CameraNoise(ROUNDING_NOISE), saturation)
    result = absolute_phase(frames, shown, noise=sigma, minimum_modulation=minimum_modulation)
    if known is None:
        result.sigma.values.fill(np.nan)
    fill_glare(result.texture.values, exposures)
    return result


def _from_one_image(
    exposures: Sequence[ExposedStack], noise: CameraNoise | None, saturation: float | None
) -> tuple[xr.Dataset, list[str]]:
    frames, projections = exposures[0].frames, exposures[0].projections
    if len(exposures) > 1:
        frames, _ = merge_stacks(exposures, noise or CameraNoise(ROUNDING_NOISE), saturation)
        saturation = None
    fringes = [index for index, each in enumerate(projections) if each.kind == PatternKind.FRINGES]
    if not fringes:
        raise InvalidSequenceError("no frame shows fringes")
    grey = [index for index, each in enumerate(projections) if each.kind == PatternKind.GREY]
    shown, number = projections[fringes[-1]], exposures[0].numbers[fringes[-1]]
    try:
        result = one_image_phase(
            frames[fringes[-1]],
            white=frames[grey[-1]] if grey else None,
            orientation=shown.orientation,
            shift_angle=float(shift_angles([shown])[0]),
            noise=noise,
            saturation=saturation,
        )
    except NoFringesError as error:
        raise WrongPatternError(f"frame {number}: {error}", index=number) from error
    return result, ["the phase of one image is relative: true up to the same number of whole fringes everywhere"]


def _settle_orders(result: xr.Dataset, stack: ExposedStack, accept_relative: bool) -> list[str]:
    """Unwrap over the image where the frames do not tell the orders; refuse orders that cannot be."""
    projections = stack.projections
    layout = layout_of(projections)
    result.phase.attrs["relative"] = 0
    if layout.code == 0 and len(layout.pitches) > 1:
        return []
    along = 1 if projections[0].orientation == Orientation.VERTICAL else 0
    growth = np.diff(result.phase.values, axis=along)
    known = np.isfinite(growth)
    jumps = known & (np.abs(growth) > np.pi)
    if layout.code:
        if jumps.sum() > np.sum(known.any(axis=along)):  # more than one on every line, as at a step of the surface
            check_code_order(stack.frames, projections, stack.numbers)
        return []
    lines = known.any(axis=along)
    if not lines.any() or np.mean(jumps.any(axis=along)[lines]) < _AMBIGUOUS_LINES:
        return []
    pitch = layout.pitches[0]
    if not accept_relative:
        raise InvalidSequenceError(
            f"fringes of one pitch of {pitch:g} px repeat in view, their order is unknown: show coarser pitches or a "
            "Gray code too, or accept a relative phase"
        )
    phase = unwrap_spatial(result.phase)
    measured = np.isfinite(phase.values)
    result["phase"] = result.phase.copy(data=phase.values.astype(np.float32))
    result.phase.attrs["relative"] = 1
    result["sigma"] = result.sigma.where(measured)
    result["valid"] = result.valid & measured
    return [
        f"the phase of one pitch of {pitch:g} px is relative: unwrapped over the image, true up to whole fringes, and "
        "wrong behind steps and shadows"
    ]
