"""False alarms and detection rate of the checks of a stack, on random scenes with and without an injected fault.

Writes docs/validation/stack_checks.md. `python benchmarks/stack_checks.py --good 100 --faults 20 --no-page` measures
fewer scenes and writes nothing.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter, defaultdict
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from datetime import date
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")  # one scene per process

import numpy as np

from fringedic.errors import ErrorCode
from fringedic.patterns.sequences import PatternSequence, fringe_sequence, gray_code_sequence
from fringedic.phase.checks.stack import inspect_stack
from fringedic.phase.findings import FindingKind
from fringedic.phase.sentences import describe
from fringedic.phase.settings import PhaseSettings
from fringedic.virtual_rig import FringeScene

PAGE = Path(__file__).resolve().parents[1] / "docs" / "validation" / "stack_checks.md"
ROWS = 8  # of the projector's image: all are alike
DELAY_MS, EXPOSURE_MS = 80.0, 10.0


@dataclass(frozen=True)
class Faulty:
    """Frames with a fault, the codes that name it, and the first frame concerned (None for all of them)."""

    frames: np.ndarray
    codes: set[ErrorCode]
    index: int | None = None


class Trial:
    """One random scene with its sequence and a random generator for its fault."""

    def __init__(self, seed: int, fewest_shifts: int = 3) -> None:
        self.fewest_shifts = fewest_shifts
        self.random = np.random.default_rng((seed, 7))
        width = int(self.random.choice([640, 800, 1024, 1280, 1920]))
        self.scene = FringeScene.random(seed, width)
        self.sequence = self._sequence(width)
        self.images = list(self.sequence)

    def _sequence(self, width: int) -> PatternSequence:
        seen = (self.scene.last_column - self.scene.first_column) / self.scene.columns
        finest = float(self.random.uniform(max(8.0, 6.0 * seen), max(16.0, 30.0 * seen)))
        if self.random.random() < 0.5:
            finest = round(finest)
        scene = self.scene
        allowed = [3, 4, 5, 6, 8, 12]
        allowed = [each for each in allowed if each >= max(self.fewest_shifts, 4 if scene.gamma > 1.1 else 3)]
        if self.random.random() < 0.25:
            return gray_code_sequence(width, ROWS, finest, int(self.random.choice(allowed)))
        # as many pitches as the noise of the darker parts requires for certain orders
        noise = np.hypot(scene.read_noise, np.sqrt(scene.shot_noise * scene.grey))
        ratio = np.clip(0.4 * scene.contrast * scene.grey / (5 * noise), 2.5, 12.0)
        steps = int(np.ceil(np.log(width / finest) / np.log(ratio)))
        pitches = np.geomspace(width, finest, steps + 1)
        coarse = int(self.random.choice(allowed[:3]))
        return fringe_sequence(width, ROWS, pitches.tolist(), [coarse] * steps + [int(self.random.choice(allowed))])

    @property
    def finest(self) -> list[int]:
        """Numbers of the frames of the finest pitch."""
        last = self.sequence.patterns[-1]
        return [
            k for k, each in enumerate(self.sequence.patterns) if (each.kind, each.pitch) == (last.kind, last.pitch)
        ]

    def differ(self, first: int, second: int) -> bool:
        """Return whether two patterns differ in what the camera sees: the coarsest bits of a code may not."""
        view = slice(int(self.scene.first_column), int(self.scene.last_column))
        one, other = (self.images[each][0, view].astype(float) for each in (first, second))
        return float(np.mean(np.abs(one - other))) > 0.1 * 255

    def draw(self, low: int, high: int, step: int) -> int:
        """Return a random frame from low to high - 1 whose pattern differs from that of the frame `step` further."""
        candidates = [each for each in range(low, high) if self.differ(each, each + step)]
        return int(self.random.choice(candidates))

    def frames(self, order: list[int] | None = None) -> np.ndarray:
        """Return the frames of the scene; frame k shows the pattern order[k]."""
        shown = range(len(self.images)) if order is None else order
        return np.array([self.scene.expose(self.images[each], k) for k, each in enumerate(shown)])


def missing(trial: Trial) -> Faulty:
    """One frame is lost: those after it follow too early, and the last pattern is seen twice."""
    count = len(trial.images)
    lost = trial.draw(0, count - 2, 1)
    return Faulty(
        trial.frames([*range(lost), *range(lost + 1, count), count - 1]), {ErrorCode.FRAMES_OUT_OF_ORDER}, lost
    )


def doubled(trial: Trial) -> Faulty:
    """One frame arrives twice: those after it are late, and the last pattern is not seen."""
    count = len(trial.images)
    twice = trial.draw(0, count - 3, 1)
    return Faulty(
        trial.frames([*range(twice + 1), *range(twice, count - 1)]), {ErrorCode.FRAMES_OUT_OF_ORDER}, twice + 1
    )


def stale(trial: Trial) -> Faulty:
    """One frame shows the pattern before instead of its own."""
    order = list(range(len(trial.images)))
    number = trial.draw(1, len(order), -1)
    order[number] -= 1
    return Faulty(trial.frames(order), {ErrorCode.WRONG_PATTERN}, number)


def late(trial: Trial) -> Faulty:
    """Every frame shows the pattern before, the first one the end of the step before."""
    count = len(trial.images)
    return Faulty(trial.frames([count - 1, *range(count - 1)]), {ErrorCode.FRAMES_OUT_OF_ORDER}, 0)


def lagging(trial: Trial) -> Faulty:
    """Every frame shows 15 to 85 % of the pattern before; above half of it the frames count as late by one, too."""
    share = trial.random.uniform(0.15, 0.85)
    lights = [trial.scene.light(each) for each in trial.images]
    frames = [trial.scene.record((1 - share) * light + share * lights[k - 1], k) for k, light in enumerate(lights)]
    codes = {ErrorCode.WRONG_PATTERN} | ({ErrorCode.FRAMES_OUT_OF_ORDER} if share > 0.5 else set())
    return Faulty(np.array(frames), codes)


def delayed(trial: Trial) -> Faulty:
    """Frames follow irregularly and show what was projected 80 ms before: patterns late, the first ones dark."""
    count = len(trial.images)
    lights = [trial.scene.light(each) for each in (np.zeros_like(trial.images[0]), *trial.images)]
    begins = np.cumsum(trial.random.uniform(15, trial.random.choice([20, 30, 60, 90]), count + 1))  # [ms]
    seen = begins[:-1] + DELAY_MS
    frames = []
    for k, begin in enumerate(begins[:-1] + 5):
        edges = [begin, *seen[(seen > begin) & (seen < begin + EXPOSURE_MS)], begin + EXPOSURE_MS]
        parts = [(end - start) * lights[np.sum(seen <= start)] for start, end in pairwise(edges)]
        frames.append(trial.scene.record(np.sum(parts, axis=0) / EXPOSURE_MS, k))
    return Faulty(np.array(frames), {ErrorCode.WRONG_PATTERN, ErrorCode.FRAMES_OUT_OF_ORDER})


def swapped(trial: Trial) -> Faulty:
    """Two frames are interchanged."""
    order = list(range(len(trial.images)))
    first, second = 0, 0
    while not trial.differ(first, second):
        first, second = sorted(trial.random.choice(len(order), 2, replace=False).tolist())
    order[first], order[second] = second, first
    return Faulty(trial.frames(order), {ErrorCode.FRAMES_OUT_OF_ORDER}, first)


def flicker(trial: Trial) -> Faulty:
    """The light changes from frame to frame, by 3 to 15 % within the finest pitch."""
    gains = trial.random.uniform(-0.5, 0.5, len(trial.images))
    gains *= trial.random.uniform(0.03, 0.15) / np.ptp(gains[trial.finest])
    scene = trial.scene
    dark = scene.dark_level
    frames = [
        scene.record(dark + (1 + gain) * (scene.light(image) - dark), k)
        for k, (image, gain) in enumerate(zip(trial.images, gains, strict=True))
    ]
    return Faulty(np.array(frames), {ErrorCode.FLICKER})


def motion(trial: Trial) -> Faulty:
    """The surface moves by 0.3 to 1.5 px across the image during the finest pitch, at once or steadily.

    Nobody sees a plain surface move: its texture has a contrast of 5 % or more.
    """
    trial.scene = replace(trial.scene, texture=max(trial.scene.texture, 0.05))
    angle, size = trial.random.uniform(0, 2 * np.pi), trial.random.uniform(0.3, 1.5)
    course = _course(trial) * size
    frames = [
        trial.scene.record(trial.scene.light(image, motion=(place * np.cos(angle), place * np.sin(angle))), k)
        for k, (image, place) in enumerate(zip(trial.images, course, strict=True))
    ]
    return Faulty(np.array(frames), {ErrorCode.SURFACE_MOVED})


def approach(trial: Trial) -> Faulty:
    """The surface moves along the line of sight: its finest fringes shift by 0.02 fringe to less than half a shift."""
    last = trial.sequence.patterns[-1]
    course = _course(trial) * trial.random.uniform(0.02, max(0.4 / last.shifts, 0.04)) * last.pitch
    frames = [
        trial.scene.record(trial.scene.light(image, lift=place), k)
        for k, (image, place) in enumerate(zip(trial.images, course, strict=True))
    ]
    return Faulty(np.array(frames), {ErrorCode.SURFACE_MOVED})


def _course(trial: Trial) -> np.ndarray:
    """Return a motion from 0 to 1 of all frames: within the finest ones, steady or as one jump."""
    first, last = trial.finest[0], trial.finest[-1]
    frames = np.arange(len(trial.images))
    if last - first < 3 or trial.random.random() < 0.5:
        return np.clip((frames - first) / (last - first), 0, 1)
    return np.asarray(frames > trial.random.integers(first + 1, last - 1), float)  # two frames or more on either side


FAULTS: dict[str, Callable[[Trial], Faulty]] = {
    "missing frame": missing,
    "doubled frame": doubled,
    "one frame with the pattern before": stale,
    "all frames late by one": late,
    "all frames with a part of the pattern before": lagging,
    "projector late by 80 ms, frames every 15 to 90 ms": delayed,
    "two frames interchanged": swapped,
    "flicker of 3 to 15 %": flicker,
    "motion of 0.3 to 1.5 px across the image": motion,
    "motion along the light, from 0.02 fringe on": approach,
}


def verdict(trial: Trial, frames: np.ndarray) -> tuple[set[ErrorCode], int | None, str]:
    """Return the codes that the checks report, the first frame concerned, and the message."""
    found = inspect_stack(frames, trial.sequence.patterns, PhaseSettings(saturation=trial.scene.saturation))
    found = [each for each in found if each.kind is not FindingKind.SATURATED or each.fault]
    first = found[-1].frames[0] if found and found[-1].frames else None
    return {each.kind.code for each in found if each.kind.code}, first, "; ".join(map(describe, found))


def good_outcome(seed: int) -> str:
    """Return the message about a stack without fault, empty as it should be."""
    trial = Trial(seed)
    return verdict(trial, trial.frames())[2]


def fault_outcome(name: str, seed: int) -> tuple[str, str]:
    """Return whether a fault was named, misnamed or missed, and the message."""
    trial = Trial(seed, fewest_shifts=4 if FAULTS[name] in (flicker, motion, approach) else 3)
    fault = FAULTS[name](trial)
    codes, index, message = verdict(trial, fault.frames)
    if not message:
        return "missed", ""
    right = bool(fault.codes & codes) and fault.index in (None, index)
    return "named" if right else "misnamed", message


def write_page(alarms: int, good: int, tally: dict[str, Counter[str]], first: int) -> None:
    """Write the generated page."""
    rows = "\n".join(
        f"| {name} | {sum(counts.values())} | {counts['named']} | {counts['misnamed']} | {counts['missed']} |"
        for name, counts in tally.items()
    )
    named = sum(counts["named"] for counts in tally.values())
    count = sum(map(Counter.total, tally.values()))
    PAGE.write_text(
        f"""# Checks of a stack: false alarms and detection

