"""Phase: noise, fringe orders, response, exposures, one image, lens blur and speed, beside targets and other programs.

Linear algebra runs in one thread, as in the nodes.
Frames come from the virtual rig at 1280x960. Writes docs/validation/phase.md with its pictures. `python
benchmarks/phase.py --no-rivals` omits the package `fringes`.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as fringedic_ros does

import cv2
import matplotlib
import numba
import numpy as np
import xarray as xr
from rivals.environment import rival_python, run_in

from fringedic.frames.noise import CameraNoise
from fringedic.patterns.render import render_pattern
from fringedic.patterns.sequences import PatternSequence, fringe_sequence, gray_code_sequence, one_image_sequence
from fringedic.phase import (
    absolute_phase,
    correct_lens_blur,
    demodulate,
    measure_phase,
    one_image_phase,
    unwrap_spatial,
)
from fringedic.phase.checks import check_stack
from fringedic.phase.checks.harmonic_error import SERIES_SHIFTS, measure_harmonic_error
from fringedic.rig.model import RigModel
from fringedic.rig_setup.response import measure_response, response_patterns
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

matplotlib.use("Agg")
import matplotlib.pyplot as plt

PAGE = Path(__file__).resolve().parents[1] / "docs" / "validation" / "phase.md"
NOISE = CameraNoise(read=float(np.hypot(1.0, 12**-0.5)), shot=0.02)
PITCH = 10.0
FREQUENCIES = (1, 5, 20, 80)
SHIFTS = (4, 4, 4, 8)
SEEDS = (0, 1, 2, 3, 4)
RUNS = 15
LOAD = os.getloadavg()[0]
TURN = 2 * np.pi
# The target rig: aligned, 50 um/px, h0 400 mm, hp 380 mm, d 180 mm, focal length 3400 px, 8 bits, plain surface.
TARGET_RIG = {"preset": "plane", "ideal": True, "texture": {"floor": 0.999}, "specimen": {"angle_degree": 0.0}}
TARGET_NOISE = {"read_noise_grey_level": 1.0, "shot_noise_grey_level": 0.02}
EXPOSED = 0.82  # full white on the surface over full scale, as an operator sets it
ALBEDO = 0.7


@dataclass
class Page:
    """Rows of the tables and what is written beneath them."""

    rows: list[tuple[str, str, str]] = field(default_factory=list)

    def add(self, figure: str, measured: str, target: str = "") -> None:
        """Take a row, and show it."""
        self.rows.append((figure, measured, target))
        print(f"{figure:82} {measured:>30} {target:>14}", flush=True)


def rig_of(**changes: Any) -> VirtualRig:
    """Return the twin of a preset at the paper's size with single values changed."""
    return VirtualRig(VirtualRigConfiguration.from_dict(changes))


def frames_of(twin: VirtualRig, sequence: PatternSequence, seed: int = 0, **exposure: float) -> np.ndarray:
    """Take the frames of a sequence; each seed gives other noise."""
    return np.array([twin.expose(image, 0.0, 1000 * seed + index, **exposure) for index, image in enumerate(sequence)])


def finest(columns: int, rows: int, shifts: int | tuple[int, ...] = SHIFTS) -> PatternSequence:
    """Return the coarse-to-fine sequence of the targets."""
    return fringe_sequence(columns, rows, [columns / part for part in FREQUENCIES], shifts)


def exact_turns(twin: VirtualRig, pitch: float = PITCH) -> np.ndarray:
    """Return the exact phase of every pixel [turn]."""
    return np.asarray((twin.view(0.0).projector_column - (twin.projector_shape[1] - 1) / 2) / pitch)


def rms(values: np.ndarray) -> float:
    """Root mean square of what is measured."""
    return float(np.sqrt(np.nanmean(values**2)))


