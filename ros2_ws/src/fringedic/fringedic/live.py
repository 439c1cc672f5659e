"""What the camera sees now, for setting up: focus, grey levels, pattern, fringes and noise, frame by frame.

Focus is the energy of the gradient over the squared brightness (Tenengrad), without the share of the noise:
S = (mean |grad f|^2 - c sigma^2) / (mean f)^2, which neither exposure time nor gain changes, relative to the best S so
far. Frames are compared with the one before under the same light, so that the patterns may change in between.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce

import cv2
import numpy as np

from fringedic.errors import RegionError
from fringedic.image_quality import full_scale_of, image_noise, texture
from fringedic.phase import demodulate
from fringedic.sequence import PatternKind, Projection

CLASSES = 256
SOBEL_NOISE = 0.375  # sum of the squared weights of both Sobel operators, each divided by 8
PIECE = 256  # [px], what is looked at for noise and pattern: some thousand speckles
SAMPLED = 100_000  # pixels whose modulation gives the median
MOVING = 1.3  # noise of 2 x 2 pixels over half the noise of one: 1 for noise, above it something moved
PREVIEW_WIDTH = 640
RED, BLUE, YELLOW = (255, 0, 0), (0, 60, 255), (255, 220, 0)

Region = tuple[int, int, int, int]


@dataclass(frozen=True)
class Figures:
    """Figures of one frame, as in ``fringedic_msgs/LiveView``; NaN where there is nothing to tell.

    Attributes
    ----------
    region
        First column, first row, width and height that the figures are of [px].
    focus
        Sharpness, 1 at the best so far.
    mean
        [grey level].
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

    region: Region
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
    """Looks at one frame after the other.

    Parameters
    ----------
    region
        First column, first row, width and height [px]; None: all of the image.
    full_scale
        Grey level of a saturated pixel; None: that of the fewest usual bits that hold the brightest pixel so far.
    """

    def __init__(self, region: Region | None = None, full_scale: float | None = None) -> None:
        self._region = region
        self._given_full_scale = full_scale
        self.reset()

    def reset(self) -> None:
        """Forget the best focus and all frames."""
        self._full_scale = self._given_full_scale or 0.0
        self._shape: tuple[int, ...] = ()
        self._before: dict[Projection | None, np.ndarray] = {}
        self._noises: dict[Projection | None, float] = {}
        self._best: dict[Projection | None, float] = {}
        self._speckle = self._modulation = math.nan

    def look(self, image: np.ndarray, projection: Projection | None = None) -> Figures:
        """Return the figures of a frame.

        Parameters
        ----------
        image
            uint8 or uint16 (row, column) [grey level].
        projection
            What lights the surface; None: plain light, or nobody knows.

        Raises
        ------
        RegionError
            The image has no such region.
        """
        if image.shape != self._shape:
            self.reset()
            self._shape = image.shape
        region = _checked(self._region, image.shape)
        part = _part(image, region)
        if self._given_full_scale is None:
            self._full_scale = max(self._full_scale, full_scale_of([image]))
        saturated = part >= self._full_scale
        if not _shows(projection, PatternKind.FRINGES):
            self._modulation = math.nan
        noise = self._noise_and_pattern(part, projection)
        self._before[projection] = part.copy()
        if _shows(projection, PatternKind.FRINGES):
            self._look_at_fringes(projection)
        return Figures(
            region=region,
            focus=self._focus(part, saturated, projection),
            mean=float(part.mean()),
            saturated=float(saturated.mean()),
            dark=float((part == 0).mean()),
            histogram=_histogram(part, self._full_scale),
            speckle_size=self._speckle,
            modulation=self._modulation,
            noise=noise,
            full_scale=self._full_scale,
        )

    def _noise_and_pattern(self, part: np.ndarray, projection: Projection | None) -> float:
        """Noise of a pixel [grey level], NaN while something moves; and, in plain light, the size of the speckles."""
        plain = projection is None or _shows(projection, PatternKind.WHITE) or _shows(projection, PatternKind.GREY)
        if not plain and not _shows(projection, PatternKind.FRINGES):
            self._speckle = math.nan
        if projection not in self._before:
            return math.nan
        first, second = _piece(self._before[projection]), _piece(part)
        if plain:
            self._speckle = _speckle_size(first, second)
        noise = _noise(first, second)
        if not math.isnan(noise):
            self._noises[projection] = noise
        return noise

    def _focus(self, part: np.ndarray, saturated: np.ndarray, projection: Projection | None) -> float:
        """Sharpness over the best so far in this light; the noise is the last that was known."""
        if projection not in self._noises:
            return math.nan
        now = sharpness(part, self._noises[projection], saturated)
        self._best[projection] = best = max(self._best.get(projection, 0.0), now)
        return now / best if best > 0 else math.nan

    def _look_at_fringes(self, projection: Projection | None) -> None:
        """After the last shift of a cycle: amplitude of the fringes, and size of the speckles without the fringes."""
        assert projection is not None, "fringes are a projection"
        shifts = projection.shifts
        if projection.shift != shifts or shifts < 3:
            return
        cycle = [_shifted(projection, shift) for shift in range(1, shifts + 1)]
        if any(each not in self._before for each in cycle):
            return
        frames = [self._before[each] for each in cycle]
        every = math.ceil(math.sqrt(frames[0].size / SAMPLED))
        sample = np.stack([frame[::every, ::every] for frame in frames])
        self._modulation = float(np.median(demodulate(sample, shifts, noise=1.0).modulation))
        if shifts % 2 == 0 and shifts > 2:
            # every second shift makes a cycle too: two images without fringes, of independent noise
            pieces = np.stack([_piece(frame) for frame in frames])
            self._speckle = _speckle_size(pieces[::2].mean(axis=0), pieces[1::2].mean(axis=0))


