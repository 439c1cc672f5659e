"""Figure of a noise floor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fringedic.metadata import NOISE_COLUMNS
from fringedic.rig_setup.noise_floor import NoiseMeasurement
from fringedic.wording.optional_packages import optional_import

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def noise_figure(measured: NoiseMeasurement) -> Figure:
    """Draw the camera's noise over its brightness with the fitted model, and the noise floors as a table."""
    with optional_import("figures"):
        from matplotlib.figure import Figure
    camera, metadata = measured.camera, measured.metadata
    figure = Figure(figsize=(12.5, 5.0), dpi=100, layout="constrained")
    figure.suptitle(f"Noise floor, {metadata.steps} steps at rest, {metadata.created}")
    axes, table = figure.subplots(1, 2)
    axes.plot(camera.level, np.sqrt(camera.variance), "o", label="measured")
    level = np.linspace(0, camera.level[-1], 200)
    fitted = f"read {camera.noise.read:.2f}, shot {camera.noise.shot:.4f} per grey level"
    axes.plot(level, np.sqrt(camera.noise.variance(level)), label=fitted)
    axes.set(xlabel="brightness [grey level]", ylabel="noise of a pixel [grey level]", ylim=(0, None))
    axes.set_title(f"Camera; the light flickers by {100 * camera.flicker:.2g} %")
    axes.legend(loc="lower right")
    rows = [[f"{quantity.title} [{quantity.unit}]", *cells] for quantity, cells in metadata.table()]
    table.axis("off")
    table.set_title("Displacement, height and strain: standard deviations")
    drawn = table.table(
        rows, colLabels=["", *NOISE_COLUMNS], loc="upper center", colWidths=[0.4, *[0.12] * len(NOISE_COLUMNS)]
    )
    drawn.auto_set_font_size(False)
    drawn.set_fontsize(10)
    drawn.scale(1, 1.7)
    return figure
