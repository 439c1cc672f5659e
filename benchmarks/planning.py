"""Predicted over measured standard uncertainties of random rigs: `fringedic plan` beside the virtual rig.

Every seed gives a rig: distances, angle and side of the projector, lenses, sensor, texture, sequence and windows. The
virtual rig renders the frames of a plane before and after a translation, several times with other noise; they are
measured as in a test and compared with the exact fields. ``--page docs/validation/planning.md`` writes figures and
picture.
"""

from __future__ import annotations

import argparse
import math
from itertools import count
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

from fringedic.configuration.rig_file import RigFile
from fringedic.configuration.yaml_section import validate
from fringedic.correlation import measure_displacement
from fringedic.patterns.sequences import fringe_sequence
from fringedic.phase.demodulation import absolute_phase
from fringedic.planning.plan import field_uncertainty
from fringedic.planning.plan_warnings import find_warnings
from fringedic.planning.planned_patch import QUANTITIES, PlannedRig
from fringedic.surface import couple, surface_strain
from fringedic.virtual_rig import VirtualRig

RIGS, REPEATS = 50, 4
WINDOWS = (4.0, 9.0)  # width of the displacement window in speckles
Ratios = dict[str, float]
MARGIN = 64  # [px] at the edges, where windows are cut
CAMERA, PROJECTOR = (640, 480), (800, 600)
FIGURES = "<!-- figures -->\n"
SIDES = {"right": (1, 0), "left": (-1, 0), "above": (0, 1), "below": (0, -1)}


def random_rig(seed: int) -> RigFile:
    """Return the rig file of a seed."""
    random = np.random.default_rng(seed)
    distance = random.uniform(200.0, 900.0)
    pixel = 1e3 * distance * random.uniform(0.15, 0.45) / CAMERA[0]
    angle, away = math.radians(random.uniform(12.0, 40.0)), distance * random.uniform(0.8, 1.3)
    side = str(random.choice(list(SIDES)))
    x, y = (part * away * math.sin(angle) for part in SIDES[side])
    upright = side in ("right", "left")
    seen = 1e-3 * pixel * np.array(CAMERA)
    reach = max(seen[0] / PROJECTOR[0], seen[1] / PROJECTOR[1]) * random.uniform(1.25, 1.7)  # [mm / projector px]
    across = PROJECTOR[0] if upright else PROJECTOR[1]
    translation = (random.uniform(0.5, 3.0), random.uniform(-2.0, 2.0), random.uniform(-1.0, 1.0))  # [px]
    feature = random.uniform(3.5, 6.0)  # [px]
    content: dict[str, Any] = {
        "camera": {"source": "virtual"},
        "projector": {"source": "virtual"},
        "calibration": "virtual_rig",
        "sequence": {
            "pitches_px": [float(across), across / 5.0, across / 20.0, random.uniform(8.0, 16.0)],
            "shifts": int(random.integers(3, 9)),
            "orientation": "vertical" if upright else "horizontal",
        },
        "nodes": {
            "dic": {"window": math.ceil(feature * random.uniform(*WINDOWS)), "spacing": int(random.integers(2, 6))},
            "coupling": {
                "z_filter_px": float(random.choice([0.0, random.uniform(0.8, 3.0)])),
                "strain_window_px": int(random.integers(45, 96)),
            },
        },
        "virtual_rig": {
            "seed": seed,
            "camera": {
                "columns": CAMERA[0],
                "rows": CAMERA[1],
                "distance_mm": distance,
                "pixel_size_um": pixel,
                "tilt_x_degree": random.uniform(-0.3, 0.3),
                "tilt_y_degree": random.uniform(-0.3, 0.3),
            },
            "projector": {
                "columns": PROJECTOR[0],
                "rows": PROJECTOR[1],
                "x_mm": x,
                "y_mm": y,
                "z_mm": away * math.cos(angle),
                "focal_length_px": away / reach,
                "roll_degree": random.uniform(-1.0, 1.0),
                "defocus_px": random.uniform(0.4, 1.2),
            },
            "sensor": {
                "bits": int(random.choice([8, 8, 12])),
                "white_level": random.uniform(0.5, 0.9),
                "ambient_light": random.uniform(0.0, 0.1),
            },
            "texture": {
                "feature_um": pixel * feature,
                "coverage": random.uniform(0.35, 0.55),
                "floor": random.uniform(0.12, 0.4),
            },
            "specimen": {
                "kind": "rigid",
                "half_width_mm": 0.75 * seen[0],
                "half_height_mm": 0.75 * seen[1],
                "translation": tuple(1e-3 * pixel * each for each in translation),
                "rotation_degree_per_mm": (0.0, 0.0, random.uniform(0.25, 0.6)),
            },
            "load_frame": {"maximum_position_mm": 1.0},
        },
    }
    sensor = content["virtual_rig"]["sensor"]
    scale = (2 ** sensor["bits"] - 1) / 255
    sensor["read_noise_grey_level"] = scale * random.uniform(0.4, 2.0)
    sensor["shot_noise_grey_level"] = scale * random.uniform(0.004, 0.04)
    return validate(RigFile, content, f"rig {seed}")


