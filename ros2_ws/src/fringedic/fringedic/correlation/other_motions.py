"""Parts of a surface that move otherwise than the rest: grips, sliding blocks, hinges, both sides of a tear.

Where texture has no result although its place is inside the deformed image, another motion is sought in what those
before left of both images. Beside a seam the windows contain both motions, so that each point is given to the motion
with which the pixels around it agree, or to none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np

from fringedic.correlation.agreement import Nodes
from fringedic.correlation.images import Photometry
from fringedic.correlation.prepared import Prepared
from fringedic.correlation.pyramid import locate_nodes, remove_shading

f4 = np.float32

MOST_MOTIONS = 5  # of an image; each further one costs a measurement of its own
_AROUND = 7  # [px], width of the square in which the residuals of two motions are compared
_CLEARLY = 0.5  # of the other motion's squared residual, which that of a point's motion may have at most
_HARDLY = 1.25  # the same where both motions say nearly the same
_DIFFERENT = 1.0  # [px] between motions beyond which they exclude each other
_RIM = np.ones((3, 3), np.uint8)
_CLOSED = np.ones((3, 3), np.uint8)  # gaps of a pixel between places of pixels that a stretch moved apart


def find_unmatched(reference: Prepared, nodes: Nodes) -> np.ndarray:
    """Return the nodes (node row, node column) with texture, without a result, and inside of the deformed image."""
    rows, columns = (locate_nodes(n, reference.cell) for n in nodes.valid.shape)
    x, y = columns + nodes.displacement[0], rows[:, None] + nodes.displacement[1]
    margin = reference.width / 2
    height, width = reference.values.shape
    inside = (x > margin) & (x < width - margin) & (y > margin) & (y < height - margin)
    return keep_wide(reference, reference.texture.rich & ~nodes.valid & inside)


def keep_wide(reference: Prepared, nodes: np.ndarray) -> np.ndarray:
    """Return what of some nodes is at least half as wide as the window; rims and weak spots are narrower."""
    side = max(reference.window.width // (2 * reference.window.cell), 1)
    opened = cv2.morphologyEx(nodes.astype(np.uint8), cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    return np.asarray(opened.astype(bool))


def fill_a_window(reference: Prepared, nodes: np.ndarray) -> bool:
    """Return whether nodes cover the area of a window at least: with less, no motion is found."""
    return bool(np.count_nonzero(nodes) >= (reference.window.width // reference.window.cell) ** 2)


def leave_out_rims(nodes: Nodes, unmatched: np.ndarray) -> Nodes:
    """Return the nodes without those next to unmatched ones: their cells reach over the border to what is in front."""
    return replace(nodes, valid=nodes.valid & ~cv2.dilate(unmatched.astype(np.uint8), _RIM).astype(bool))


def measure_other_motions(
    reference: Prepared, deformed: np.ndarray, photometry: Photometry, nodes: Nodes
) -> Iterator[Nodes]:
    """Yield motion after motion, each measured in what those before left of both images."""
    left = deformed
    for _ in range(MOST_MOTIONS - 1):
        measured = reference.spread(nodes.valid)
        left = np.where(_find_taken(reference, nodes, measured), f4(np.nan), left)
        reference = reference.without(measured)
        if not fill_a_window(reference, find_unmatched(reference, nodes)) or not np.isfinite(left).any():
            return
        found = reference.attempt(left, photometry)
        if found is None or not fill_a_window(reference, keep_wide(reference, found.valid)):
            return
        nodes = found
        yield nodes


def _find_taken(reference: Prepared, nodes: Nodes, measured: np.ndarray) -> np.ndarray:
    """Return the pixels of the deformed image where the measured ones of the reference are now."""
    moved = reference.at_pixels(nodes.displacement)
    row, column = np.nonzero(measured)
    x = np.rint(column + moved[0, row, column]).astype(int)
    y = np.rint(row + moved[1, row, column]).astype(int)
    inside = (x >= 0) & (x < measured.shape[1]) & (y >= 0) & (y < measured.shape[0])
    taken = np.zeros(measured.shape, np.uint8)
    taken[y[inside], x[inside]] = 1
    return np.asarray(cv2.morphologyEx(taken, cv2.MORPH_CLOSE, _CLOSED).astype(bool))


def separate(
    reference: Prepared, deformed: np.ndarray, photometry: Photometry, motions: list[Nodes]
) -> list[tuple[Nodes, np.ndarray]]:
    """Measure each motion again without the pixels of the others.

    Returns
    -------
    list of (Nodes, ndarray)
        The motions, each with the pixels (row, column) bool at which no other one explains the images as well.
    """
    flat = remove_shading(reference.values), remove_shading(deformed)
    fields, residuals = _compare(reference, flat, motions)
    owner = _find_owners(fields, residuals)
    taken = [_find_taken(reference, nodes, owner == i) for i, nodes in enumerate(motions)]
    apart = []
    for i, nodes in enumerate(motions):
        others = np.any([each for j, each in enumerate(taken) if j != i], axis=0) & ~taken[i]
        own = reference.without((owner >= 0) & (owner != i))
        left = np.where(others, f4(np.nan), deformed)
        apart.append(own.attempt(left, photometry, nodes.displacement) or nodes)
    fields, residuals = _compare(reference, flat, apart)
    return [(nodes, _prevails(i, fields, residuals)) for i, nodes in enumerate(apart)]


def _find_owners(fields: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """Return which motion explains each pixel best (row, column); -1 where several are near it and say the same."""
    near = np.isfinite(residuals)
    first = np.argmax(near, axis=0)[None, None]
    away = np.hypot(*np.moveaxis(fields - np.take_along_axis(fields, first, axis=0), 1, 0))
    settled = (near.sum(axis=0) == 1) | (near & (away > _DIFFERENT)).any(axis=0)
    return np.where(settled, np.argmin(residuals, axis=0), -1)


def _prevails(i: int, fields: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """Return the pixels at which motion i explains the images better than those that say something else."""
    held = np.isfinite(residuals[i])
    for j, field in enumerate(fields):
        if j != i:
            different = np.hypot(*(fields[i] - field)) > _DIFFERENT
            held &= residuals[i] < np.where(different, _CLEARLY, _HARDLY) * residuals[j]
    return np.asarray(held)


def _compare(
    reference: Prepared, flat: tuple[np.ndarray, np.ndarray], motions: list[Nodes]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacement (motion, 2, row, column) of all motions and their local squared residuals.

    The residual (motion, row, column) is infinite further than a window from the points of a motion. `flat` are both
    images without their shading.
    """
    fields = np.array([reference.at_pixels(each.displacement) for each in motions])
    residuals = [
        np.where(_widen(reference, nodes.valid), _average_residual(*flat, field), f4(np.inf))
        for nodes, field in zip(motions, fields, strict=True)
    ]
    return fields, np.array(residuals)


def _average_residual(first: np.ndarray, second: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """Return the local mean of the squared difference of both images after a displacement (2, row, column)."""
    rows, columns = np.indices(first.shape, f4)
    moved = cv2.remap(second, columns + displacement[0], rows + displacement[1], cv2.INTER_LANCZOS4)
    return np.asarray(cv2.blur((moved - first) ** 2, (_AROUND, _AROUND)))


def _widen(reference: Prepared, valid: np.ndarray) -> np.ndarray:
    """Return the pixels up to a window away from valid nodes."""
    reach = 2 * reference.window.width // reference.window.cell + 1
    wide = cv2.dilate(valid.astype(np.uint8), np.ones((reach, reach), np.uint8))
    return reference.spread(wide.astype(bool))
