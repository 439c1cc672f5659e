"""Measuring while the specimen moves: phase, orders, faults and times beside targets, with an independent renderer.

Frames come from `moving_scenes`, which uses nothing of the library. Writes docs/validation/moving.md. `--random 300` is
the number of random motions that the target is for; by default a short form runs, `--quick` a test of the program.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as fringedic_ros does

import cv2
import numpy as np
import xarray as xr
from moving_scenes.scene import Motion, Scene, Shown

from fringedic.correlation import measure_displacement
from fringedic.errors import FringedicError
from fringedic.frames.collector import Stack
from fringedic.frames.noise import CameraNoise
from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import WHITE, PatternKind, ProjectedPattern
from fringedic.patterns.render import render_pattern
from fringedic.phase import PhaseSettings, absolute_phase, plan_shifts
from fringedic.phase.checks.stack import inspect_stack
from fringedic.rig.model import RigModel
from fringedic.settings.experiment import SequenceSettings
from fringedic.steps import (
    CouplingParameters,
    DicParameters,
    DisplacementTracker,
    MovingPhase,
    PhaseParameters,
    ShapeTracker,
    measure_moving_phase,
    motion_between,
    phase_step,
)
from fringedic.virtual_rig import ConstantRate, VirtualRig

PAGE = Path(__file__).resolve().parents[1] / "docs" / "validation" / "moving.md"
NOISE = CameraNoise(float(np.hypot(1.0, 12**-0.5)), 0.02)
SETTINGS = PhaseSettings(noise=NOISE)
PITCH, SHIFTS = 12.0, 8
COARSE = ((384.0, 4), (48.0, 4))
TURN = 2 * np.pi
EXPOSURE = 0.4
RATE = 20.0  # frames/s, for motions with a frequency


@dataclass
class Page:
    """Rows of the tables."""

    rows: list[tuple[str, str, str]] = field(default_factory=list)

    def add(self, figure: str, measured: str, target: str = "") -> None:
        """Take a row, and show it."""
        self.rows.append((figure, measured, target))
        print(f"{figure:96} {measured:>26} {target:>16}", flush=True)


def fringes(pitch: float, order: tuple[int, ...], shifts: int) -> list[ProjectedPattern]:
    """Return the frames of one pitch."""
    return [ProjectedPattern(PatternKind.FRINGES, pitch=pitch, shift=k, shifts=shifts) for k in order]


def sequence(order: tuple[int, ...], *, white: bool = True) -> list[ProjectedPattern]:
    """Return the patterns of a stack whose finest pitch has a chosen order of shifts."""
    coarse = [each for pitch, count in COARSE for each in fringes(pitch, tuple(range(1, count + 1)), count)]
    fine = fringes(PITCH, order, SHIFTS)
    return [WHITE, *coarse, WHITE, *fine, WHITE] if white else [*coarse, *fine]


def times_of(patterns: list[ProjectedPattern]) -> np.ndarray:
    """Return times [frame], 0 in the middle of the finest pitch."""
    last = max(k for k, each in enumerate(patterns) if each.kind == PatternKind.FRINGES)
    return np.arange(len(patterns)) - last + (SHIFTS - 1) / 2


def expose(scene: Scene, patterns: list[ProjectedPattern], motion: Motion, noise: int = 0) -> np.ndarray:
    """Return the frames of a stack."""
    shown = [Shown(each.pitch, each.shift, max(each.shifts, 1)) for each in patterns]
    return scene.expose(shown, times_of(patterns).tolist(), motion, noise=noise)


def predicted(motion: Motion, scene: Scene) -> float:
    """Return the drift that an operator predicts from the speed [rad/frame]."""
    rate = (motion.course(0.01) - motion.course(-0.01)) / 0.02
    return TURN / PITCH * rate * (motion.right + scene.slope * motion.up)


def measure(scene: Scene, motion: Motion, noise: int = 0) -> MovingPhase:
    """Expose and measure a moving stack with shifts planned for its motion."""
    drift = predicted(motion, scene)
    patterns = sequence(plan_shifts(drift, SHIFTS, shifts=[SHIFTS], uncertainty=0.1).order)
    frames = expose(scene, patterns, motion, noise)
    return measure_moving_phase(
        frames, times_of(patterns), patterns, SETTINGS, drift=drift, exposure_time=scene.exposure
    )


def rms(values: np.ndarray) -> float:
    """Root mean square of what is measured."""
    return float(np.sqrt(np.nanmean(np.asarray(values, float) ** 2)))


class Tally:
    """Errors of several stacks together."""

    def __init__(self) -> None:
        self.errors: list[float] = []
        self.scores: list[float] = []
        self.drifts: list[float] = []
        self.valid: list[float] = []
        self.wrong = self.points = 0

    def take(self, scene: Scene, motion: Motion, measured: MovingPhase, truth: np.ndarray) -> float:
        """Take the result of a stack; return its z-score."""
        maps = measured.maps
        error = maps.phase.values - truth
        ordered = np.isfinite(error)
        self.wrong += int((np.abs(error[ordered]) > np.pi).sum())
        self.points += int(ordered.sum())
        self.errors.append(rms(error))
        self.scores.append(rms(error / maps.sigma.values))
        self.drifts.append(rms((maps.drift.values - scene.drift(PITCH, motion)) / maps.sigma_drift.values))
        self.valid.append(float(ordered.mean()))
        return self.scores[-1]


def measure_speeds(page: Page, count: int) -> None:
    """Ratios to rest at three speeds in all directions, with motion out of plane."""
    for speed, target in ((0.0, ""), (0.25, "<= 1.05"), (1.0, "<= 1.1"), (3.0, "<= 1.2")):
        tally, rest = Tally(), []
        for k in range(count if speed else 1):
            scene = Scene(seed=k, exposure=EXPOSURE)
            truth = scene.phase_at_rest(PITCH)
            still = sequence(tuple(range(1, SHIFTS + 1)), white=False)
            resting = absolute_phase(expose(scene, still, Motion()), still, noise=NOISE)
            rest.append(rms(resting.phase.values - truth))
            angle = TURN * k / count
            up = 0.3 * (1 if k % 2 else -1) if speed else 0.0
            motion = Motion(speed * np.cos(angle), speed * np.sin(angle), up)
            tally.take(scene, motion, measure(scene, motion), truth)
        ratios = np.array(tally.errors) / np.array(rest)
        what = f"{speed:g} px/frame in {count} directions, 0.3 px/frame out of plane" if speed else "no motion"
        page.add(
            f"RMS of the phase over that at rest, {what}: mean, largest",
            f"{ratios.mean():.3f}, {ratios.max():.3f}",
            target,
        )
        page.add(
            f"z-scores of the phase and of its drift, {what}",
            f"{min(tally.scores):.2f} to {max(tally.scores):.2f}, {min(tally.drifts):.2f} to {max(tally.drifts):.2f}",
            "0.9 to 1.1",
        )
        page.add(f"wrong orders, {what}", f"{tally.wrong} of {tally.points / 1e6:.2f} million", "0")
        page.add(f"part of the image that is measured, {what}", f"{min(tally.valid):.0%} to {max(tally.valid):.0%}")


def measure_displacements(page: Page, count: int) -> None:
    """Ratios to rest of displacement and strain, between a stack at rest and one in motion."""
    names = ("u", "v", "w", "e_11", "e_22", "e_12")
    for speed in (0.25, 1.0, 3.0):
        squares = []
        for k in range(count):
            scene = Scene(rows=160, columns=224, seed=200 + k, exposure=EXPOSURE, instants=3)
            angle = TURN * (k + 0.3) / count  # neither component is a whole number of pixels
            motion = Motion(speed * np.cos(angle), speed * np.sin(angle), 0.3, ((1e-4, 0.0), (0.0, 2e-4)))
            passed = (
                3.3 / speed
            )  # [frame] after which a point has moved by 3.3 px: displacements by whole pixels are better
            still = sequence(tuple(range(1, SHIFTS + 1)), white=False)

            held, onward = (lambda _, at=passed: at), (lambda t, at=passed: t + at)
            reference = absolute_phase(expose(scene, still, Motion(), 1), still, noise=NOISE)
            held_still = absolute_phase(expose(scene, still, replace(motion, course=held), 2), still, noise=NOISE)
            passing = measure(scene, replace(motion, course=onward), 2).maps
            errors = [errors_of(scene, motion, passed, reference, each) for each in (held_still, passing)]
            both = np.isfinite(errors[0]).all(axis=0) & np.isfinite(errors[1]).all(axis=0)
            squares.append([np.mean(each[:, both] ** 2, axis=1) for each in errors])
        resting, moving = np.swapaxes(squares, 0, 1)
        together = np.sqrt(moving.mean(axis=0) / resting.mean(axis=0))
        largest = np.sqrt(moving / resting).max(axis=0)
        for name, pooled, worst in zip(names, together, largest, strict=True):
            page.add(
                f"RMS of {name} over that at rest, {speed:g} px/frame, {count} directions together, largest of one",
                f"{pooled:.2f}, {worst:.2f}",
                "<= 1.15",
            )


def errors_of(scene: Scene, motion: Motion, course: float, reference: xr.Dataset, deformed: xr.Dataset) -> np.ndarray:
    """Return the errors of u, v, w [px] and of the strain between two stacks at the points of the first one."""
    field = measure_displacement(reference.texture.values, deformed.texture.values, window=24)
    found = np.stack([field.displacement_x.values, field.displacement_y.values])
    rows, columns = np.indices(found.shape[1:], np.float32)
    there = cv2.remap(deformed.phase.values.astype(np.float32), columns + found[0], rows + found[1], cv2.INTER_CUBIC)
    rise = (there - reference.phase.values) * PITCH / TURN - found[0]
    x, y = np.meshgrid(np.arange(scene.columns) - (scene.columns - 1) / 2, np.arange(scene.rows) - (scene.rows - 1) / 2)
    (xx, _), (_, yy) = motion.gradient
    u = found[0] - course * (motion.right + xx * x)
    v = found[1] - course * (motion.down + yy * y)
    w = rise / scene.slope - course * motion.up
    u_x, u_y, v_x, v_y = ((np.roll(d, -8, axis) - np.roll(d, 8, axis)) / 16 for d in (u, v) for axis in (1, 0))
    errors = np.stack([u, v, w, u_x, v_y, (u_y + v_x) / 2])
    errors[:, [*range(24), *range(-24, 0)]] = np.nan  # the border that a point may cross
    errors[:, :, [*range(24), *range(-24, 0)]] = np.nan
    return errors


def measure_ways(page: Page) -> None:
    """Compare ways to measure the motion within a stack."""
    scene = Scene(exposure=EXPOSURE)
    motion = Motion(1.0, 0.5, 0.3, ((0.002, 0.0), (0.0, -0.001)))
    order = plan_shifts(predicted(motion, scene), SHIFTS, shifts=[SHIFTS]).order
    truth, shape = scene.velocity(motion), (slice(40, -40), slice(40, -40))
    texture = {}
    for later in (-18.0, 18.0):
        patterns = sequence(order)
        shifted = Motion(
            motion.right, motion.down, motion.up, motion.gradient, course=lambda t, by=later: motion.course(t + by)
        )
        frames = expose(scene, patterns, shifted)
        texture[later] = measure_moving_phase(
            frames, times_of(patterns), patterns, SETTINGS, drift=predicted(motion, scene)
        ).maps.texture.values
    patterns = sequence(order)
    frames = expose(scene, patterns, motion)
    fine = frames[10:18].astype(np.float32)
    ways: dict[str, Callable[[], np.ndarray]] = {
        "white frames before and after the finest pitch": lambda: motion_between(frames[9], frames[18], 9.0).velocity,
        "textures of the stacks before and after": lambda: motion_between(texture[-18.0], texture[18.0], 36.0).velocity,
        "means of the halves of the finest pitch": lambda: (
            motion_between(fine[:4].mean(axis=0), fine[4:].mean(axis=0), 4.0).velocity
        ),
        "means of the two coarse pitches": lambda: (
            motion_between(frames[1:5].mean(axis=0), frames[5:9].mean(axis=0), 4.0).velocity
        ),
    }
    for name, way in ways.items():
        try:
            error = f"{rms((way() - truth)[:, *shape]):.4f}"
        except FringedicError:
            error = "no agreement"
        page.add(f"error of the velocity [px/frame], {name}", error)


def measure_courses(page: Page, count: int) -> None:
    """Sine and creep: the error stays within sigma, or the stack is named."""
    courses: dict[str, Callable[[float], Callable[[float], float]]] = {
        "sine of 0.3 Hz, amplitude 2 px, 20 frames/s": lambda start: (
            lambda t: np.sin(TURN * 0.3 * (t / RATE + start)) - np.sin(TURN * 0.3 * start)
        ),
        "creep, 4 px ln(1 + t / 1 s)": lambda start: (
            lambda t: 2 * (np.log1p(t / RATE + 1.5 + 3 * start) - np.log1p(1.5 + 3 * start))
        ),
    }
    for name, course in courses.items():
        tally, named, scores = Tally(), 0, []
        for k in range(count):
            scene = Scene(rows=160, columns=224, seed=100 + k, exposure=EXPOSURE, instants=3)
            motion = Motion(2.0, 0.6, 1.0, course=course(k / count))
            try:
                scores.append(tally.take(scene, motion, measure(scene, motion), scene.phase_at_rest(PITCH)))
            except FringedicError:
                named += 1
        page.add(
            f"{name}, {count} stacks: z-scores of the phase, wrong orders, stacks that are named",
            f"{min(scores):.2f} to {max(scores):.2f}, {tally.wrong}, {named}",
            "<= 1.1 or named",
        )


def random_motion(random: np.random.Generator) -> Motion:
    """Return a motion that the model covers."""
    bend = random.uniform(-0.01, 0.01)
    gradient = tuple(tuple(row) for row in random.uniform(-0.002, 0.002, (2, 2)))
    return Motion(
        *random.uniform(-2.5, 2.5, 2),
        random.uniform(-0.3, 0.3),
        gradient,
        tuple(random.uniform(-0.0005, 0.0005, 2)),
        course=lambda t: t + bend * t * t,
    )


def measure_random(page: Page, count: int) -> None:
    """Motions that the model covers are measured."""
    random = np.random.default_rng(51)
    tally, refused = Tally(), []
    for k in range(count):
        scene = Scene(
            rows=128, columns=192, seed=1000 + k, exposure=random.uniform(0.1, 0.6), instants=3,
            feature=random.uniform(1.6, 2.4), bright=random.uniform(70, 120),
        )  # fmt: skip
        motion = random_motion(random)
        try:
            tally.take(scene, motion, measure(scene, motion), scene.phase_at_rest(PITCH))
        except FringedicError as error:
            refused.append(str(error))
    for reason in refused:
        print("  refused:", reason)
    page.add(f"false refusals of {count} random motions", str(len(refused)), "0")
    page.add(
        f"wrong orders in {count} random motions", f"{tally.wrong} of {tally.points / 1e6:.2f} million", "0 of 10^6"
    )
    low, middle, high = np.percentile(tally.scores, [2.5, 50, 97.5])
    page.add(
        f"z-scores of the phase of {count} random motions: median, 95 %",
        f"{middle:.2f}, {low:.2f} to {high:.2f}",
        "0.9 to 1.1",
    )
    low, middle, high = np.percentile(tally.drifts, [2.5, 50, 97.5])
    page.add(
        f"z-scores of the drift of {count} random motions: median, 95 %",
        f"{middle:.2f}, {low:.2f} to {high:.2f}",
        "0.9 to 1.1",
    )


def measure_faults(page: Page, count: int) -> None:
    """Faults are named."""
    random = np.random.default_rng(52)

    def faulty(kind: str, scene: Scene) -> None:
        motion = replace(random_motion(random), gradient=((0.0, 0.0), (0.0, 0.0)))
        drift = predicted(motion, scene)
        if kind == "shift along the motion":
            motion = Motion(1.5 + random.uniform(-0.15, 0.15), random.uniform(-1, 1))
            patterns = sequence(tuple(range(1, SHIFTS + 1)))
            measure_moving_phase(expose(scene, patterns, motion), times_of(patterns), patterns, SETTINGS)
            return
        start, size = random.uniform(-2.5, 2.5), random.uniform(1.0, 3.0) * random.choice([-1, 1])
        if kind == "jump of 1 to 3 px (stick-slip)":
            motion = Motion(1.0, 0.3, 0.3, course=lambda t: 0.1 * t + size * (float(t > start) - float(start < 0)))
            drift = 0.1 * TURN / PITCH
        if kind == "reversal":
            motion = Motion(random.uniform(0.7, 2.0), 0.3, 0.5, course=lambda t: abs(t - start) - abs(start))
            drift = 0.0
        patterns = sequence(plan_shifts(drift, SHIFTS, shifts=[SHIFTS], uncertainty=0.1).order)
        frames = expose(scene, patterns, motion)
        if kind == "wrong frame":
            k = int(random.integers(10, 17))
            frames[k] = frames[k + 1]
        measure_moving_phase(frames, times_of(patterns), patterns, SETTINGS, drift=drift)

    for kind in ("wrong frame", "shift along the motion", "jump of 1 to 3 px (stick-slip)", "reversal"):
        named = 0
        for k in range(count):
            scene = Scene(rows=128, columns=192, seed=5000 + k, exposure=EXPOSURE, instants=3)
            try:
                faulty(kind, scene)
            except FringedicError:
                named += 1
        page.add(f"named of {count} stacks with a fault: {kind}", f"{named}", ">= 99 %")


def measure_times(page: Page, runs: int) -> None:
    """Processor time of a moving stack, and of the same frames at rest."""
    scene = Scene(exposure=EXPOSURE)
    motion = Motion(1.0, 0.5)
    patterns = sequence(plan_shifts(predicted(motion, scene), SHIFTS, shifts=[SHIFTS]).order)
    moving = np.tile(expose(scene, patterns, motion), (1, 4, 4))
    still = sequence(tuple(range(1, SHIFTS + 1)), white=False)
    resting = np.tile(expose(scene, still, Motion()), (1, 4, 4))
    noisy = replace(SETTINGS, largest_misfit=np.inf)  # the seams of the tiles do not move as the tiles do

    def best(work: Callable[[], object]) -> float:
        spent = []
        for _ in range(runs):
            begin = time.process_time()
            work()
            spent.append(time.process_time() - begin)
        return 1e3 * min(spent)

    rest = best(lambda: absolute_phase(resting, still, noise=NOISE))
    checked = rest + best(lambda: inspect_stack(resting, still, SETTINGS))
    align = best(lambda: measure_moving_phase(moving, times_of(patterns), patterns, noisy))
    page.add(
        "processor time at 1280x960, 16 fringe frames: at rest, with the checks of the frames [ms]",
        f"{rest:.0f}, {checked:.0f}",
    )
    page.add("the same, moving: motion of the white frames, alignment, fit and checks [ms]", f"{align:.0f}")
    page.add("processor time of the phase in motion over that at rest with its checks", f"{align / checked:.0f}")


def measure_whole_steps(page: Page, runs: int) -> None:
    """Processor time of phase, displacement, shape and strain of a stack in motion, and of one at rest."""
    rig = VirtualRig.from_preset("plate", size="small")
    rows, columns = rig.projector_shape
    settings = SequenceSettings()
    noise = PhaseParameters(read_noise_grey_level=NOISE.read, shot_noise_grey_level=NOISE.shot)
    stacks = []
    for step, patterns in enumerate([settings.patterns(columns, rows), settings.moving_patterns(columns, rows)]):
        motion = ConstantRate(3e-4, step * 2e-4)
        times = 0.05 * (np.arange(len(patterns)) - 12.5)
        frames = [
            rig.expose_moving(render_pattern(each, columns, rows), motion, time, 0.02, 100 * step + k, instants=1)
            for k, (each, time) in enumerate(zip(patterns, times, strict=True))
        ]
        stamps = [10**9 * (1 + step) + round(1e9 * time) for time in times]
        records = [
            FrameRecord("e", step, k, len(patterns), each, stamp, 0.02)
            for k, (each, stamp) in enumerate(zip(patterns, stamps, strict=True))
        ]
        stacks.append(Stack("e", step, records, np.array(frames), stamps[-1]))
    resting, moving = stacks

    def seconds(stack: Stack) -> float:
        displacement, shape = DisplacementTracker(DicParameters()), ShapeTracker(CouplingParameters())
        shape.set_calibration(RigModel(**rig.optics()))
        spent = []
        for step in range(runs + 1):
            each = replace(resting if step == 0 else stack, step=step)
            begin = time.process_time()
            phase = phase_step(each, noise)
            shape.step(phase, displacement.step("e", step, each.stamp, phase.texture))
            spent.append(time.process_time() - begin)
        return min(spent[1:])

    seconds(moving)  # compiles
    still, in_motion = seconds(resting), seconds(moving)
    page.add(
        f"processor time at {rig.shape[1]}x{rig.shape[0]}, phase to strain: at rest, in motion [ms]",
        f"{1e3 * still:.0f}, {1e3 * in_motion:.0f}",
    )
    page.add("processor time of a whole stack in motion over one at rest", f"{in_motion / still:.1f}", "<= 2")


def write(page: Page, *, short: bool) -> None:
    """Write the page; `short` says that fewer stacks than planned were measured."""
    note = "\nA short form: the target is for 300 random motions (`--random 300`).\n" if short else ""
    rows = "\n".join(f"| {figure} | {measured} | {target} |" for figure, measured, target in page.rows)
    PAGE.write_text(
        f"""# Measuring while the specimen moves: measured figures

