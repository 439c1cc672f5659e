"""Virtual extensometer: two gauge subsets of a textured surface, tracked from image to image."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Self

import numpy as np
from numba import get_num_threads, set_num_threads
from numpy.typing import ArrayLike

from fringedic.correlation.images import require_image
from fringedic.correlation.measure import Reference, measure_displacement
from fringedic.errors import CorrelationError, FringedicError, ImageError

f4 = np.float32


@contextmanager
def _one_thread() -> Iterator[None]:
    """Keep compiled kernels in this thread: two subsets are too small to share, a second thread costs more time."""
    threads = get_num_threads()
    set_num_threads(1)
    try:
        yield
    finally:
        set_num_threads(threads)


@dataclass(frozen=True)
class StrainReading:
    """Reading of a virtual extensometer in one image.

    Attributes
    ----------
    strain
        Change of the distance of the gauge subsets over their distance in the reference [-], positive in tension; NaN
        when not measured.
    sigma
        Standard uncertainty of the strain from the image noise [-].
    displacements
        (d_x, d_y) of the two gauge subsets [px], d_y > 0 downwards; shape (subset, 2).
    reason
        Why there is no strain; empty when there is.
    """

    strain: float
    sigma: float
    displacements: np.ndarray
    reason: str = ""

    @classmethod
    def invalid(cls, reason: str) -> Self:
        """Return a reading without numbers."""
        return cls(math.nan, math.nan, np.full((2, 2), np.nan), reason)

    def limited(self, largest_sigma: float) -> StrainReading:
        """Return the reading; without its strain when the sigma exceeds `largest_sigma` [-], or is NaN.

        Examples
        --------
        >>> import numpy as np
        >>> reading = StrainReading(0.01, 2e-3, np.zeros((2, 2)))
        >>> reading.limited(1e-2).valid, reading.limited(1e-3).reason
        (True, 'the strain is uncertain by 2000 µstrain')
        """
        if not self.valid or self.sigma <= largest_sigma:
            return self
        reason = f"the strain is uncertain by {1e6 * self.sigma:.0f} µstrain"
        return StrainReading(math.nan, self.sigma, self.displacements, reason)

    @property
    def valid(self) -> bool:
        """Whether the strain was measured."""
        return not self.reason


class _GaugeSubset:
    """One gauge subset: its texture in the reference and its last displacement."""

    def __init__(self, image: np.ndarray, name: str, centre: tuple[int, int], size: int) -> None:
        self.name = name
        self._size = size
        self._shape = image.shape
        self._centre = centre
        # twice the window, so that the window of the point in the middle is complete after a motion of some pixels
        reference = self._cut(image, 0, 0)
        if reference is None:
            raise CorrelationError(
                f"the {name} gauge subset at column {centre[0]}, row {centre[1]} needs {size} px around it inside the "
                f"image of {image.shape[1]}x{image.shape[0]} px"
            )
        try:
            self._reference = Reference(reference, window=size, spacing=size)
        except FringedicError as error:
            raise CorrelationError(
                f"the {name} gauge subset at column {centre[0]}, row {centre[1]}: {error}"
            ) from error
        self.displacement = np.zeros(2)
        self._step = np.zeros(2)  # from the image before to the last one

    def track(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray] | str:
        """Return the displacement (d_x, d_y) and its sigmas [px], or the reason why there is none."""
        expected = self.displacement + self._step
        moved = np.rint(expected).astype(int)
        seen = self._cut(image, moved[0], moved[1])
        if seen is None:
            return f"the {self.name} gauge subset has left the image"
        grid = (len(self._reference.rows), len(self._reference.columns))
        rest = [np.full(grid, value, f4) for value in expected - moved]
        try:
            field = measure_displacement(self._reference, seen, initial=rest)
            if not field.valid.values[1, 1]:
                # the motion changed: search the whole cut-out
                field = measure_displacement(self._reference, seen)
        except FringedicError as error:
            return f"the {self.name} gauge subset is not recognised: {error}"
        if not field.valid.values[1, 1]:
            return f"the {self.name} gauge subset is not recognised"
        measured = moved + np.array([field.displacement_x.values[1, 1], field.displacement_y.values[1, 1]], float)
        self._step = measured - self.displacement
        self.displacement = measured
        return measured, np.array([field.sigma_x.values[1, 1], field.sigma_y.values[1, 1]], float)

    def _cut(self, image: np.ndarray, right: int, down: int) -> np.ndarray | None:
        """Return the pixels around the moved centre, None if they are not all inside the image."""
        column, row = self._centre[0] + right - self._size, self._centre[1] + down - self._size
        width = 2 * self._size + 1
        if column < 0 or row < 0 or column + width > self._shape[1] or row + width > self._shape[0]:
            return None
        return image[row : row + width, column : column + width]


class VirtualExtensometer:
    """Strain between two gauge subsets, image by image.

    The strain is L / L0 - 1 with L the distance of the centres of the gauge subsets: the engineering strain along the
    line between them, in the image plane. Each subset is measured against the reference image (errors do not add up)
    and searched where its last motion leads, so it may move by about half its size between two images.

    Parameters
    ----------
    reference
        Grey image (row, column) at the start.
    first, second
        (column, row) of the centres of the gauge subsets [px].
    subset
        Width of a gauge subset [px]; twice as much around each centre has to be inside the image.

    Raises
    ------
    ImageError
        The reference is not a grey image.
    CorrelationError
        A gauge subset leaves the image or has no texture, or both are the same point.

    Examples
    --------
    >>> import numpy as np
    >>> texture = np.random.default_rng(1).normal(size=(60, 120)).astype(np.float32)
    >>> gauge = VirtualExtensometer(texture, first=(20, 30), second=(100, 30), subset=16)
    >>> moved = np.hstack([texture[:, :60], texture[:, 59:-1]])  # the right half by one pixel
    >>> round(gauge.measure(moved).strain, 3)  # 1 / 80
    0.013
    """

    def __init__(
        self, reference: ArrayLike, first: tuple[int, int], second: tuple[int, int], *, subset: int = 48
    ) -> None:
        image = require_image(reference, "reference")
        self._gauge = np.subtract(second, first).astype(float)
        self.gauge_length = float(np.hypot(*self._gauge))
        if self.gauge_length < 1:
            raise CorrelationError("the two gauge subsets are the same point; their distance is the gauge length")
        self._shape = image.shape
        self._subsets = (
            _GaugeSubset(image, "first", first, subset),
            _GaugeSubset(image, "second", second, subset),
        )

    def measure(self, image: ArrayLike) -> StrainReading:
        """Measure the strain in one image; if it cannot be measured, the reading contains the reason and no numbers.

        Raises
        ------
        ImageError
            The image is not a grey image of the reference's size.
        """
        seen = require_image(image, "image")
        if seen.shape != self._shape:
            raise ImageError(f"image of shape {seen.shape} for a reference of shape {self._shape}")
        with _one_thread():
            tracked = [subset.track(seen) for subset in self._subsets]
        reasons = [each for each in tracked if isinstance(each, str)]
        if reasons:
            return StrainReading.invalid("; ".join(reasons))
        displacements, sigmas = (np.array([each[part] for each in tracked]) for part in (0, 1))
        line = self._gauge + displacements[1] - displacements[0]
        length = float(np.hypot(*line))
        variance = (sigmas**2).sum(axis=0) @ (line / length) ** 2
        sigma = float(math.sqrt(variance)) / self.gauge_length
        return StrainReading(length / self.gauge_length - 1, sigma, displacements)
