"""Image pairs with known displacement: exact speckle seen by a camera of 12 or 8 bits, and the DIC Challenge's images.

The speckle is the tests' one: a sum of Gaussian spots of 1.4 px evaluated at the material point of every pixel, so that
no image is interpolated. Seeds differ from those of the tests.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np

ROOT = Path(__file__).resolve().parents[2]


def load_test(file: str) -> ModuleType:
    """Import a file of the tests of the library, for the exactly known images and light in it.

    Numba's cached loops refer to their module by its name. It is that of the tests, which share them.
    """
    path = ROOT / "ros2_ws" / "src" / "fringedic" / "test" / file
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


_EXACT = load_test("conftest.py")
Speckle, camera = _EXACT.Speckle, _EXACT.camera

Motion = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]

GREY_LEVELS = 31  # noise of the paper's Table 1, of 12 bits
PERIODS = (150.0, 75.0, 66.0, 60.0, 55.0, 50.0, 46.0, 43.0, 40.0, 37.0, 33.0, 29.0, 25.0, 20.0)
DIRECTIONS = {"x": (1.0, 0.0), "y": (0.0, 1.0), "45 degrees": (0.5**0.5, 0.5**0.5)}
AMPLITUDE = 0.1  # [px] of the waves
SHIFTS = np.linspace(-0.5, 0.5, 11)


@dataclass(frozen=True)
class Task:
    """Images (n, row, column), the pairs (reference, deformed) to be measured, and what their displacement is."""

    name: str
    images: np.ndarray
    pairs: list[tuple[int, int]]
    truth: list[Motion]


def translation(dx: float, dy: float) -> Motion:
    """A rigid translation."""
    return lambda x, y: (np.full_like(x, dx), np.full_like(y, dy))


def affine(
    strain_x: float = 0.0,
    strain_y: float = 0.0,
    degrees: float = 0.0,
    dx: float = 0.0,
    dy: float = 0.0,
    middle: tuple[float, float] = (0.0, 0.0),
) -> Motion:
    """A strain, then a rotation, about `middle`, then a translation."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))

    def motion(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u, v = x - middle[0], y - middle[1]
        a, b = u * (1 + strain_x), v * (1 + strain_y)
        return c * a - s * b - u + dx, s * a + c * b - v + dy

    return motion


def wave(period: float, direction: tuple[float, float]) -> Motion:
    """The same wave of 0.1 px in both components, along a direction."""
    kx, ky = (2 * np.pi / period * a for a in direction)
    return lambda x, y: (AMPLITUDE * np.sin(kx * x + ky * y),) * 2


def static_pairs(surface: Speckle, count: int) -> Task:
    """Pairs of images of the same surface with independent noise."""
    grey = surface.grey()
    images = np.stack([camera(grey, GREY_LEVELS, 1000 + k) for k in range(2 * count)])
    return Task("static", images, [(2 * k, 2 * k + 1) for k in range(count)], [translation(0.0, 0.0)] * count)


def waves(surface: Speckle) -> Task:
    """Waves of every period and direction without noise, against the surface at rest; periods change fastest."""
    truth = [wave(period, direction) for direction in DIRECTIONS.values() for period in PERIODS]
    images = np.stack([camera(surface.grey()), *(camera(surface.grey(motion)) for motion in truth)])
    return Task("waves", images, [(0, k + 1) for k in range(len(truth))], truth)


def translations(
    surface: Speckle, noise: float, repeats: int, shifts: Sequence[float] = tuple(SHIFTS), seed: int = 0
) -> Task:
    """Rigid translations by the same amount along both axes, each with `repeats` pairs of independent noise."""
    at_rest = surface.grey()
    images, pairs, truth = [], [], []
    for k, t in enumerate(shifts):
        moved = surface.grey(translation(t, t))
        for repeat in range(repeats):
            number = seed + 3000 + 2 * (k * repeats + repeat)
            pairs.append((len(images), len(images) + 1))
            images += [camera(at_rest, noise, number), camera(moved, noise, number + 1)]
            truth.append(translation(t, t))
    return Task(f"translations {noise:g} GL", np.stack(images), pairs, truth)


def eight_bits(grey: np.ndarray) -> np.ndarray:
    """The 12-bit grey levels seen by a camera of 8 bits without noise."""
    return np.rint(grey / 16).clip(0, 255).astype(np.uint8)


def sines(surface: Speckle, periods: Sequence[float]) -> Task:
    """Fields 0.02 sin x sin in both components, 8 bits without noise (paper, section 4.1)."""

    def sine(period: float) -> Motion:
        k = 2 * np.pi / period
        return lambda x, y: (0.02 * np.sin(k * x) * np.sin(k * y),) * 2

    truth = [sine(period) for period in periods]
    images = np.stack([eight_bits(surface.grey(motion)) for motion in (None, *truth)])
    return Task("sines", images, [(0, k + 1) for k in range(len(truth))], truth)


@dataclass(frozen=True)
class Challenge:
    """Sample 14 of the SEM 2D-DIC Challenge 1.0: images, and the displacement along x, which depends on x alone."""

    names: list[str]
    task: Task


def data_folder() -> Path:
    """Folder of the reference images: FRINGEDIC_DATA, or `shared/data` beside the project."""
    return Path(os.environ.get("FRINGEDIC_DATA", ROOT.parent / "shared" / "data"))


def challenge() -> Challenge | None:
    """Sample 14, or None where its images are not there."""
    folder = data_folder() / "challenge_sample14"
    if not (folder / "Sample14Exact.mat").exists():
        return None
    import scipy.io
    import tifffile

    exact = scipy.io.loadmat(folder / "Sample14Exact.mat")
    table = next(value for name, value in exact.items() if not name.startswith("__") and value.ndim == 2)
    names = ["L1", "L3", "L5"]
    images = np.stack([tifffile.imread(folder / f"{name}.tif") for name in ("reference", *names)])

    def motion(column: int) -> Motion:
        return lambda x, _y: (np.interp(x, table[:, 0], table[:, column]), np.full_like(x, np.nan))

    truth = [motion(column) for column in (1, 3, 5)]
    return Challenge(names, Task("sample 14", images, [(0, k + 1) for k in range(3)], truth))
