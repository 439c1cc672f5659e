"""Figure of the grey-level residual: its map and its histogram."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from fringedic.figures.maps import draw_map
from fringedic.figures.panels import GREY_RESIDUAL
from fringedic.wording.numbers import number_text
from fringedic.wording.optional_packages import optional_import

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CLASSES = 80
_SHOWN = 5.0  # standard deviations on either side


def residual_figure(step: xr.Dataset, contrast: float) -> Figure:
    """Draw the map and the histogram of the grey-level residual, beside the normal distribution of the same width.

    Parameters
    ----------
    step
        One step with ``grey_residual`` [grey level].
    contrast
        Standard deviation of the reference image [grey level].
    """
    with optional_import("figures"):
        from matplotlib.figure import Figure
    figure = Figure(figsize=(11.0, 4.2), dpi=100, layout="constrained")
    draw_map(figure.add_subplot(1, 2, 1), step, GREY_RESIDUAL)
    values = step["grey_residual"].values
    finite = values[np.isfinite(values)].astype(np.float64)
    centre, width = float(finite.mean()), max(float(finite.std()), 1e-12)
    edges = np.linspace(centre - _SHOWN * width, centre + _SHOWN * width, _CLASSES + 1)
    axes = figure.add_subplot(1, 2, 2)
    axes.hist(finite, edges.tolist(), color="#7aa6cf", label="points")
    places = 0.5 * (edges[1:] + edges[:-1])
    expected = finite.size * (edges[1] - edges[0]) / (width * np.sqrt(2 * np.pi))
    axes.plot(places, expected * np.exp(-0.5 * ((places - centre) / width) ** 2), "k--", lw=1.2, label="normal")
    axes.set(xlabel="residual [grey level]", ylabel="points")
    axes.set_title(
        f"σ = {number_text(width, 3)} grey levels, {100 * width / contrast:.2g} % of the contrast",
        fontsize=11,
    )
    axes.legend(frameon=False, loc="upper right")
    return figure