def measured_uncertainty(rig: RigFile, repeats: int = REPEATS) -> dict[str, float]:
    """Return the root mean square errors of all quantities over the image and repeated measurements."""
    configuration = rig.virtual_configuration()
    twin = VirtualRig(configuration)
    planned = PlannedRig.of(rig)
    position = 1e-3
    truth = twin.truth(position)
    squares: dict[str, list[np.ndarray]] = {name: [] for name in QUANTITIES}
    for repeat in range(repeats):
        found = measure_once(twin, planned, position, 10_000 * repeat)
        for name, error in errors(found, truth).items():
            squares[name].append(error**2)
    return {name: float(np.sqrt(np.mean(np.concatenate(each)))) for name, each in squares.items()}


def measure_once(twin: VirtualRig, planned: PlannedRig, position: float, first_frame: int) -> tuple[xr.Dataset, ...]:
    """Return shape, cloud and strain of a translation, measured from rendered frames."""
    sensor = twin.configuration.sensor
    pitches, direction = planned.layout.pitches, planned.orientation.name.lower()
    shifts = [planned.patterns[0].shifts] * len(pitches)
    sequence = fringe_sequence(twin.projector_shape[1], twin.projector_shape[0], pitches, shifts, direction)
    images = list(sequence)
    phases = []
    for step, at in enumerate((0.0, position)):
        start = first_frame + 1000 * step
        frames = np.array([twin.expose(image, at, start + number) for number, image in enumerate(images)])
        phases.append(absolute_phase(frames, sequence.patterns, noise=planned.noise, saturation=2**sensor.bits - 1))
    shapes = [planned.model.reconstruct(each.phase, pitches[-1], each.sigma, planned.orientation) for each in phases]
    dic = planned.dic
    field = measure_displacement(phases[0].texture, phases[1].texture, window=dic.window, spacing=dic.spacing)
    cloud = couple(*shapes, field, z_filter=planned.coupling.z_filter_px)
    return shapes[0], cloud, surface_strain(cloud, window=planned.coupling.strain_window_px)


def errors(found: tuple[xr.Dataset, ...], truth: xr.Dataset) -> dict[str, np.ndarray]:
    """Return the errors of a measurement where all windows are whole; a translation has no strain."""
    shape, cloud, strain = found
    some = truth.sel(row=cloud.row, column=cloud.column)
    inner = (some.valid & some.lit).to_numpy()
    for axis, length in (("row", CAMERA[1]), ("column", CAMERA[0])):
        place = some[axis].to_numpy()
        whole = (place >= MARGIN) & (place < length - MARGIN)
        inner = inner & (whole[:, None] if axis == "row" else whole)
    result = {}
    for name in QUANTITIES:
        if name in "xyz":
            error = np.where(truth.lit, shape[name] - truth[name], np.nan)
        elif name in "uvw":
            error = np.where(inner, cloud[name] - some[name], np.nan)
        else:
            error = np.where(inner, strain[name], np.nan)
        result[name] = error[np.isfinite(error)].astype(float)
    return result


