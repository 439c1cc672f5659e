"""Discontinuities of a surface: points beside which displacement or height jump, so that windows must not cross.

Within its window, a measured displacement cannot follow a jump: it changes from one side to the other over about half a
window on either side. With points at a distance h from a place, three eighths of the window, the lines through the
points at h and 2 h on either side differ at the place by

    jump(h) = f(h) - f(-h) - (f(2h) - f(h)) - (f(-h) - f(-2h))

This is zero for any slope or curvature, small for a smooth field, and the jump at a discontinuity. Seen from twice as
far, the jump of a discontinuity is the same and that of a smooth field 8 times as large. A slope that changes at one
place gives the same jump from any distance, but no larger one than the change of the slope times h.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import xarray as xr
from numba import njit, prange

from fringedic.surface.planes import spacing_of

# Standard deviations of the jump above which it is a discontinuity; test_waves_are_no_discontinuities,
# test_strain_beside_a_crack.
JUMP = 6.0
_REACH = 3 / 8  # a jump is seen from this part of the window of the displacement, see above
_SAME = (0.6, 1.5)  # seen from twice as far, a discontinuity jumps as much and a smooth field 8 times as much
_KINK = 1.5  # a strain that changes from one point to the next jumps by no more than its kink
_MOST = 0.75  # without room to look from farther, the jump is most of the difference between both sides
_FIELDS = (("z", "noise_z"), ("u", "sigma_u"), ("v", "sigma_v"), ("w", "sigma_w"))


def find_discontinuities(cloud: xr.Dataset) -> np.ndarray:
    """Find the points of a cloud that lie beside a discontinuity of height or displacement.

    Parameters
    ----------
    cloud
        From `couple`, with the standard deviations of its fields and the window of the displacement.

    Returns
    -------
    ndarray
        Bool (row, column), True within the reach of a jump.
    """
    reach = _REACH * float(cloud.attrs["displacement_window_px"])
    near = [max(1, math.ceil(reach / spacing_of(cloud[name].values))) for name in ("row", "column")]
    # the displacement changes little between the points of a third of this distance
    every = [max(1, each // 3) for each in near]
    fields = {
        name: np.ascontiguousarray(cloud.variables[name].values[:: every[0], :: every[1]], np.float32)
        for pair in _FIELDS
        for name in pair
    }
    size = next(iter(fields.values())).shape
    near = [math.ceil(each / step) for each, step in zip(near, every, strict=True)]
    across, along = (np.zeros(size, np.uint8) for _ in near)
    for name, sigma in _FIELDS:
        values, noise = fields[name], fields[sigma]
        for lines, sigmas, h, marked in ((values, noise, near[1], along), (values.T, noise.T, near[0], across.T)):
            # the relief of a rough surface and a strain that varies are no discontinuities
            _mark(lines, sigmas, np.float32(JUMP * _measure_roughness(lines, h)), h, marked)
    # a single value with an error larger than stated is none either: neighbouring lines have to agree
    for marked, side in ((along, (near[0] // 2 + 1, 1)), (across, (1, near[1] // 2 + 1))):
        cv2.morphologyEx(marked, cv2.MORPH_OPEN, np.ones(side, np.uint8), dst=marked)
    nearest = (
        np.minimum((np.arange(count) + step // 2) // step, kept - 1)
        for count, kept, step in zip(cloud["x"].shape, size, every, strict=True)
    )
    return np.asarray((along | across).astype(bool)[np.ix_(*nearest)])


def _measure_roughness(values: np.ndarray, h: int) -> float:
    """Return the robust standard deviation of the jumps along the lines of a map, by noise and relief."""
    some = values[:: max(1, len(values) // 100)].astype(float)
    if some.shape[1] <= 4 * h:
        return 0.0
    near = some[:, 3 * h : -h] - some[:, h : -3 * h]
    jumps = np.abs(2 * near - some[:, 4 * h :] + some[:, : -4 * h])
    jumps = jumps[np.isfinite(jumps)]
    return 1.4826 * float(np.median(jumps)) if len(jumps) else 0.0


@njit(cache=True, nogil=True)
def _find_measured(line: np.ndarray, start: int, way: int, farthest: int) -> int:
    """Return the index of the first measured value from `start` on, up to `farthest`; -1 if there is none."""
    for k in range(farthest + 1):
        at = start + way * k
        if at < 0 or at >= len(line):
            return -1
        if np.isfinite(line[at]):
            return at
    return -1


@njit(cache=True, nogil=True)
def _jump(line: np.ndarray, before: int, after: int, h: int) -> tuple[float, float, float]:
    """Return the jump between two places from the slopes over h beyond them, their difference, and a kink's jump.

    The last is the largest jump that the change of the slope imitates, where it changes between the places. NaN without
    room.
    """
    if before - h < 0 or after + h >= len(line):
        return np.nan, np.nan, np.nan
    left, right = line[before] - line[before - h], line[after + h] - line[after]
    difference, share = line[after] - line[before], (after - before) / (2.0 * h)
    return difference - share * (left + right), difference, share * abs(right - left)


@njit(cache=True, nogil=True)
def _variance(noise: np.ndarray, before: int, after: int, h: int) -> float:
    """Return the variance of `_jump` from the standard deviations of the values of its line."""
    share = (after - before) / (2.0 * h)
    near = noise[before] ** 2 + noise[after] ** 2
    far = noise[before - h] ** 2 + noise[after + h] ** 2
    return float((1.0 + share) ** 2 * near + share**2 * far)


@njit(cache=True, nogil=True, parallel=True)
def _mark(values: np.ndarray, noise: np.ndarray, usual: np.float32, h: int, marked: np.ndarray) -> None:
    """Mark the points of each line within h of a jump above noise and `usual`; in gaps the nearest values are used."""
    lines, length = values.shape
    for i in prange(lines):
        line = values[i]
        for place in range(h, length - h):
            before = _find_measured(line, place - h, -1, 2 * h)
            after = _find_measured(line, place + h, 1, 2 * h)
            if before < 0 or after < 0:
                continue
            jump, difference, kink = _jump(line, before, after, h)
            # NaN is no jump, nor is any jump known where the noise is not
            if not (abs(jump) > usual and abs(jump) > _KINK * kink):
                continue
            if not abs(jump) > JUMP * math.sqrt(_variance(noise[i], before, after, h)):
                continue
            farther, confirmed = np.nan, abs(jump) > _MOST * abs(difference)
            outer, beyond = _find_measured(line, before - h, -1, h), _find_measured(line, after + h, 1, h)
            if outer >= 0 and beyond >= 0:
                farther, _, _ = _jump(line, outer, beyond, 2 * h)
            if np.isfinite(farther):
                confirmed = _SAME[0] < farther / jump < _SAME[1]
            if confirmed:
                marked[i, before : after + 1] = 1