This page shows how often the checks of a stack refuse good frames, and how often they name an injected fault. It is
written by `python benchmarks/stack_checks.py`.

## Figures

*Measured on {date.today()} with the random scenes from number {first} on of `fringedic.virtual_rig.FringeScene`; the
limits of the checks were set with scenes 0 to 99. Specimen on 10 to 100 % of the
image, dark or lit background, gamma 1 to 2.4, noise 0.3 to 2.5 grey levels, 8 or 12 bits or real numbers, fringe
contrast 0.35 to 0.95, texture 0 to 35 %, 3 to 12 shifts (4 or more above gamma 1.1), 2 to 8 pitches or a Gray code. No
noise model is given. A remark counts as a false alarm; a message that the image saturates does not. Flicker and motions
are injected into the finest fringes, of 4 shifts or more.*

False alarms: {alarms} of {good} good stacks (target: 0 of 1000).

| fault | stacks | named rightly | with another name | missed |
|---|---:|---:|---:|---:|
{rows}

{named / count:.1%} of the faults are named rightly (target: 99 %). A fault is named rightly when the error code is
right, and the number of the frame where a single frame is the cause.

## Conditions

- **Three shifts.** Flicker and motion are not detected, nor with fewer than five of the finest fringes in view.
- **Motion across the image** is visible on a texture only; the injected one has a contrast of 5 % or more. With 4
  shifts, a motion of 0.3 px may not be significant on a faint texture of wide spots.
