"""Interpolation of a model at measured points: along the z axis of the rig, which the camera looks down.

The triangles that cover a point's (x, y) are found in a grid of bins. Of several the one nearest in z is taken. A
vertical line and the closest point differ by the residual times the slope, which the alignment has made small.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit, prange

_OUTSIDE = 1e-9  # barycentric weight below zero that still is the triangle: rounding at a common edge


class _Bins(NamedTuple):
    """A grid in (x, y): corner, size, bins along both axes; bin i has `members[starts[i] : starts[i + 1]]`."""

    low: np.ndarray
    extent: np.ndarray
    shape: np.ndarray
    starts: np.ndarray
    members: np.ndarray


@dataclass(frozen=True)
class Samples:
    """Where points are on a model.

    Attributes
    ----------
    corners : (point, 3)
        Numbers of the nodes of the point's triangle; -1 where the model has no surface.
    weights : (point, 3)
        Barycentric weights of the corners, NaN where the model has no surface.
    """

    corners: np.ndarray
    weights: np.ndarray

    @property
    def found(self) -> np.ndarray:
        """Whether the model has a surface at the point, bool (point,)."""
        return np.asarray(self.corners[:, 0] >= 0)

    def interpolate(self, values: np.ndarray) -> np.ndarray:
        """Return values of the nodes (node, component) at the points (point, component); NaN beside the model."""
        found = np.empty((len(self.corners), values.shape[1]))
        _interpolate(self.corners, self.weights, np.ascontiguousarray(values, float), found)
        return found


def sample(nodes: np.ndarray, triangles: np.ndarray, points: np.ndarray) -> Samples:
    """Find the triangle of each point (point, 3) and its weights; all positions in the rig frame [m]."""
    nodes, triangles, points = (np.ascontiguousarray(each) for each in (nodes, triangles, points))
    low, high = nodes[:, :2].min(axis=0), nodes[:, :2].max(axis=0)
    extent = np.maximum(high - low, 1e-12)
    size = float(np.sqrt(np.prod(extent) / len(triangles)))
    shape = np.minimum(extent / size, 4000).astype(np.int64) + 1
    bins = _Bins(low, extent, shape, *_fill_bins(nodes, triangles, low, extent, shape))
    corners = np.full((len(points), 3), -1, np.int64)
    weights = np.full((len(points), 3), np.nan)
    _find(nodes, triangles, points, bins, corners, weights)
    return Samples(corners, weights)


class Distances(NamedTuple):
    """Distances of points from a model along its normals.

    Attributes
    ----------
    along_normal : (point,)
        Positive outside, towards the camera [m]; NaN beside the model.
    normals, foot : (point, 3)
        Unit normals, and the points of the model at the same (x, y) [m].
    """

    along_normal: np.ndarray
    normals: np.ndarray
    foot: np.ndarray


def distances(nodes: np.ndarray, triangles: np.ndarray, normals: np.ndarray, points: np.ndarray) -> Distances:
    """Return the distances of points (point, 3) from triangles, with normals of the nodes as of `node_normals`."""
    samples = sample(nodes, triangles, points)
    foot, normal = samples.interpolate(nodes), samples.interpolate(normals)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return Distances(np.einsum("pi,pi->p", normal, points - foot), normal, foot)


def facing(nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the triangles whose normal has a positive z: those that a camera above the model sees."""
    return np.ascontiguousarray(triangles[_across(nodes, triangles)[:, 2] > 0])


