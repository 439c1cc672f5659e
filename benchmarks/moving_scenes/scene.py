"""Frames of a speckled surface that moves while fringes are shifted, computed without the library.

The camera is orthographic: the image position of a point is its x and y [px] from the middle. Fringes fall in at an
angle, so that the phase of a point at x and height z is 2 pi (x + slope z) / pitch. Texture is a sum of waves through a
saturating function, heights are Gaussian bumps; both are exact functions of the material point, and the motion has an
exact inverse. Lens and pixels blur the image, which displaces the phase where the texture has a gradient, at rest too:
errors are counted from the phase that frames at rest without noise have.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import gaussian_filter

TURN = 2 * np.pi
_WAVES = 160


@dataclass(frozen=True)
class Shown:
    """Fringes of one frame: pitch [px], shift k of q; a pitch of 0 is white light."""

    pitch: float
    shift: int = 0
    shifts: int = 1


def linear(time: float) -> float:
    """Return the course of a constant rate."""
    return time


@dataclass(frozen=True)
class Motion:
    """Displacement of the point at (x, y) from the middle of the image, course(t) times a rate for each frame.

    Attributes
    ----------
    right, down, up
        Rates of translation [px/frame], up towards the camera.
    gradient
        ((d right/dx, d right/dy), (d down/dx, d down/dy)), rates [1/frame].
    tilt
        Rate of w along x and y [1/frame].
    course
        Course in time, 0 at 0.
    """

    right: float = 0.0
    down: float = 0.0
    up: float = 0.0
    gradient: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    tilt: tuple[float, float] = (0.0, 0.0)
    course: Callable[[float], float] = linear


@dataclass(frozen=True)
class Scene:
    """Surface, light and camera.

    Attributes
    ----------
    rows, columns
        Size of the image.
    seed
        Of texture, heights and noise.
    slope
        Change of the fringes' position by height [px/px].
    height, radius
        Of the bumps [px].
    feature
        Standard deviation of the texture's autocorrelation [px].
    contrast
        0 for no texture, 1 for paint between black and white.
    bright, modulation
        Grey level of the brightest paint in the mean of the fringes, and modulation over mean.
    read, shot
        Noise: standard deviation [grey level] and growth of the variance with the level.
    exposure
        Part of the interval of two frames.
    blur
        Standard deviation of the point spread of lens and pixels [px].
    instants
        Of an exposure whose mean is the blurred frame.
    """

    rows: int = 240
    columns: int = 320
    seed: int = 0
    slope: float = 0.5
    height: float = 12.0
    radius: float = 90.0
    feature: float = 1.6
    contrast: float = 0.75
    bright: float = 110.0
    modulation: float = 0.8
    read: float = 1.0
    shot: float = 0.02
    exposure: float = 0.0
    blur: float = 0.7
    instants: int = 5
    _drawn: dict[str, np.ndarray] = field(default_factory=dict, repr=False)

    def _waves(self) -> tuple[np.ndarray, np.ndarray]:
        if "waves" not in self._drawn:
            random = np.random.default_rng((self.seed, 1))
            self._drawn["waves"] = random.normal(0, 1 / self.feature, (2, _WAVES))
            self._drawn["phases"] = random.uniform(0, TURN, _WAVES)
            self._drawn["bumps"] = np.stack(
                [
                    random.uniform(-0.4, 0.4, 3) * self.columns,
                    random.uniform(-0.4, 0.4, 3) * self.rows,
                    random.uniform(0.3, 1.0, 3) * self.height,
                ],
                axis=1,
            )
        return self._drawn["waves"], self._drawn["phases"]

    def relief(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the height of the material points at (x, y) from the middle [px]."""
        self._waves()
        parts = [
            top * np.exp(-((x - right) ** 2 + (y - down) ** 2) / (2 * self.radius**2))
            for right, down, top in self._drawn["bumps"]
        ]
        return np.sum(parts, axis=0)

    def _paint(self, inverse: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Return the reflectance at material = inverse @ pixel + offset; waves are products of rows and columns."""
        (kx, ky), phases = self._waves()
        along = kx * inverse[0, 0] + ky * inverse[1, 0]
        across = kx * inverse[0, 1] + ky * inverse[1, 1]
        start = kx * offset[0] + ky * offset[1] + phases
        x, y = self._axes()
        waves = np.exp(1j * (np.outer(y, across) + start)) @ np.exp(1j * np.outer(along, x))
        value = waves.real * np.sqrt(2 / _WAVES)
        return 1 - self.contrast * (0.5 + 0.5 * np.tanh(1.2 * value))

    def _axes(self) -> tuple[np.ndarray, np.ndarray]:
        return np.arange(self.columns) - (self.columns - 1) / 2, np.arange(self.rows) - (self.rows - 1) / 2

    def material(self, motion: Motion, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return inverse, offset and the material x, y that each pixel sees at a time [frames]."""
        s = motion.course(time)
        inverse = np.linalg.inv(np.eye(2) + s * np.array(motion.gradient))
        offset = -inverse @ (s * np.array([motion.right, motion.down]))
        x, y = np.meshgrid(*self._axes())
        return (
            inverse,
            offset,
            inverse[0, 0] * x + inverse[0, 1] * y + offset[0],
            inverse[1, 0] * x + inverse[1, 1] * y + offset[1],
        )

    def height_at(self, motion: Motion, time: float) -> np.ndarray:
        """Return the height that each pixel sees at a time [px]."""
        _, _, x, y = self.material(motion, time)
        return self.relief(x, y) + motion.course(time) * (motion.up + motion.tilt[0] * x + motion.tilt[1] * y)

    def phase(self, pitch: float, motion: Motion, time: float = 0.0) -> np.ndarray:
        """Return the fringe phase at each pixel at a time [rad]."""
        x, _ = self._axes()
        return TURN * (x + self.slope * self.height_at(motion, time)) / pitch

    def drift(self, pitch: float, motion: Motion, span: float = 1e-4) -> np.ndarray:
        """Return the drift of the phase at the material point that each pixel sees at time 0 [rad/frame]."""
        x, y = np.meshgrid(*self._axes())
        rate = (motion.course(span) - motion.course(-span)) / (2 * span)
        right = motion.right + motion.gradient[0][0] * x + motion.gradient[0][1] * y
        up = motion.up + motion.tilt[0] * x + motion.tilt[1] * y
        return TURN / pitch * rate * (right + self.slope * up)

    def velocity(self, motion: Motion, span: float = 1e-4) -> np.ndarray:
        """Return the velocity of the points that the pixels see at time 0 [px/frame], (2, row, column)."""
        x, y = np.meshgrid(*self._axes())
        rate = (motion.course(span) - motion.course(-span)) / (2 * span)
        (xx, xy), (yx, yy) = motion.gradient
        return rate * np.stack([motion.right + xx * x + xy * y, motion.down + yx * x + yy * y])

    def acceleration(self, motion: Motion, span: float = 1e-2) -> np.ndarray:
        """Return the acceleration of these points [px/frame^2], (2, row, column)."""
        unit = self.velocity(Motion(motion.right, motion.down, 0.0, motion.gradient))
        return unit * (motion.course(span) + motion.course(-span)) / span**2

    def light(self, shown: Shown, motion: Motion, time: float) -> np.ndarray:
        """Return the mean grey levels without noise of an exposure around a time [frames]."""
        total = np.zeros((self.rows, self.columns))
        moments = (
            time + self.exposure * ((np.arange(self.instants) + 0.5) / self.instants - 0.5) if self.exposure else [time]
        )
        for moment in moments:
            inverse, offset, _, _ = self.material(motion, moment)
            paint = self.bright * self._paint(inverse, offset)
            if shown.pitch:
                angle = self.phase(shown.pitch, motion, moment) - TURN * shown.shift / shown.shifts
                total += paint * (1 + self.modulation * np.cos(angle))
            else:
                total += paint * (1 + self.modulation)
        return gaussian_filter(total / len(moments), self.blur, mode="nearest", truncate=6.0)

    def phase_at_rest(self, pitch: float) -> np.ndarray:
        """Return the phase of frames without noise and motion [rad], of the order next to that without blur."""
        shifts = 8
        still = replace(self, exposure=0.0)
        levels = [still.light(Shown(pitch, k, shifts), Motion(), 0.0) for k in range(shifts)]
        angles = TURN * np.arange(shifts) / shifts
        wrapped = np.arctan2(np.tensordot(np.sin(angles), levels, 1), np.tensordot(np.cos(angles), levels, 1))
        return wrapped + TURN * np.round((self.phase(pitch, Motion()) - wrapped) / TURN)

    def expose(self, shown: Sequence[Shown], times: Sequence[float], motion: Motion, *, noise: int = 0) -> np.ndarray:
        """Return 8-bit frames (frame, row, column) at times [frames]; `noise` is the seed of their noise."""
        random = np.random.default_rng((self.seed, 2, noise))
        frames = []
        for each, time in zip(shown, times, strict=True):
            level = self.light(each, motion, time)
            level = level + random.normal(size=level.shape) * np.sqrt(self.read**2 + self.shot * level)
            frames.append(np.clip(np.round(level), 0, 255).astype(np.uint8))
        return np.array(frames)
