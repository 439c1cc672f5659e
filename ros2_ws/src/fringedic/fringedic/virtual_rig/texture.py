"""Random patterns as sums of Gaussian strokes: speckle, skin furrows, leather grain.

A stroke is an optical density that falls off as an anisotropic Gaussian of the material coordinates. Densities add and
the reflectance is their exponential: the pattern is an analytic function and no image is interpolated. The widths
include the blur of the camera's lens. The strokes of the presets are about 1.2 pixels wide (standard deviation) or
more, have less than 1e-3 of their amplitude at the Nyquist frequency, and are sampled at the pixels' centres.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Voronoi

from fringedic.virtual_rig import tracing
from fringedic.virtual_rig.configuration import TextureConfiguration

Strokes = NDArray[np.float64]

_FULL_WIDTH = 2.0 * math.sqrt(2.0 * math.log(2.0))
# Each kind of stroke has its own random stream, so that a change of one does not change the others.
_SPECKLE, _FURROWS, _FINE_LINES, _GRAIN, _PATCHES = range(5)


def make_texture(texture: TextureConfiguration, outline: NDArray[np.float64], seed: int) -> tracing.StrokeField:
    """Return the strokes of the pattern that covers a specimen.

    Parameters
    ----------
    texture
        Kind and feature size.
    outline
        First and last X, first and last Y [m] of the specimen.
    seed
        The same seed gives the same pattern.
    """
    feature = 1e-6 * texture.feature_um
    match texture.kind:
        case "speckle":
            strokes = _speckle_strokes(outline, feature, texture.coverage, seed)
        case "furrows":
            furrows = furrow_strokes(outline, feature, seed)
            furrows[:, 5] *= 0.9
            strokes = np.concatenate([furrows, _skin_detail_strokes(outline, feature, seed)])
        case "grain":
            strokes = _grain_strokes(outline, feature, seed)
    return stroke_field(strokes, outline)


def stroke_field(strokes: Strokes, outline: NDArray[np.float64]) -> tracing.StrokeField:
    """Sort strokes into cells of about the width of the median stroke."""
    if len(strokes) == 0:
        return tracing.StrokeField(
            strokes, np.zeros(1, np.int64), np.empty(0, np.int32), np.ones(3), np.zeros(2, np.int64)
        )
    a, b, c = strokes[:, 2], strokes[:, 3], strokes[:, 4]
    determinant = a * c - b * b
    extent = np.sqrt(tracing.STROKE_REACH * np.stack([c, a], axis=1) / determinant[:, None])
    steepest = 0.5 * (a + c) + np.sqrt(0.25 * (a - c) ** 2 + b**2)
    edge = 2.0 * float(np.median(1.0 / np.sqrt(steepest)))
    size = np.array([outline[3] - outline[2], outline[1] - outline[0]])
    cells = np.ceil(size / edge).astype(np.int64) + 1
    grid = np.array([outline[0], outline[2], edge])
    start = np.zeros(int(cells.prod()) + 1, np.int64)
    tracing.fill_cells(strokes, extent, grid, cells, start, np.empty(0, np.int32))
    np.cumsum(start, out=start)
    items = np.empty(int(start[-1]), np.int32)
    tracing.fill_cells(strokes, extent, grid, cells, start, items)
    return tracing.StrokeField(strokes, start, items, grid, cells)


def _gaussians(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    length: NDArray[np.float64],
    width: NDArray[np.float64],
    direction: NDArray[np.float64],
    height: NDArray[np.float64],
) -> Strokes:
    """Return strokes with standard deviations `length` along `direction` [rad] and `width` across it [m]."""
    cos, sin = np.cos(direction), np.sin(direction)
    p, q = 1.0 / length**2, 1.0 / width**2
    return np.stack(
        [x, y, p * cos**2 + q * sin**2, (p - q) * sin * cos, p * sin**2 + q * cos**2, height], axis=1
    ).astype(np.float64)


def _scatter(
    rng: np.random.Generator, outline: NDArray[np.float64], per_area: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points of a jittered grid over the outline: random, but without large gaps and clusters."""
    spacing = 1.0 / math.sqrt(per_area)
    x = np.arange(outline[0], outline[1] + spacing, spacing)
    y = np.arange(outline[2], outline[3] + spacing, spacing)
    grid_x, grid_y = (centre.ravel() for centre in np.meshgrid(x, y))
    jitter = rng.uniform(-0.9, 0.9, (2, grid_x.size)) * spacing
    return grid_x + jitter[0], grid_y + jitter[1]


def _speckle_strokes(outline: NDArray[np.float64], feature: float, coverage: float, seed: int) -> Strokes:
    rng = np.random.default_rng([seed, _SPECKLE])
    # A dot of mean peak density 2.4 is darker than half (density above ln 2) out to 1.6 standard deviations.
    density = -math.log(1.0 - coverage) / (math.pi / 4.0 * (1.25 * feature) ** 2)
    x, y = _scatter(rng, outline, density)
    width = feature / 3.2 * np.exp(rng.normal(0.0, 0.18, x.size))
    return _gaussians(
        x,
        y,
        width * rng.uniform(1.0, 1.35, x.size),
        width,
        rng.uniform(0.0, math.pi, x.size),
        rng.uniform(1.4, 3.4, x.size),
    )


def furrow_strokes(outline: NDArray[np.float64], feature: float, seed: int) -> Strokes:
    """Return the main furrows of skin: two families of random lines, as chains of strokes of height up to 1."""
    rng = np.random.default_rng([seed, _FURROWS])
    families = [_lines(rng, outline, feature, direction) for direction in (math.radians(38.0), math.radians(-52.0))]
    return np.concatenate(families)


