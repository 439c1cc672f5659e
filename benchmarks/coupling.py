"""3D displacement, strain, increments and their uncertainties beside their targets; time of each step.

Frames come from the digital twin at 1280x960 (50 µm/pixel, 8 bits, 1 grey level and shot noise, misaligned rig), with a
seed that no test uses; the displacement is measured in their texture. Exact surfaces with the noise of such frames tell
the floor. ``--page docs/validation/coupling.md`` writes the figures and two pictures.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib.pyplot as plt
import numba
import numpy as np
import xarray as xr
from scipy.ndimage import binary_dilation, binary_erosion, maximum_filter, minimum_filter

from fringedic.correlation.increments import accumulate
from fringedic.frames.collector import Stack
from fringedic.frames.records import FrameRecord
from fringedic.patterns.sequences import fringe_sequence
from fringedic.rig.model import RigModel
from fringedic.steps.displacement_tracker import DisplacementTracker
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters
from fringedic.steps.phase import phase_step
from fringedic.steps.shape_tracker import ShapeTracker
from fringedic.steps.step_results import CouplingResult, DicResult, PhaseResult
from fringedic.surface import PreparedShape, couple, surface_strain, to_local_frame
from fringedic.virtual_rig import VirtualRig

RUNS = 5
SEED = 4021
OTHERS = (("skin", 911, 0.35), ("skin", 512, 0.12), ("leather", 911, 0.1), ("plate", 911, 0.35))  # of no study
PITCH = 10.0
SHIFTS = (4, 4, 4, 8)
FINER, MORE_SHIFTS = 8.0, (3, 3, 3, 11)  # as many frames, for dark speckles: docs/validation/limits.md
SPACING = 4
STRAIN_WINDOW = 85
LIGHT_TRAVEL = 0.3  # of the steps whose light changes
FIGURES, TIMES = "<!-- figures -->\n", "Best times [ms]"
FRINGE, PIXEL = 0.002, 0.0026  # noise of phase and displacement of such frames
PLATE = "Rendered frames of a plate"
MORE = "The same plate and number of frames, finest pitch 8 px, 3, 3, 3 and 11 shifts"
SURFACES = "Other surfaces: z-scores"
EXACT = "Exact surfaces with white noise of 0.002 fringe and 0.0026 px"
SPACINGS = "Best times by the distance of the points [ms]"
LIGHT = "Coupling step with its light, one thread"
BY_COLUMN = (PLATE, MORE, SURFACES, EXACT, SPACINGS, LIGHT)
Row = tuple[str, float, float | None]


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(np.square(values, dtype=float))))


@dataclass
class Rendered:
    """Two steps of a specimen of the twin, as measured from its frames."""

    twin: VirtualRig
    rig: RigModel
    stacks: list[Stack]
    phases: list[PhaseResult]
    displacements: list[DicResult]
    truth: xr.Dataset

    def shapes(self) -> list[xr.Dataset]:
        return [self.rig.reconstruct(each.phase, each.pitch, each.sigma) for each in self.phases]

    def in_plane(self) -> xr.Dataset:
        return self.displacements[1].field


def render(twin: VirtualRig, travel: float = 0.2, pitch: float = PITCH, shifts: tuple[int, ...] = SHIFTS) -> Rendered:
    """Expose, demodulate and correlate two steps; `travel` is the part of the largest position."""
    rig = RigModel(**twin.optics())
    sequence = fringe_sequence(rig.projector_width, rig.projector_height, [800, 160, 4 * pitch, pitch], shifts)
    position = travel * twin.maximum_position
    tracker = DisplacementTracker(DicParameters(spacing=SPACING))
    stacks, phases, found = [], [], []
    for step, crosshead in enumerate((0.0, position)):
        frames = np.array([twin.expose(image, crosshead, 100 * step + k) for k, image in enumerate(sequence)])
        records = [
            FrameRecord("bench", step, k, len(frames), pattern, k, 0.01, 0)
            for k, pattern in enumerate(sequence.patterns)
        ]
        stacks.append(Stack("bench", step, records, frames, step))
        phases.append(phase_step(stacks[-1], PhaseParameters()))
        found.append(tracker.step("bench", step, step, phases[-1].texture))
    grid = slice(None, None, SPACING)
    return Rendered(
        twin,
        rig,
        stacks,
        phases,
        found,
        twin.truth(position).isel(row=grid, column=grid),
    )


def displacements(rendered: Rendered, spacing: int) -> list[DicResult]:
    """Correlate the textures of both steps again, at points of a spacing [px]."""
    tracker = DisplacementTracker(DicParameters(spacing=spacing))
    return [tracker.step("bench", each.step, each.stamp, each.texture) for each in rendered.phases]


def finer_rows() -> list[Row]:
    """Return the raw figures of the plate from as many frames with a finer pitch and more shifts of it."""
    rendered = render(VirtualRig.from_preset("plate", seed=SEED), pitch=FINER, shifts=MORE_SHIFTS)
    return [row for row in twin_rows(rendered, {}) if "raw z" in row[0]]


def coupled(rendered: Rendered, with_textures: bool = True) -> xr.Dataset:
    """Return 3D displacement and strain of the second step as the coupling node computes them.

    Without the textures the change of the light on the relief is not taken out.
    """
    tracker = ShapeTracker(CouplingParameters(strain_window_px=STRAIN_WINDOW))
    tracker.set_calibration(rendered.rig)
    for phase, displacement in zip(rendered.phases, rendered.displacements, strict=True):
        maps = phase.maps if with_textures else phase.maps[["phase", "sigma"]]
        result = tracker.step(replace(phase, maps=maps), displacement)
    return result.displacement


def strains(rendered: Rendered, cloud: xr.Dataset, window: int = STRAIN_WINDOW) -> tuple[xr.Dataset, xr.Dataset]:
    """Return the measured strain, and that of the exact fields over the same windows."""
    measured = np.isfinite(cloud.w.values)
    exact = {name: (("row", "column"), np.where(measured, rendered.truth[name].values, np.nan)) for name in "xyzuvw"}
    return surface_strain(cloud, window=window), surface_strain(xr.Dataset(exact, cloud.coords), window=window)


def twin_rows(rendered: Rendered, maps: dict[str, np.ndarray]) -> list[Row]:
    """Errors of what is measured in rendered frames, 48 px away from the edges of what both images see."""
    truth = rendered.truth
    visible = (truth.valid & truth.lit).values
    inner = binary_erosion(visible, iterations=48 // SPACING)
    shapes, in_plane = rendered.shapes(), rendered.in_plane()
    targets = {0.0: (0.40, 0.31, 9.5), 2.0: (0.15, 0.15, 1.4)}
    rows: list[Row] = []
    for z_filter, limits in targets.items():
        cloud = couple(*shapes, in_plane, calibration=rendered.rig, z_filter=z_filter)
        words = f"z filtered {z_filter:g} px" if z_filter else "raw z"
        for name, target in zip("uvw", limits, strict=True):
            error = np.where(inner, cloud[name].values - truth[name].values, np.nan)
            rows.append((f"{name}, {words} [µm]: RMS error", 1e6 * rms(error), target))
            sigma = cloud[f"sigma_{name}"].where(inner)
            rows.append((f"{name}, {words} [µm]: median sigma", 1e6 * float(sigma.median()), target))
            rows.append((f"{name}, {words} [µm]: z-score", float(np.nanstd(error / sigma.values)), None))
            if z_filter:
                maps[f"error of {name} [µm]"] = 1e6 * error
    found, true = strains(rendered, cloud)
    for name, target in (("e_11", 40), ("e_12", 20), ("e_22", 28)):
        error = np.where(inner, found[name].values - true[name].values, np.nan)
        rows.append((f"{name} over {STRAIN_WINDOW} px, filtered [µstrain]: RMS error", 1e6 * rms(error), target))
        score = float(np.nanstd(error / found[f"sigma_{name}"].values))
        rows.append((f"{name} over {STRAIN_WINDOW} px, filtered [µstrain]: z-score", score, None))
        maps[f"error of {name} [µstrain]"] = 1e6 * error
    in_plane_errors = [
        np.where(inner, in_plane[f"displacement_{axis}"].values - truth[f"displacement_{axis}"].values, np.nan)
        for axis in "xy"
    ]
    for axis, error in zip("xy", in_plane_errors, strict=True):
        score = float(np.nanstd(error / in_plane[f"sigma_{axis}"].values))
        rows.append((f"displacement_{axis} [px]: RMS error", rms(error), None))
        rows.append((f"displacement_{axis} [px]: z-score", score, None))
    return rows


def scores(rendered: Rendered, cloud: xr.Dataset) -> dict[str, np.ndarray]:
    """Return error over standard deviation at every point, by the name of the field."""
    measured = np.isfinite(cloud.w.values)
    exact = {name: (("row", "column"), np.where(measured, rendered.truth[name].values, np.nan)) for name in "xyzuvw"}
    strain = surface_strain(xr.Dataset(exact, cloud.coords), window=STRAIN_WINDOW)
    true = rendered.truth.merge(strain[["e_11", "e_22", "e_12"]])
    names = ("u", "v", "w", "e_11", "e_12", "e_22")
    return {name: (cloud[name].values - true[name].values) / cloud[f"sigma_{name}"].values for name in names}


def score_rows() -> list[Row]:
    """Z-scores on other surfaces, and what moves them away from 1: light on turning flanks, pixels across steps."""
    skin, stepped = (VirtualRig.from_preset(name, seed=SEED) for name in ("skin", "stepped"))
    smooth = skin.with_specimen({**skin.configuration.specimen.model_dump(), "relief_um": 0.0})
    cases = [("skin", skin, 0.2), ("skin without relief", smooth, 0.2)]
    cases += [
        (f"{name}, seed {seed}, {100 * travel:g} % of the travel", VirtualRig.from_preset(name, seed=seed), travel)
        for name, seed, travel in OTHERS
    ]
    rows: list[Row] = []
    for words, twin, travel in [*cases, ("stepped plate", stepped, 0.2)]:
        rendered = render(twin, travel)
        truth = rendered.truth
        inner = binary_erosion((truth.valid & truth.lit).values, iterations=48 // SPACING)
        parts = {words: inner}
        if twin is stepped:
            height = truth.z.values
            jumps = maximum_filter(height, 3) - minimum_filter(height, 3) > SPACING * rendered.rig.pixel_size
            parts |= {f"{words}, 8 px and more from a step": inner & ~binary_dilation(jumps)}
        clouds = {"": coupled(rendered)}
        if words.startswith("skin") and twin is not smooth:
            clouds[", light not corrected"] = coupled(rendered, with_textures=False)
        for part, where in parts.items():
            for how, cloud in clouds.items():
                for name, score in scores(rendered, cloud).items():
                    rows.append((f"{part}{how}: {name}", float(np.nanstd(score[where])), None))
    return rows


def exact_rows(rendered: Rendered) -> list[Row]:
    """Errors on the exact surfaces of the same steps with white noise of .002 fringe and .0026 px at every pixel."""
    rig, twin = rendered.rig, rendered.twin
    position = 0.2 * twin.maximum_position
    truth = twin.truth(position)
    rng = np.random.default_rng(SEED)
    sigma = np.full(twin.shape, 2 * np.pi * FRINGE, np.float32)
    shapes = []
    for each in (twin.truth(0.0), truth):
        heights = each.z_deformed.values
        column, row = np.meshgrid(np.arange(twin.shape[1]), np.arange(twin.shape[0]))
        rays = np.stack([column, row, np.ones_like(row)], axis=-1) @ rig.ray_matrix.T
        along = (heights - rig.camera_distance) / rays[..., 2]
        phase = rig.phase(along * rays[..., 0], along * rays[..., 1], heights, PITCH)
        noisy = (phase + sigma * rng.normal(size=phase.shape)).astype(np.float32)
        shapes.append(rig.reconstruct(noisy, PITCH, sigma))
    fields = {f"sigma_{axis}": np.full(twin.shape, PIXEL, np.float32) for axis in "xy"}
    for axis in "xy":
        exact = truth[f"displacement_{axis}"].values
        fields[f"displacement_{axis}"] = (exact + PIXEL * rng.normal(size=exact.shape)).astype(np.float32)
    displacement = xr.Dataset({name: (("row", "column"), each) for name, each in fields.items()}, truth.coords)
    inner = binary_erosion((truth.valid & truth.lit).values, iterations=16)
    rows: list[Row] = []
    for z_filter, limits in ((0.0, (0.40, 0.31, 9.5)), (2.0, (0.15, 0.15, 1.4))):
        cloud = couple(*shapes, displacement, z_filter=z_filter)
        words = f"z filtered {z_filter:g} px" if z_filter else "raw z"
        for name, target in zip("uvw", limits, strict=True):
            error = np.where(inner, cloud[name].values - truth[name].values, np.nan)
            rows.append((f"{name}, {words} [µm]: RMS error", 1e6 * rms(error), target))
            score = float(np.nanstd(error / cloud[f"sigma_{name}"].values))
            rows.append((f"{name}, {words} [µm]: z-score", score, None))
    return rows


def increment_rows() -> list[Row]:
    """Twenty increments to 10 % with waves of 8 and 5 px, on points every 4 px of 1280x960."""
    rows, columns = np.arange(0.0, 960, 4), np.arange(0.0, 1280, 4)
    row, column = np.meshgrid(rows, columns, indexing="ij")
    steps = 20

    def motion(row: np.ndarray, column: np.ndarray) -> np.ndarray:
        waves = 8 * np.sin(2 * np.pi * column / 640) * np.cos(2 * np.pi * row / 700)
        across = 5 * np.sin(2 * np.pi * (column + row) / 800)
        return np.stack([0.10 * (column - 200) + waves, -0.03 * (row - 480) + across])

    exact = []
    for step in range(steps):
        from_row, from_column = row.copy(), column.copy()
        for _ in range(40):
            d_x, d_y = motion(from_row, from_column) * step / steps
            from_row, from_column = row - d_y, column - d_x
        exact.append(motion(from_row, from_column) / steps)
    total = motion(row, column)
    found: list[Row] = [("plain sums, no noise: RMS error [px]", rms(np.sum(exact, axis=0) - total), None)]
    for noise in (0.0, 0.01):
        rng = np.random.default_rng(SEED)
        parts = []
        for each in exact:
            noisy = each + noise * rng.normal(size=each.shape)
            fields = dict(zip(("displacement_x", "displacement_y"), noisy, strict=True))
            fields |= {f"sigma_{axis}": np.full(row.shape, noise) for axis in "xy"}
            dimensions, coordinates = ("row", "column"), {"row": rows, "column": columns}
            parts.append(xr.Dataset({name: (dimensions, each) for name, each in fields.items()}, coordinates))
        words = f"noise of {noise:g} px per point and increment" if noise else "no noise"
        target = 0.045 if noise else 0.005
        for label, method, element, limit in (
            ("spline", "spline", 20.0, target),
            ("mesh of 20 px", "mesh", 20.0, target),
            ("mesh of 80 px", "mesh", 80.0, None),
        ):
            result = accumulate(parts, method=method, element=element)
            error = np.stack([result.displacement_x.values, result.displacement_y.values]) - total
            found.append((f"{label}, {words}: RMS error [px]", rms(error), limit))
            if noise and method == "spline":
                score = float(np.nanstd(error[0] / result.sigma_x.values))
                found.append((f"{label}, {words}: z-score", score, None))
    return found


def milliseconds(work: Callable[[], object]) -> float:
    """Return the best time of several runs [ms]."""
    work()
    times = []
    for _ in range(RUNS):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return 1e3 * min(times)


def time_rows(rendered: Rendered) -> list[Row]:
    """Best times of the steps, from the last frame to the cloud with strain and all sigmas, without the nodes."""
    stack = rendered.stacks[1]
    shape = rendered.shapes()[1]
    return [
        ("phase of 20 frames", milliseconds(lambda: phase_step(stack, PhaseParameters())), None),
        ("reconstruction", milliseconds(lambda: rendered.rig.reconstruct(rendered.phases[1].phase, PITCH)), 25),
        ("preparation of a shape, filter of 2 px", milliseconds(lambda: PreparedShape(shape, z_filter=2.0)), None),
    ]


def spacing_rows(rendered: Rendered, spacing: int) -> list[Row]:
    """Best times of what depends on the distance of the points."""
    dic, coupling = DisplacementTracker(DicParameters(spacing=spacing)), ShapeTracker(CouplingParameters())
    coupling.set_calibration(rendered.rig)
    numbers = iter(range(10**6))

    def correlate(k: int) -> DicResult:
        return dic.step("bench", next(numbers), 0, rendered.phases[k].texture)

    def couple_step(k: int, found: DicResult) -> CouplingResult:
        return coupling.step(replace(rendered.phases[k], step=next(numbers)), found)

    couple_step(0, correlate(0))
    found = correlate(1)
    in_plane = found.field
    prepared = [PreparedShape(each, z_filter=2.0) for each in rendered.shapes()]
    cloud = couple(*prepared, in_plane, z_filter=2.0)
    cracked = with_crack(cloud)
    return [
        (f"every {spacing} px: in-plane displacement", milliseconds(lambda: correlate(1)), None),
        (f"every {spacing} px: coupling", milliseconds(lambda: couple(*prepared, in_plane, z_filter=2.0)), None),
        (f"every {spacing} px: local frame with sigmas", milliseconds(lambda: to_local_frame(cloud)), None),
        (
            f"every {spacing} px: strain with sigmas",
            milliseconds(lambda: surface_strain(cloud, window=STRAIN_WINDOW)),
            None,
        ),
        (
            f"every {spacing} px: the same with a crack of 300 px",
            milliseconds(lambda: surface_strain(cracked, window=STRAIN_WINDOW)),
            None,
        ),
        (f"every {spacing} px: whole coupling step", milliseconds(lambda: couple_step(1, found)), None),
    ]


def light_rows() -> list[Row]:
    """Best processor times of a coupling step with its light corrected, and over that of one without; one thread."""
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    rows: list[Row] = []
    for name in ("plate", "skin", "leather"):
        rendered = render(VirtualRig.from_preset(name, seed=SEED), LIGHT_TRAVEL)
        bare = [replace(each, maps=each.maps[["phase", "sigma"]]) for each in rendered.phases]
        for spacing in (SPACING, 1):
            fields = displacements(rendered, spacing)
            best = dict.fromkeys(("with", "without"), np.inf)
            for words, phases in (("with", rendered.phases), ("without", bare)) * RUNS:
                coupling = ShapeTracker(CouplingParameters())
                coupling.set_calibration(rendered.rig)
                for phase, field in zip(phases, fields, strict=True):
                    coupling.step(phase, field)  # the last one measures the responses of the reference
                begin = time.thread_time()
                coupling.step(replace(phases[-1], step=2), fields[-1])
                best[words] = min(best[words], 1e3 * (time.thread_time() - begin))
            where = f"{name}, every {spacing} px"
            rows.append((f"{where}: processor time [ms]", best["with"], None))
            rows.append((f"{where}: over that without the light [1]", best["with"] / best["without"], None))
    numba.set_num_threads(threads)
    return rows


def with_crack(cloud: xr.Dataset) -> xr.Dataset:
    """Open a crack of 300 px along the middle row of a displacement by 100 µm."""
    row, column = np.meshgrid(cloud.row.values, cloud.column.values, indexing="ij")
    opening = 1e-4 * np.sqrt(np.clip(1 - ((column - 640) / 150) ** 2, 0, None))
    beside = np.where(row < 480, 0.5, -0.5) * np.exp(-np.abs(row - 480) / 150)
    return cloud.assign(v=cloud.v + (opening * beside).astype(np.float32))


def window_figure(rendered: Rendered, path: Path) -> None:
    """Noise of the strain, measured and predicted, over the virtual strain gauge."""
    truth = rendered.truth
    cloud = couple(*rendered.shapes(), rendered.in_plane(), z_filter=2.0)
    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    windows = (21, 29, 41, 61, 85, 121)
    for colour, name in zip(("C0", "C1", "C2"), ("e_11", "e_22", "e_12"), strict=True):
        errors, sigmas, lengths = [], [], []
        for window in windows:
            found, true = strains(rendered, cloud, window)
            inner = binary_erosion((truth.valid & truth.lit).values, iterations=(32 + window // 2) // SPACING)
            errors.append(1e6 * rms(np.where(inner, (found[name] - true[name]).values, np.nan)))
            sigmas.append(1e6 * rms(found[f"sigma_{name}"].where(inner).values))
            lengths.append(found.attrs["virtual_strain_gauge_px"])
        axes.loglog(lengths, errors, "o", color=colour, label=f"{name}, RMS error")
        axes.loglog(lengths, sigmas, "-", color=colour, label=f"{name}, predicted sigma")
    axes.set(xlabel="virtual strain gauge [px]", ylabel="noise of the strain [µstrain]")
    ticks = [50, 60, 80, 100, 120, 150]
    axes.set_xticks(ticks, labels=[str(tick) for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(ncols=2, fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def error_figure(maps: dict[str, np.ndarray], path: Path) -> None:
    """Maps of the errors against the twin's truth."""
    figure, axes = plt.subplots(2, 3, figsize=(10, 5), layout="constrained")
    for each, (name, values) in zip(axes.flat, maps.items(), strict=True):
        limit = 3 * rms(values)
        shown = each.imshow(values, cmap="RdBu_r", vmin=-limit, vmax=limit, extent=(0, 1280, 960, 0))
        each.set_title(name, fontsize=9)
        each.tick_params(labelsize=7)
        each.set_xlabel("column [px]", fontsize=7)
        each.set_ylabel("row [px]", fontsize=7)
        figure.colorbar(shown, ax=each, shrink=0.8)
    figure.savefig(path, dpi=100)
    plt.close(figure)


