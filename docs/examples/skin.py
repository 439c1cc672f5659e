"""Skin under tension (4.2, figure 8): the apparent anisotropy at three angles of the device, and summed increments.

The virtual skin is pulled by 1 mm between two pads; its stiff direction is turned against the device by 0, 45 and 90
degrees, which is what turning the device on the arm does. Run ``python docs/examples/skin.py``; it writes ``skin.png``.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.ndimage import binary_erosion
from virtual_test import Measured, rms, run

import fringedic
from fringedic.virtual_rig import VirtualRig
from fringedic.virtual_rig.configuration import VirtualRigConfiguration, preset

ANGLES = (0.0, 45.0, 90.0)
STEPS = 5
SPACING = 8


def skin(angle: float) -> VirtualRig:
    """Virtual skin with the device at an angle [degree] to its stiff direction."""
    description = preset("skin")
    description["specimen"] = {**description["specimen"], "device_angle_degree": angle}
    return VirtualRig(VirtualRigConfiguration.from_dict({**description, "seed": 42}))


def increments(steps: list[Measured]) -> tuple[float, float, float]:
    """RMS errors [px] of d_x, d_y against the truth: direct, increments summed naively, increments composed."""
    parts = []
    for before, after in pairwise(steps):
        parts.append(fringedic.measure_displacement(before.texture, after.texture, window=32, spacing=SPACING))
    composed = fringedic.accumulate(parts)
    last = steps[-1].truth
    seen = binary_erosion((last.valid & last.lit).values, iterations=4)

    def error(x: np.ndarray, y: np.ndarray) -> float:
        wrong = np.stack([x - last.displacement_x.values, y - last.displacement_y.values])
        return rms(np.where(seen, wrong, np.nan))

    direct = steps[-1].displacement
    naive = [sum(part[f"displacement_{axis}"].values for part in parts) for axis in "xy"]
    return (
        error(direct.displacement_x.values, direct.displacement_y.values),
        error(*naive),
        error(composed.displacement_x.values, composed.displacement_y.values),
    )


def main() -> None:
    """Pull three skins, print the errors, draw the maps."""
    figure, axes = plt.subplots(3, len(ANGLES), figsize=(10, 8), layout="constrained")
    for column, angle in enumerate(ANGLES):
        twin = skin(angle)
        steps = run(twin, np.linspace(0, twin.maximum_position, STEPS + 1).tolist(), spacing=SPACING)
        last = steps[-1]
        wrong = ", ".join(f"{name} {1e6 * rms(last.error(name)):.2f}" for name in "uvw")
        print(f"device at {angle:g} degree: RMS errors [µm] {wrong}")
        strain = fringedic.surface_strain(last.cloud, window=121)
        middle = {"row": slice(420, 540), "column": slice(500, 780)}
        mean = {name: float(strain[name].sel(middle).mean()) for name in ("e_11", "e_22", "e_12")}
        tilt = 0.5 * np.degrees(np.arctan2(2 * mean["e_12"], mean["e_11"] - mean["e_22"]))
        words = ", ".join(f"{name} {100 * value:.2f} %" for name, value in mean.items())
        print(f"    strain in the middle: {words}; larger principal strain at {tilt:.1f} degree from x")
        if column == 0:
            direct, naive, composed = increments(steps)
            print(
                f"    {STEPS} increments: direct {direct:.4f}, summed naively {naive:.4f}, "
                f"composed {composed:.4f} px RMS error"
            )
        for row, (name, values) in enumerate(
            (
                ("u [µm]", 1e6 * last.cloud.u.values),
                ("v [µm]", 1e6 * last.cloud.v.values),
                ("w [µm]", 1e6 * last.cloud.w.values),
            )
        ):
            shown = axes[row, column].imshow(values, cmap="viridis", extent=(0, 1280, 960, 0))
            levels = np.linspace(np.nanmin(values), np.nanmax(values), 12)[1:-1]
            grid = (last.cloud.column.values, last.cloud.row.values)
            axes[row, column].contour(*grid, values, levels=levels, colors="white", linewidths=0.6)
            axes[row, column].set_title(f"device at {angle:g}°: {name}", fontsize=9)
            axes[row, column].tick_params(labelsize=7)
            axes[row, column].set_xlabel("column [px]", fontsize=7)
            axes[row, column].set_ylabel("row [px]", fontsize=7)
            figure.colorbar(shown, ax=axes[row, column], shrink=0.8)
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=85)


if __name__ == "__main__":
    main()
