"""Achieved noise over the Cramer-Rao bound, for phase and displacement. Writes docs/validation/limits.md."""

from __future__ import annotations

import os
from datetime import date
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from fringedic.correlation import measure_displacement
from fringedic.frames.noise import CameraNoise
from fringedic.patterns.sequences import fringe_sequence
from fringedic.phase import absolute_phase
from fringedic.phase.limit import phase_limit
from fringedic.virtual_rig import FringeScene

PAGE = Path(__file__).resolve().parents[1] / "docs" / "validation" / "limits.md"
SIZE = 512  # px of the textures
BORDER = 40  # px: whole windows only
SHIFT = (0.27, -0.41)  # px along x and y
SEEDS = (1, 2, 3)


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

With the same noise in all frames, phase stepping reaches the bound. With shot noise, bright frames would deserve less
weight; equal weights cost what the table shows.

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
