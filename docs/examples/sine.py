"""The paper's simulated experiment (4.1, figure 7): a sine of 0.02 px in images of 8 bits.

A surface of random spots is displaced by d_x = 0.02 sin(2 pi x / p); every pixel is the exact sum of the spots at its
material point, rounded to 8 bits. Run ``python docs/examples/sine.py``; it writes ``sine.png`` beside itself.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import fringedic

SIZE = 520
AMPLITUDE = 0.02
RADIUS = 1.4  # of a spot [px]
PERIODS = (43, 52, 65, 87, 130, 260)
SHOWN = 130
REACH = 8  # pixels around a spot


def surface(period: float | None) -> np.ndarray:
    """Image of 8 bits of the surface, displaced by a sine of this period [px] or at rest."""
    rng = np.random.default_rng(41)
    margin = 20
    width = SIZE + 2 * margin
    spots = rng.uniform(0, width, (2, int(0.35 * width**2))) - margin
    sign = rng.choice([-1.0, 1.0], spots.shape[1])
    x = np.arange(SIZE, dtype=float)
    material = x.copy()
    if period is not None:
        for _ in range(20):  # the material point that has come to each pixel
            material = x - AMPLITUDE * np.sin(2 * np.pi * material / period)
    image = np.zeros((SIZE, SIZE))
    around = np.arange(-REACH, REACH + 1)
    column = np.rint(spots[0]).astype(int)[:, None] + around
    row = np.rint(spots[1]).astype(int)[:, None] + around
    known = [(each >= 0) & (each < SIZE) for each in (column, row)]
    column, row = np.clip(column, 0, SIZE - 1), np.clip(row, 0, SIZE - 1)
    across = np.where(known[0], np.exp(-((material[column] - spots[0][:, None]) ** 2) / (2 * RADIUS**2)), 0)
    down = np.where(known[1], np.exp(-((x[row] - spots[1][:, None]) ** 2) / (2 * RADIUS**2)), 0)
    np.add.at(image, (row[:, :, None], column[:, None, :]), (sign[:, None] * down)[:, :, None] * across[:, None, :])
    return np.clip(np.rint(128 + 38 * image / image.std()), 0, 255).astype(np.uint8)


def main() -> None:
    """Measure every period, print the errors and draw the maps of one of them."""
    still = surface(None)
    columns = np.arange(SIZE)
    inner = np.s_[40:-40, 40:-40]
    rows = []
    for period in PERIODS:
        found = fringedic.measure_displacement(still, surface(period), window=32)
        truth = np.broadcast_to(AMPLITUDE * np.sin(2 * np.pi * columns / period), (SIZE, SIZE))
        error_x = found.displacement_x.values - truth
        rows.append((period, np.sqrt(np.mean(error_x[inner] ** 2)), found.displacement_y.values[inner].std()))
        print(f"period {period:4} px: RMS error x {rows[-1][1]:.5f} px, y {rows[-1][2]:.5f} px")
        if period == SHOWN:
            maps = (truth, found.displacement_x.values, error_x, found.displacement_y.values)

    figure = plt.figure(figsize=(11, 5.6), layout="constrained")
    axes = figure.subplot_mosaic([["truth", "x", "curve"], ["error", "y", "curve"]], width_ratios=[1, 1, 1.3])
    titles = ("true d_x", "measured d_x", "error of d_x", "measured d_y (truth: 0)")
    for name, title, values in zip(("truth", "x", "error", "y"), titles, maps, strict=True):
        limit = AMPLITUDE if name in ("truth", "x") else AMPLITUDE / 4
        shown = axes[name].imshow(values, cmap="RdBu_r", vmin=-limit, vmax=limit)
        axes[name].set_title(f"{title} [px], period {SHOWN} px", fontsize=9)
        figure.colorbar(shown, ax=axes[name], shrink=0.8)
    curve = axes["curve"]
    table = np.array(rows)
    curve.loglog(table[:, 0], table[:, 1], "o-", label="x")
    curve.loglog(table[:, 0], table[:, 2], "s-", label="y")
    curve.axhline(0.003, color="grey", linestyle="--", label="paper, both directions")
    curve.set(xlabel="period of the sine [px]", ylabel="RMS error [px]", title="window 32 px, 8 bits, no noise")
    curve.grid(True, which="both", alpha=0.3)
    ticks = [45, 65, 130, 260]
    curve.set_xticks(ticks, labels=[str(tick) for tick in ticks])
    curve.set_xticks([], minor=True)
    curve.yaxis.set_minor_formatter("{x:.4f}")
    curve.legend(loc="upper left")
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=90)


if __name__ == "__main__":
    main()
