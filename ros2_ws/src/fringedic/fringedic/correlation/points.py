"""Displacement at the points of a result by the dense method: periodic textures, and parts that move otherwise.

A first measurement follows the motion of the image as a whole. The displacements that a periodic texture allows are
compared then. Where texture has no result although its place is inside the deformed image, another motion is sought
in what the first one left of both images, and again, until nothing more is found.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Self

import cv2
import numpy as np

from fringedic.correlation import resampling_kernels
from fringedic.correlation.affine import fit_motion
from fringedic.correlation.agreement import Nodes, assess, find_textured_cells
from fringedic.correlation.dense import estimate_nodes
from fringedic.correlation.images import Photometry
from fringedic.correlation.lattice import Lattice, choose_displacement, find_lattice, keep_resolved
from fringedic.correlation.periodic_start import start_of_lattice
from fringedic.correlation.pyramid import Level, build_pyramid, locate_nodes, prepare_level, resample, sample_initial
from fringedic.correlation.window import Window, design_window
from fringedic.errors import CorrelationError, ErrorCode

f4 = np.float32

MOST_MOTIONS = 5  # of an image; each further one costs a measurement of its own
_GROW = np.ones((3, 3), np.uint8)


@dataclass(frozen=True, eq=False)
class Prepared:
    """A reference with what every measurement against it needs.

    Attributes
    ----------
    values : (row, column) float32
        Grey levels in standard deviations; NaN where nothing is known.
    window
        Filters of the dense method.
    lattice
        How its texture repeats; None where it does not.
    images
        Its pyramid, finest first; of a periodic texture the levels that show it.
    levels
        Them with their gradients.
    textured : (node row, node column) bool
        Where a match is expected.
    """

    values: np.ndarray
    window: Window
    lattice: Lattice | None
    images: list[np.ndarray]
    levels: list[Level]
    textured: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray, width: int) -> Self:
        """Prepare the grey levels of a reference for a window of a width [px]."""
        images, window = build_pyramid(values), design_window(width)
        lattice = find_lattice(images)
        images = keep_resolved(images, lattice)
        levels = [prepare_level(level) for level in images]
        return cls(values, window, lattice, images, levels, find_textured_cells(levels[0], window.cell))

    def without(self, pixels: np.ndarray) -> Self:
        """Return the reference without the pixels (row, column) bool."""
        values = np.where(pixels, f4(np.nan), self.values)
        images = build_pyramid(values)[: len(self.images)]
        levels = [prepare_level(level) for level in images]
        textured = find_textured_cells(levels[0], self.window.cell) & self.textured
        return replace(self, values=values, images=images, levels=levels, textured=textured)


@dataclass(frozen=True, eq=False)
class Points:
    """Result at the points.

    Attributes
    ----------
    displacement, sigma : (2, row, column) float32
        Displacement and its standard uncertainty [px]; NaN where not valid.
    valid : (row, column) bool
        Where they hold.
    attributes
        What is to be known of the result besides.
    """

    displacement: np.ndarray
    sigma: np.ndarray
    valid: np.ndarray
    attributes: dict[str, Any] = field(default_factory=dict)


def measure_points(
    reference: Prepared, deformed: np.ndarray, photometry: Photometry, start: np.ndarray | None, spacing: int
) -> Points:
    """Measure the displacement at every `spacing`-th pixel.

    Parameters
    ----------
    deformed
        Grey levels (row, column) in standard deviations of the reference; NaN where nothing is known.
    photometry
        Their brightness and saturation.
    start
        Expected displacement (2, row, column) [px] at the points, NaN where unknown; None searches globally.

    Raises
    ------
    CorrelationError
        The images do not show the same surface.
    """
    prediction = None
    if start is not None and np.isfinite(start).any():
        prediction = sample_initial(start, deformed.shape, reference.window.cell, spacing)
    expected = np.zeros(2) if prediction is None else prediction.mean(axis=(1, 2), dtype=float)
    if prediction is None and reference.lattice is not None:
        prediction = start_of_lattice(
            reference.values, deformed, build_pyramid(deformed), reference.lattice, reference.window.cell
        )
    nodes = _measure_nodes(reference, deformed, photometry, prediction)
    attributes: dict[str, Any] = {}
    if reference.lattice is not None:
        nodes, unique = _settle_period(reference, deformed, photometry, nodes, expected)
        if not unique:
            attributes["repeats_px"] = [float(each) for each in reference.lattice.vectors.ravel()]
    points = _evaluate(nodes, reference, spacing)
    unmatched = _find_unmatched(reference, nodes)
    if unmatched.any():
        others = list(_measure_other_motions(reference, deformed, photometry, nodes))
        for other in others:
            points = _merge(points, _evaluate(other, reference, spacing))
            unmatched &= ~other.valid
        unmatched = _open(unmatched, reference.window)
        attributes["motions"] = 1 + len(others)
    attributes["unmatched_fraction"] = float(np.count_nonzero(unmatched) / max(np.count_nonzero(reference.textured), 1))
    return replace(points, attributes=attributes)


def _measure_nodes(
    reference: Prepared, deformed: np.ndarray, photometry: Photometry, prediction: np.ndarray | None
) -> Nodes:
    """Measure at the nodes of the finest level.

    Raises
    ------
    CorrelationError
        Hardly any point agrees.
    """
    pyramid = build_pyramid(deformed)[: len(reference.images)]
    width = reference.window.width
    estimated = estimate_nodes(reference.levels, reference.images, pyramid, width, prediction, photometry)
    return assess(estimated, reference.window, int(np.count_nonzero(reference.textured)))


def _settle_period(
    reference: Prepared, deformed: np.ndarray, photometry: Photometry, nodes: Nodes, expected: np.ndarray
) -> tuple[Nodes, bool]:
    """Return the displacement of those that a periodic texture allows, and whether the texture decides."""
    assert reference.lattice is not None
    cell = reference.window.cell
    rows, columns = ((np.arange(n) - locate_nodes(1, cell)[0]) / cell for n in deformed.shape)
    everywhere = resample(nodes.displacement, rows, columns)
    everywhere[:, ~_spread(nodes.valid, cell, deformed.shape)] = np.nan
    gradient = fit_motion(nodes.displacement, cell)[:, 1:]
    choice = choose_displacement(reference.values, deformed, everywhere, gradient, reference.lattice, expected)
    if not choice.shift.any():
        return nodes, choice.unique
    shift = (np.eye(2) + gradient) @ choice.shift
    prediction = nodes.displacement + shift.astype(f4)[:, None, None]
    return _measure_nodes(reference, deformed, photometry, prediction), choice.unique


def _evaluate(nodes: Nodes, reference: Prepared, spacing: int) -> Points:
    """Return the result at every `spacing`-th pixel from that at the nodes."""
    cell = reference.window.cell
    values = reference.values
    rows, columns = ((np.arange(0, n, spacing) - 0.5 * (cell - 1)) / cell for n in values.shape)
    near_rows, near_columns = (
        np.clip(np.rint(each).astype(np.intp), 0, n - 1)
        for each, n in zip((rows, columns), nodes.valid.shape, strict=True)
    )
    lines = np.empty((4, nodes.valid.shape[0] + 4, values.shape[1]), f4)
    resampling_kernels.upsample_nodes(np.concatenate([nodes.displacement, nodes.sigma]), cell, lines)
    lines = np.ascontiguousarray(lines[:, :, ::spacing])
    fields = np.empty((4, rows.size, columns.size), f4)
    valid = np.empty((rows.size, columns.size), np.bool_)
    measured = np.ascontiguousarray(values[::spacing, ::spacing])
    resampling_kernels.evaluate_points(lines, rows, nodes.valid, near_rows, near_columns, measured, fields, valid)
    return Points(fields[:2], fields[2:], valid)


def _merge(points: Points, other: Points) -> Points:
    """Return the points, and where they are not valid those of another motion."""
    taken = other.valid & ~points.valid
    return replace(
        points,
        displacement=np.where(taken, other.displacement, points.displacement),
        sigma=np.where(taken, other.sigma, points.sigma),
        valid=points.valid | taken,
    )


def _find_unmatched(reference: Prepared, nodes: Nodes) -> np.ndarray:
    """Return the nodes with texture but no result whose place is inside the deformed image (node row, node column)."""
    cell, window = reference.window.cell, reference.window
    rows, columns = (locate_nodes(n, cell) for n in nodes.valid.shape)
    x, y = columns + nodes.displacement[0], rows[:, None] + nodes.displacement[1]
    margin = window.width / 2
    height, width = reference.values.shape
    inside = (x > margin) & (x < width - margin) & (y > margin) & (y < height - margin)
    return _open(reference.textured & ~nodes.valid & inside, window)


def _open(nodes: np.ndarray, window: Window) -> np.ndarray:
    """Return what of some nodes is at least as wide as a window: rims beside borders are narrower."""
    side = max(window.width // window.cell, 1)
    opened = cv2.morphologyEx(nodes.astype(np.uint8), cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    return np.asarray(opened.astype(bool))


def _measure_other_motions(
    reference: Prepared, deformed: np.ndarray, photometry: Photometry, nodes: Nodes
) -> Iterator[Nodes]:
    """Yield motion after motion, measured in what those before left of both images."""
    left, cell = deformed, reference.window.cell
    for _ in range(MOST_MOTIONS - 1):
        measured = _spread(nodes.valid, cell, deformed.shape)
        reference = reference.without(measured)
        left = np.where(_find_taken(nodes, measured, cell), f4(np.nan), left)
        if not _find_unmatched(reference, nodes).any() or not np.isfinite(left).any():
            return
        try:
            nodes = _measure_nodes(reference, left, photometry, None)
        except CorrelationError as error:
            if error.code is not ErrorCode.NO_CORRELATION:
                raise
            return
        if not _open(nodes.valid, reference.window).any():
            return
        yield nodes


def _spread(nodes: np.ndarray, cell: int, shape: tuple[int, ...]) -> np.ndarray:
    """Return values of nodes at all pixels of their cells."""
    pixels = np.repeat(np.repeat(nodes, cell, axis=0), cell, axis=1)
    return np.asarray(pixels[: shape[0], : shape[1]])


def _find_taken(nodes: Nodes, measured: np.ndarray, cell: int) -> np.ndarray:
    """Return the pixels of the deformed image where the measured ones are now."""
    rows, columns = ((np.arange(n) - locate_nodes(1, cell)[0]) / cell for n in measured.shape)
    moved = resample(nodes.displacement, rows, columns)
    row, column = np.nonzero(measured)
    x = np.rint(column + moved[0, row, column]).astype(int)
    y = np.rint(row + moved[1, row, column]).astype(int)
    inside = (x >= 0) & (x < measured.shape[1]) & (y >= 0) & (y < measured.shape[0])
    taken = np.zeros(measured.shape, np.uint8)
    taken[y[inside], x[inside]] = 1
    return np.asarray(cv2.morphologyEx(taken, cv2.MORPH_CLOSE, _GROW).astype(bool))