def measure_noise(page: Page) -> None:
    """Noise of the target rig, and of one with speckle."""
    plate = rig_of(preset="plate")
    for name, twin, shifts in (
        (
            "target rig, exposure for its surface",
            rig_of(**TARGET_RIG, sensor={"white_level": EXPOSED, **TARGET_NOISE}),
            8,
        ),
        (
            "target rig, exposure for white, albedo 0.7",
            rig_of(**TARGET_RIG, sensor={"white_level": ALBEDO * EXPOSED, **TARGET_NOISE}),
            8,
        ),
        ("plate with speckle", plate, 8),
        ("plate with speckle, four more frames", plate, 12),
    ):
        rows, columns = twin.projector_shape
        sequence = finest(columns, rows, (*SHIFTS[:-1], shifts))
        result = absolute_phase(frames_of(twin, sequence), sequence.patterns, noise=NOISE)
        error = result.phase.values / TURN - exact_turns(twin)
        score = np.nanstd(error * TURN / result.sigma.values)
        typical = float(np.nanmedian(np.abs(error))) / 0.6745
        modulation = float(result.modulation.median())
        page.add(
            f"noise, {name}, q = {shifts}, modulation {modulation:.0f} GL: RMS / median pixel [fringe]",
            f"{rms(error):.5f} / {typical:.5f}",
            "<= 0.0021",
        )
        page.add(f"z-score of sigma, {name}", f"{score:.3f}", "0.95 to 1.05")


def measure_orders(page: Page, folder: Path) -> None:
    """Wrong orders on the stepped object, by every way of finding them."""
    counts: dict[str, list[int]] = {}
    pictures = {}
    for seed in SEEDS:
        twin = rig_of(preset="stepped", seed=seed)
        rows, columns = twin.projector_shape
        truth = exact_turns(twin)
        ways = {
            "coarse to fine 800/160/40/10, q = 4": finest(columns, rows, 4),
            "coarse to fine 800/80/10, q = 4": fringe_sequence(columns, rows, [800, 80, 10], 4),
            "complementary Gray code, q = 4": gray_code_sequence(columns, rows, PITCH, 4),
        }
        for name, sequence in ways.items():
            result = absolute_phase(frames_of(twin, sequence, seed), sequence.patterns, noise=NOISE)
            wrong = np.abs(result.phase.values / TURN - truth) > 0.5
            tally = counts.setdefault(f"{name}, {len(sequence)} frames", [0, 0])
            tally[0] += int(wrong.sum())
            tally[1] += int(result.valid.sum())
            if seed == 0:
                pictures[name] = np.where(result.valid, wrong, np.nan)
        if seed == 0:
            sequence = fringe_sequence(columns, rows, [PITCH], 4)
            wrapped = demodulate(frames_of(twin, sequence), 4, noise=NOISE)
            turns = unwrap_spatial(wrapped.phase).values / TURN - truth
            turns -= np.round(np.nanmedian(turns))
            ordered = np.isfinite(turns)
            wrong = np.abs(turns) > 0.5
            valid = int(wrapped.valid.sum())
            spatial = f"{wrong[ordered].sum() / valid:.0%} wrong, {1 - ordered.sum() / valid:.0%} without an order"
            pictures["spatial unwrapping of one pitch"] = np.where(np.isfinite(turns), wrong, np.nan)
    for name, (number, valid) in counts.items():
        page.add(
            f"wrong orders, stepped object with shadows, {name}", f"{number} of {valid / 1e6:.1f} million", "<= 1e-5"
        )
    page.add("wrong orders, spatial unwrapping of one pitch (scikit-image, largest region)", spatial, "31 %")
    chosen = [name for name in pictures if "800/80" not in name]
    figure, axes = plt.subplots(1, len(chosen), figsize=(11, 3.1), constrained_layout=True)
    for axis, name in zip(axes, chosen, strict=True):
        axis.imshow(pictures[name], cmap="coolwarm", vmin=0, vmax=1, interpolation="nearest")
        axis.set_title(name, fontsize=9)
        axis.set_axis_off()
    figure.savefig(folder / "phase_orders.png", dpi=110)


