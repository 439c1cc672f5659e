"""The protocol of the DIC Challenge 2.0 (Reu et al. 2022) on its noisy Star 5 and a replica of Star 6.

Writes docs/validation/dic_challenge.md. The images of Star 5 are those in the package of pyvale; without its
environment only the replica is measured. ``--against FOLDER`` measures a library of another version in the same run,
FOLDER being its ``ros2_ws/src/fringedic``.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import matplotlib as mpl
import numpy as np
import scipy.fft
from correlation_study import pyvale
from correlation_study.estimators import Measured
from correlation_study.pyvale import Subset
from correlation_study.scenes import ROOT, Motion, Speckle, Task, camera, translation
from environment import rival_python
from numpy.polynomial import Polynomial
from scipy.ndimage import gaussian_filter1d

from fringedic.correlation import Reference, measure_displacement
from fringedic.correlation.transfer import noise_transfer, transfer_function
from fringedic.surface import flat_strain

mpl.use("agg")
import matplotlib.pyplot as plt

PAGE = ROOT / "docs" / "validation" / "dic_challenge.md"
SHAPE = (501, 4000)
CENTRE = 250  # row of the crests
AMPLITUDE = 0.5  # [px] of Star 5
STRAIN = 0.05  # amplitude of Star 6
PERIODS = np.linspace(10, 300, SHAPE[1])  # [px] by column
MARGIN = 30  # columns left out at either end
RESOLVED = np.arange(SHAPE[1]) > 2000  # columns whose waves every tested window resolves
WINDOWS = (16, 20, 24, 32, 38, 48, 64, 80, 96)
STRAINS = tuple((window, size) for window in (24, 32, 48, 64) for size in (3, 9, 17))
SUBSETS = tuple(Subset("AFFINE", s) for s in (17, 25, 33, 45)) + tuple(Subset("QUAD", s) for s in (33, 45, 61, 81))
DEGREE = 12  # of the polynomial of the protocol
SMOOTHED = 30  # columns, standard deviation of the local mean: 2 px of period
KEPT = 0.9
STEP = 4  # columns between the points of pyvale
LOWEST = 3  # the figure of a program is the mean of its lowest ones
NOISE = 31  # grey levels of 12 bits in the replica
PUBLISHED = {"displacement": 0.356, "strain": 1.271}


@dataclass(frozen=True)
class Setting:
    """Noise and resolution at one setting of a program; a figure by each reading of the centre row."""

    name: str
    noise: float
    polynomial: float  # period [px] at which the polynomial of the row crosses 90 %
    local: float  # the same of the local mean
    overshoot: float  # of the local mean

    def figures(self, power: int) -> tuple[float, float]:
        """Metrological efficiency indicators by both readings: noise x period^power [px^2]."""
        return self.noise * self.polynomial**power, self.noise * self.local**power


def first_crossing(periods: np.ndarray, gain: np.ndarray) -> float:
    """Smallest period at which the gain rises through 90 %."""
    up = np.flatnonzero((gain[:-1] < KEPT) & (gain[1:] >= KEPT))
    return float(periods[up[0]]) if up.size else float("nan")


def read_row(name: str, noise: float, columns: np.ndarray, gain: np.ndarray) -> Setting:
    """Read the resolution from the gain along the centre row at some columns; NaN is left out."""
    kept = np.isfinite(gain) & (columns >= MARGIN) & (columns < SHAPE[1] - MARGIN)
    periods, gain = PERIODS[columns[kept]], gain[kept]
    fine = np.linspace(periods[0], periods[-1], 20_000)
    fitted = Polynomial.fit(periods, gain, DEGREE)(fine)
    mean = gaussian_filter1d(gain, SMOOTHED / (columns[1] - columns[0]))
    return Setting(name, noise, first_crossing(fine, fitted), first_crossing(periods, mean), float(mean.max()) - 1)


def score(settings: list[Setting], power: int) -> tuple[float, float]:
    """Mean of the lowest figures by both readings."""
    figures = np.sort(np.array([each.figures(power) for each in settings]), axis=0)
    return float(np.nanmean(figures[:LOWEST, 0])), float(np.nanmean(figures[:LOWEST, 1]))


def star_5() -> np.ndarray | None:
    """Reference and deformed image, or None where the environment of pyvale is not there."""
    python = rival_python("pyvale")
    folders = list(python.parents[1].glob("lib/python*/site-packages/pyvale/data/dic/challenge")) if python else []
    if not folders:
        return None
    import tifffile

    return np.stack([tifffile.imread(folders[0] / f"DIC_Challenge_Star_Noise_{name}.tiff") for name in ("Ref", "Def")])


def measure_star_5(images: np.ndarray) -> list[Setting]:
    """Noise is that of d_x, which is zero, where the waves along y are resolved."""
    found = []
    for window in WINDOWS:
        field = measure_displacement(Reference(images[0], window=window), images[1])
        noise = float(np.nanstd(field.displacement_x.values[60:-60, RESOLVED][:, :-100]))
        row = field.displacement_y.values[CENTRE] / AMPLITUDE
        found.append(read_row(f"window {window} px", noise, np.arange(SHAPE[1]), row))
    return found


def measure_with_pyvale(images: np.ndarray) -> dict[str, list[Setting]]:
    """The same on a strip about the centre row, every few pixels."""
    jobs = []
    for subset in SUBSETS:
        half = max(subset.size // 2 + 7, 20)  # pyvale searches 16 px about each point
        strip = images[:, CENTRE - half : CENTRE + half + 1]
        jobs.append((Task(f"Star 5, {subset}", strip, [(0, 1)], [translation(0, 0)]), subset))
    measured = pyvale.measure(jobs, step=STEP) or {}
    found: dict[str, list[Setting]] = {}
    for task, subset in jobs:
        if (task.name, subset) in measured:
            found.setdefault(subset.shape, []).append(_read_strip(task, subset, measured[task.name, subset]))
    return found


def _read_strip(task: Task, subset: Subset, one: Measured) -> Setting:
    columns = one.columns.astype(int)
    away = one.rows - task.images.shape[1] // 2
    nearest = int(np.argmin(np.abs(away)))
    wave = AMPLITUDE * np.cos(2 * np.pi * away[nearest] / PERIODS[columns])
    resolved = RESOLVED[columns] & (columns < SHAPE[1] - 100)
    noise = float(np.nanstd(one.fields[0, 0][:, resolved]))
    return read_row(str(subset), noise, columns, one.fields[0, 1, nearest] / wave)


def star_6() -> Motion:
    """Displacement along y whose strain has the same amplitude at every period."""

    def motion(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        period = np.interp(x, np.arange(SHAPE[1]), PERIODS)
        return 0 * x, STRAIN * period / (2 * np.pi) * np.sin(2 * np.pi * (y - CENTRE) / period)

    return motion


def replica() -> np.ndarray:
    """Three images of the exact speckle of the page on correlation: twice at rest, once deformed as Star 6."""
    surface = Speckle(SHAPE, 96)
    at_rest, deformed = surface.grey(), surface.grey(star_6())
    return np.stack([camera(grey, NOISE, 900 + k) for k, grey in enumerate((at_rest, at_rest, deformed))])


def measure_star_6(images: np.ndarray) -> list[Setting]:
    """Strain of a displacement window and a strain window; the noise is measured between the images at rest."""
    found = []
    near = np.s_[CENTRE - 150 : CENTRE + 151]
    for window, size in STRAINS:
        reference = Reference(images[0], window=window)
        still, moved = (
            flat_strain(measure_displacement(reference, image).isel(row=near), window=size).e_yy.values
            for image in images[1:]
        )
        engineering = np.sqrt(1 + 2 * moved[150]) - 1  # of the Green-Lagrange strain
        noise = float(np.nanstd(still[50:-50, 100:-100]))
        name = f"window {window} px, strain window {size} px"
        found.append(read_row(name, noise, np.arange(SHAPE[1]), engineering / STRAIN))
    return found


def filter_exactly(name: str, gain_at: np.ndarray, frequency: np.ndarray, noise: float) -> Setting:
    """Apply a transfer function, given at frequencies [1/px], to the exact displacement of Star 5."""
    y = np.arange(1024)[:, np.newaxis] - 512
    waves = np.cos(2 * np.pi * y / np.concatenate([PERIODS, PERIODS[::-1]])).astype(np.float32)
    spectrum = scipy.fft.rfft2(waves)
    radius = np.hypot(np.fft.fftfreq(1024)[:, np.newaxis], np.fft.rfftfreq(2 * SHAPE[1]))
    row = scipy.fft.irfft2(spectrum * np.interp(radius, frequency, gain_at), waves.shape)[512, : SHAPE[1]]
    return read_row(name, noise, np.arange(SHAPE[1]), row)


def ideal_filters(measured: list[Setting]) -> list[Setting]:
    """What the protocol gives to exact filters on the texture of the images.

    The noise of T is the measured one; that of an ideal low-pass with the same cut-off follows from the integrals of
    the spectra of both over the frequencies.
    """
    frequency = np.linspace(0, 0.5, 20_001)
    found = []
    for window in (32, 64):
        noise = next(s.noise for s in measured if s.name == f"window {window} px")
        own = transfer_function(frequency, window)
        low_pass = (frequency <= frequency[np.argmax(own < KEPT)]).astype(float)
        power = [np.trapezoid(frequency * gain**2, frequency) for gain in (noise_transfer(frequency, window), low_pass)]
        found.append(filter_exactly(f"T of window {window} px", own, frequency, noise))
        ideal = noise * float(np.sqrt(power[1] / power[0]))
        found.append(filter_exactly("ideal low-pass of the same cut-off", low_pass, frequency, ideal))
    return found


def measure_elsewhere(library: Path, images: np.ndarray | None, stars: np.ndarray) -> list[list[Setting]]:
    """Measure with a library of another version, in a process of its own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.savez(folder / "images.npz", stars=stars, **({} if images is None else {"images": images}))
        path = os.pathsep.join([str(library), os.environ.get("PYTHONPATH", "")])
        command = [sys.executable, __file__, "--measure", name]
        subprocess.run(command, check=True, env={**os.environ, "PYTHONPATH": path})
        with np.load(folder / "settings.npz") as found:
            return [
                [
                    Setting(str(n), *map(float, values))
                    for n, values in zip(found[f"names{k}"], found[f"values{k}"], strict=True)
                ]
                for k in (0, 1)
            ]


