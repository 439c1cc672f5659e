"""Periodic textures: how a reference repeats, and which of the displacements that it allows is the true one.

A texture that repeats after a vector a looks the same after any displacement a + d(p + a). Grids, fabrics and
perforated plates do. What is not periodic in the texture, such as dirt and uneven printing, decides between these
displacements. Where nothing does, the smallest is taken, or the one that is closest to the expected one, and the
vectors are stated with the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import cv2
import numpy as np
import scipy.fft
from scipy.ndimage import maximum_filter

from fringedic.correlation.pyramid import find_level, remove_shading

f4 = np.float32

# Autocorrelation from which on a texture counts as periodic: the rest is then up to 2 / 5 of its variance. Speckle of
# 25 px in an image of 512 px reaches .3. test_random_texture_is_not_periodic
PERIODIC = 0.6
WIDEST = 512  # [px] of the part, or of the level, in which repetitions are sought
_SECOND = 0.45  # the same of the second vector, which an object in front of the surface lowers
# Of the surface, with which its texture has to agree. The few pixels that a narrow strip shares with itself across its
# width agree by chance. An image that is known everywhere has .4 for the longest shift. test_a_narrow_strip_is_measured
_LEAST_OVERLAP = 0.25
_SHADING = 65  # [px], width of the local mean and contrast, which do not count as texture
_LEAST_CONTRAST = 0.1  # of the largest one; with less an image is noise
# Of the autocorrelation at a repetition, below which it falls before it: to 0.45 in grids and perforated plates. Along
# straight edges it has maxima without falling. test_straight_edges_are_no_repetition
_DIP = 0.75
SMALLEST_PERIOD = 3.0  # [px], with less the samples of a period do not tell where it is
SAMPLES = 4.0  # [px of a level] per period, below which the halves of an image show a moire instead of the texture
_SMALLEST_ANGLE = np.sin(np.deg2rad(20))  # between both vectors
_PROPOSED = 4  # displacements that the correlation of what is not periodic proposes
# Standard errors by which a displacement has to be better than another one; test_random_part_decides. It is 12 and more
# where the texture decides, and up to 4 by errors of interpolation, which repeat too, in images without noise. A false
# choice once in 10^15 for normal distributions, and in 10^6 with the few blocks of a small image.
DECIDED = 8.0
_BLOCK = 32  # [px]: blocks whose products are independent of each other
_FEWEST_BLOCKS = 12


@dataclass(frozen=True, eq=False)
class Lattice:
    """Vectors after which a texture repeats.

    Attributes
    ----------
    vectors
        (2, 2) [px], one (x, y) each, the shorter one first; (1, 2) of a texture that repeats in one direction only.
    """

    vectors: np.ndarray

    @property
    def shortest(self) -> float:
        """Length of the shorter vector [px]."""
        return float(np.linalg.norm(self.vectors[0]))

    def multiples(self, reach: tuple[float, float]) -> np.ndarray:
        """Return all vectors (n, 2) between -reach and reach (x, y) [px] after which the texture repeats."""
        most = [int(np.hypot(*reach) / np.linalg.norm(vector) / _SMALLEST_ANGLE) for vector in self.vectors]
        counts = np.array(list(product(*(range(-n, n + 1) for n in most))), float)
        vectors = counts @ self.vectors
        return np.asarray(vectors[(np.abs(vectors) <= np.asarray(reach)).all(axis=1)])


@dataclass(frozen=True, eq=False)
class Choice:
    """The displacement that was chosen among those of a periodic texture.

    Attributes
    ----------
    shift
        Vector (x, y) [px of the reference] of the chosen displacement from the measured one; zero keeps it.
    unique
        Whether the texture decides; otherwise others are as probable.
    """

    shift: np.ndarray
    unique: bool


def find_lattice(images: list[np.ndarray]) -> Lattice | None:
    """Find the vectors after which a texture repeats.

    Parameters
    ----------
    images
        Pyramid of grey levels (row, column), finest first; NaN where nothing is known.

    Returns
    -------
    Lattice or None
        None where less than three fifths of its variance repeat.
    """
    level = find_level(images, WIDEST)
    for k in (0, level) if level else (0,):
        rows, columns = ((n - min(n, WIDEST)) // 2 for n in images[k].shape)
        part = images[k][rows : rows + WIDEST, columns : columns + WIDEST]
        vectors = _find_vectors(np.ascontiguousarray(part))
        if vectors is not None:
            return Lattice(2**k * vectors)
    return None


def keep_resolved(images: list[np.ndarray], lattice: Lattice | None) -> list[np.ndarray]:
    """Return the levels of a pyramid on which a periodic texture is seen as it is; all of them without a lattice."""
    if lattice is None:
        return images
    halvings = int(np.log2(max(lattice.shortest / SAMPLES, 1)))
    return images[: halvings + 1]


def _autocorrelate(image: np.ndarray) -> np.ndarray:
    """Return the autocorrelation for shifts (y, x) of up to a quarter of the image, with 0 in the middle."""
    known = np.isfinite(image)
    flat = np.where(known, image, f4(0))
    around = (_SHADING, _SHADING)
    flat = np.where(known, flat - cv2.blur(flat, around), f4(0))
    contrast = np.sqrt(np.maximum(cv2.blur(flat * flat, around), 0))  # sums of rounded values are below 0 at borders
    flat /= np.maximum(contrast, f4(_LEAST_CONTRAST) * contrast.max() + f4(1e-12))
    taper = _taper(image.shape)
    overlap = _taper_overlap(image.shape) if known.all() else _correlate(taper * known)
    enough = overlap > f4(_LEAST_OVERLAP) * overlap.max()
    surface = np.where(enough, _correlate(taper * flat), f4(0)) / np.where(enough, overlap, f4(1))
    return np.asarray(surface / max(float(surface[tuple(n // 2 for n in surface.shape)]), 1e-12))


def _correlate(values: np.ndarray) -> np.ndarray:
    """Return the sums of the products of an array and the shifted one, for shifts of up to a quarter of its size."""
    spectrum = scipy.fft.rfft2(values)
    power = (spectrum.real**2 + spectrum.imag**2).astype(f4)
    surface = scipy.fft.irfft2(power, values.shape)
    rows, columns = (np.arange(-(n // 4), n // 4 + 1) for n in values.shape)
    return np.asarray(surface[np.ix_(rows, columns)])


@lru_cache(maxsize=16)
def _taper(shape: tuple[int, int]) -> np.ndarray:
    """Return a window whose ends do not meet across the borders of an image."""
    return np.outer(*(np.hanning(n + 2)[1:-1] for n in shape)).astype(f4)


@lru_cache(maxsize=16)
def _taper_overlap(shape: tuple[int, int]) -> np.ndarray:
    return _correlate(_taper(shape))


def _find_vectors(image: np.ndarray) -> np.ndarray | None:
    surface = _autocorrelate(image)
    centre = np.array(surface.shape) // 2
    rows, columns = np.nonzero((surface == cv2.dilate(surface, np.ones((3, 3)))) & (surface > _SECOND))
    away = np.stack([rows, columns], axis=1) - centre
    inside = (np.abs(away) < centre).all(axis=1)  # an interpolation needs the neighbours
    length = np.hypot(*away.T)
    away = away[inside & (length >= SMALLEST_PERIOD)]
    away = away[[_falls_between(surface, vector) for vector in away]] if len(away) else away
    away = away[np.argsort(np.hypot(*away.T), kind="stable")]
    clear = [surface[tuple(centre + vector)] > PERIODIC for vector in away]
    if not any(clear):
        return None
    first = away[clear.index(True)]
    across = np.abs(first[0] * away[:, 1] - first[1] * away[:, 0])
    apart = across > _SMALLEST_ANGLE * np.hypot(*first) * np.hypot(*away.T)
    chosen = [first, away[apart][0]] if apart.any() else [first]
    return np.array([_refine(surface, vector)[::-1] for vector in chosen])


def _falls_between(surface: np.ndarray, vector: np.ndarray) -> bool:
    """Return whether the autocorrelation is clearly lower on the way to a maximum at a vector (y, x) than there."""
    centre = np.array(surface.shape) // 2
    steps = np.linspace(0, 1, int(np.abs(vector).max()) + 1)
    way = surface[tuple(np.rint(centre[:, None] + np.outer(vector, steps)).astype(int))]
    return bool(way.min() < _DIP * way[-1])


def _refine(surface: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return a vector (y, x) to a small part of a pixel, from the farthest of its multiples that repeats too."""
    centre = np.array(surface.shape) // 2
    best, count = _find_top(surface, centre + vector) - centre, 1
    while True:
        expected = 2 * best
        near = centre + np.rint(expected).astype(int)
        if (near < 2).any() or (near + 2 >= surface.shape).any():
            break
        window = surface[near[0] - 1 : near[0] + 2, near[1] - 1 : near[1] + 2]
        top = np.array(np.unravel_index(int(np.argmax(window)), window.shape)) - 1
        found = _find_top(surface, near + top) - centre
        if window.max() < PERIODIC or np.abs(found - expected).max() > 1:
            break
        best, count = found, 2 * count
    return np.asarray(best / count)


