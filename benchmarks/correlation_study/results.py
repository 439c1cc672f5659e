"""Runs the studies one after the other and keeps what they found."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from correlation_study import estimators, figures, pyvale, scenes, studies
from correlation_study.figures import Filter, Translations
from correlation_study.pyvale import Subset
from correlation_study.scenes import GREY_LEVELS, Speckle
from correlation_study.speed import Speed, speed, textured_pair

SINE_PERIODS = (45.0, 130.0, 260.0)
SINE_WINDOWS = (24, 28, 30, 32, 36, 48, 64, 96)
CHALLENGE_WINDOWS = (32, 48, 64, 80)
CHALLENGE_SUBSETS = (Subset("AFFINE", 33), Subset("QUAD", 65))
SUBSETS = tuple(Subset("AFFINE", s) for s in (11, 13, 17)) + tuple(Subset("QUAD", s) for s in (21, 25, 29, 35))


@dataclass(frozen=True)
class Extent:
    """How much is measured: all of it, or a glance while developing."""

    pairs: int = 20
    repeats: int = 6
    windows: tuple[int, ...] = studies.WINDOWS
    subsets: tuple[Subset, ...] = SUBSETS
    challenge_subsets: tuple[Subset, ...] = CHALLENGE_SUBSETS
    seeds: tuple[int, ...] = (401, 402, 403, 404)
    sizes: tuple[tuple[int, int, int], ...] = ((960, 1280, 15), (2048, 2448, 5), (5120, 5120, 2))


QUICK = Extent(
    3, 1, (32, 36), (Subset("AFFINE", 13), Subset("QUAD", 27)), (Subset("AFFINE", 33),), (401,), ((960, 1280, 5),)
)


@dataclass
class Rivals:
    """What pyvale reached; None in place of this where it could not be run."""

    filters: dict[Subset, Filter]
    matched: dict[str, Subset]  # by shape function: the size with nearly our cut-off
    interpolated: dict[str, float]  # noise at exactly our cut-off [px]
    translations: dict[tuple[Subset, int], Translations] = field(default_factory=dict)
    table_1: dict[Subset, studies.Table1] = field(default_factory=dict)
    sines: dict[Subset, np.ndarray] = field(default_factory=dict)
    sample_14: dict[Subset, studies.Columns] = field(default_factory=dict)
    points_per_second: dict[Subset, float] = field(default_factory=dict)


@dataclass
class Results:
    """Everything that the page shows."""

    window: int
    filters: dict[int, Filter]
    bound: float
    translations: dict[int, Translations]  # by grey levels
    zone_translations: dict[int, Translations]
    table_1: dict[str, studies.Table1]
    sines: dict[int, np.ndarray]
    sample_14: dict[int, studies.Columns]
    large: list[studies.Large]
    scores: studies.Scores
    diameters: dict[str, float]
    speeds: list[Speed]
    opencv: dict[str, Filter]
    rivals: Rivals | None
    seconds: float = 0.0

    @property
    def chosen(self) -> Filter:
        """The filter of the window at which the targets are stated."""
        return self.filters[self.window]

    def sine_window(self, targets: tuple[float, ...]) -> int:
        """The one window that comes closest to the targets of all three periods."""
        return min(self.sines, key=lambda w: max(self.sines[w] / np.array(targets)))


@contextmanager
def _said(what: str) -> Iterator[None]:
    """Say on the error stream what is being measured, and how long it took."""
    begin = time.perf_counter()
    print(f"  {what} ...", end="", file=sys.stderr, flush=True)
    yield
    print(f" {time.perf_counter() - begin:.0f} s", file=sys.stderr, flush=True)


def measure_times(extent: Extent, window: int) -> list[Speed]:
    """Time images of several sizes."""
    speed(256, 256, window, 1)  # leaves the compiled loops behind, so that compiling does not count below
    return [speed(rows, columns, window, runs) for rows, columns, runs in extent.sizes]


def measure_all(extent: Extent, *, with_rivals: bool = True) -> Results:
    """Run every study."""
    begin = time.perf_counter()
    with _said("images"):
        surface = Speckle((512, 512), 91)
        static, moving = scenes.static_pairs(surface, extent.pairs), scenes.waves(surface)
        rigid = {
            level: scenes.translations(surface, level, extent.repeats if level else 1) for level in (0, GREY_LEVELS)
        }
        table_tasks = studies.table_1_tasks(Speckle((22 * 32, 32 * 32), 93))
        sine_task = scenes.sines(Speckle((640, 640), 94), SINE_PERIODS)
        challenge = scenes.challenge()
    with _said("noise and transfer over windows"):
        filters = {
            w: figures.filter_of(static, estimators.fringedic(static, w), moving, estimators.fringedic(moving, w))
            for w in extent.windows
        }
        window = studies.best_window(filters)
    with _said("translations"):
        translations = {
            level: figures.translation_errors(task, estimators.fringedic(task, window)) for level, task in rigid.items()
        }
        zone_tasks = {level: scenes.translations(surface, level, 1, seed=7000) for level in (0, GREY_LEVELS)}
        zone_translations = {
            level: figures.translation_errors(task, estimators.fringedic(task, studies.ZONE, 16, "zoi"))
            for level, task in zone_tasks.items()
        }
    with _said("Table 1"):
        table_1 = {
            f"{method}, window {w} px": studies.table_1(
                table_tasks, tuple(estimators.fringedic(task, w, studies.ZONE, method) for task in table_tasks)
            )
            for method, w in dict.fromkeys((("zoi", studies.ZONE), ("dense", studies.ZONE), ("dense", window)))
        }
    with _said("sines"):
        sines = {w: figures.root_mean_square(sine_task, estimators.fringedic(sine_task, w)) for w in SINE_WINDOWS}
    sample_14 = {}
    if challenge is not None:
        with _said("sample 14"):
            sample_14 = {
                w: studies.sample_14(challenge, estimators.fringedic(challenge.task, w, 8))
                for w in sorted({window, *CHALLENGE_WINDOWS})
            }
    with _said("large motions"):
        large = studies.large_motions()
    with _said("z-scores"):
        scores = studies.z_scores(extent.seeds)
    with _said("autocorrelation"):
        diameters = {
            f"dense, window {studies.ZONE} px": studies.diameter(surface, studies.ZONE, "dense", 2),
            f"dense, window {window} px": studies.diameter(surface, window, "dense", 2),
            f"zoi, window {studies.ZONE} px": studies.diameter(Speckle((200, 200), 92), studies.ZONE, "zoi", 3),
        }
    with _said("speed"):
        speeds = measure_times(extent, window)
    with _said("OpenCV"):
        opencv = {
            f"{name} {size}": figures.filter_of(static, flow(static, size), moving, flow(moving, size))
            for name, flow, sizes in (
                ("PyrLK", estimators.pyramidal_lucas_kanade, (9, 11, 13, 17)),
                ("DIS", estimators.dense_inverse_search, (8,)),
            )
            for size in sizes
        }
    rivals = None
    if with_rivals:
        with _said("pyvale"):
            rivals = _rivals(extent, filters[window].period, (static, moving), rigid, table_tasks, sine_task, challenge)
    bound = figures.brick_wall_bound(0.15 * 4096, surface.radius, GREY_LEVELS)
    return Results(
        window, filters, bound, translations, zone_translations, table_1, sines, sample_14, large, scores, diameters,
        speeds, opencv, rivals, time.perf_counter() - begin,
    )  # fmt: skip


def _at_cut_off(filters: dict[Subset, Filter], period: float) -> tuple[dict[str, Subset], dict[str, float]]:
    """Return the subset of each shape function with nearly this cut-off, and the noise interpolated at it."""
    matched, interpolated = {}, {}
    for shape in ("AFFINE", "QUAD"):
        own = sorted((s for s in filters if s.shape == shape), key=lambda s: filters[s].period)
        periods = np.log([filters[s].period for s in own])
        noises = np.log([filters[s].noise for s in own])
        matched[shape] = min(own, key=lambda s: abs(np.log(filters[s].period / period)))
        interpolated[shape] = float(np.exp(np.interp(np.log(period), periods, noises)))
    return matched, interpolated


def _rivals(
    extent: Extent,
    period: float,
    filter_tasks: tuple[scenes.Task, scenes.Task],
    rigid: dict[int, scenes.Task],
    table_tasks: tuple[scenes.Task, scenes.Task],
    sine_task: scenes.Task,
    challenge: scenes.Challenge | None,
) -> Rivals | None:
    """pyvale's noise and transfer at several sizes, then everything else at the size with nearly our cut-off."""
    found = pyvale.measure([(task, subset) for subset in extent.subsets for task in filter_tasks])
    if found is None:
        return None
    static, moving = filter_tasks
    filters = {
        s: figures.filter_of(static, found[static.name, s], moving, found[moving.name, s]) for s in extent.subsets
    }
    matched, interpolated = _at_cut_off(filters, period)
    rivals = Rivals(filters, matched, interpolated)

    some = {level: _fewer(task, 2) for level, task in rigid.items()}
    jobs = [(task, s) for s in matched.values() for task in (*some.values(), sine_task)]
    fields = pyvale.measure(jobs) or {}
    zones = pyvale.measure([(task, s) for s in matched.values() for task in table_tasks]) or {}
    for s in matched.values():
        for level, task in some.items():
            if (task.name, s) in fields:
                rivals.translations[s, level] = figures.translation_errors(task, fields[task.name, s])
        if (sine_task.name, s) in fields:
            rivals.sines[s] = figures.root_mean_square(sine_task, fields[sine_task.name, s])
        if zones:
            rivals.table_1[s] = studies.table_1(table_tasks, tuple(zones[task.name, s] for task in table_tasks))
    if challenge is not None:
        subsets = dict.fromkeys((*matched.values(), *extent.challenge_subsets))
        for (_, s), one in (pyvale.measure([(challenge.task, s) for s in subsets], step=8) or {}).items():
            rivals.sample_14[s] = studies.sample_14(challenge, one)
    speed_task = scenes.Task("speed", np.stack(textured_pair(960, 1280)), [(0, 1)], static.truth[:1])
    for (_, s), one in (pyvale.measure([(speed_task, s) for s in matched.values()], step=8) or {}).items():
        rivals.points_per_second[s] = one.rows.size * one.columns.size / one.seconds
    return rivals


def _fewer(task: scenes.Task, repeats: int) -> scenes.Task:
    """The first pairs of every shift only."""
    shifts = len(scenes.SHIFTS)
    each = len(task.pairs) // shifts
    kept = [k for k in range(len(task.pairs)) if k % each < min(repeats, each)]
    return scenes.Task(task.name, task.images, [task.pairs[k] for k in kept], [task.truth[k] for k in kept])