def measure_in(folder: Path) -> None:
    """Measure the images of a folder with the library of this process."""
    with np.load(folder / "images.npz") as given:
        found = [measure_star_5(given["images"]) if "images" in given else [], measure_star_6(given["stars"])]
    arrays: dict[str, np.ndarray] = {}
    for k, settings in enumerate(found):
        arrays[f"names{k}"] = np.array([each.name for each in settings])
        arrays[f"values{k}"] = np.array([[s.noise, s.polynomial, s.local, s.overshoot] for s in settings])
    np.savez(folder / "settings.npz", **arrays)


def table(settings: list[Setting], power: int) -> str:
    """Rows of a Markdown table."""
    return "\n".join(
        f"| {s.name} | {s.noise:.5f} | {s.local:.1f} | {s.polynomial:.1f} | {s.figures(power)[1]:.3f} | "
        f"{s.figures(power)[0]:.3f} | {100 * s.overshoot:.1f} |"
        for s in settings
    )


COLUMNS = (
    "setting", "noise", "period, local mean [px]", "period, polynomial [px]", "MEI, local mean [px²]",
    "MEI, polynomial [px²]", "overshoot [%]",
)  # fmt: skip
HEADER = f"| {' | '.join(COLUMNS)} |\n|---|{6 * '---:|'}\n"