def shown(title: str, rows: list[Row]) -> str:
    lines = [f"## {title}", "", "| figure | measured | target |", "|---|---:|---:|"]
    for name, value, target in rows:
        lines.append(f"| {name.strip()} | {value:.3g} | {'' if target is None else f'≤ {target:g}'} |")
    return "\n".join(lines)


def shown_by_column(title: str, rows: list[Row]) -> str:
    """Return one line for each name before the colon of a row, and one column for each after it."""
    lines: dict[str, dict[str, str]] = {}
    for name, value, target in rows:
        line, _, column = name.rpartition(": ")
        lines.setdefault(line, {})[column] = f"{value:.3g}" + ("" if target is None else f" (≤ {target:g})")
    columns = list(dict.fromkeys(column for cells in lines.values() for column in cells))
    head = [f"## {title}", "", f"| figure | {' | '.join(columns)} |", "|---|" + "---:|" * len(columns)]
    body = [f"| {line} | {' | '.join(cells.get(each, '') for each in columns)} |" for line, cells in lines.items()]
    return "\n".join(head + body)


def between(text: str, begin: str, end: str, new: str) -> str:
    """Return a text with something new from one mark to another."""
    before, mark, rest = text.partition(begin)
    _, stop, after = rest.partition(end)
    if not (mark and stop):
        raise SystemExit(f"the page has no '{begin.strip()}' before '{end}'")
    return f"{before}{new}{stop}{after}"


