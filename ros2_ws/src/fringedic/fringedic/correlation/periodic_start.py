"""Start for periodic textures: displacement from the phases of their waves, up to one common repetition.

The vectors after which both images repeat give the affine part of the motion. Moved back by it, the deformed image has
nearly the same waves as the reference, and the local phase of each follows the rest of the motion: the phase of the
wave with the wave vector k changes by -2 pi k . d. It is unwrapped over the image.

References
----------
M. J. Hytch, E. Snoeck, R. Kilaas (1998), Quantitative measurement of displacement and strain fields from HREM
micrographs, Ultramicroscopy 74, 131-146.
M. Grediac, F. Sur, B. Blaysat (2016), The grid method for in-plane displacement and strain measurement: a review and
analysis, Strain 52, 205-243.
"""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np

from fringedic.correlation.lattice import Lattice, find_lattice
from fringedic.correlation.pyramid import count_nodes, inpaint, locate_nodes, remove_shading
from fringedic.phase.fringe_order import unwrap_spatial

f4 = np.float32
TURN = 2 * np.pi

LARGEST_STRETCH = 0.8  # of a lattice: beyond it, multiples of its vectors are mistaken for them
_PERIODS = 1.0  # standard deviation of the window of a phase, in periods
_FAINT = 0.2  # of the usual amplitude of a wave, below which its phase is not used


def start_of_lattice(
    reference: np.ndarray, deformed: np.ndarray, images: list[np.ndarray], lattice: Lattice, cell: int
) -> np.ndarray | None:
    """Return the displacement (2, node row, node column) [px], up to a common multiple of the lattice's vectors.

    Parameters
    ----------
    reference, deformed
        Grey levels (row, column); NaN where nothing is known.
    images
        Pyramid of the deformed image.
    lattice
        Of the reference.
    cell
        Distance of the nodes [px].

    Returns
    -------
    ndarray or None
        None for a texture that repeats in one direction only, or whose waves are not seen in both images.
    """
    if len(lattice.vectors) < 2:
        return None
    other = find_lattice(images)
    gradient = np.zeros((2, 2)) if other is None else _match_lattices(lattice.vectors, other.vectors)
    middle = 0.5 * (np.array(reference.shape[::-1]) - 1)
    away = middle - (np.eye(2) + gradient) @ middle
    moved = cv2.warpAffine(
        np.nan_to_num(remove_shading(deformed)),
        np.column_stack([np.eye(2) + gradient, away]),
        reference.shape[::-1],
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
    )
    rest = _follow_waves(remove_shading(reference), moved, lattice, cell)
    if rest is None:
        return None
    rows, columns = (locate_nodes(n, cell) for n in rest.shape[1:])
    places = np.stack(np.meshgrid(columns - middle[0], rows - middle[1]))
    whole = np.einsum("ij,jrc->irc", gradient, places) + np.einsum("ij,jrc->irc", np.eye(2) + gradient, rest)
    return np.asarray(whole, f4)


def _match_lattices(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the smallest gradient (2, 2) that makes the first of two lattices the second."""
    if len(after) < 2:
        return np.zeros((2, 2))
    best = np.zeros((2, 2))
    least = LARGEST_STRETCH
    for counts in product(range(-2, 3), repeat=4):
        matrix = np.reshape(counts, (2, 2))
        if abs(matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]) != 1:
            continue
        gradient = (matrix @ after).T @ np.linalg.inv(before.T) - np.eye(2)
        size = float(np.linalg.norm(gradient))
        if size < least:
            best, least = gradient, size
    return best


def _follow_waves(first: np.ndarray, second: np.ndarray, lattice: Lattice, cell: int) -> np.ndarray | None:
    """Return the displacement (2, node row, node column) [px] between images with nearly the same waves."""
    waves = np.linalg.inv(lattice.vectors)  # columns are the wave vectors k_j, k_j . a_i = delta_ij
    phases = []
    for k in waves.T:
        products = _demodulate(first, k, cell) * np.conj(_demodulate(second, k, cell))
        strength = np.abs(products)
        bright = strength > _FAINT**2 * np.quantile(strength, 0.9)
        phases.append(unwrap_spatial(np.where(bright, np.angle(products), np.nan)).values / TURN)
    field = np.einsum("jrc,ji->irc", np.stack(phases), lattice.vectors).astype(f4)
    field[:, ~np.isfinite(field).all(axis=0)] = np.nan
    return inpaint(field) if np.isfinite(field).any() else None


def _demodulate(image: np.ndarray, k: np.ndarray, cell: int) -> np.ndarray:
    """Return the complex amplitude of the wave k (x, y) [1/px] at nodes, averaged over a Gaussian window."""
    y, x = (np.arange(n) for n in image.shape)
    carrier = np.exp(-1j * TURN * k[1] * y)[:, None] * np.exp(-1j * TURN * k[0] * x)
    deviation = _PERIODS / float(np.linalg.norm(k))
    parts = [cv2.GaussianBlur((image * part).astype(f4), (0, 0), deviation) for part in (carrier.real, carrier.imag)]
    rows, columns = (
        np.minimum(np.rint(locate_nodes(count, cell)).astype(int), n - 1)
        for count, n in zip(count_nodes((image.shape[0], image.shape[1]), cell), image.shape, strict=True)
    )
    return np.asarray((parts[0] + 1j * parts[1])[np.ix_(rows, columns)])