def measure_response_curve(page: Page, folder: Path) -> None:
    """Waves of a projector of gamma 2.2 before a camera that bends the light too, before and after the correction."""
    bent = {"preset": "plane", "projector": {"gamma": 2.2}, "texture": {"floor": 0.999}}
    twin = rig_of(**bent, sensor={"response": 0.9})
    silent = rig_of(
        **bent, sensor={"response": 0.9, "read_noise_grey_level": 0, "shot_noise_grey_level": 0, "bits": 16}
    )
    rows, columns = twin.projector_shape
    greys = response_patterns()
    ramp = np.array([twin.expose(render_pattern(each, columns, rows), 0.0, k) for k, each in enumerate(greys)])
    curve = measure_response(ramp, greys)
    page.add("response curve: gamma of projector x camera (2.2 x 0.9 = 1.98)", f"{curve.gamma:.3f}")
    truth = exact_turns(silent)
    lines = {}
    for shifts in (3, 4, 8):
        waves = []
        for known in (None, curve):
            sequence = fringe_sequence(columns, rows, [800, 160, 40, 10], [4, 4, 4, shifts], response=known)
            error = (
                absolute_phase(frames_of(silent, sequence), sequence.patterns, noise=20.0).phase.values / TURN - truth
            )
            waves.append(rms(error - np.nanmean(error)))
            lines[shifts, known is not None] = error[480, 600:680]
        reference = "without: 0.026" if shifts == 3 else ""
        page.add(
            f"harmonic error, q = {shifts}, without / with correction [fringe]",
            f"{waves[0]:.5f} / {waves[1]:.5f}",
            reference,
        )
    for name, known in (("without", None), ("with", curve)):
        series = fringe_sequence(columns, rows, [PITCH], SERIES_SHIFTS, response=known)
        seen = measure_harmonic_error(frames_of(twin, series))
        page.add(
            f"harmonic error by `fringedic response`, noisy frames, {name} correction: q = 3 / 4 / 8 [fringe]",
            " / ".join(f"{seen.rms(each):.5f}" for each in (3, 4, 8)),
        )
    figure, axes = plt.subplots(1, 3, figsize=(11, 2.8), sharey=True, constrained_layout=True)
    for axis, shifts in zip(axes, (3, 4, 8), strict=True):
        axis.plot(lines[shifts, False], label="gamma 2.2, camera bent by .9")
        axis.plot(lines[shifts, True], label="pre-compensated patterns")
        axis.set_title(f"q = {shifts}", fontsize=9)
        axis.set_xlabel("column [px]")
    axes[0].set_ylabel("error [fringe]")
    axes[0].legend(fontsize=8)
    figure.savefig(folder / "phase_response.png", dpi=110)


def measure_exposures(page: Page) -> None:
    """Merged exposures on a surface whose brightness differs by a factor of 50."""
    times = (1.0, 4.0, 16.0)
    twin = rig_of(preset="sphere", texture={"floor": 0.02}, sensor={"ambient_light": 0.005})
    rows, columns = twin.projector_shape
    sequence = fringe_sequence(columns, rows, [800, 80, 10], 4)
    stacks = [frames_of(twin, sequence, number, exposure_factor=each) for number, each in enumerate(times)]
    truth = exact_turns(twin)
    patterns = list(sequence.patterns)

    def measured(chosen: list[int]) -> xr.Dataset:
        frames = np.concatenate([stacks[number] for number in chosen])
        exposed = [times[number] for number in chosen for _ in patterns]
        return measure_phase(frames, patterns * len(chosen), exposure_times=exposed)[0]

    for chosen in ([0], [1], [2], [0, 1], [0, 1, 2]):
        result = measured(chosen)
        error = result.phase.values / TURN - truth
        score = np.nanstd(error * TURN / result.sigma.values)
        page.add(
            f"surface with glare and dark parts, exposure x{' and x'.join(f'{times[each]:g}' for each in chosen)}: "
            "valid, noise RMS [fringe], z-score",
            f"{float(result.valid.mean()):.1%}, {rms(error):.5f}, {score:.3f}",
            "0.95 to 1.05",
        )
    page.add("2 x 12 frames merged, checked and measured [ms]", milliseconds(lambda: measured([0, 1])))


def measure_one_image(page: Page) -> None:
    """One-image phase on plain and speckled surfaces."""
    for name, floor, divided, target in (
        ("plain surface", 0.999, False, "<= 0.005"),
        ("speckle", 0.12, False, "<= 0.017"),
        ("speckle, divided by a grey image", 0.12, True, "<= 0.005"),
    ):
        twin = rig_of(preset="sphere", texture={"floor": floor})
        rows, columns = twin.projector_shape
        grey, image = frames_of(twin, one_image_sequence(columns, rows, PITCH, grey=True))
        result = one_image_phase(image, white=grey if divided else None, noise=NOISE)
        error = result.phase.values / TURN - exact_turns(twin)
        error -= np.round(np.nanmedian(error))
        page.add(
            f"one image, {name}: RMS inside / with a border of 60 px [fringe]",
            f"{rms(error[60:-60, 60:-60]):.5f} / {rms(error):.5f}",
            target,
        )


