"""Light of the projector on the surface, and the exposure of the camera's sensor to it."""

# mypy: allow-untyped-defs, allow-incomplete-defs
from __future__ import annotations

import math

import numpy as np
from numba import prange

from fringedic.virtual_rig.tracing import compiled, in_parallel


def taps_of(defocus: float) -> int:
    """Return the number of projector pixels whose point spread reaches a point; the rest adds less than 3e-7."""
    return 2 * math.ceil(5.0 * defocus) + 1


@in_parallel
def spread_weights(coordinate, defocus, size, first, weights):
    """Fill in the weights of the projector pixels ``first, first + 1, ...`` at every point; 0 beyond the image's edges.

    The point spread is the pixel's square convolved with a Gaussian, a difference of two error functions.
    """
    reach = weights.shape[2] // 2
    k = math.sqrt(0.5) / defocus
    for i in prange(coordinate.shape[0]):
        for j in range(coordinate.shape[1]):
            centre = coordinate[i, j]
            if not -reach - 1.0 < centre < size + reach:
                first[i, j] = 0
                weights[i, j, :] = 0.0
                continue
            first[i, j] = round(centre) - reach
            lower = math.erf((centre - first[i, j] + 0.5) * k)
            for tap in range(weights.shape[2]):
                n = first[i, j] + tap
                upper = math.erf((centre - n - 0.5) * k)
                weights[i, j, tap] = 0.5 * (lower - upper) if 0 <= n < size else 0.0
                lower = upper


@in_parallel
def edge_weight(coordinate, defocus, size, weight):
    """Fill in the sum of the weights of all ``size`` projector pixels: 1 inside the image, falling to 0 at its edges.

    It is also 0 beside the specimen, where the coordinate is NaN.
    """
    k = math.sqrt(0.5) / defocus
    for i in prange(coordinate.shape[0]):
        for j in range(coordinate.shape[1]):
            c = coordinate[i, j]
            inside = 0.5 * (math.erf((c + 0.5) * k) - math.erf((c + 0.5 - size) * k))
            weight[i, j] = 0.0 if math.isnan(c) else inside


@in_parallel
def light_along(line, first, weights, edge, light):
    """Fill in the light of an image that changes along one direction only: one sum over its `line` of values."""
    last = line.shape[0] - 1
    for i in prange(light.shape[0]):
        for j in range(light.shape[1]):
            total = 0.0
            for k in range(weights.shape[2]):
                total += weights[i, j, k] * line[min(max(first[i, j] + k, 0), last)]
            light[i, j] = total * edge[i, j]


@in_parallel
def light_of(image, first_column, column_weights, first_row, row_weights, light):
    """Fill in the light of any image: the separable sum over all pixels whose point spread reaches the point."""
    last_row = image.shape[0] - 1
    last_column = image.shape[1] - 1
    for i in prange(light.shape[0]):
        for j in range(light.shape[1]):
            total = 0.0
            for m in range(row_weights.shape[2]):
                if row_weights[i, j, m] == 0.0:
                    continue
                n = min(max(first_row[i, j] + m, 0), last_row)
                line = 0.0
                for k in range(column_weights.shape[2]):
                    line += column_weights[i, j, k] * image[n, min(max(first_column[i, j] + k, 0), last_column)]
                total += row_weights[i, j, m] * line
            light[i, j] = total


@compiled
def _mixed(key):
    """Return a pseudo-random 64-bit number from a counter: the finaliser of splitmix64 (Steele, Lea, Flood 2014)."""
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return key ^ (key >> np.uint64(31))


@compiled
def _normal(stream, counter):
    """Return standard normal deviate `counter` of a stream (Box and Muller 1958), for any number of threads the same.

    Logarithm and cosine in single precision take half the time and change it by 1e-5 at most.
    """
    bits = _mixed(stream + np.uint64(counter) * np.uint64(0x9E3779B97F4A7C15))
    first = np.float32((float(bits >> np.uint64(32)) + 0.5) / 4294967296.0)
    angle = np.float32(float(bits & np.uint64(0xFFFFFFFF)) * (2.0 * math.pi / 4294967296.0))
    return math.sqrt(np.float32(-2.0) * math.log(first)) * math.cos(angle)


@in_parallel
def expose_sensor(level, read_variance, shot_variance, response, full_scale, seed, frame, image):
    """Fill in the grey levels of a sensor from its light [grey level]: noise, response, rounding, clipping."""
    stream = _mixed(_mixed(np.uint64(seed) + np.uint64(0x9E3779B97F4A7C15)) ^ np.uint64(frame))
    noisy = read_variance > 0.0 or shot_variance > 0.0
    for i in prange(level.shape[0]):
        for j in range(level.shape[1]):
            grey = float(level[i, j])
            if noisy:
                sigma = math.sqrt(read_variance + shot_variance * grey)
                grey += sigma * _normal(stream, i * level.shape[1] + j)
            if response != 1.0:
                grey = full_scale * (max(grey, 0.0) / full_scale) ** response
            image[i, j] = min(max(round(grey), 0), full_scale)
