"""Sample of a stack for its checks: grey levels of a few thousand pixels, and the sinusoids through them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from fringedic.patterns.pattern import Orientation
from fringedic.phase.layout import Layout, shift_angles
from fringedic.phase.sinusoids import fit_wave

SAMPLES = 6000  # pixels: the checks of 20 frames then take about 20 ms (docs/validation/phase.md)
_GOLDEN = 0.618034  # each row of the sample is displaced by this part of a step: no fringe pitch is in step with it
_MANY_FRINGES = 5.0
_FINEST_SKIP = 3  # a pixel and its neighbours are used once


@dataclass
class Sample:
    """Some pixels of a stack with their neighbours, and the sinusoids of each pitch at these pixels.

    Attributes
    ----------
    layout
        Layout of the stack.
    levels, right, left, below, above
        Grey levels at the pixel, and one pixel to the right, left, below and above, shape (frame, pixel).
    x, y
        Position in the image, -1 to 1, shape (pixel,).
    size
        Rows and columns of the image.
    angles
        2 pi k / q of the frames of each pitch [rad].
    fits
        Mean, B cos(phi) and B sin(phi) of each pitch [grey level], shape (3, pixel).
    """

    layout: Layout
    levels: np.ndarray
    right: np.ndarray
    left: np.ndarray
    below: np.ndarray
    above: np.ndarray
    x: np.ndarray
    y: np.ndarray
    size: tuple[int, int]
    angles: list[np.ndarray] = field(default_factory=list)
    fits: list[np.ndarray] = field(default_factory=list)
    _growth: dict[int, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.angles:
            self.angles = [shift_angles(period) for period in self.layout.periods]
            self.fits = [fit_wave(*each) for each in zip(self.groups(), self.angles, strict=True)]

    @classmethod
    def from_stack(
        cls, frames: np.ndarray, layout: Layout, pixels: int = SAMPLES, region: np.ndarray | None = None
    ) -> Sample:
        """Sample a stack, shape (frame, row, column), at about so many pixels that cover the image evenly.

        A region (row, column) limits them to its True pixels.
        """
        _, rows, columns = frames.shape
        if region is None:
            place = _places(rows, columns, pixels)
        else:
            place = _places(rows, columns, round(pixels / max(float(region.mean()), pixels / region.size)))
            place = place[region.ravel()[place]]
        flat = frames.reshape(len(frames), -1)

        def at(step: int) -> np.ndarray:
            return np.take(flat, place + step, axis=1).astype(np.float32)

        return cls(
            layout=layout,
            levels=at(0),
            right=at(1),
            left=at(-1),
            below=at(columns),
            above=at(-columns),
            x=2 * (place % columns) / max(columns - 1, 1) - 1,
            y=2 * (place // columns) / max(rows - 1, 1) - 1,
            size=(rows, columns),
        )

    def select(self, which: np.ndarray) -> Sample:
        """Return some of the pixels, selected by a mask."""
        if which.all():
            return self
        return replace(
            self,
            levels=self.levels[:, which],
            right=self.right[:, which],
            left=self.left[:, which],
            below=self.below[:, which],
            above=self.above[:, which],
            x=self.x[which],
            y=self.y[which],
            fits=[fit[:, which] for fit in self.fits],
            _growth={number: growth[which] for number, growth in self._growth.items()},
        )

    def with_light(self, gains: np.ndarray) -> Sample:
        """Return the sample with the grey levels of each frame divided by the light of that frame."""
        factor = (1 / gains[:, None]).astype(np.float32)
        parts = {name: getattr(self, name) * factor for name in ("levels", "right", "left", "below", "above")}
        return replace(self, **parts, angles=[], fits=[], _growth={})

    def thin(self, pixels: int) -> Sample:
        """Return about so many of the pixels."""
        count = self.levels.shape[1]
        return self.select(np.arange(count) % max(1, count // pixels) == 0)

    def groups(self) -> list[np.ndarray]:
        """Return the grey levels of each pitch, each of shape (frame, pixel)."""
        return [self.levels[where] for where in self.layout.slices()]

    @property
    def is_vertical(self) -> bool:
        """Whether the fringes are vertical, so that the phase grows with x."""
        return self.layout.periods[0][0].orientation == Orientation.VERTICAL

    def along_fringes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the grey levels of the two neighbours along the fringes, whose phase is nearly the same."""
        return (self.above, self.below) if self.is_vertical else (self.left, self.right)

    def growth(self, number: int) -> np.ndarray:
        """Return exp(i d) of each pixel, d being the growth of the phase of a pitch over two pixels."""
        if number not in self._growth:
            where, angles = self.layout.slices()[number], self.angles[number]
            ends = (self.right, self.left) if self.is_vertical else (self.above, self.below)
            after, before = (fit_wave(each[where], angles) for each in ends)
            turned = (after[1] + 1j * after[2]) * (before[1] - 1j * before[2])
            self._growth[number] = np.asarray(turned / np.maximum(np.abs(turned), np.float32(1e-6)))
        return self._growth[number]

    @property
    def has_many_fringes(self) -> bool:
        """Whether so many of the finest fringes are in view that their phases are spread evenly over the circle."""
        if self.layout.code:  # gives the number of fringes also where the fringes are wrong
            code = self.levels[: self.layout.code]
            numbers = half_periods(code > 0.5 * (code.min(axis=0) + code.max(axis=0)))
            return 0.5 * float(np.subtract(*np.percentile(numbers, [95, 5]))) > _MANY_FRINGES
        place, length = (self.x, self.size[1]) if self.is_vertical else (self.y, self.size[0])
        growth = np.abs(np.angle(self.growth(len(self.fits) - 1)))
        return 0.5 * float(np.ptp(place)) * length * 0.5 * float(np.median(growth)) / (2 * np.pi) > _MANY_FRINGES


def _places(rows: int, columns: int, pixels: int) -> np.ndarray:
    """Return the flat indices of about so many pixels, none of them at the border of the image."""
    height, width = max(rows - 2, 0), max(columns - 2, 0)
    skip = max(_FINEST_SKIP, math.ceil(math.sqrt(rows * columns / pixels)))
    row = np.arange(0, height, skip)
    column = np.arange(0, width, skip)[None] + (skip * (row // skip * _GOLDEN % 1)).astype(int)[:, None]
    inside = column < width
    return np.asarray(((row[:, None] + 1) * columns + column + 1)[inside])


def half_periods(bits: np.ndarray) -> np.ndarray:
    """Return the numbers that the bits of a Gray code, shape (bit, pixel), encode."""
    numbers = np.zeros(bits.shape[1], int)
    for bit in np.logical_xor.accumulate(bits):
        numbers = 2 * numbers + bit
    return numbers
