"""The moved surface of a step as a picture, for paper and for browsers without WebGL."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fringedic.errors import DatasetError
from fringedic.wording.optional_packages import optional_import

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_POINTS = 90  # along the longer side
_MILLI, _MICRO = 1e-3, 1e-6


def surface_figure(step: xr.Dataset) -> Figure:
    """Draw the moved surface of a step [mm] in perspective, coloured by w [µm].

    Parameters
    ----------
    step
        One step with the maps x, y, z, u, v, w [m].

    Raises
    ------
    DatasetError
        The step has no surface.
    FringedicError
        The package ``matplotlib`` is not installed.
    """
    with optional_import("figures"):
        from matplotlib import colormaps
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize
        from matplotlib.figure import Figure
    thin = max(1, -(-max(step["w"].shape) // _POINTS))
    maps = {name: step[name].values[::thin, ::thin].astype(float) for name in "xyzuvw"}
    at = [(maps[axis] + maps[way]) / _MILLI for axis, way in zip("xyz", "uvw", strict=True)]
    w = maps["w"] / _MICRO
    known = np.isfinite(at[0] + at[1] + at[2])
    if not known.any():
        raise DatasetError(f"step {int(step.step)} has no surface")
    low, high = np.percentile(w[known], (0.5, 99.5))
    colour = ScalarMappable(Normalize(low, high if high > low else low + 1.0), colormaps["viridis"])
    faces = colour.to_rgba(np.where(known, w, low))
    whole = known.copy()  # a face between four known points
    whole[:-1, :-1] &= known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
    faces[~whole] = 0.0  # not drawn
    figure = Figure(figsize=(10, 6.2), dpi=100)
    axes: Any = figure.add_axes((-0.02, -0.05, 0.92, 1.05), projection="3d")  # whose type Matplotlib does not state
    # without gaps, as the drawing needs it: faces without a value are transparent
    filled = [np.where(known, each, each[known].mean()) for each in at]
    drawn = axes.plot_surface(
        *filled, facecolors=faces, rstride=1, cstride=1, linewidth=0, antialiased=False, shade=False
    )
    drawn.set_clip_on(False)  # the axes are a square, beyond which the view reaches
    sizes = [max(float(np.ptp(each[known])), 1e-9) for each in at]
    axes.set_box_aspect([max(size, 0.15 * max(sizes)) for size in sizes], zoom=1.25)
    axes.locator_params(axis="z", nbins=3)
    axes.view_init(elev=38, azim=-70)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    figure.suptitle(f"Step {int(step.step)}: surface")
    figure.colorbar(colour, cax=figure.add_axes((0.9, 0.2, 0.02, 0.6)), label="w [µm]")
    return figure