def node_normals(nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return normals of the nodes towards the camera (node, 3): sums over the areas of their triangles [m^2].

    Interpolated, they vary smoothly. Those of the facets would make a cylinder of facets resist its rotation.
    """
    across = _across(nodes, triangles)
    across *= np.sign(across[:, 2:])
    corners = triangles.T.ravel()
    return np.column_stack([np.bincount(corners, np.tile(part, 3), len(nodes)) for part in across.T])


def _across(nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the normals of triangles, twice as long as their areas (triangle, 3)."""
    first, second, third = (nodes[triangles[:, corner]] for corner in range(3))
    return np.cross(second - first, third - first)


@njit(cache=True, nogil=True)
def _bin_of(value: float, low: float, extent: float, number: int) -> int:
    return min(max(int((value - low) / extent * number), 0), number - 1)


@njit(cache=True, nogil=True)
def _fill_bins(
    nodes: np.ndarray, triangles: np.ndarray, low: np.ndarray, extent: np.ndarray, shape: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return where the triangles of each bin start, and their numbers: a triangle is in every bin of its rectangle."""
    starts = np.zeros(shape[0] * shape[1] + 1, np.int64)
    ranges = np.empty((len(triangles), 4), np.int64)
    for t in range(len(triangles)):
        for axis in range(2):
            a, b, c = nodes[triangles[t, 0], axis], nodes[triangles[t, 1], axis], nodes[triangles[t, 2], axis]
            ranges[t, 2 * axis] = _bin_of(min(a, b, c), low[axis], extent[axis], shape[axis])
            ranges[t, 2 * axis + 1] = _bin_of(max(a, b, c), low[axis], extent[axis], shape[axis])
        for i in range(ranges[t, 0], ranges[t, 1] + 1):
            for j in range(ranges[t, 2], ranges[t, 3] + 1):
                starts[i * shape[1] + j + 1] += 1
    starts = np.cumsum(starts)
    filled = starts.copy()
    members = np.empty(starts[-1], np.int64)
    for t in range(len(triangles)):
        for i in range(ranges[t, 0], ranges[t, 1] + 1):
            for j in range(ranges[t, 2], ranges[t, 3] + 1):
                members[filled[i * shape[1] + j]] = t
                filled[i * shape[1] + j] += 1
    return starts, members


@njit(cache=True, nogil=True, parallel=True)
def _find(
    nodes: np.ndarray,
    triangles: np.ndarray,
    points: np.ndarray,
    bins: _Bins,
    corners: np.ndarray,
    weights: np.ndarray,
) -> None:
    low, extent, shape, starts, members = bins
    for k in prange(len(points)):
        x, y, z = points[k]
        if not (low[0] <= x <= low[0] + extent[0] and low[1] <= y <= low[1] + extent[1]):
            continue
        i, j = _bin_of(x, low[0], extent[0], shape[0]), _bin_of(y, low[1], extent[1], shape[1])
        place = i * shape[1] + j
        nearest = np.inf
        for member in range(starts[place], starts[place + 1]):
            first, second, third = triangles[members[member]]
            dx, dy = x - nodes[first, 0], y - nodes[first, 1]
            ax, ay = nodes[second, 0] - nodes[first, 0], nodes[second, 1] - nodes[first, 1]
            bx, by = nodes[third, 0] - nodes[first, 0], nodes[third, 1] - nodes[first, 1]
            area = ax * by - ay * bx
            if area == 0.0:
                continue
            b, c = (dx * by - dy * bx) / area, (ax * dy - ay * dx) / area
            a = 1.0 - b - c
            if min(a, b, c) < -_OUTSIDE:
                continue
            distance = abs(a * nodes[first, 2] + b * nodes[second, 2] + c * nodes[third, 2] - z)
            if distance < nearest:
                nearest = distance
                corners[k, 0], corners[k, 1], corners[k, 2] = first, second, third
                weights[k, 0], weights[k, 1], weights[k, 2] = a, b, c


@njit(cache=True, nogil=True, parallel=True)
def _interpolate(corners: np.ndarray, weights: np.ndarray, values: np.ndarray, found: np.ndarray) -> None:
    for k in prange(len(corners)):
        first, second, third = corners[k]  # -1 is the last node: its weight is NaN
        for i in range(values.shape[1]):
            found[k, i] = (
                weights[k, 0] * values[first, i] + weights[k, 1] * values[second, i] + weights[k, 2] * values[third, i]
            )
