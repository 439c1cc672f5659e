"""Picture of a phase that was measured from image files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from fringedic.wording.optional_packages import optional_import

_WIDEST = 900  # points of a map along its longer side


def save_phase_picture(measured: xr.Dataset, file: Path) -> Path:
    """Draw texture, coordinate on the projector, standard deviation, and the closure between two pitches.

    Parameters
    ----------
    measured
        From `fringedic.images.measure_phase_images`.
    file
        Written; its ending selects the format.
    """
    with optional_import("figures"):
        from matplotlib.figure import Figure
    scale = measured.attrs["pitch_px"] / (2 * np.pi)
    maps = [
        ("texture [grey level]", measured.texture, "gray"),
        (
            "column on the projector [px]"
            if measured.attrs["direction"] == "vertical"
            else "row on the projector [px]",
            measured.coordinate,
            "viridis",
        ),
        ("standard deviation [projector px]", measured.sigma * scale, "viridis"),
    ]
    if "closure" in measured:
        maps.append(("closure between pitches [standard deviations]", measured.closure, "RdBu_r"))
    figure = Figure(figsize=(12, 8 if len(maps) > 2 else 4), dpi=100, layout="constrained")
    skip = max(1, max(measured.texture.shape) // _WIDEST)
    for axes, (title, values, colours) in zip(figure.subplots(2, 2).flat, maps, strict=False):
        shown = values.values[::skip, ::skip]
        low, high = np.nanpercentile(shown, [1, 99]) if np.isfinite(shown).any() else (0, 1)
        limit = max(abs(low), abs(high))
        low, high = (-limit, limit) if colours == "RdBu_r" else (low, high)
        image = axes.imshow(shown, cmap=colours, vmin=low, vmax=high, interpolation="nearest")
        axes.set(title=title, xticks=[], yticks=[])
        figure.colorbar(image, ax=axes)
    figure.savefig(file)
    return file
