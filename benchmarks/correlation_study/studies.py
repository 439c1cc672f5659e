"""The studies of the validation page: what is measured on which images."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from correlation_study import estimators, figures, scenes
from correlation_study.estimators import Measured
from correlation_study.figures import Filter, Translations
from correlation_study.scenes import GREY_LEVELS, Speckle, Task
from fringedic.correlation import Reference, measure_displacement

WINDOWS = (20, 24, 28, 32, 34, 35, 36, 37, 38, 40, 48, 56, 64)
LONGEST_PERIOD = 44.0  # [px], the longest with 10 % loss at which the targets of resolution are stated
MOST_OVERSHOOT = 0.05


def best_window(filters: dict[int, Filter]) -> int:
    """Widest window that keeps 90 % of the waves of 44 px."""
    fitting = [w for w, one in filters.items() if one.period <= LONGEST_PERIOD and one.overshoot <= MOST_OVERSHOOT]
    return max(fitting)


@dataclass(frozen=True)
class Table1:
    """The paper's Table 1: zones of 32 px, ten shifts."""

    clean: Translations
    noisy: Translations


TABLE_SHIFTS = np.linspace(-0.5, 0.5, 10)
ZONE = 32


def table_1_tasks(surface: Speckle) -> tuple[Task, Task]:
    """Ten shifts along both axes without and with noise, on a surface for 20 x 30 zones."""
    return tuple(
        Task(f"table 1, {noise} GL", task.images, task.pairs, task.truth)
        for noise in (0, GREY_LEVELS)
        for task in [scenes.translations(surface, noise, 1, tuple(TABLE_SHIFTS), seed=50000)]
    )


def table_1(tasks: tuple[Task, Task], measured: tuple[Measured, Measured]) -> Table1:
    """Resolution and bias over the zones that lie inside the image."""
    return Table1(
        *(
            figures.translation_errors(task, one, TABLE_SHIFTS, margin=ZONE)
            for task, one in zip(tasks, measured, strict=True)
        )
    )


@dataclass(frozen=True)
class Columns:
    """Sample 14: positions, true column values and the column means of each load."""

    names: list[str]
    columns: np.ndarray
    truth: np.ndarray  # (load, column)
    means: np.ndarray
    rmse: np.ndarray


def sample_14(challenge: scenes.Challenge, measured: Measured) -> Columns:
    """RMSE of the means of the columns, without the outer 24 px."""
    inner = measured.inside(challenge.task.images.shape[1:], 24)
    means = np.nanmean(inner.fields[:, 0], axis=1)
    x = inner.columns.astype(float)
    truth = np.stack([motion(x, x)[0] for motion in challenge.task.truth])
    return Columns(challenge.names, inner.columns, truth, means, np.sqrt(np.nanmean((means - truth) ** 2, axis=1)))


@dataclass(frozen=True)
class Large:
    """A large motion: errors at the pixels that must be measured."""

    name: str
    rmse: float  # [px]
    largest: float  # [px]
    measured: float  # share of the pixels that must be
    margin: int


LARGE_SHAPE = (480, 640)


def large_motions(seeds: tuple[int, ...] = (311, 312)) -> list[Large]:
    """10 % strain and 10 degrees at once, 20 degrees by five increments, with 10 grey levels of noise.

    Every pixel must be measured that is a window inside the reference and whose material is as far inside the deformed
    image.
    """
    window, margin = 32, 32
    middle = (LARGE_SHAPE[1] / 2, LARGE_SHAPE[0] / 2)
    y, x = np.mgrid[: LARGE_SHAPE[0], : LARGE_SHAPE[1]].astype(float)
    cases = {
        "10 % strain": [scenes.affine(0.1, -0.03, middle=middle)],
        "10 degrees": [scenes.affine(degrees=10, middle=middle)],
        "20 degrees by five increments": [scenes.affine(degrees=4 * k, middle=middle) for k in range(1, 6)],
    }
    found = []
    for name, steps in cases.items():
        squares, count, largest, share = 0.0, 0, 0.0, []
        for seed in seeds:
            surface = Speckle(LARGE_SHAPE, seed)
            reference = Reference(scenes.camera(surface.grey(), 10, seed), window=window)
            before = None
            for k, motion in enumerate(steps, 1):
                initial = None if before is None else [d * k / (k - 1) for d in before]
                image = scenes.camera(surface.grey(motion), 10, seed + 100 * k)
                result = measure_displacement(reference, image, initial=initial)
                before = result.displacement_x.to_numpy(), result.displacement_y.to_numpy()
            truth = np.stack(steps[-1](x, y))
            needed = np.ones(LARGE_SHAPE, bool)
            for at_x, at_y in ((x, y), (x + truth[0], y + truth[1])):
                needed &= (at_x >= margin) & (at_x < LARGE_SHAPE[1] - margin)
                needed &= (at_y >= margin) & (at_y < LARGE_SHAPE[0] - margin)
            e = (np.stack(before) - truth)[:, needed]
            share.append(np.isfinite(e[0]).mean())
            squares += float(np.nansum(e**2))
            count += int(np.isfinite(e).sum())
            largest = max(largest, float(np.nanmax(np.abs(e))))
        found.append(Large(name, float(np.sqrt(squares / count)), largest, float(np.mean(share)), margin))
    return found


@dataclass(frozen=True)
class Scores:
    """Standard deviation of error / sigma by noise and strain, its range over seeds, and the scores themselves."""

    levels: tuple[int, ...]
    strains: tuple[float, ...]
    deviation: np.ndarray  # (noise, strain, seed)
    all: np.ndarray = field(repr=False)


def z_scores(seeds: tuple[int, ...] = (401, 402, 403, 404)) -> Scores:
    """Rigid motion and smooth 1 % strain at 5, 10 and 31 grey levels, on seeds of their own."""
    levels, strains = (5, 10, GREY_LEVELS), (0.0, 0.01)
    deviation = np.empty((len(levels), len(strains), len(seeds)))
    scores = []
    for k, seed in enumerate(seeds):
        surface = Speckle((400, 400), seed)
        at_rest = surface.grey()
        for j, strain in enumerate(strains):
            motion = scenes.affine(strain, -0.3 * strain, dx=0.27, dy=-0.41, middle=(200, 200))
            moved = surface.grey(motion)
            for i, level in enumerate(levels):
                images = np.stack(
                    [scenes.camera(at_rest, level, 10 * seed), scenes.camera(moved, level, 10 * seed + 1 + i)]
                )
                task = Task("z", images, [(0, 1)], [motion])
                measured = estimators.fringedic(task, 32, spacing=4).inside((400, 400), 40)
                z = (measured.errors(task) / measured.sigma)[0].ravel()
                z = z[np.isfinite(z)]
                deviation[i, j, k] = np.sqrt(np.mean(z**2))
                scores.append(z)
    return Scores(levels, strains, deviation, np.concatenate(scores))


def diameter(surface: Speckle, window: int, method: str, pairs: int) -> float:
    """Half-height diameter [px] of the autocorrelation of static error maps (the paper's spatial resolution)."""
    task = scenes.static_pairs(surface, pairs)
    spacing = 1 if method == "dense" else 2
    measured = estimators.fringedic(task, window, spacing=spacing, method=method)
    inner = measured.inside(task.images.shape[1:], 40 if method == "dense" else ZONE // 2 + 4)
    return figures.autocorrelation_diameter(inner.fields, spacing)