def _find_top(surface: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the top of the parabolas through a maximum and its neighbours."""
    top = place.astype(float)
    for axis in range(2):
        step = np.eye(2, dtype=int)[axis]
        before, at, after = (float(surface[tuple(place + k * step)]) for k in (-1, 0, 1))
        bend = before - 2 * at + after
        top[axis] += float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0
    return top


def choose_displacement(
    reference: np.ndarray,
    deformed: np.ndarray,
    displacement: np.ndarray,
    gradient: np.ndarray,
    lattice: Lattice,
    expected: np.ndarray,
) -> Choice:
    """Choose among the displacements that a periodic texture allows.

    What is not periodic in the reference is its difference from the mean of its repetitions. The displacement with
    which the deformed image contains most of it is compared with the most welcome one, block by block: it is taken
    where the difference of the products exceeds its standard error `DECIDED` times.

    Parameters
    ----------
    reference, deformed
        Grey levels (row, column); NaN where nothing is known.
    displacement
        (2, row, column) [px] of the reference's pixels, one of those allowed; NaN where not known.
    gradient
        Mean gradient (2, 2) of the displacement.
    lattice
        Of the reference.
    expected
        Mean displacement (x, y) [px] that is the most welcome one, zero or that of a prediction.
    """
    first, second = remove_shading(reference), remove_shading(deformed)
    second[~np.isfinite(deformed)] = np.nan
    uneven, mean = _split(first, lattice)
    known = np.isfinite(displacement[0]) & np.isfinite(uneven)
    uneven = np.where(known, uneven, 0)
    turned = np.eye(2) + gradient
    rows, columns = reference.shape
    shifts = lattice.multiples((columns / 2, rows / 2))
    moved = np.array([np.nanmean(part) for part in displacement]) - expected
    welcome = shifts[np.argmin(np.hypot(*(moved + shifts @ turned.T).T))]
    still = _move_back(second, displacement)
    candidates = _unique_rows([np.zeros(2), welcome, *_propose(uneven, _split(still, lattice)[0], shifts)])
    products = np.array(
        [
            _block_products(uneven, _move_back(second, shift_by_repetition(displacement, gradient, each)) - mean)
            for each in candidates
        ]
    )
    totals = np.nansum(products, axis=1)
    best = int(np.argmax(totals))
    equal = [i for i, each in enumerate(products) if i == best or not _exceeds(products[best] - each)]
    away = [float(np.hypot(*(moved + turned @ candidates[index]))) for index in equal]
    return Choice(candidates[equal[int(np.argmin(away))]], len(equal) == 1)


def shift_by_repetition(
    displacement: np.ndarray, gradient: np.ndarray, shift: np.ndarray, spacing: int = 1
) -> np.ndarray:
    """Return the displacement d'(p) = a + d(p + a) that a texture with the repetition a allows beside d.

    Where d(p + a) is not known it is d(p) plus what the mean gradient of the displacement adds.

    Parameters
    ----------
    displacement
        (2, row, column) [px]; NaN where not known.
    gradient
        Its mean gradient (2, 2).
    shift
        a (x, y) [px].
    spacing
        Distance of its points [px].
    """
    rows, columns = np.indices(displacement.shape[1:], f4)
    x, y = (np.asarray(each + f4(part / spacing)) for each, part in zip((columns, rows), shift, strict=True))
    nothing = float("nan")
    there = [
        cv2.remap(part.astype(f4), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=nothing)
        for part in displacement
    ]
    near = displacement + (gradient @ shift)[:, None, None]
    return np.asarray(shift[:, None, None] + np.where(np.isfinite(there), there, near))


def _unique_rows(vectors: list[np.ndarray]) -> list[np.ndarray]:
    kept: list[np.ndarray] = []
    for vector in vectors:
        if all(np.abs(vector - other).max() > 1 for other in kept):
            kept.append(vector)
    return kept


def _split(image: np.ndarray, lattice: Lattice) -> tuple[np.ndarray, np.ndarray]:
    """Return what is not periodic in an image, NaN at borders, and the mean of its repetitions."""
    shape = image.shape[1], image.shape[0]
    copies = [
        cv2.warpAffine(
            image,
            np.array([[1, 0, sign * x], [0, 1, sign * y]]),
            shape,
            flags=cv2.INTER_LANCZOS4,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        )
        for x, y in lattice.vectors
        for sign in (1, -1)
    ]
    mean = np.mean(copies, axis=0)
    return image - mean, mean


def _move_back(deformed: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """Return the deformed image at the displaced pixels of the reference, NaN where it is not known."""
    rows, columns = np.indices(deformed.shape, f4)
    x, y = (
        np.where(np.isfinite(each), each, f4(-10)).astype(f4)
        for each in (columns + displacement[0], rows + displacement[1])
    )
    nothing = float("nan")
    moved = cv2.remap(deformed, x, y, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_CONSTANT, borderValue=nothing)
    return np.asarray(moved)


def _propose(uneven: np.ndarray, moved: np.ndarray, shifts: np.ndarray) -> list[np.ndarray]:
    """Return the shifts with the highest correlation of what is not periodic in both images."""
    shape = [scipy.fft.next_fast_len(2 * n, real=True) for n in uneven.shape]
    spectra = [scipy.fft.rfft2(np.nan_to_num(each), shape) for each in (uneven, moved)]
    surface = maximum_filter(scipy.fft.irfft2(np.conj(spectra[0]) * spectra[1], shape), 3, mode="wrap")
    places = np.rint(shifts[:, ::-1]).astype(int)
    heights = surface[places[:, 0], places[:, 1]]  # negative shifts count from the end
    return list(shifts[np.argsort(-heights)[:_PROPOSED]])


def _block_products(uneven: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Return the means over blocks of what is not periodic in the reference times what is left of the other image."""
    rows, columns = (n // _BLOCK * _BLOCK for n in uneven.shape)
    products = np.where(np.isfinite(rest), uneven * np.nan_to_num(rest), 0)[:rows, :columns]
    seen = (np.isfinite(rest) & (uneven != 0))[:rows, :columns]
    blocks = (rows // _BLOCK, _BLOCK, columns // _BLOCK, _BLOCK)
    number = seen.reshape(blocks).sum(axis=(1, 3))
    total = products.reshape(blocks).sum(axis=(1, 3), dtype=np.float64)
    return np.where(number > _BLOCK**2 / 2, total / np.maximum(number, 1), np.nan).ravel()


def _exceeds(differences: np.ndarray) -> bool:
    """Return whether the mean of differences is above zero, by `DECIDED` standard errors."""
    known = differences[np.isfinite(differences)]
    if known.size < _FEWEST_BLOCKS:
        return False
    return bool(known.mean() > DECIDED * known.std(ddof=1) / np.sqrt(known.size))
