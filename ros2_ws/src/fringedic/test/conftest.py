"""Images without interpolation: a speckle is a sum of Gaussian spots, evaluated at the material point of each pixel."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator

import cv2  # noqa: F401 (its first import changes the environment: not inside of a test)
import numpy as np
import pytest
from numba import njit, prange

Motion = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
DENSITY = 0.35  # spots per pixel


@njit(cache=True, parallel=True)
def _spots_at(
    x: np.ndarray,
    y: np.ndarray,
    amplitude: np.ndarray,
    bins: np.ndarray,
    radius: float,
    at_x: np.ndarray,
    at_y: np.ndarray,
) -> np.ndarray:
    """Sum the spots at the points (at_x, at_y); `bins` (row, column) counts the spots before each 8 x 8 square."""
    out = np.zeros(at_x.shape)
    reach = 5 * radius  # where a spot ends, its grey level is below 0.002, far below the rounding to whole ones
    squares = bins.shape[1]
    for r in prange(at_x.shape[0]):
        for c in range(at_x.shape[1]):
            px, py = at_x[r, c], at_y[r, c]
            first, last = max(int((px - reach) / 8), 0), min(int((px + reach) / 8), squares - 2)
            for row in range(max(int((py - reach) / 8), 0), min(int((py + reach) / 8), bins.shape[0] - 1) + 1):
                for k in range(bins[row, first], bins[row, last + 1]):
                    distance = (px - x[k]) ** 2 + (py - y[k]) ** 2
                    if distance < reach * reach:
                        out[r, c] += amplitude[k] * np.exp(-distance / (2 * radius * radius))
    return out


class Speckle:
    """A surface of random spots of 1.4 px, whose contrast (standard deviation) is 15 % of the full scale of 12 bits.

    `image(motion)` is the surface displaced by d = motion(x, y) [px], d known at the material points: the grey level of
    a pixel is that of the material point that has come there, found to 1e-7 px by iteration.
    """

    def __init__(self, shape: tuple[int, int], seed: int, *, radius: float = 1.4, margin: int = 120) -> None:
        generator = np.random.default_rng(seed)
        self.shape, self.radius, self.margin = shape, radius, margin
        height, width = (8 * -(-(n + 2 * margin) // 8) for n in shape)
        x = generator.uniform(0, width, int(DENSITY * height * width))
        y = generator.uniform(0, height, x.size)
        rows, columns = height // 8, width // 8
        square = (y // 8).astype(int) * columns + (x // 8).astype(int)
        order = np.argsort(square, kind="stable")
        self.x, self.y = x[order], y[order]
        self.amplitude = generator.choice([-1.0, 1.0], x.size)
        before = np.concatenate([[0], np.cumsum(np.bincount(square, minlength=rows * columns))])
        self.bins = before[np.arange(rows)[:, None] * columns + np.arange(columns + 1)]
        # Variance of a sum of spots: density times the integral of the squared spot.
        self.gain = 0.15 * 4096 / np.sqrt(DENSITY * np.pi * radius**2)

    def grey(self, motion: Motion | None = None) -> np.ndarray:
        """Exact grey levels of 12 bits, mean 2048, neither rounded nor clipped."""
        y, x = np.mgrid[: self.shape[0], : self.shape[1]].astype(float)
        material_x, material_y = x, y
        if motion is not None:
            # what remains is turned and stretched back by the mean gradient of the motion
            corners = [motion(x[at], y[at]) for at in (np.s_[:1, :1], np.s_[:1, -1:], np.s_[-1:, :1])]
            first, along_x, along_y = (np.array([float(part[0, 0]) for part in each]) for each in corners)
            gradient = np.stack([(along_x - first) / (x.shape[1] - 1), (along_y - first) / (x.shape[0] - 1)], axis=1)
            back = np.linalg.inv(np.eye(2) + gradient)
            for _ in range(100):
                dx, dy = motion(material_x, material_y)
                left_x, left_y = material_x + dx - x, material_y + dy - y
                material_x = material_x - (back[0, 0] * left_x + back[0, 1] * left_y)
                material_y = material_y - (back[1, 0] * left_x + back[1, 1] * left_y)
                if max(np.abs(left_x).max(), np.abs(left_y).max()) < 1e-7:
                    break
            else:
                raise ArithmeticError("the motion cannot be inverted by iteration")
        at = material_x + self.margin, material_y + self.margin
        return 2048 + self.gain * _spots_at(self.x, self.y, self.amplitude, self.bins, self.radius, *at)

    def image(self, motion: Motion | None = None, *, noise: float = 0.0, seed: int = 0) -> np.ndarray:
        """The same seen by a camera of 12 bits with read noise [grey level]."""
        return camera(self.grey(motion), noise, seed)


def camera(grey: np.ndarray, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """12 bits with white noise of a standard deviation [grey level]."""
    noisy = grey + np.random.default_rng(seed).normal(0, noise, grey.shape) if noise else grey
    return np.clip(np.rint(noisy), 0, 4095).astype(np.uint16)


@pytest.fixture(scope="session")
def speckle() -> type[Speckle]:
    return Speckle


@pytest.fixture(scope="session")
def expose() -> Callable[..., np.ndarray]:
    return camera


@pytest.fixture(autouse=True)
def process_left_as_found() -> Iterator[None]:
    """What a test leaves of environment, folder and signal handlers would decide over later tests."""
    before = _process_state()
    yield
    after = _process_state()
    assert after == before, f"left behind: {sorted(map(str, set(after.items()) ^ set(before.items())))}"


def _process_state() -> dict[str, object]:
    state: dict[str, object] = {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"}
    handlers = {number.name: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    return {**state, **handlers, "folder": os.getcwd()}
