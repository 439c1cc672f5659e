"""Leather at a screw (4.3, figures 9 and 10): shape, displacement vectors, global against local frame.

The virtual leather is folded before the test and flattens under load. Run ``python docs/examples/leather.py``; it
writes ``leather_shape.png`` and ``leather_frames.png``.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from scipy.ndimage import binary_erosion
from virtual_test import Measured, rms, run

import fringedic
from fringedic.virtual_rig import VirtualRig

LOAD = 0.5  # of the crosshead's range
WINDOWS = (9, 21, 41)
SPACING = 4
FOLDER = Path(__file__).parent


def true_cloud(step: Measured) -> xr.Dataset:
    """Return the exact fields at the points that are measured."""
    known = np.isfinite(step.cloud.w.values)
    return xr.Dataset(
        {name: (("row", "column"), np.where(known, step.truth[name].values, np.nan)) for name in "xyzuvw"},
        step.cloud.coords,
    )


def draw_shape(cloud: xr.Dataset) -> None:
    """Draw the initial shape with the displacement vectors, as in figure 9."""
    few = cloud.isel(row=slice(None, None, 10), column=slice(None, None, 10))
    x, y, z = (1e3 * few[name].values for name in "xyz")
    u, v, w = (1e3 * few[name].values for name in "uvw")
    figure = plt.figure(figsize=(8, 6), layout="constrained")
    axes = figure.add_subplot(pattern="3d")
    axes.plot_surface(x, y, z, cmap="copper", linewidth=0, alpha=0.6)
    known = np.isfinite(w)
    thin = np.zeros_like(known)
    thin[::2, ::2] = True
    here = known & thin
    axes.quiver(x[here], y[here], z[here], u[here], v[here], w[here], length=1.0, color="navy", linewidth=0.8)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    axes.set_box_aspect((4, 3, 1.2))
    axes.view_init(35, -70)
    figure.savefig(FOLDER / "leather_shape.png", dpi=90)


def draw_frames(cloud: xr.Dataset, local: xr.Dataset) -> None:
    """Displacement in the global and in the local frame, as in figure 10."""
    figure, axes = plt.subplots(3, 2, figsize=(8, 8.5), layout="constrained")
    for row, (here, there) in enumerate((("u", "u_t"), ("v", "v_t"), ("w", "w_n"))):
        for column, (fields, name) in enumerate(((cloud, here), (local, there))):
            values = 1e3 * fields[name].values
            shown = axes[row, column].imshow(values, cmap="viridis", extent=(0, 1280, 960, 0))
            axes[row, column].set_title(f"{name} [mm], {'local' if column else 'global'} frame", fontsize=9)
            axes[row, column].tick_params(labelsize=7)
            axes[row, column].set_xlabel("column [px]", fontsize=7)
            axes[row, column].set_ylabel("row [px]", fontsize=7)
            figure.colorbar(shown, ax=axes[row, column], shrink=0.8)
    figure.savefig(FOLDER / "leather_frames.png", dpi=85)


def main() -> None:
    """Pull the leather, print the errors, draw the figures."""
    twin = VirtualRig.from_preset("leather", seed=43)
    positions = (np.linspace(0, LOAD, 4) * twin.maximum_position).tolist()
    for z_filter in (0.0, 2.0):
        last = run(twin, positions, spacing=SPACING, z_filter=z_filter)[-1]
        seen = binary_erosion((last.truth.valid & last.truth.lit).values, iterations=24 // SPACING)
        wrong = {name: rms(np.where(seen, last.error(name), np.nan)) for name in "uvw"}
        print(
            f"z filtered {z_filter:g} px: RMS errors [µm]",
            *(f"{name} {1e6 * each:.2f}" for name, each in wrong.items()),
        )
        for window in WINDOWS:
            local = fringedic.to_local_frame(last.cloud, window=window)
            exact = fringedic.to_local_frame(true_cloud(last), window=window)
            errors = {
                name: rms(np.where(seen, (local[name] - exact[name]).values, np.nan)) for name in ("u_t", "v_t", "w_n")
            }
            words = ", ".join(f"{name} {1e6 * each:.2f}" for name, each in errors.items())
            print(f"    slopes over {window} px (noise gain {local.attrs['slope_noise_gain']:.3f}): {words} µm")
    draw_shape(last.cloud)
    draw_frames(last.cloud, fringedic.to_local_frame(last.cloud, window=21))


if __name__ == "__main__":
    main()