def _lines(rng: np.random.Generator, outline: NDArray[np.float64], feature: float, direction: float) -> Strokes:
    from scipy.signal import lfilter  # takes half a second to load and is needed for skin only

    radius = 0.5 * math.hypot(outline[1] - outline[0], outline[3] - outline[2])
    centre_x, centre_y = 0.5 * (outline[0] + outline[1]), 0.5 * (outline[2] + outline[3])
    spacing, pace = 8.0 * feature, 1.6 * feature
    steps = np.arange(-radius, radius, pace)
    chains = []
    for offset in np.arange(-radius, radius, spacing):
        angle = direction + lfilter([0.13], [1.0, -0.9], rng.normal(0.0, 1.0, steps.size))
        start = offset + rng.normal(0.0, 0.3) * spacing
        along = np.cumsum(np.cos(angle - direction)) * pace - radius
        across = start + np.cumsum(np.sin(angle - direction)) * pace
        fading = 0.65 + 0.35 * np.sin(2.0 * np.pi * (steps / (26.0 * feature) + rng.uniform()))
        chains.append(
            _gaussians(
                centre_x + along * math.cos(direction) - across * math.sin(direction),
                centre_y + along * math.sin(direction) + across * math.cos(direction),
                pace * rng.uniform(0.7, 1.1, steps.size),
                feature / _FULL_WIDTH * rng.uniform(0.9, 1.4, steps.size),
                angle,
                fading * rng.uniform(0.35, 0.75, steps.size),
            )
        )
    return _clip(np.concatenate(chains), outline)


def _clip(strokes: Strokes, outline: NDArray[np.float64]) -> Strokes:
    x, y = strokes[:, 0], strokes[:, 1]
    return np.asarray(strokes[(x >= outline[0]) & (x <= outline[1]) & (y >= outline[2]) & (y <= outline[3])])


def _skin_detail_strokes(outline: NDArray[np.float64], feature: float, seed: int) -> Strokes:
    """Return fine lines between the furrows, pores and grain, and large patches of another tone."""
    rng = np.random.default_rng([seed, _FINE_LINES])
    x, y = _scatter(rng, outline, 1.0 / (2.6 * feature) ** 2)
    family = np.where(rng.uniform(size=x.size) < 0.55, math.radians(15.0), math.radians(-70.0))
    fine = _gaussians(
        x,
        y,
        feature * rng.uniform(0.8, 2.2, x.size),
        feature / _FULL_WIDTH * rng.uniform(0.7, 1.0, x.size),
        family + rng.normal(0.0, 0.3, x.size),
        rng.uniform(0.1, 0.65, x.size),
    )
    rng = np.random.default_rng([seed, _GRAIN])
    x, y = _scatter(rng, outline, 1.0 / (1.5 * feature) ** 2)
    width = feature / _FULL_WIDTH * rng.uniform(0.68, 1.1, x.size)
    grain = _gaussians(x, y, width, width, np.zeros(x.size), rng.exponential(0.22, x.size))
    return np.concatenate([fine, grain, _patch_strokes(outline, 30.0 * feature, 0.25, seed)])


def _patch_strokes(outline: NDArray[np.float64], size: float, height: float, seed: int) -> Strokes:
    rng = np.random.default_rng([seed, _PATCHES])
    x, y = _scatter(rng, outline, 1.0 / size**2)
    width = 0.45 * size * rng.uniform(0.7, 1.3, x.size)
    return _gaussians(x, y, width, width, np.zeros(x.size), rng.uniform(0.0, height, x.size))


def _grain_strokes(outline: NDArray[np.float64], feature: float, seed: int) -> Strokes:
    """Return the grain of leather: creases (edges of Voronoi cells), pores, and patches of another tone."""
    rng = np.random.default_rng([seed, _FURROWS])
    cells = Voronoi(np.stack(_scatter(rng, outline, 1.0 / (3.0 * feature) ** 2), axis=1))
    edges = np.array(cells.ridge_vertices)
    first, last = (cells.vertices[edges[(edges >= 0).all(axis=1), end]] for end in (0, 1))
    along = last - first
    length = np.hypot(*along.T)
    # edges shorter than the width of a crease would be blots, those at the border of the diagram are infinite
    drawn = (length > 0.3 * feature) & (length < 10.0 * feature)
    count = int(drawn.sum())
    middle = 0.5 * (first + last)[drawn]
    creases = _gaussians(
        middle[:, 0],
        middle[:, 1],
        0.5 * length[drawn] + 0.2 * feature,
        feature / _FULL_WIDTH * rng.uniform(0.75, 1.1, count),
        np.arctan2(along[drawn, 1], along[drawn, 0]),
        rng.uniform(0.25, 1.2, count),
    )
    rng = np.random.default_rng([seed, _GRAIN])
    x, y = _scatter(rng, outline, 1.0 / (2.8 * feature) ** 2)
    width = feature / _FULL_WIDTH * rng.uniform(0.75, 1.3, x.size)
    pores = _gaussians(x, y, width, width, np.zeros(x.size), rng.uniform(0.1, 1.5, x.size))
    return np.concatenate([_clip(creases, outline), pores, _patch_strokes(outline, 25.0 * feature, 0.3, seed)])


def reflectance_at(
    strokes: tracing.StrokeField, floor: float, X: NDArray[np.float64], Y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the reflectance of a painted surface at material points [m], relative to the unpainted surface.

    Parameters
    ----------
    strokes
        From `make_texture`.
    floor
        Darkest reflectance.
    X, Y
        Material coordinates [m], C-contiguous arrays of one shape (row, column).
    """
    value = np.empty(X.shape)
    tracing.reflectance(strokes, floor, X, Y, value)
    return value
