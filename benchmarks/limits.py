"""Achieved noise over the Cramer-Rao bound, for phase and displacement. Writes docs/validation/limits.md."""

from __future__ import annotations

import os
from datetime import date
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import xarray as xr

from fringedic.correlation import measure_displacement
from fringedic.frames.noise import CameraNoise
from fringedic.patterns.sequences import fringe_sequence
from fringedic.phase import absolute_phase, measure_phase
from fringedic.phase.limit import phase_limit
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import FringeScene, VirtualRig
from fringedic.virtual_rig.configuration import VirtualRigConfiguration

PAGE = Path(__file__).resolve().parents[1] / "docs" / "validation" / "limits.md"
SIZE = 512  # px of the textures
BORDER = 40  # px: whole windows only
SHIFT = (0.27, -0.41)  # px along x and y
SEEDS = (1, 2, 3)
PLATE = 137  # seed of texture and noise of the speckled plate
ROUNDED = CameraNoise(np.sqrt(1 + 1 / 12), 0.02)  # of the virtual rig: read noise and rounding, and shot noise
CLASSES = (0.05, 0.25, 0.5, 0.75, 0.95)  # quantiles of the modulation, from dark to light points
USUAL = ([800.0, 160.0, 40.0, 10.0], [4, 4, 4, 8])
# What a user can change at 20 frames: pitches and shifts, relative exposures, darkest reflectance of the paint.
PLATES = {
    "usual sequence": (*USUAL, (1.0,), 0.12),
    "3 shifts of the coarse pitches, 11 of the finest": (USUAL[0], [3, 3, 3, 11], (1.0,), 0.12),
    "the same, finest pitch 8 px": ([800.0, 160.0, 32.0, 8.0], [3, 3, 3, 11], (1.0,), 0.12),
    "the same, finest pitch 6 px": ([800.0, 150.0, 30.0, 6.0], [3, 3, 3, 11], (1.0,), 0.12),
    "one pitch less, 14 shifts of the finest": ([800.0, 80.0, 10.0], [3, 3, 14], (1.0,), 0.12),
    "two exposures x1 and x4 of 10 frames": ([800.0, 80.0, 10.0], [3, 3, 4], (1.0, 4.0), 0.12),
    "grey speckles, reflectance 0.4 instead of 0.12": (*USUAL, (1.0,), 0.4),
}


def phase_ratio(shifts: int, shot: float) -> float:
    """Return the RMS error of the finest phase over its Cramer-Rao bound (`phase_limit`)."""
    scene = FringeScene(
        rows=200,
        columns=400,
        seed=5,
        grey=70.0,
        texture=0.15,
        bits=0,
        read_noise=1.0,
        shot_noise=shot,
        first_column=20.0,
        last_column=220.0,
    )
    shown = fringe_sequence(240, 4, [240, 48, 12], [4, 4, shifts])
    silent = scene.without_noise()
    frames, exact = (np.array([each.expose(image, k) for k, image in enumerate(shown)]) for each in (scene, silent))
    noise = CameraNoise(1.0, shot)
    measured, true = (absolute_phase(each, shown.patterns, noise=noise) for each in (frames, exact))
    maps = (true[name].values.astype(float) for name in ("texture", "modulation", "phase"))
    error = measured.phase.values - true.phase.values
    return float(np.sqrt(np.nanmean((error / phase_limit(*maps, shifts, noise)) ** 2)))


