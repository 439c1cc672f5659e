"""Where a surface is torn: points beside which displacement or height jump, so that windows must not reach across.

A displacement cannot follow a jump within the window that it is measured with: it changes over from one side to the
other in about a window's half on either side. With points at a distance h from a place, h three eighths of the window,
the lines through the points at h and 2 h on either side meet the place at values that differ by

    jump(h) = f(h) - f(-h) - (f(2h) - f(h)) - (f(-h) - f(-2h))

which is nothing on any slope or bend, the jump at a tear, and small on a smooth field. A tear jumps as much seen from
twice as far; what is smooth differs 8 times as much.
"""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numba import njit, prange

JUMP = 6.0  # standard deviations of the jump, from which on it is one
_NOISE = 10.0  # variance of a jump over that of a value: coefficients 1, 2, 2, 1
_REACH = 3 / 8  # of the window of the displacement
_SAME = (0.6, 1.5)  # jump from twice as far over the jump, of a tear
_MOST = 0.75  # of the difference between both sides, where there is no room to look from farther
_FIELDS = (("z", "noise_z"), ("u", "sigma_u"), ("v", "sigma_v"), ("w", "sigma_w"))


def torn_points(cloud: xr.Dataset) -> np.ndarray:
    """Return the points of a cloud of `couple` that lie beside a tear, bool (row, column).

    Parameters
    ----------
    cloud
        With the standard deviations of its fields and the window of the displacement.
    """
    window = float(cloud.attrs["displacement_window_px"])
    near = [max(1, math.ceil(_REACH * window / _spacing(cloud[name].values))) for name in ("row", "column")]
    torn = np.zeros(cloud["x"].shape, np.bool_)
    for name, sigma in _FIELDS:
        values, noise = (np.ascontiguousarray(cloud[each], np.float32) for each in (name, sigma))
        variance = np.float32(JUMP**2 * _NOISE) * np.square(noise)
        for lines, limit, h, found in ((values, variance, near[1], torn), (values.T, variance.T, near[0], torn.T)):
            # the relief of a rough surface and a strain that changes from place to place are no tears
            usual = np.float32((JUMP * _roughness(lines, h)) ** 2)
            _mark(lines, np.maximum(limit, usual), h, found)
    return torn


def _spacing(positions: np.ndarray) -> float:
    return float(positions[1] - positions[0]) if len(positions) > 1 else 1.0


def _roughness(values: np.ndarray, h: int) -> float:
    """Robust standard deviation of the jumps along the lines of a map, which noise and relief make everywhere."""
    some = values[:: max(1, len(values) // 100)].astype(float)
    if some.shape[1] <= 4 * h:
        return 0.0
    near = some[:, 3 * h : -h] - some[:, h : -3 * h]
    jumps = np.abs(2 * near - some[:, 4 * h :] + some[:, : -4 * h])
    jumps = jumps[np.isfinite(jumps)]
    return 1.4826 * float(np.median(jumps)) if len(jumps) else 0.0


@njit(cache=True, nogil=True)
def _seen(line: np.ndarray, start: int, way: int, farthest: int) -> int:
    """Index of the first measured value from `start` on, not farther than `farthest`; -1 when there is none."""
    for k in range(farthest + 1):
        at = start + way * k
        if at < 0 or at >= len(line):
            return -1
        if np.isfinite(line[at]):
            return at
    return -1


@njit(cache=True, nogil=True)
def _jump(line: np.ndarray, before: int, after: int, h: int) -> tuple[float, float]:
    """Jump between two places from the slopes over h beyond them, and their difference; NaN without room."""
    if before - h < 0 or after + h >= len(line):
        return np.nan, np.nan
    left, right = line[before] - line[before - h], line[after + h] - line[after]
    difference = line[after] - line[before]
    return difference - (left + right) * (after - before) / (2.0 * h), difference


@njit(cache=True, nogil=True, parallel=True)
def _mark(values: np.ndarray, limit: np.ndarray, h: int, torn: np.ndarray) -> None:
    """Mark the points of each line that are not farther than h from a jump; in gaps the nearest values count."""
    lines, length = values.shape
    for i in prange(lines):
        line = values[i]
        for place in range(h, length - h):
            before, after = _seen(line, place - h, -1, 2 * h), _seen(line, place + h, 1, 2 * h)
            if before < 0 or after < 0:
                continue
            jump, difference = _jump(line, before, after, h)
            # NaN is no jump; where the noise is not known nothing is told
            if not 2.0 * jump * jump > limit[i, before] + limit[i, after]:
                continue
            farther, tear = np.nan, abs(jump) > _MOST * abs(difference)
            if before >= h and after + h < length:
                farther, _ = _jump(line, before - h, after + h, 2 * h)
            if np.isfinite(farther):
                tear = _SAME[0] < farther / jump < _SAME[1]
            if tear:
                torn[i, before : after + 1] = True
