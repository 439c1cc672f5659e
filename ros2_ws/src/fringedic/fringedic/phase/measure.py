"""The phase of a step by the method that its frames call for: phase stepping, or one image; absolute, or relative."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Literal

import numpy as np
import xarray as xr

from fringedic.errors import FramesOutOfOrderError, InvalidSequenceError, NoFringesError, WrongPatternError
from fringedic.phase.blur import correct_lens_blur
from fringedic.phase.faults import check_stack
from fringedic.phase.layout import layout_of, shift_angles
from fringedic.phase.noise import CameraNoise
from fringedic.phase.one_image import one_image_phase
from fringedic.phase.order import unwrap_spatial
from fringedic.phase.steps import absolute_phase
from fringedic.sequence import Orientation, PatternKind, Projection

_AMBIGUOUS_LINES = 0.05  # of the lines across the fringes; more jump by a turn when one fringe does not cover the view
_FEWER_JUMPS = 0.5  # of the jumps remain when frames of the code are put in their right order
_CODE_LINES = 60  # lines that are looked at for the order of the code's frames

Method = Literal["auto", "steps", "one_image"]


def measure_phase(
    frames: np.ndarray,
    projections: Sequence[Projection],
    *,
    method: Method = "auto",
    accept_relative: bool = False,
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
    noise, saturation, minimum_modulation
        See `absolute_phase`.
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
    kinds = [each.kind for each in projections]
    if method == "one_image" or (method == "auto" and kinds.count(PatternKind.FRINGES) == 1):
        if not accept_relative:
            raise InvalidSequenceError(
                "one fringe image gives a phase up to whole fringes only: accept a relative phase, or show whole "
                "cycles of shifts at several pitches"
            )
        result, remarks = _from_one_image(frames, projections, noise, saturation)
    else:
        stepped = [index for index, kind in enumerate(kinds) if kind != PatternKind.GREY]
        shown = [projections[index] for index in stepped]
        levels = frames if len(stepped) == len(frames) else frames[stepped]
        remarks = check_stack(
            levels,
            shown,
            noise=noise,
            saturation=saturation,
            largest_error=largest_error,
            largest_motion=largest_motion,
        )
        result = absolute_phase(
            levels, shown, noise=noise, saturation=saturation, minimum_modulation=minimum_modulation
        )
        remarks += _settle_orders(result, levels, shown, accept_relative)
    if lens_blur > 0:
        relative = result.phase.attrs["relative"]
        result["phase"] = result.phase.copy(data=correct_lens_blur(result.phase, result.modulation, lens_blur))
        result.phase.attrs["relative"] = relative
    return result, remarks


def _from_one_image(
    frames: np.ndarray, projections: Sequence[Projection], noise: CameraNoise | None, saturation: float | None
) -> tuple[xr.Dataset, list[str]]:
    fringes = [index for index, each in enumerate(projections) if each.kind == PatternKind.FRINGES]
    if not fringes:
        raise InvalidSequenceError("no frame shows fringes")
    grey = [index for index, each in enumerate(projections) if each.kind == PatternKind.GREY]
    shown = projections[fringes[-1]]
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
        raise WrongPatternError(str(error)) from error
    return result, ["the phase of one image is relative: true up to the same number of whole fringes everywhere"]


def _settle_orders(
    result: xr.Dataset, frames: np.ndarray, projections: Sequence[Projection], accept_relative: bool
) -> list[str]:
    """Unwrap over the image where the frames do not tell the orders; refuse orders that cannot be."""
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
            _check_code(frames, projections, along)
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


def _check_code(frames: np.ndarray, projections: Sequence[Projection], along: int) -> None:
    """Raise when the orders jump less with two frames of the Gray code interchanged."""
    skip = max(1, frames.shape[2 - along] // _CODE_LINES)
    part = np.ascontiguousarray(frames[:, ::skip] if along == 1 else frames[:, :, ::skip])
    bits = layout_of(projections).code

    def jumps(order: Sequence[int]) -> int:
        phase = absolute_phase(part[order], projections).phase.values
        return int(np.sum(np.abs(np.diff(phase, axis=along)) > np.pi))

    recorded = list(range(len(projections)))
    found = []
    for first, second in combinations(range(bits), 2):
        order = list(recorded)
        order[first], order[second] = second, first
        found.append((jumps(order), first, second))
    fewest, first, second = min(found)
    if fewest < _FEWER_JUMPS * jumps(recorded):
        raise FramesOutOfOrderError(
            f"the orders that the Gray code tells jump, less so with frames {first} and {second} interchanged: frames "
            "are out of order"
        )