def sharpness(image: np.ndarray, noise: float, saturated: np.ndarray | None = None) -> float:
    """Energy of the gradient over the squared mean, without the noise's share; 0 where noise is all there is.

    Parameters
    ----------
    image
        (row, column) [grey level].
    noise
        Standard deviation of a pixel's noise [grey level].
    saturated
        Booleans (row, column); these pixels and their neighbours do not count.
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


def preview(image: np.ndarray, figures: Figures, *, width: int = PREVIEW_WIDTH) -> np.ndarray:
    """Small picture of a frame for people: saturated pixels red, black ones blue, the region framed in yellow.

    Parameters
    ----------
    image
        uint8 or uint16 (row, column) [grey level].
    figures
        Of this frame.
    width
        Of the picture at most [px]; a pixel of it is red when any of the pixels under it is saturated.

    Returns
    -------
    ndarray
        uint8 (row, column, 3), red green blue.
    """
    factor = max(math.ceil(image.shape[1] / width), 1)
    rows, columns = (size // factor for size in image.shape)
    whole = image[: rows * factor, : columns * factor]
    under = [whole[i::factor, j::factor] for i in range(factor) for j in range(factor)]
    grey = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA) * np.float32(255 / figures.full_scale)
    picture = np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
    picture[reduce(np.minimum, under) == 0] = BLUE
    picture[reduce(np.maximum, under) >= figures.full_scale] = RED
    column, row, wide, high = (part // factor for part in figures.region)
    if (wide, high) != (columns, rows):
        cv2.rectangle(picture, (column, row), (column + wide - 1, row + high - 1), YELLOW, 2)
    return picture


def _checked(region: Region | None, shape: tuple[int, ...]) -> Region:
    rows, columns = shape
    if region is None:
        return 0, 0, columns, rows
    column, row, width, height = region
    if min(column, row) < 0 or min(width, height) < 16 or column + width > columns or row + height > rows:
        raise RegionError(
            f"the region of {width}x{height} px from column {column} and row {row} on does not lie in the image of "
            f"{columns}x{rows} px, or has fewer than 16 px along a side"
        )
    return region


def _part(image: np.ndarray, region: Region) -> np.ndarray:
    column, row, width, height = region
    return image[row : row + height, column : column + width]


def _piece(part: np.ndarray) -> np.ndarray:
    """The middle of a region as float64."""
    rows, columns = part.shape
    height, width = min(rows, PIECE), min(columns, PIECE)
    top, left = (rows - height) // 2, (columns - width) // 2
    return part[top : top + height, left : left + width].astype(np.float64)


def _noise(first: np.ndarray, second: np.ndarray) -> float:
    """Noise of a pixel, NaN where neighbours differ alike: then something moved or the light changed in places."""
    noise = image_noise(first, second, np.ones(first.shape, bool))
    coarse_first, coarse_second = _binned(first), _binned(second)
    coarse = image_noise(coarse_first, coarse_second, np.ones(coarse_first.shape, bool))
    return noise if 2 * coarse <= MOVING * noise else math.nan


def _binned(image: np.ndarray) -> np.ndarray:
    rows, columns = image.shape[0] // 2, image.shape[1] // 2
    return np.asarray(image[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2).mean(axis=(1, 3)))


def _speckle_size(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.mean(texture(first, second, np.ones(first.shape, bool))[0]))


def _histogram(part: np.ndarray, full_scale: float) -> np.ndarray:
    counts = np.bincount(part.ravel(), minlength=int(full_scale) + 1)
    levels = np.minimum(np.arange(counts.size) * CLASSES // (int(full_scale) + 1), CLASSES - 1)
    return np.bincount(levels, weights=counts, minlength=CLASSES).astype(np.uint32)


def _shows(projection: Projection | None, kind: PatternKind) -> bool:
    return projection is not None and projection.kind == kind


def _shifted(projection: Projection, shift: int) -> Projection:
    return Projection(projection.kind, projection.orientation, projection.pitch, shift, projection.shifts)
