"""Plots of the validation page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from correlation_study.results import Results
from correlation_study.scenes import DIRECTIONS, GREY_LEVELS, PERIODS

DPI = 90
OURS = "tab:red"


def save_plots(results: Results, folder: Path) -> None:
    """Write every plot of the page."""
    folder.mkdir(parents=True, exist_ok=True)
    plots = {
        "transfer": _transfer,
        "noise_and_cut_off": _noise_and_cut_off,
        "translations": _translations,
        "sines": _sines,
        "z_scores": _z_scores,
        **({"sample_14": _sample_14} if results.sample_14 else {}),
    }
    for name, plot in plots.items():
        plot(results).savefig(folder / f"{name}.png", dpi=DPI)


def _figure(width: float, height: float = 3.6) -> Figure:
    return Figure(figsize=(width, height), layout="constrained")


def _transfer(results: Results) -> Figure:
    figure = _figure(7)
    axes = figure.subplots()
    for name, gain, colour in zip(DIRECTIONS, results.chosen.gain, ("tab:red", "tab:blue", "tab:green"), strict=True):
        axes.plot(PERIODS, gain[:, 0], "o-", ms=3, color=colour, label=f"waves along {name}, d_x")
        axes.plot(PERIODS, gain[:, 1], "s--", ms=3, color=colour, label=f"waves along {name}, d_y")
    if results.rivals:
        for subset, style in zip(results.rivals.matched.values(), (":", "-."), strict=True):
            worst = results.rivals.filters[subset].gain.min(axis=(0, 2))
            axes.plot(PERIODS, worst, style, color="black", lw=1, label=f"{subset}, worst")
    axes.axhline(0.9, color="grey", lw=0.8)
    axes.set(xlabel="period [px]", ylabel="gain", xscale="log", title=f"Transfer, window {results.window} px")
    axes.set_xticks([20, 30, 40, 50, 75, 150], ["20", "30", "40", "50", "75", "150"])
    axes.minorticks_off()
    axes.legend(fontsize=7)
    return figure


def _noise_and_cut_off(results: Results) -> Figure:
    figure = _figure(7, 4.6)
    axes = figure.subplots()
    curves = {"fringedic, dense": ([*results.filters.items()], "o-", OURS)}
    if results.rivals:
        for shape, name, colour in (("AFFINE", "affine", "tab:blue"), ("QUAD", "quadratic", "tab:green")):
            own = [(s.size, f) for s, f in results.rivals.filters.items() if s.shape == shape]
            curves[f"pyvale, {name}"] = (own, "s-", colour)
    for name, colour in (("PyrLK", "tab:purple"), ("DIS", "tab:brown")):
        own = [(int(key.split()[1]), f) for key, f in results.opencv.items() if key.startswith(name)]
        curves[f"OpenCV {name}, 8 bits"] = (own, "^-", colour)
    for label, (points, style, colour) in curves.items():
        points = sorted(points, key=lambda point: point[1].period)
        axes.plot([f.period for _, f in points], [f.noise for _, f in points], style, ms=4, color=colour, label=label)
        for size, f in points:
            axes.annotate(str(size), (f.period, f.noise), xytext=(3, 3), textcoords="offset points", fontsize=6)
    period = np.linspace(28, 80, 50)
    axes.plot(period, 0.35 / period, "--", color="grey", lw=0.8, label="noise × period = 0.35 (target)")
    axes.plot(period, results.bound / period, ":", color="grey", lw=0.8, label="brick wall at the Cramér-Rao bound")
    axes.set(
        xlabel="period with 10 % amplitude loss [px]", ylabel=f"noise, {GREY_LEVELS} grey levels [px]",
        xscale="log", yscale="log", title="Noise against cut-off; numbers: window or subset [px]",
    )  # fmt: skip
    axes.set_xticks([30, 40, 50, 60, 80], ["30", "40", "50", "60", "80"])
    axes.set_yticks([0.004, 0.006, 0.01, 0.015], [".004", ".006", ".010", ".015"])
    axes.minorticks_off()
    axes.legend(fontsize=7)
    return figure


def _translations(results: Results) -> Figure:
    figure = _figure(9)
    for axes, (level, dense) in zip(figure.subplots(1, 2), results.translations.items(), strict=True):
        zones = results.zone_translations[level]
        for name, one, colour, move in (("dense", dense, OURS, 0.0), ("zoi", zones, "tab:blue", 0.008)):
            deviation = np.sqrt(np.mean(one.deviation**2, axis=1))
            axes.errorbar(
                one.shifts + move, 1000 * one.mean, 1000 * deviation, fmt="o-", ms=3, lw=1, capsize=2, color=colour,
                label=f"{name}, window {results.window if name == 'dense' else 32} px",
            )  # fmt: skip
        axes.set(xlabel="translation [px]", ylabel="error [0.001 px]", title=f"{level} grey levels")
        axes.legend(fontsize=7)
    return figure


def _sines(results: Results) -> Figure:
    figure = _figure(6)
    axes = figure.subplots()
    windows = sorted(results.sines)
    for k, (period, target) in enumerate(((45, 0.003), (130, 0.0012), (260, 0.0012))):
        (line,) = axes.plot(windows, [1000 * results.sines[w][k] for w in windows], "o-", ms=3, label=f"{period} px")
        axes.axhline(1000 * target, color=line.get_color(), lw=0.8, ls="--")
    axes.set(
        xlabel="window [px]", ylabel="RMSE [0.001 px]", yscale="log", title="Sine of 0.02 px, 8 bits (dashed: targets)"
    )
    axes.set_yticks([0.3, 0.5, 1, 2, 3, 5, 10], ["0.3", "0.5", "1", "2", "3", "5", "10"])
    axes.minorticks_off()
    axes.legend(fontsize=7, title="period")
    return figure


def _z_scores(results: Results) -> Figure:
    figure = _figure(5)
    axes = figure.subplots()
    z = np.linspace(-4.5, 4.5, 91)
    axes.hist(results.scores.all, bins=z, density=True, color="lightgrey", label="measured")
    axes.plot(z, np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi), color=OURS, label="standard normal")
    axes.set(xlabel="error / stated uncertainty", ylabel="density", yscale="log", ylim=(1e-5, 1))
    axes.legend(fontsize=7)
    return figure


def _sample_14(results: Results) -> Figure:
    figure = _figure(9, 5.5)
    ours = results.sample_14[min(results.sample_14, key=lambda w: float(np.sum(results.sample_14[w].rmse)))]
    rival = None
    if results.rivals and results.rivals.sample_14:
        candidates = results.rivals.sample_14
        rival = candidates[min(candidates, key=lambda s: float(np.sum(candidates[s].rmse)))]
    for k, axes in enumerate(figure.subplots(3, 1, sharex=True)):
        if rival is not None:
            axes.plot(
                rival.columns, 1000 * (rival.means[k] - rival.truth[k]), lw=0.8, color="grey", label="pyvale, best"
            )
        axes.plot(ours.columns, 1000 * (ours.means[k] - ours.truth[k]), lw=0.8, color=OURS, label="dense, best")
        axes.set(ylabel=f"{ours.names[k]} [0.001 px]")
        axes.legend(fontsize=7, loc="upper left")
    axes.set(xlabel="column [px]")
    figure.suptitle("Sample 14: error of the column means")
    return figure