This page shows how well the phase of a moving surface is measured, beside the same stack at rest, and which faults are
named. The method is explained in [Moving specimens](../moving.md). `python benchmarks/moving.py` writes it.
z is proportional to the phase here, so that the ratios of the phase are those of z.
{note}

*Measured on {date.today()} with frames of `benchmarks/moving_scenes`, which uses nothing of the library: orthographic
camera, speckled bumps of 12 px height, 320x240 px (displacements and courses 224x160, random motions and faults
192x128), 8 bits, read noise 1 GL, shot noise variance 0.02 per GL, blur of lens and pixels 0.7 px, exposure 0.4 of the
interval of two frames.
Pitches 384, 48 and 12 px with 4, 4 and 8 shifts, those of the finest pitch in the direction that `plan_shifts` chooses;
white frames at the begin, before the finest pitch and at the end: 19 frames. The motion is measured from the white
frames. Errors are counted from the phase that frames at rest without noise have. Ratios are those to 16 frames at rest
of the same scene. Random motions: 2.5 px/frame along x and along y, 0.3 px/frame out of plane, 0.2 % strain and shear,
0.05 % tilt and 1 % acceleration per frame at most; exposure, speckle size and brightness are random too. u, v, w and
strain: between a stack at rest and one that moves and is 3.3 px away, with 0.01 and 0.02 % strain per frame, over those
between two stacks at rest; window 24 px, strain over 16 px. Processor time of whole stacks: plate of the virtual rig,
sequences of the rig file.*

| figure | measured | target |
|---|---:|---:|
{rows}

Jumps and reversals inside the finest pitch leave residuals that exceed the noise. Motion blur of half of the modulation
needs a drift of more than half a turn per frame, which no order of shifts can follow, so that it is not among these
faults.
"""
    )


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few stacks")
    parser.add_argument("--random", type=int, default=200, help="random motions (200); other counts follow")
    options = parser.parse_args()
    count = 5 if options.quick else options.random
    page = Page()
    measure_speeds(page, max(count // 80, 2))
    measure_displacements(page, max(count // 60, 2))
    measure_ways(page)
    measure_courses(page, max(count // 25, 2))
    measure_random(page, count)
    measure_faults(page, max(count // 8, 3))
    measure_times(page, 1 if options.quick else 3)
    measure_whole_steps(page, 1 if options.quick else 3)
    write(page, short=count < 300)


if __name__ == "__main__":
    main()