def scores(results: dict[str, list[Setting]], power: int) -> str:
    """Rows of a table of all programs."""
    return "\n".join(
        f"| {name} | {score(settings, power)[1]:.3f} | {score(settings, power)[0]:.3f} |"
        for name, settings in results.items()
        if settings
    )


def draw(results: dict[str, list[Setting]]) -> None:
    """Noise over resolution; one curve per program."""
    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    for name, settings in results.items():
        if settings:
            axes.loglog([s.local for s in settings], [s.noise for s in settings], "o-", markersize=4, label=name)
    axes.set(xlabel="period with 10 % loss [px]", ylabel="noise [px]", title="Star 5, displacement")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    figure.savefig(PAGE.with_suffix(".png"), dpi=110)


def write_page(fives: dict[str, list[Setting]], sixes: dict[str, list[Setting]], exact: list[Setting]) -> None:
    """Write the page."""
    own = "fringedic"
    overshoot = max((s.overshoot for s in fives[own]), default=float("nan"))
    PAGE.write_text(
        f"""# DIC Challenge 2.0

This page ranks the in-plane displacement and its strain by the protocol of the DIC Challenge 2.0, and shows how far an
ideal filter is. It is written by `python benchmarks/dic_challenge.py`.

*Measured on {date.today()}. The metrological efficiency indicator (MEI) is noise times period with 10 % loss for the
displacement, and noise times the square of this period for the strain; the figure of a program is the mean of its three
lowest ones over its settings (P. L. Reu et al. 2022, DIC Challenge 2.0, Experimental Mechanics 62, 639-654). Lower is
better.*

## Displacement: Star 5

The two noisy images are those distributed with pyvale: a wave of {AMPLITUDE} px along y whose period grows from 10
to 300 px over 4000 columns. Noise is the standard deviation of the displacement along x, which is zero, at periods
above 155 px: no noise image is distributed with the pair. The period with 10 % loss is the first at which the row rises
through 90 %, read in two ways: from a polynomial of degree {DEGREE} over the row, as in the protocol, and from a local
mean over {SMOOTHED} columns (standard deviation). The polynomial is smoother than the transition of a sharp filter: it
moves the crossing by 2 to 7 px.

| program | MEI, local mean [px²] | MEI, polynomial [px²] |
|---|---:|---:|
{scores(fives, 1)}
| best of 26 published codes | | {PUBLISHED["displacement"]} |

![Noise over resolution](dic_challenge.png)

{HEADER}{table(fives[own], 1)}

Largest overshoot of the local mean: {100 * overshoot:.1f} % (target 2.5 %), with the bias of the pattern and noise.

### What an ideal filter would reach

The waves of the star are not plane: their period changes within a window, and sharp filters lose amplitude by it. Exact
filters were applied to the exact displacement, with the measured noise:

{HEADER}{table(exact, 1)}

The ideal low-pass, which rings, has less noise, but loses more of its resolution on the star
([decision 0008](../decisions/0008-an-own-interpolation-kernel.md)). The target of 0.295 px² lies below its figure.

## Strain: replica of Star 6

The strain of {STRAIN:.0%} has the same amplitude at all periods. Images: exact speckle of 1.4 px, contrast 15 %,
{NOISE} grey levels of noise of 12 bits, as on the [page on correlation](correlation.md). Noise is measured between two
images at rest. The strain window is that of `fringedic.surface.flat_strain`, at every pixel.

| program | MEI, local mean [px²] | MEI, polynomial [px²] |
|---|---:|---:|
{scores(sixes, 2)}
| best of 26 published codes, on the original Star 6 | | {PUBLISHED["strain"]} |

{HEADER}{table(sixes[own], 2)}

For a strain with less noise, widen the window of the displacement rather than that of the strain.
"""
    )


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", type=Path, help="library of another version")
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        measure_in(options.measure)
        return
    images, stars = star_5(), replica()
    if images is None:
        print("Star 5 is left out, because the environment of pyvale with its images is not there.", file=sys.stderr)
    fives = {"fringedic": [] if images is None else measure_star_5(images)}
    sixes = {"fringedic": measure_star_6(stars)}
    if options.against:
        fives["fringedic before"], sixes["fringedic before"] = measure_elsewhere(options.against, images, stars)
    if images is not None:
        names = {"AFFINE": "pyvale, affine", "QUAD": "pyvale, quadratic"}
        fives |= {names[shape]: settings for shape, settings in measure_with_pyvale(images).items()}
    for results, power in ((fives, 1), (sixes, 2)):
        print(scores(results, power), flush=True)
    write_page(fives, sixes, ideal_filters(fives["fringedic"]) if fives["fringedic"] else [])
    draw(fives)


if __name__ == "__main__":
    main()