def measure_blur(page: Page, folder: Path) -> None:
    """Bias that the lens's blur gives a speckled surface, and what the correction leaves."""
    bars: dict[str, list[float]] = {"uncorrected": [], "corrected": []}
    names = []
    for floor in (0.4, 0.12):
        sensor = {"bits": 16, "lens_blur_px": 0.8, "read_noise_grey_level": 0.0, "shot_noise_grey_level": 0.0}
        twin = rig_of(preset="sphere", ideal=True, texture={"floor": floor}, sensor=sensor)
        rows, columns = twin.projector_shape
        sequence = finest(columns, rows)
        result = absolute_phase(frames_of(twin, sequence), sequence.patterns, noise=20.0)
        rig, height = RigModel(**twin.optics()), twin.truth(0.0).z.values
        contrast = float(result.texture.std() / result.texture.mean())
        names.append(f"speckle contrast {contrast:.0%}")
        for name, phase in (
            ("uncorrected", result.phase.values),
            ("corrected", correct_lens_blur(result.phase, result.modulation, 0.8)),
        ):
            bars[name].append(1e6 * rms((rig.reconstruct(phase, PITCH).z.values - height)[5:-5, 5:-5]))
        page.add(
            f"z bias by a lens blur of 0.8 px, contrast {contrast:.0%}: uncorrected / corrected [um]",
            f"{bars['uncorrected'][-1]:.2f} / {bars['corrected'][-1]:.2f}",
            "7-9 / 2" if floor == 0.4 else "",
        )
    figure, axis = plt.subplots(figsize=(5, 2.8), constrained_layout=True)
    for offset, (name, values) in zip((-0.2, 0.2), bars.items(), strict=True):
        axis.bar(np.arange(len(values)) + offset, values, 0.4, label=name)
    axis.set_xticks(range(len(names)), names)
    axis.set_ylabel("z bias RMS [µm]")
    axis.legend()
    figure.savefig(folder / "phase_blur.png", dpi=110)


def milliseconds(work: Callable[[], object]) -> str:
    """Return the best and the median time of several runs, and the best time that the processor's cores worked."""
    work()
    times, worked = [], []
    for _ in range(RUNS):
        begin, begun = time.perf_counter(), time.process_time()
        work()
        times.append(time.perf_counter() - begin)
        worked.append(time.process_time() - begun)
    return f"{1e3 * min(times):.0f} / {1e3 * float(np.median(times)):.0f} / {1e3 * min(worked):.0f}"


def opencv_demodulation(frames: np.ndarray) -> np.ndarray:
    """The same arctangent with what OpenCV has for it: one weighted sum per frame, and phase()."""
    sine = np.zeros(frames.shape[1:], np.float32)
    cosine, mean = np.zeros_like(sine), np.zeros_like(sine)
    for k, frame in enumerate(frames, start=1):
        level = frame.astype(np.float32)
        cv2.scaleAdd(level, float(np.sin(TURN * k / len(frames))), sine, sine)
        cv2.scaleAdd(level, float(np.cos(TURN * k / len(frames))), cosine, cosine)
        cv2.add(mean, level, mean)
    cv2.magnitude(cosine, sine)
    return cv2.phase(cosine, sine)


def measure_speed(page: Page, folder: Path, rivals: bool) -> None:
    """Time of demodulation and unwrapping, beside OpenCV's functions and the package `fringes`."""
    twin = rig_of(preset="stepped")
    rows, columns = twin.projector_shape
    sequence = finest(columns, rows)
    frames = frames_of(twin, sequence)
    projections = list(sequence.patterns)
    page.add(
        "8 frames: phase, modulation, mean, noise estimate [ms: best / median / processor time of all cores]",
        milliseconds(lambda: demodulate(frames[-8:], 8)),
        "<= 40",
    )
    page.add(
        "the same frames, OpenCV: scaleAdd, phase, magnitude only [ms]",
        milliseconds(lambda: opencv_demodulation(frames[-8:])),
    )
    page.add("20 frames with unwrapping [ms]", milliseconds(lambda: absolute_phase(frames, projections)), "<= 120")
    page.add(
        "20 frames with unwrapping and checks of the frames, as in the node [ms]",
        milliseconds(lambda: measure_phase(frames, projections)),
        "<= 120",
    )
    page.add("checks of the frames only [ms]", milliseconds(lambda: check_stack(frames, projections)), "<= 20")
    python = rival_python("fringes") if rivals else None
    if python is None:
        return
    (folder / "job.json").write_text(
        json.dumps({"width": columns, "height": rows, "frequencies": FREQUENCIES, "shifts": SHIFTS})
    )
    wrapped = demodulate(frames[-8:], 8)
    np.save(folder / "wrapped.npy", wrapped.phase.values)
    if not run_in(python, "measure_with_fringes.py", folder):
        return
    patterns = np.load(folder / "patterns.npy")
    np.save(folder / "frames.npy", np.array([twin.expose(image, 0.0, k) for k, image in enumerate(patterns)]))
    if not run_in(python, "measure_with_fringes.py", folder):
        return
    decoded = np.load(folder / "decoded.npz")
    seconds = decoded["seconds"]
    page.add(
        f"package fringes 2.1.0, {len(patterns)} frames of its own patterns [ms]",
        f"{1e3 * seconds.min():.0f} / {1e3 * np.median(seconds):.0f}",
    )
    ours = absolute_phase(frames, projections, noise=NOISE)
    both = ours.valid.values
    column = decoded["column"] - twin.view(0.0).projector_column
    mine = (ours.phase.values / TURN - exact_turns(twin)) * PITCH
    for name, error in (("fringedic", mine), ("fringes", column)):
        error = error[both] - np.median(error[both])
        wrong = np.abs(error) > PITCH / 2
        page.add(
            f"stepped object, {name}: noise of the median pixel [projector px], wrong orders (valid for fringedic)",
            f"{np.median(np.abs(error)) / 0.6745:.4f}, {wrong.mean():.1e}",
        )
    turns = decoded["unwrapped"] / TURN - exact_turns(twin)
    turns -= np.round(np.median(turns[both]))
    page.add(
        "spatial unwrapping by OpenCV (contrib), one pitch, q = 8: wrong orders",
        f"{np.mean(np.abs(turns[both] - np.median(turns[both])) > 0.5):.0%}",
    )


