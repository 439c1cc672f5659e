"""Motion of the material points during a stack, from the stack itself, and the phase that is aligned with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import xarray as xr

from fringedic.correlation import measure_displacement
from fringedic.errors import CorrelationError, ErrorCode, StepError
from fringedic.patterns.pattern import UNIFORM_KINDS, ProjectedPattern
from fringedic.phase import ImageMotion, PhaseSettings, demodulate_moving
from fringedic.phase.layout import layout_of
from fringedic.phase.settings import DEFAULT_SETTINGS

f4 = np.float32


@dataclass(frozen=True)
class MovingPhase:
    """Phase of a moving stack and the motion that its frames were aligned with.

    Attributes
    ----------
    maps
        From `demodulate_moving`.
    motion
        Of the material points [px/s, px/s^2]; time 0 is ``maps.attrs["time"]``.
    """

    maps: xr.Dataset
    motion: ImageMotion


def measure_moving_phase(
    frames: np.ndarray,
    times: np.ndarray,
    patterns: Sequence[ProjectedPattern],
    settings: PhaseSettings = DEFAULT_SETTINGS,
    *,
    initial: ImageMotion | None = None,
    window: int = 32,
    **known: Any,
) -> MovingPhase:
    """Measure motion and phase of a moving stack.

    White frames (or uniform grey) before and after the finest pitch give the velocity, a third one the acceleration.
    They contain no fringes, so that the motion does not depend on the phase and needs no iteration. Without them the
    motion is `initial`, such as that between the textures of the stacks before and after, see `motion_between`.

    Parameters
    ----------
    frames, times, patterns, settings
        See `demodulate_moving`; frames of white light may stand among them.
    initial
        Motion where the stack has no white frames.
    window
        Of the displacement [px].
    known
        ``drift``, ``exposure_time`` and ``prediction`` of `demodulate_moving`.

    Raises
    ------
    StepError
        See `demodulate_moving`; neither white frames nor `initial` are given (`SURFACE_MOVED`); the white frames do not
        show the same surface (`NO_CORRELATION`).
    PhaseError, ImageError
        See `demodulate_moving`.
    """
    times = np.asarray(times, float)
    try:
        motion = motion_of_white_frames(frames, times, patterns, window=window) or initial
    except CorrelationError as error:
        raise StepError(f"the motion within the stack is not measured: {error}", code=error.code) from error
    if motion is None:
        raise StepError(
            "the stack does not show its own motion: take a white frame before and after the finest pitch, or give the "
            "motion between the stacks before and after",
            code=ErrorCode.SURFACE_MOVED,
        )
    return MovingPhase(demodulate_moving(frames, times, patterns, motion, settings, **known), motion)


def motion_of_white_frames(
    frames: np.ndarray, times: np.ndarray, patterns: Sequence[ProjectedPattern], *, window: int = 32
) -> ImageMotion | None:
    """Return the motion that white frames show; None without one before and one after the finest pitch.

    A third white frame gives the acceleration of an affine displacement of the image.

    Raises
    ------
    CorrelationError
        The textures do not agree.
    """
    finest = _finest(patterns)
    white = [k for k, each in enumerate(patterns) if each.kind in UNIFORM_KINDS]
    before, after = [k for k in white if k < finest[0]], [k for k in white if k > finest[-1]]
    if not before or not after:
        return None
    first, last = before[-1], after[0]
    velocity = motion_between(frames[first], frames[last], float(times[last] - times[first]), window=window).velocity
    others = [(each, first) for each in before[-2:-1]] or [(last, each) for each in after[1:2]]
    if not others:
        return ImageMotion(velocity)
    one, two = others[0]
    beside = motion_between(frames[one], frames[two], float(times[two] - times[one]), window=window).velocity
    middle, other = (float(times[j] + times[k]) / 2 for j, k in ((first, last), (one, two)))
    acceleration = _affine((velocity - beside) / f4(middle - other)).astype(f4)
    return ImageMotion(velocity + acceleration * f4(times[finest].mean() - middle), acceleration)


def motion_between(first: np.ndarray, second: np.ndarray, interval: float, *, window: int = 32) -> ImageMotion:
    """Return the velocity of the points that are at the pixels half way between two textures.

    Parameters
    ----------
    first, second
        Grey levels (row, column).
    interval
        Between them [s].
    window
        Of the displacement [px].

    Raises
    ------
    CorrelationError
        The textures do not agree.
    """
    field = measure_displacement(first, second, window=window)
    displacement = _filled(np.stack([field.displacement_x.values, field.displacement_y.values]))
    rows, columns = np.indices(first.shape, f4)
    halfway = displacement
    for _ in range(2):  # the point that is at p half way was at p - d / 2 of that point
        x, y = columns - f4(0.5) * halfway[0], rows - f4(0.5) * halfway[1]
        halfway = np.stack(
            [cv2.remap(each, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for each in displacement]
        )
    return ImageMotion(halfway / f4(interval))


def _finest(patterns: Sequence[ProjectedPattern]) -> list[int]:
    """Return the numbers of the frames of the finest pitch."""
    fringes = [k for k, each in enumerate(patterns) if each.kind not in UNIFORM_KINDS]
    return [fringes[k] for k in range(*layout_of([patterns[k] for k in fringes]).slices()[-1].indices(len(fringes)))]


def _affine(values: np.ndarray) -> np.ndarray:
    """Return the affine field through the measured values (2, row, column) by least squares."""
    rows, columns = values.shape[1:]
    down, right = np.linspace(-0.5, 0.5, rows), np.linspace(-0.5, 0.5, columns)
    known = np.isfinite(values).all(axis=0)
    weight, measured = known.astype(float), np.where(known, values, 0).astype(float)

    def moments(each: np.ndarray) -> np.ndarray:
        """Return the sums of values times 1, x and y: those over rows and columns alone are enough."""
        by_column = each.sum(axis=0)
        return np.array([by_column.sum(), by_column @ right, each.sum(axis=1) @ down])

    count, x, y = moments(weight)
    by_column, by_row = weight.sum(axis=0), weight.sum(axis=1)
    xx, yy, xy = by_column @ right**2, by_row @ down**2, down @ weight @ right
    normal = np.array([[count, x, y], [x, xx, xy], [y, xy, yy]])
    coefficients = np.linalg.lstsq(normal, np.stack([moments(each) for each in measured], axis=1), rcond=None)[0]
    constant, along, across = coefficients[..., None, None]
    return np.asarray(constant + along * right + across * down[:, None])


def _filled(values: np.ndarray) -> np.ndarray:
    """Return values with those of the affine field through them where they are not measured."""
    missing = ~np.isfinite(values).all(axis=0)
    if not missing.any():
        return values
    return np.where(missing, _affine(values), values).astype(f4)