def main() -> None:
    """Measure and print the tables, and write the page when asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path, help="Markdown page whose figures are replaced, between its markers")
    parser.add_argument("--times", action="store_true", help="measure and write only the times")
    options = parser.parse_args()
    rendered, maps = render(VirtualRig.from_preset("plate", seed=SEED)), dict[str, np.ndarray]()
    tables = {}
    if not options.times:
        tables = {
            PLATE: twin_rows(rendered, maps),
            MORE: finer_rows(),
            SURFACES: score_rows(),
            EXACT: exact_rows(rendered),
            "Twenty increments to 10 %": increment_rows(),
        }
    load = os.getloadavg()[0]  # of other programs: these figures alone depend on it
    times = f"{TIMES}, 1280x960, {numba.get_num_threads()} threads, load average before {load:.0f}"
    tables[times] = time_rows(rendered)
    tables[SPACINGS] = spacing_rows(rendered, SPACING) + spacing_rows(rendered, 1)
    tables[LIGHT] = light_rows()
    text = "\n\n".join(
        shown_by_column(title, rows) if title in BY_COLUMN else shown(title, rows) for title, rows in tables.items()
    )
    print(text)
    if options.page is not None:
        page = options.page.read_text(encoding="utf-8")
        begin, new = (f"## {TIMES}", text) if options.times else (FIGURES, f"{FIGURES}\n{text}")
        options.page.write_text(between(page, begin, "<!-- end of figures -->", f"{new}\n\n"), encoding="utf-8")
    if options.page is not None and not options.times:
        error_figure(maps, options.page.with_name("coupling_errors.png"))
        window_figure(rendered, options.page.with_name("coupling_strain.png"))


if __name__ == "__main__":
    main()