- **Motion along the light** by a whole shift looks like a frame too many or too few. The injected one is less than half
  a shift.
- **One frame with another pattern** is named when it deviates by half the difference of two successive shifts or more.
  A smaller deviation is attributed to displaced fringes of this frame, to the light or to a motion.
- **A part of the pattern before** above 50 % may be reported as "late by one frame". Both have the same cause.
"""
    )


def main() -> None:
    """Measure both rates and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--good", type=int, default=1000, help="scenes without a fault")
    parser.add_argument("--faults", type=int, default=200, help="scenes with each of the faults")
    parser.add_argument("--first", type=int, default=1000, help="number of the first scene")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--no-page", action="store_true", help="do not write the page")
    parser.add_argument("--details", action="store_true", help="print each scene that is judged wrongly")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.good)
    tally: dict[str, Counter[str]] = defaultdict(Counter)
    with ProcessPoolExecutor(arguments.workers) as pool:
        alarms = [
            (seed, words)
            for seed, words in zip(seeds, pool.map(good_outcome, seeds, chunksize=4), strict=True)
            if words
        ]
        print(f"false alarms: {len(alarms)} of {arguments.good}", flush=True)
        for seed, words in alarms if arguments.details else ():
            print(f"  {seed}: {words}")
        for name in FAULTS:
            chosen = range(arguments.first, arguments.first + arguments.faults)
            outcomes = pool.map(fault_outcome, [name] * len(chosen), chosen, chunksize=4)
            for seed, (outcome, words) in zip(chosen, outcomes, strict=True):
                tally[name][outcome] += 1
                if outcome != "named" and arguments.details:
                    print(f"  {seed}: {outcome}: {words}")
            print(f"{name:50} {dict(tally[name])}", flush=True)
    if not arguments.no_page:
        write_page(len(alarms), arguments.good, tally, arguments.first)


if __name__ == "__main__":
    main()
