"""Figures of an acceptance test: errors with their limits, and residuals at every place."""

from __future__ import annotations

import numpy as np

from fringedic.calibration.acceptance import Acceptance, AcceptanceError
from fringedic.wording.optional_packages import optional_import

with optional_import("figures"):
    from matplotlib.figure import Figure

_BAR, _LIMIT = "#1f5fa8", "#c25e00"
_PER_LINE = 6
_RANGE = 99.0  # percentile of the residuals that the colours cover


def draw_errors(acceptance: Acceptance) -> Figure:
    """Draw the errors of every characteristic at its places with the maximum permissible errors [µm]."""
    figure = Figure(figsize=(10.0, 5.4), layout="constrained")
    for axes, error in zip(figure.subplots(2, 2).ravel(), AcceptanceError, strict=True):
        found = [(n, each.errors[error]) for n, each in enumerate(acceptance.results, start=1) if error in each.errors]
        axes.bar([str(number) for number, _ in found], [1e6 * value for _, value in found], color=_BAR)
        limit = acceptance.limits.get(error)
        if limit is not None:
            signs = (1,) if error in (AcceptanceError.FORM, AcceptanceError.FLATNESS) else (-1, 1)
            for sign in signs:
                axes.axhline(1e6 * sign * limit, color=_LIMIT, ls="--", lw=1)
        axes.axhline(0, color="black", lw=0.6)
        axes.set(title=error.value, xlabel="place", ylabel="error [µm]")
        axes.grid(axis="y", alpha=0.3)
    return figure


def draw_residuals(acceptance: Acceptance) -> Figure:
    """Draw the distances from the fitted spheres and planes at every place [µm]."""
    lines = -(-len(acceptance.results) // _PER_LINE)
    figure = Figure(figsize=(11.0, 1.9 * lines), layout="constrained")
    grid = figure.subplots(lines, _PER_LINE, squeeze=False)
    limit = 1e6 * max(float(np.percentile(np.abs(each.residuals[2]), _RANGE)) for each in acceptance.results)
    for axes in grid.ravel()[len(acceptance.results) :]:
        axes.axis("off")
    for number, (axes, each) in enumerate(zip(grid.ravel(), acceptance.results, strict=False), start=1):
        x, y, distance = each.residuals
        shown = axes.scatter(1e3 * x, 1e3 * y, c=1e6 * distance, s=1.5, cmap="RdBu_r", vmin=-limit, vmax=limit, lw=0)
        axes.set_title(f"{number}: {each.place.artefact}", fontsize=8)
        axes.set_aspect("equal")
        axes.tick_params(labelsize=6)
    figure.colorbar(shown, ax=grid.ravel().tolist(), label="distance [µm]; axes: x, y [mm]", shrink=0.8)
    return figure