def compare(seed: int, repeats: int = REPEATS) -> Ratios:
    """Return predicted over measured uncertainties of a rig."""
    rig = random_rig(seed)
    planned = PlannedRig.of(rig)
    whole, inner = field_uncertainty(planned).sigma, field_uncertainty(planned, margin=MARGIN).sigma
    measured = measured_uncertainty(rig, repeats)
    return {name: (whole if name in "xyz" else inner)[name] / measured[name] for name in QUANTITIES}


def table(rigs: list[Ratios]) -> list[str]:
    """Return the rows of a table of ratios."""
    rows = ["| quantity | median | 5 % to 95 % | range | within 0.9 to 1.1 |", "|---|---|---|---|---|"]
    for name in QUANTITIES:
        each = [rig[name] for rig in rigs]
        low, high = np.percentile(each, (5, 95))
        within = 100 * np.mean([0.9 <= ratio <= 1.1 for ratio in each])
        extremes = f"{min(each):.3f} to {max(each):.3f}"
        rows.append(f"| {name} | {np.median(each):.3f} | {low:.3f} to {high:.3f} | {extremes} | {within:.0f} % |")
    return rows


def draw(rigs: list[Ratios], path: Path) -> None:
    """Draw the ratios of all rigs."""
    figure, axes = plt.subplots(figsize=(8.0, 3.6), layout="constrained")
    axes.axhspan(0.9, 1.1, color="#1f5fa8", alpha=0.12, lw=0, label="target")
    for place, name in enumerate(QUANTITIES):
        values = sorted(rig[name] for rig in rigs)
        axes.plot(place + np.linspace(-0.3, 0.3, len(values)), values, ".", color="#c25e00", ms=4)
    axes.set_xticks(range(len(QUANTITIES)), QUANTITIES)
    axes.set(ylabel="predicted / measured", ylim=(0.6, 1.4))
    axes.grid(axis="y", alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def measure_rigs(number: int) -> tuple[list[Ratios], list[Ratios]]:
    """Return the ratios of so many rigs without a warning, and of the rigs with a warning among them."""
    good: list[Ratios] = []
    warned: list[Ratios] = []
    for seed in count():
        rig = PlannedRig.of(random_rig(seed))
        problems = [each.problem.name for each in find_warnings(rig, field_uncertainty(rig))]
        found = compare(seed)
        (warned if problems else good).append(found)
        print(seed, *problems, *(f"{name} {ratio:.3f}" for name, ratio in found.items()), flush=True)
        if len(good) == number:
            break
    return good, warned


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=RIGS)
    parser.add_argument("--page", type=Path, help="page whose figures are replaced")
    arguments = parser.parse_args()
    good, warned = measure_rigs(arguments.rigs)
    lines = [
        f"Predicted over measured standard uncertainty of {len(good)} random rigs about which `fringedic plan` does "
        "not warn.\n",
        *table(good),
        f"\nThe same for the {len(warned)} rigs among the first {len(good) + len(warned)} about which it warns: few "
        "speckles in the displacement window, uncertain fringe orders, or pixels of the projector in the phase.\n",
        *(table(warned) if warned else []),
    ]
    print("\n".join(lines))
    if arguments.page is not None:
        text = arguments.page.read_text(encoding="utf-8")
        arguments.page.write_text(text.split(FIGURES)[0] + FIGURES + "\n" + "\n".join(lines) + "\n", encoding="utf-8")
        draw(good, arguments.page.with_suffix(".png"))


if __name__ == "__main__":
    main()
