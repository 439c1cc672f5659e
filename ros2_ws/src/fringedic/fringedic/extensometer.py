"""A virtual extensometer: two pads on a textured surface, followed from image to image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fringedic.correlation import Reference, measure_displacement
from fringedic.correlation.images import checked_image
from fringedic.errors import FringedicError, PadError, ShapeMismatchError

f4 = np.float32


@dataclass(frozen=True)
class Elongation:
    """What a virtual extensometer reads in one image.

    Attributes
    ----------
    strain
        Change of the pads' distance over their distance in the reference [-], positive in tension; NaN when not
        measured.
    sigma
        Standard uncertainty of the strain from the image noise [-].
    displacements
        (d_x, d_y) of the two pads [px], d_y > 0 downwards; shape (pad, 2).
    reason
        Why there is no strain; empty when there is.
    """

    strain: float
    sigma: float
    displacements: np.ndarray
    reason: str = ""

    @property
    def valid(self) -> bool:
        """Whether the strain was measured."""
        return not self.reason


class _Pad:
    """One pad: its texture in the reference, and where it was last."""

    def __init__(self, image: np.ndarray, name: str, centre: tuple[int, int], size: int) -> None:
        self.name = name
        self._size = size
        self._shape = image.shape
        self._centre = centre
        # twice the window, so that the point in the middle sees a whole window after a motion of some pixels
        reference = self._cut(image, 0, 0)
        if reference is None:
            raise PadError(
                f"the {name} pad at column {centre[0]}, row {centre[1]} needs {size} px around it inside the image of "
                f"{image.shape[1]}x{image.shape[0]} px"
            )
        try:
            self._reference = Reference(reference, window=size, spacing=size)
        except FringedicError as error:
            raise PadError(f"the {name} pad at column {centre[0]}, row {centre[1]}: {error}") from error
        self.displacement = np.zeros(2)
        self._step = np.zeros(2)  # of the last image, for the next

    def follow(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray] | str:
        """Displacement (d_x, d_y) and its sigmas [px], or why there are none."""
        expected = self.displacement + self._step
        moved = np.rint(expected).astype(int)
        seen = self._cut(image, moved[0], moved[1])
        if seen is None:
            return f"the {self.name} pad has left the image"
        grid = (len(self._reference.rows), len(self._reference.columns))
        rest = [np.full(grid, value, f4) for value in expected - moved]
        try:
            field = measure_displacement(self._reference, seen, initial=rest)
            if not field.valid.values[1, 1]:
                # the motion changed: look for it in the whole cut
                field = measure_displacement(self._reference, seen)
        except FringedicError as error:
            return f"the {self.name} pad is not recognised: {error}"
        if not field.valid.values[1, 1]:
            return f"the {self.name} pad is not recognised"
        measured = moved + np.array([field.displacement_x.values[1, 1], field.displacement_y.values[1, 1]], float)
        self._step = measured - self.displacement
        self.displacement = measured
        return measured, np.array([field.sigma_x.values[1, 1], field.sigma_y.values[1, 1]], float)

    def _cut(self, image: np.ndarray, right: int, down: int) -> np.ndarray | None:
        column, row = self._centre[0] + right - self._size, self._centre[1] + down - self._size
        width = 2 * self._size + 1
        if column < 0 or row < 0 or column + width > self._shape[1] or row + width > self._shape[0]:
            return None
        return image[row : row + width, column : column + width]


class VirtualExtensometer:
    """Strain between two pads, image by image.

    The strain is L / L0 - 1 with L the distance of the pads' centres: the engineering strain along the line between
    them, in the image plane. Each pad is measured against the reference image (errors do not add up) from where it is
    expected after its last motion, so a pad may move by about half its size between two images.

    Parameters
    ----------
    reference
        Grey image (row, column) at the start.
    first, second
        (column, row) of the pads' centres [px].
    pad
        Width of a pad's window [px]; twice as much around each centre has to lie in the image.

    Raises
    ------
    ColourImageError, ImageTypeError, ImageSizeError
        The reference is not a grey image.
    PadError
        A pad leaves the image or has no texture, or both are the same point.
    """

    def __init__(self, reference: ArrayLike, first: tuple[int, int], second: tuple[int, int], *, pad: int = 48) -> None:
        image = checked_image(reference, "reference")
        self._gauge = np.subtract(second, first).astype(float)
        self.gauge_length = float(np.hypot(*self._gauge))
        if self.gauge_length < 1:
            raise PadError("the two pads are the same point; their distance is the gauge length")
        self._shape = image.shape
        self._pads = (_Pad(image, "first", first, pad), _Pad(image, "second", second, pad))

    def measure(self, image: ArrayLike) -> Elongation:
        """Read the strain in one image; what cannot be measured has a reason and no numbers.

        Raises
        ------
        ColourImageError, ImageTypeError, ShapeMismatchError
            The image is not a grey image of the reference's size.
        """
        seen = checked_image(image, "image")
        if seen.shape != self._shape:
            raise ShapeMismatchError(f"image of shape {seen.shape} for a reference of shape {self._shape}")
        followed = [pad.follow(seen) for pad in self._pads]
        reasons = [each for each in followed if isinstance(each, str)]
        if reasons:
            return Elongation(math.nan, math.nan, np.full((2, 2), np.nan), "; ".join(reasons))
        displacements, sigmas = (np.array([each[part] for each in followed]) for part in (0, 1))
        line = self._gauge + displacements[1] - displacements[0]
        length = float(np.hypot(*line))
        variance = (sigmas**2).sum(axis=0) @ (line / length) ** 2
        return Elongation(length / self.gauge_length - 1, float(math.sqrt(variance)) / self.gauge_length, displacements)