def plate_rows() -> tuple[list[str], list[str]]:
    """Return the rows of what a user can change on a speckled plate, and of the ratios by the modulation.

    Two stacks of the plate at rest differ by noise only: the difference of their heights is raw w.
    """
    changes, ratios = [], []
    for words, (pitches, shifts, exposures, floor) in PLATES.items():
        entries = {"preset": "plate", "seed": PLATE, "texture": {"floor": floor}}
        twin = VirtualRig(VirtualRigConfiguration.from_dict(entries))
        rig = RigModel(**twin.optics())
        shown = fringe_sequence(rig.projector_width, rig.projector_height, pitches, shifts)
        numbers = iter(range(10_000))
        stacks = [
            np.array(
                [twin.expose(image, 0.0, next(numbers), exposure_factor=each) for each in exposures for image in shown]
            )
            for _ in "ab"
        ]
        times = np.repeat(exposures, len(shown.patterns))
        patterns = list(shown.patterns) * len(exposures)
        found = [measure_phase(stack, patterns, exposure_times=times)[0] for stack in stacks]
        heights = [rig.reconstruct(each.phase.values, pitches[-1], each.sigma.values).z.values for each in found]
        w = heights[1] - heights[0]
        lit = np.isfinite(twin.truth(0.0).z.values) & twin.truth(0.0).lit.values
        wrong = np.nanmean(np.abs(found[1].phase.values - found[0].phase.values)[lit] > np.pi)
        bounded = 1e6 * np.nanmedian(np.abs(w[lit])) / 0.6745
        changes.append(
            f"| {words} | {1e6 * np.sqrt(np.nanmean(w[lit] ** 2)):.1f} | {bounded:.1f} | "
            f"{100 * np.mean(np.isfinite(w[lit])):.2f} % | {wrong:.1g} |"
        )
        print(changes[-1], flush=True)
        if not ratios:
            ratios = _ratios_by_modulation(found, shifts[-1], lit)
    return changes, ratios


def _ratios_by_modulation(found: list[xr.Dataset], shifts: int, lit: np.ndarray) -> list[str]:
    """Return rows of noise, bound and ratio for points from dark to light."""
    mean = {
        name: np.mean([each[name].values for each in found], axis=0, dtype=float)
        for name in ("texture", "modulation", "phase")
    }
    limit = phase_limit(mean["texture"], mean["modulation"], mean["phase"], shifts, ROUNDED)
    noise = (found[1].phase.values - found[0].phase.values) / np.sqrt(2)
    known = lit & np.isfinite(noise) & np.isfinite(limit)
    ends = np.quantile(mean["modulation"][known], (0, *CLASSES, 1))
    rows = []
    for low, high in [*pairwise(ends), (ends[0], ends[-1])]:
        part = known & (mean["modulation"] >= low) & (mean["modulation"] <= high)
        measured, bound = (np.sqrt(np.mean(each[part] ** 2)) for each in (noise, limit))
        rows.append(
            f"| {low:.0f} to {high:.0f} | {100 * part.sum() / known.sum():.0f} % | {1e3 * measured:.1f} | "
            f"{1e3 * bound:.1f} | {np.sqrt(np.mean((noise / limit)[part] ** 2)):.3f} |"
        )
        print(rows[-1], flush=True)
    return rows


