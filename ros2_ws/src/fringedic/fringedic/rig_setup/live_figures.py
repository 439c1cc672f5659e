"""Figures of a live image while a rig is set up: focus, grey levels, noise, speckle size, fringe modulation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from fringedic.errors import ImageError
from fringedic.frames.image_quality import full_scale_of, image_noise, texture
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.phase import demodulate

CLASSES = 256
SOBEL_NOISE = 0.375  # sum of the squared weights of both Sobel operators, each divided by 8
PIECE = 256  # [px], side of the part for noise and speckles: some thousand speckles
SAMPLED = 100_000  # pixels whose modulation gives the median, to 0.5 %
MOVING = 1.3  # noise of 2 x 2 pixels over half the noise of one: 1 for white noise, larger when something moved
Rectangle = tuple[int, int, int, int]
"""First column, first row, width and height in an image [px]."""


@dataclass(frozen=True)
class Figures:
    """Figures of one frame, as in ``fringedic_msgs/LiveView``; NaN where not measured.

    Attributes
    ----------
    region
        First column, first row, width and height of the evaluated part [px].
    focus
        Sharpness over the best so far, 0 to 1.
    mean
        Mean brightness [grey level].
    saturated, dark
        Share of the pixels at the full scale and at zero, 0 to 1.
    histogram
        Pixels in each of 256 classes from zero to full scale, uint32.
    speckle_size
        Full width at half height of the autocorrelation of the surface's pattern, mean of both directions [px].
    modulation
        Median amplitude of the fringes over the last cycle of shifts [grey level].
    noise
        Standard deviation of one pixel from frame to frame [grey level]; NaN while something moves.
    full_scale
        Grey level of a saturated pixel.
    """

    region: Rectangle
    focus: float
    mean: float
    saturated: float
    dark: float
    histogram: np.ndarray
    speckle_size: float
    modulation: float
    noise: float
    full_scale: float


class LiveView:
    """Evaluates one frame after the other while a rig is set up.

    Parameters
    ----------
    region
        First column, first row, width and height [px]; None for the whole image.
    full_scale
        Grey level of a saturated pixel; None for that of the fewest usual bits that hold the brightest pixel so far.

    Examples
    --------
    >>> import numpy as np
    >>> random = np.random.default_rng(1)
    >>> view = LiveView(region=(8, 8, 32, 32), full_scale=255)
    >>> for _ in range(2):
    ...     figures = view.look(np.rint(random.normal(100, 2, (48, 64))).astype(np.uint8))
    >>> round(figures.noise), round(figures.mean), figures.saturated
    (2, 100, 0.0)
    """

    def __init__(self, region: Rectangle | None = None, full_scale: float | None = None) -> None:
        self._region = region
        self._given_full_scale = full_scale
        self.reset()

    def reset(self) -> None:
        """Forget the best focus and all frames."""
        self._full_scale = self._given_full_scale or 0.0
        self._shape: tuple[int, ...] = ()
        self._before: dict[ProjectedPattern | None, np.ndarray] = {}
        self._noises: dict[ProjectedPattern | None, float] = {}
        self._best: dict[ProjectedPattern | None, float] = {}
        self._speckle = self._modulation = math.nan

    def look(self, image: np.ndarray, pattern: ProjectedPattern | None = None) -> Figures:
        """Return the figures of a frame.

        Parameters
        ----------
        image
            uint8 or uint16 (row, column) [grey level].
        pattern
            The projected pattern; None for plain or unknown light.

        Raises
        ------
        ImageError
            The region is not inside the image.
        """
        if image.shape != self._shape:
            self.reset()
            self._shape = image.shape
        region = self._region
        rows, columns = image.shape
        if region is None:
            region = 0, 0, columns, rows
        else:
            column, row, width, height = region
            if min(column, row) < 0 or min(width, height) < 16 or column + width > columns or row + height > rows:
                raise ImageError(
                    f"the region of {width}x{height} px from column {column} and row {row} is not inside the image of "
                    f"{columns}x{rows} px, or has fewer than 16 px along a side"
                )
        column, row, width, height = region
        part = image[row : row + height, column : column + width]
        if self._given_full_scale is None:
            self._full_scale = max(self._full_scale, full_scale_of([image]))
        saturated = part >= self._full_scale
        if not _shows(pattern, PatternKind.FRINGES):
            self._modulation = math.nan
        plain = pattern is None or _shows(pattern, PatternKind.WHITE) or _shows(pattern, PatternKind.GREY)
        if not plain and not _shows(pattern, PatternKind.FRINGES):
            self._speckle = math.nan
        if pattern not in self._before:
            noise = math.nan
        else:
            first, second = _piece(self._before[pattern]), _piece(part)
            if plain:
                self._speckle = _speckle_size(first, second)
            # Neighbours that change alike show motion, or light that changes locally.
            noise = image_noise(first, second, np.ones(first.shape, bool))
            coarse_first, coarse_second = _binned(first), _binned(second)
            coarse = image_noise(coarse_first, coarse_second, np.ones(coarse_first.shape, bool))
            noise = noise if 2 * coarse <= MOVING * noise else math.nan
            if not math.isnan(noise):
                self._noises[pattern] = noise
        self._before[pattern] = part.copy()
        if _shows(pattern, PatternKind.FRINGES):
            self._look_at_fringes(pattern)
        counts = np.bincount(part.ravel(), minlength=int(self._full_scale) + 1)
        levels = np.minimum(np.arange(counts.size) * CLASSES // (int(self._full_scale) + 1), CLASSES - 1)
        if pattern not in self._noises:
            focus = math.nan
        else:
            now = sharpness(part, self._noises[pattern], saturated)
            self._best[pattern] = best = max(self._best.get(pattern, 0.0), now)
            focus = now / best if best > 0 else math.nan
        return Figures(
            region=region,
            focus=focus,
            mean=float(part.mean()),
            saturated=float(saturated.mean()),
            dark=float((part == 0).mean()),
            histogram=np.bincount(levels, weights=counts, minlength=CLASSES).astype(np.uint32),
            speckle_size=self._speckle,
            modulation=self._modulation,
            noise=noise,
            full_scale=self._full_scale,
        )

    def _look_at_fringes(self, pattern: ProjectedPattern | None) -> None:
        """Update modulation and speckle size after the last shift of a cycle."""
        assert pattern is not None, "fringes are a pattern"
        shifts = pattern.shifts
        if pattern.shift != shifts or shifts < 3:
            return
        cycle = [
            ProjectedPattern(pattern.kind, pattern.orientation, pattern.pitch, shift, pattern.shifts)
            for shift in range(1, shifts + 1)
        ]
        if any(each not in self._before for each in cycle):
            return
        frames = [self._before[each] for each in cycle]
        every = math.ceil(math.sqrt(frames[0].size / SAMPLED))
        sample = np.stack([frame[::every, ::every] for frame in frames])
        self._modulation = float(np.median(demodulate(sample, shifts, noise=1.0).modulation))
        if shifts % 2 == 0 and shifts > 2:
            # every second shift is a cycle, too: two images without fringes and with independent noise
            pieces = np.stack([_piece(frame) for frame in frames])
            self._speckle = _speckle_size(pieces[::2].mean(axis=0), pieces[1::2].mean(axis=0))


def sharpness(image: np.ndarray, noise: float, saturated: np.ndarray | None = None) -> float:
    """Return the energy of the gradient over the squared mean, without the noise's share; 0 for pure noise.

    Parameters
    ----------
    image
        (row, column) [grey level].
    noise
        Standard deviation of a pixel's noise [grey level].
    saturated
        Booleans (row, column); these pixels and their neighbours are left out.
    """
    grey = image.astype(np.float32)
    along_x = cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=1 / 8)
    along_y = cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=1 / 8)
    energy = along_x * along_x + along_y * along_y
    if saturated is not None and saturated.any():
        counted = cv2.dilate(saturated.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0
        if not counted.any():
            return 0.0
        energy, grey = energy[counted], grey[counted]
    brightness = float(grey.mean(dtype=np.float64))
    if brightness <= 0:
        return 0.0
    return max(float(energy.mean(dtype=np.float64)) - SOBEL_NOISE * noise**2, 0.0) / brightness**2


def _piece(part: np.ndarray) -> np.ndarray:
    """Return the middle of a region as float64."""
    rows, columns = part.shape
    height, width = min(rows, PIECE), min(columns, PIECE)
    top, left = (rows - height) // 2, (columns - width) // 2
    return part[top : top + height, left : left + width].astype(np.float64)


def _binned(image: np.ndarray) -> np.ndarray:
    rows, columns = image.shape[0] // 2, image.shape[1] // 2
    return np.asarray(image[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2).mean(axis=(1, 3)))


def _speckle_size(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.mean(texture(first, second, np.ones(first.shape, bool))[0]))


def _shows(pattern: ProjectedPattern | None, kind: PatternKind) -> bool:
    return pattern is not None and pattern.kind == kind
