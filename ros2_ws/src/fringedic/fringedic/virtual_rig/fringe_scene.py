"""Random scenes under fringes, without ray tracing: a specimen of any size, its background, light, camera and motion.

`VirtualRig` traces rays through a calibrated geometry. For statistics over a thousand scenes this is too slow and too
uniform; here the column of the projector at each pixel is a smooth function with a step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

_EDGE = 0.8  # blur of the specimen's outline [px]
_MARGIN = 8  # of the texture around the image, so that it can move [px]


@dataclass(frozen=True)
class FringeScene:
    """A specimen before a background, lit by the columns of a projector.

    Attributes
    ----------
    rows, columns
        Size of the image.
    seed
        Of texture and shape.
    specimen
        Part of the image that the specimen covers; 1 for the whole image.
    background
        Light that the background returns over that of the specimen; 0 for a dark one.
    dark_level
        Grey level without light of the projector.
    grey
        Mean grey level of the fringes on the specimen, before texture.
    contrast
        Modulation over the mean, without texture.
    texture, texture_size
        Standard deviation of the surface's reflectance over its mean, and the width of its spots [px].
    gamma
        Exponent of the projector's light over its grey level.
    read_noise, shot_noise
        Standard deviation without light [8-bit grey level], and growth of the variance with the level [8-bit level].
    bits
        Of a grey level: 8, 12 or 16; 0 for real numbers without rounding.
    first_column, last_column
        Of the projector, at the left and right edge of the image.
    relief
        Amplitude of the surface's waves [projector px].
    step
        Displacement of the fringes behind a step across the specimen [projector px].

    Examples
    --------
    >>> scene = FringeScene(rows=40, columns=60, seed=1, specimen=0.3)
    >>> ramp = np.tile(np.arange(240, dtype=np.uint8), (4, 1))
    >>> frame = scene.expose(ramp, index=0)
    >>> frame.shape, str(frame.dtype), bool(frame.max() > 50)
    ((40, 60), 'uint8', True)
    """

    rows: int = 450
    columns: int = 600
    seed: int = 0
    specimen: float = 1.0
    background: float = 0.0
    dark_level: float = 3.0
    grey: float = 110.0
    contrast: float = 0.9
    texture: float = 0.2
    texture_size: float = 3.0
    gamma: float = 1.0
    read_noise: float = 1.0
    shot_noise: float = 0.01
    bits: int = 8
    first_column: float = 0.0
    last_column: float = 239.0
    relief: float = 2.0
    step: float = 0.0

    @classmethod
    def random(cls, seed: int, projector_columns: int) -> FringeScene:
        """Return a scene as laboratories have them; each seed gives another one, all of them without a fault."""
        random = np.random.default_rng(seed)
        rows, columns = ((450, 600), (600, 900), (720, 1280))[random.choice(3, p=(0.7, 0.2, 0.1))]
        seen = projector_columns * random.uniform(0.3, 0.95)
        first = random.uniform(0.02, 0.98 - seen / projector_columns) * projector_columns
        return cls(
            rows=rows,
            columns=columns,
            seed=seed,
            specimen=float(random.choice([random.uniform(0.1, 0.6), random.uniform(0.6, 1.0), 1.0])),
            background=float(random.choice([0.0, 0.0, random.uniform(0.1, 1.0)])),
            dark_level=random.uniform(1.0, 20.0),
            grey=random.uniform(40.0, 90.0),
            contrast=random.uniform(0.35, 0.95),
            texture=random.uniform(0.0, 0.35),
            texture_size=random.uniform(1.5, 6.0),
            gamma=float(random.choice([1.0, random.uniform(1.0, 2.4)])),
            read_noise=random.uniform(0.3, 2.5),
            shot_noise=random.uniform(0.0, 0.03),
            bits=int(random.choice([8, 8, 12, 0])),
            first_column=first,
            last_column=first + seen,
            relief=random.uniform(0.0, 0.01) * projector_columns,
            step=float(random.choice([0.0, random.uniform(-0.03, 0.03) * projector_columns])),
        )

    def light(self, image: np.ndarray, *, motion: tuple[float, float] = (0.0, 0.0), lift: float = 0.0) -> np.ndarray:
        """Return the grey levels that a pattern gives, without noise.

        Parameters
        ----------
        image
            What the projector shows, uint8, shape (rows, columns); all its rows are alike.
        motion
            Displacement of the surface along x and y across the image [px]. A flat surface stays under its fringes.
        lift
            Displacement of the fringes, as the surface moves along the line of sight [projector px].

        Returns
        -------
        ndarray
            Grey levels of 8 bits, real numbers, shape (row, column).
        """
        shown = (image[0].astype(float) / 255) ** self.gamma
        shown = 0.5 + self.contrast * (shown - 0.5)
        lit = np.interp(self.projector_column + lift, np.arange(len(shown)), shown).astype(np.float32)
        moved = np.array([[1, 0, motion[0] - _MARGIN], [0, 1, motion[1] - _MARGIN]], float)
        texture = cv2.warpAffine(self._texture, moved, (self.columns, self.rows), flags=cv2.INTER_CUBIC)
        cover = self._cover(motion)
        return np.asarray(
            self.dark_level + 2 * self.grey * np.asarray(cover * texture + (1 - cover) * self.background) * lit
        )

    def record(self, light: np.ndarray, index: int) -> np.ndarray:
        """Return a frame of these grey levels with noise, which differs with the index, in the camera's type."""
        noise = np.random.default_rng((self.seed, index)).standard_normal(light.shape, np.float32)
        levels = light + noise * np.sqrt(self.read_noise**2 + self.shot_noise * light)
        if not self.bits:
            return np.asarray(levels, np.float32)
        scale = 2 ** (self.bits - 8)
        highest = 2**self.bits - 1
        kind = np.uint8 if self.bits == 8 else np.uint16
        return np.asarray(np.clip(np.round(levels * scale), 0, highest), kind)

    def expose(self, image: np.ndarray, index: int) -> np.ndarray:
        """Return the frame that a pattern gives."""
        return self.record(self.light(image), index)

    def without_noise(self) -> FringeScene:
        """Return the same scene without noise and without rounding."""
        return replace(self, read_noise=0.0, shot_noise=0.0, bits=0)

    @property
    def saturation(self) -> float:
        """Grey level from which a pixel of a frame is saturated."""
        return float(2**self.bits - 1) if self.bits else np.inf

    @cached_property
    def on_specimen(self) -> np.ndarray:
        """Whether a pixel shows the specimen, shape (row, column)."""
        return np.asarray(self._cover((0.0, 0.0)) > 0.5)

    @cached_property
    def _place(self) -> tuple[np.ndarray, np.ndarray]:
        y, x = np.mgrid[0 : self.rows, 0 : self.columns].astype(np.float32)
        return x, y

    @cached_property
    def _shape(self) -> np.ndarray:
        """Numbers that fix outline and relief, each 0 to 1."""
        return np.random.default_rng((self.seed, 1)).uniform(size=8)

    @cached_property
    def projector_column(self) -> np.ndarray:
        """Column of the projector that lights each pixel, shape (row, column)."""
        x, y = self._place
        waves = sum(
            np.sin(2 * np.pi * ((0.3 + each) * x / self.columns + (1 - each) * y / self.rows) + 6 * each)
            for each in self._shape[:3]
        )
        ramp = self.first_column + (self.last_column - self.first_column) * x / (self.columns - 1)
        behind = y + 0.3 * x > (0.3 + 0.4 * self._shape[3]) * self.rows + 0.15 * self.columns
        return np.asarray(ramp + self.relief * waves / 3 + self.step * behind)

    @cached_property
    def _texture(self) -> np.ndarray:
        """Reflectance of mean 1, larger than the image by a margin."""
        size = self.rows + 2 * _MARGIN, self.columns + 2 * _MARGIN
        white = np.random.default_rng((self.seed, 2)).standard_normal(size, np.float32)
        spots = cv2.GaussianBlur(white, (0, 0), self.texture_size / 2)
        return np.asarray(np.clip(1 + self.texture * spots / spots.std(), 0.05, 1.9))

    def _cover(self, motion: tuple[float, float]) -> np.ndarray:
        """Return how far each pixel shows the specimen, 0 to 1: an ellipse of the wanted area with a soft outline."""
        if self.specimen >= 1:
            return np.ones((self.rows, self.columns), np.float32)
        x, y = self._place
        area = self.specimen * self.rows * self.columns
        aspect = 0.7 + 0.6 * self._shape[4]
        half = np.sqrt(area / np.pi * aspect), np.sqrt(area / np.pi / aspect)
        centre = [
            min(max(size * place, part), size - part) if 2 * part < size else 0.5 * size
            for size, place, part in zip((self.columns, self.rows), self._shape[5:7], half, strict=True)
        ]
        away = np.hypot((x - centre[0] - motion[0]) / half[0], (y - centre[1] - motion[1]) / half[1]) - 1
        return np.asarray(np.clip(0.5 - away * min(half) / (2 * _EDGE), 0, 1))