def texture(seed: int, width: float, shift: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return a periodic texture of spots of a width [px], displaced exactly, and its derivative along x."""
    spectrum = np.fft.fft2(np.random.default_rng(seed).standard_normal((SIZE, SIZE)))
    y, x = np.fft.fftfreq(SIZE)[:, None], np.fft.fftfreq(SIZE)[None]
    spectrum *= np.exp(-((np.pi * width) ** 2) * (x**2 + y**2) / 2)
    spectrum[SIZE // 2] = spectrum[:, SIZE // 2] = 0  # no derivative and no shift are defined there
    scale = 600 / np.fft.ifft2(spectrum).real.std()
    moved = np.fft.ifft2(spectrum * np.exp(-2j * np.pi * (x * shift[0] + y * shift[1]))).real
    return 2048 + scale * moved, scale * np.fft.ifft2(2j * np.pi * x * spectrum).real


def displacement_ratio(width: float, noise: float, window: int) -> float:
    """Return the RMS error of d_x over its Cramer-Rao bound.

    Both images have the noise: ``2 sigma^2 / sum(g_x^2)`` over as many pixels as the window averages noise over,
    ((window - 1) / 1.8)^2 for the bi-triangular window.
    """
    ratios = []
    for seed in SEEDS:
        still, slope = texture(seed, width, (0.0, 0.0))
        random = np.random.default_rng(100 + seed)
        images = [
            (grey + random.normal(0, noise, grey.shape)).astype(np.float32)
            for grey in (still, texture(seed, width, SHIFT)[0])
        ]
        field = measure_displacement(*images, window=window)
        error = (field.displacement_x.values - SHIFT[0])[BORDER:-BORDER, BORDER:-BORDER]
        bound = np.sqrt(2 * noise**2 / (((window - 1) / 1.8) ** 2 * np.mean(slope**2)))
        ratios.append(float(np.sqrt(np.nanmean(error**2))) / bound)
    return float(np.mean(ratios))


def main() -> None:
    """Measure all ratios and write the page."""
    phase = "\n".join(
        f"| {shifts} | " + " | ".join(f"{phase_ratio(shifts, shot):.3f}" for shot in (0.0, 0.02, 0.2)) + " |"
        for shifts in (3, 4, 8, 16)
    )
    rows = []
    for width in (2.5, 4.0, 6.0):
        for noise in (5.0, 20.0, 60.0):
            cells = " | ".join(f"{displacement_ratio(width, noise, window):.2f}" for window in (16, 32, 64))
            rows.append(f"| {width:g} | {noise / 40.95:.1f} | {cells} |")
            print(rows[-1], flush=True)
    displacement = "\n".join(rows)
    changes, ratios = ("\n".join(each) for each in plate_rows())
    PAGE.write_text(
        f"""# How close to the limit

This page compares the noise of phase and displacement with the Cramer-Rao bound, below which no unbiased estimate can
be. It is written by `python benchmarks/limits.py`, on {date.today()}.

## Phase

*RMS error over the bound; 400x200 px, real numbers, mean 70 grey levels, read noise 1 grey level, finest pitch 12 px.
The bound is that of mean, modulation and phase of each pixel from the q frames of the finest pitch.*

| q | without shot noise | variance 0.02 per grey level | 0.2 per grey level |
|---:|---:|---:|---:|
{phase}

With shot noise, bright frames would deserve less weight; equal weights cost what the table shows.

## Dark speckles

*RMS noise of the phase of the speckled plate of the virtual rig, seed {PLATE}, 1280x960, 8 bits, read noise 1 grey
level, shot noise 0.02 per grey level, 20 frames (pitches 800, 160, 40, 10 px; 4, 4, 4, 8 shifts), from two stacks at
rest, over the bound of the 8 frames of the finest pitch. The bound is sqrt(2 / q) s / B for equal noise s: a speckle
that returns a tenth of the light has a tenth of the modulation B, and nearly the same s.*

| modulation [grey level] | points | noise [mrad] | bound [mrad] | noise / bound |
|---:|---:|---:|---:|---:|
{ratios}

No unbiased estimate from these frames, with texture and phase together or apart, gains more than the last column says.
The 12 frames of the coarse pitches contain as much about the height as 0.27 frames of the finest one (squares of
10 / 40, 10 / 160 and 10 / 800): 1.7 % of the noise. Less noise needs other frames; at the same number of 20:

| change | raw w, RMS [µm] | from the median [µm] | measured | wrong orders |
|---|---:|---:|---:|---:|
{changes}

Raw w: difference of the heights of two stacks at rest, without a filter. "From the median": the median of its absolute
value over 0.6745, the noise of the usual point. Measured: points whose order is sure by 5 standard deviations.

- **Shifts.** Coarse pitches only have to give the order: 3 shifts are enough.
- **Pitch.** The noise of the height is proportional to the pitch as long as projector and lens keep the contrast:
  `fringedic plan` predicts it.
- **Fewer pitches** leave dark speckles without a sure order.
- **Paint.** Grey speckles gain as much as the finer pitch without any change of the sequence: keep their reflectance
  above a third of that of the ground. The displacement has less contrast then.

## Displacement

*RMS error of d_x over the bound for a motion of ({SHIFT[0]}, {SHIFT[1]}) px; textures of {SIZE}x{SIZE} px with a
standard deviation of 600 of 4096 grey levels, {len(SEEDS)} textures, noise in both images, method `dense`. The
bound is that of a window that averages noise over the same number of pixels.*

| spots [px] | noise [% of full scale] | window 16 px | 32 px | 64 px |
|---:|---:|---:|---:|---:|
{displacement}

A ratio below 1 is possible: interpolation at a fraction of a pixel averages a part of the noise of the deformed image.
Small windows contain few spots of 6 px: with much noise, the deconvolution costs up to 40 %.
"""
    )


if __name__ == "__main__":
    main()
