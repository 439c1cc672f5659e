"""Affine motions of an image: at the nodes of a level, and as a frame beside which a displacement is measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from fringedic.correlation import node_kernels
from fringedic.correlation.pyramid import count_nodes, locate_nodes

f4 = np.float32

# Largest rotation [rad] or strain of a motion that the gradient of the reference describes; beyond it, the error of a
# step is this part of it, and with it the uncertainty.
LARGE_GRADIENT = 0.05
SMALLEST_STRETCH = 0.05  # of a line of a surface; a motion that no surface makes has no inverse


@dataclass(frozen=True, eq=False)
class AffineFrame:
    """A large affine motion, beside which displacements are measured in the directions of the reference.

    The point x of the reference is at x + c + L x + (1 + L) r in the deformed image, with the displacement r in the
    frame. The gradient of the moved image by r is that of the reference.

    Attributes
    ----------
    motion
        c and L (2, 3) [px of the full image], as `make_affine_nodes` takes them; None is no motion.
    """

    motion: np.ndarray | None

    @classmethod
    def of(cls, motion: np.ndarray) -> Self:
        """Return the frame of a motion.

        None where it turns and stretches so little that the gradient suffices, and where a surface would collapse.
        """
        large = np.linalg.norm(motion[:, 1:], 2) > LARGE_GRADIENT
        smallest = np.linalg.svd(np.eye(2) + motion[:, 1:], compute_uv=False)[-1]
        return cls(motion if large and smallest > SMALLEST_STRETCH else None)

    @property
    def matrix(self) -> np.ndarray:
        """1 + L, (2, 2)."""
        return np.eye(2) if self.motion is None else np.eye(2) + self.motion[:, 1:]

    def total(self, nodes: np.ndarray, k: int, cell: int) -> np.ndarray:
        """Return nodes (2 or more channels) of level k with the displacement from the reference in the first two."""
        if self.motion is None:
            return nodes
        base = _evaluate_affine(self.motion, k, (nodes.shape[1], nodes.shape[2]), cell)
        total = nodes.copy()
        total[:2] = base + self._turned(self.matrix, nodes[:2])
        return total

    def inside(self, displacement: np.ndarray, k: int, cell: int) -> np.ndarray:
        """Return the displacement (2, node row, node column) in the frame, the inverse of `total`."""
        if self.motion is None:
            return displacement
        base = _evaluate_affine(self.motion, k, (displacement.shape[1], displacement.shape[2]), cell)
        return self._turned(np.linalg.inv(self.matrix), displacement - base)

    def turn_sigma(self, sigma: np.ndarray) -> np.ndarray:
        """Return the standard uncertainty (2, ...) along x and y of the image from that along those of the frame."""
        return sigma if self.motion is None else np.sqrt(self._turned(self.matrix**2, sigma**2))

    @staticmethod
    def _turned(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("ij,j...->i...", matrix.astype(f4), values))


def fit_motion(displacement: np.ndarray, cell: int) -> np.ndarray:
    """Return the affine motion (2, 3) [px] closest to a displacement (2, node row, node column) of the full image."""
    planes = np.empty((2, 3), f4)
    node_kernels.fit_planes(displacement, np.ones(displacement.shape[1:], f4), planes)
    value, by_node = planes[:, :1].astype(float), planes[:, 1:].astype(float)
    first = locate_nodes(1, cell)[0]  # [px] of the first node from the corner pixel
    return np.hstack([value - by_node.sum(axis=1, keepdims=True) * first / cell, by_node / cell])


def _evaluate_affine(affine: np.ndarray, k: int, counts: tuple[int, int], cell: int) -> np.ndarray:
    """Return the displacement (2, node row, node column) [px of level k] of an affine motion at nodes of level k.

    The columns of `affine` are the displacement at the image's corner pixel (0, 0) and its derivatives by x and by y.
    """
    scale = 2**k
    rows, columns = (scale * locate_nodes(count, cell) + (scale - 1) / 2 for count in counts)
    field = affine[:, 0, None, None] + affine[:, 1, None, None] * columns + affine[:, 2, None, None] * rows[:, None]
    return np.asarray(field / scale, dtype=f4)


def make_affine_nodes(
    affine: np.ndarray, k: int, shape: tuple[int, int], cell: int, gain: float, offset: float
) -> np.ndarray:
    """Make nodes (4, node row, node column) of level k with an affine motion and a uniform brightness."""
    nodes = np.empty((4, *count_nodes(shape, cell)), f4)
    nodes[:2] = _evaluate_affine(affine, k, count_nodes(shape, cell), cell)
    nodes[2], nodes[3] = gain, offset
    return nodes