def write_page(page: Page) -> None:
    """Write the generated page."""
    table = "\n".join(f"| {figure} | {measured} | {target} |" for figure, measured, target in page.rows)
    threads = numba.get_num_threads()
    PAGE.write_text(
        f"""# Phase: measured figures

This page shows noise, fringe orders, response, exposures and speed of the phase measurement. It is written by
`python benchmarks/phase.py`.

## Figures

*Measured on {date.today()}, {threads} threads, with frames of the virtual rig: 1280x960, projector of 800x600 px,
pitch {PITCH:g} px, 8 bits, read noise 1 GL before rounding, shot noise variance 0.02 per GL (GL: grey level).
Target rig: 50 µm/px, h0 400 mm, hp 380 mm, d 180 mm, focal length 3400 px, plain surface of albedo 0.7. Exposure
for its surface: white light gives 82 % of full scale on it. Exposure for white: 82 % on a surface of albedo 1, 57 %
on this one. Speckled plate: its bright paint at 82 %. Times: best and median of {RUNS} runs with other work on the
machine (load {LOAD:.1f} on {os.cpu_count()} cores), and the processor time of all cores in the best run, which
other work hardly changes:*

| figure | measured | target |
|---|---:|---:|
{table}

![Wrong fringe orders (red) on the stepped object; white is not measured](phase_orders.png)

![Error along a row with a nonlinear response, without and with pre-compensated patterns](phase_response.png)

![Bias by the blur of the lens on speckle](phase_blur.png)

`fringes` decodes frames of its own patterns (same number, pitches and shifts, same scene and noise), because its
phases have another zero. Its time includes its unwrapping, which uses all frequencies at once. The spatial
unwrapping of OpenCV is part of its contributed modules.

## Remarks

- **Relative orders.** Orders from a single pitch ([relative](../nodes/phase.md#sequences-of-a-step)): the part that a
  shadow separates from the largest region is not measured. OpenCV assigns orders to it, and they are wrong.
- **Speckle.** The median pixel is darker than the bright paint that determines the exposure. More frames of the
  finest pitch reduce the noise as 1 / sqrt(q); a weighted merge of the coarser pitches reduces it by 2 %.
- **Response.** The remaining error is the 8-bit quantisation of the projector.
- **One image.** The error increases towards the border of the image, where half of the window is missing. On smooth
  surfaces without texture the error is the curvature inside the window, which sigma does not contain.
"""
    )


def main() -> None:
    """Measure everything and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-rivals", action="store_true", help="omit the package fringes")
    arguments = parser.parse_args()
    page, pictures = Page(), PAGE.parent
    with tempfile.TemporaryDirectory() as folder:
        measure_speed(page, Path(folder), not arguments.no_rivals)
    measure_noise(page)
    measure_orders(page, pictures)
    measure_response_curve(page, pictures)
    measure_exposures(page)
    measure_one_image(page)
    measure_blur(page, pictures)
    write_page(page)


if __name__ == "__main__":
    main()
