"""Calibration of the rig on the virtual rig: heights, convergence without starting values, uncertainties, time.

Prints the table of targets and writes ``docs/validation/calibration.md`` with its pictures. `--quick` takes smaller
images and fewer rigs, renders no frames and does not write the page; `--times` measures only the times and updates them
in the page. Takes about ten minutes on two cores without other load. The seeds differ from those of the tests.
"""

from __future__ import annotations

import argparse
import math
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from fringedic.calibration import RigCalibration, calibrate_rig
from fringedic.calibration.sentences import model_choice_sentence, verdict_sentence
from fringedic.camera import DistortionMap
from fringedic.camera.grid import GridMeasurement, measure_distortion
from fringedic.camera.plane_homography import PlaneHomography
from fringedic.camera.tilted_grid import TiltedGrid, locate_pin_hole, measure_tilted_grid
from fringedic.patterns.sequences import fringe_sequence
from fringedic.phase import absolute_phase
from fringedic.rig.geometry import parameter_values
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

PAGE = Path(__file__).resolve().parents[1] / "docs" / "validation" / "calibration.md"
PITCH = 10.0
NOISE = 0.0021 * 2 * math.pi  # [rad]
GRID_ANGLES = (math.radians(-12.0), math.radians(12.0))
GRID_NOISE = 1e-3  # [px] of a block of grid points
ANGLES = np.radians([-15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 15.0, 7.5])
HELD_OUT = (7,)
CALIBRATION_ROW = f"calibration of {len(ANGLES)} images of 1280 x 960"
SHAPE_ROW = "phase to x, y, z and sigmas, 1280 x 960"
SPHERE = {
    "kind": "rigid",
    "shape": "sphere",
    "radius_mm": 120.0,
    "height_mm": 10.0,
    "half_width_mm": 80.0,
    "half_height_mm": 60.0,
}
MISALIGNED = {
    "camera": {"tilt_x_degree": 0.2, "tilt_y_degree": 0.2},
    "projector": {"yaw_degree": math.degrees(1.5 / 420), "roll_degree": 0.7},  # aims 1.5 mm beside the origin
    "stage": {"axis_x_mm": 1.0, "axis_z_mm": 1.0},
}
RIGS: dict[str, dict[str, dict[str, float]]] = {
    "ideal": {},
    "misaligned": MISALIGNED,
    "+ projector distortion": {**MISALIGNED, "projector": {**MISALIGNED["projector"], "k1": 0.1}},
    "+ five coefficients": {
        **MISALIGNED,
        "projector": {**MISALIGNED["projector"], "k1": 0.1, "k2": -2.0, "p1": 2e-3, "p2": -3e-3, "k3": 20.0},
    },
}
PAPER = {"ideal": 5.7, "misaligned": 366.0, "+ projector distortion": 367.0}


def twin_of(changes: dict[str, dict[str, float]], width: int, sensor: dict[str, float] | None = None) -> VirtualRig:
    """Return the rig of the table with `width` pixels across its field."""
    sections: dict[str, dict[str, Any]] = {
        "camera": {"columns": width, "rows": width * 3 // 4, "pixel_size_um": 64e3 / width},
        "projector": {"defocus_px": 0.45},
        "stage": {"albedo": 1.0, "grid_pitch_mm": 640 / width},  # 10 px
        "sensor": {"white_level": 0.7, **(sensor or {})},  # the albedo of plane and sphere
        "texture": {"floor": 0.999},
        "specimen": {"kind": "reference_plane"},
    }
    for name, entries in changes.items():
        sections[name] = {**sections[name], **entries}
    return VirtualRig(VirtualRigConfiguration.from_dict(sections))


def exact_phase(twin: VirtualRig, specimen: dict[str, Any]) -> np.ndarray:
    """Return the phase of a specimen without any measurement [rad]."""
    column = twin.with_specimen(specimen).view(0.0).projector_column
    return 2 * math.pi / PITCH * (column - (twin.projector_shape[1] - 1) / 2)


def plane(angle: float) -> dict[str, Any]:
    """Return the plane on the stage."""
    return {"kind": "reference_plane", "angle_degree": math.degrees(angle)}


def exact_view(twin: VirtualRig) -> PlaneHomography:
    """Return how the camera sees the plane at angle 0, from where four pixels meet it."""
    truth = twin.with_specimen(plane(0.0)).truth(0.0)
    rows, columns = twin.shape
    equations = []
    for r, s in ((0, 0), (0, columns - 1), (rows - 1, 0), (rows - 1, columns - 1)):
        x, y = float(truth.x[r, s]), float(truth.y[r, s])
        equations += [[s, r, 1, 0, 0, 0, -x * s, -x * r, -x], [0, 0, 0, s, r, 1, -y * s, -y * r, -y]]
    homography = np.linalg.svd(np.array(equations))[2][-1].reshape(3, 3)
    centre = np.array([(columns - 1) / 2, (rows - 1) / 2, 1.0])
    homography /= homography[2] @ centre
    shift = np.eye(3)
    shift[:2, 2] = -(homography @ centre)[:2]
    homography = shift @ homography
    turn = -math.atan2(homography[1, 0], homography[0, 0])
    c, s = math.cos(turn), math.sin(turn)
    return PlaneHomography(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ homography, centre[0], centre[1])


def calibrate(twin: VirtualRig, phases: list[np.ndarray], sigma: list[np.ndarray], **known: Any) -> RigCalibration:
    """Calibrate with the plane at 7.5 degree kept out, if it is there."""
    return calibrate_rig(
        phases,
        ANGLES[: len(phases)],
        1e-6 * twin.configuration.camera.pixel_size_um,
        pitch=PITCH,
        projector_size=(800, 600),
        sigma=sigma,
        held_out=[i for i in HELD_OUT if i < len(phases)],
        **known,
    )


def rendered(twin: VirtualRig, specimen: dict[str, Any], first: int) -> xr.Dataset:
    """Return the phase that frames of the twin give: 8-bit projector, pitches 800/160/40/10, q = 8 at the finest."""
    sequence = fringe_sequence(800, 600, [800, 160, 40, 10], [4, 4, 4, 8])
    seen = twin.with_specimen(specimen)
    frames = np.array([seen.expose(image, 0.0, first + index) for index, image in enumerate(sequence)])
    return absolute_phase(frames, list(sequence.patterns))


def grid_picture(twin: VirtualRig, angle: float) -> np.ndarray:
    """Return the mean of eight pictures of the printed grid on the plane."""
    white = np.full(twin.projector_shape, 255, np.uint8)
    seen = twin.with_specimen({**plane(angle), "surface": "grid"})
    first = 10_000 + 100 * round(math.degrees(angle))
    return np.mean([seen.expose(white, 0.0, first + i) for i in range(8)], axis=0)


def exact_grids(twin: VirtualRig, generator: np.random.Generator) -> PlaneHomography:
    """Return how the camera sees the plane, with its pin-hole by grids on the turned plane: exact points with noise."""
    view, (rows, columns) = exact_view(twin), twin.shape
    row, column = (each.ravel() for each in np.meshgrid(*(np.arange(5, n, 10) for n in (rows, columns)), indexing="ij"))
    pixels = np.stack([column, row], axis=1).astype(float)
    sigma = GRID_NOISE * 1e-6 * twin.configuration.camera.pixel_size_um
    turned = []
    for angle in GRID_ANGLES:
        seen = twin.with_specimen(plane(angle)).view(0.0)
        points = np.stack([seen.X[row, column], seen.Y[row, column]], axis=1)
        points += sigma * generator.standard_normal(points.shape)
        turned.append(TiltedGrid(angle, pixels, points, np.full(len(points), sigma), 0.0))
    nothing = np.zeros(len(pixels))
    flat = GridMeasurement(
        distortion=DistortionMap(columns, rows, np.zeros((1, 1)), np.zeros((1, 1))),
        plane=view,
        pitch=1e-3,
        period=10.0,
        turn=0.0,
        order=1,
        orders=(1,),
        cross_validation=(0.0,),
        magnitude=0.0,
        residual=1e-6,  # exact: the picture at angle 0 is not made
        sigma=0.0,
        columns=pixels[:, 0],
        rows=pixels[:, 1],
        residual_columns=nothing,
        residual_rows=nothing,
        valid_fraction=1.0,
        warnings=(),
    )
    return locate_pin_hole(flat, turned).plane


def rms(values: Any) -> float:
    """Return the root mean square [µm] of heights [m]."""
    return 1e6 * float(np.sqrt(np.nanmean(np.asarray(values, float) ** 2)))


def from_frames(changes: dict[str, dict[str, float]], width: int) -> tuple[list[np.ndarray], RigCalibration]:
    """Return errors of z [m] from rendered frames and the last calibration.

    A camera of 16 bits without noise shows what the projector's 8 bits leave; then comes one of 8 bits with noise.
    """
    errors = []
    for sensor in ((16, 0.0, 0.0), (8, 1.0, 0.02)):
        names = ("bits", "read_noise_grey_level", "shot_noise_grey_level")
        twin = twin_of(changes, width, dict(zip(names, sensor, strict=True)))
        flat = measure_distortion(grid_picture(twin, 0.0), pitch=1e-3 * twin.configuration.stage.grid_pitch_mm)
        measured = locate_pin_hole(
            flat, [measure_tilted_grid(grid_picture(twin, angle), flat, angle) for angle in GRID_ANGLES]
        )
        stacks = [rendered(twin, plane(angle), 100 * (i + 1)) for i, angle in enumerate(ANGLES)]
        found = calibrate(
            twin,
            [np.asarray(each.phase) for each in stacks],
            [np.asarray(each.sigma) for each in stacks],
            plane=measured.plane,
            distortion=measured.distortion,
        )
        truth = twin.with_specimen(SPHERE).truth(0.0).z
        errors.append(np.asarray(found.reconstruct(rendered(twin, SPHERE, 5000).phase).z - truth))
    return errors, found


def heights(
    width: int, frames: bool
) -> tuple[list[list[str]], dict[str, tuple[np.ndarray, np.ndarray]], RigCalibration]:
    """Return rows of the table, maps of the error and one calibration of rendered frames."""
    table, maps = [], {}
    generator = np.random.default_rng(20)
    for name, changes in RIGS.items():
        twin = twin_of(changes, width)
        phases = [exact_phase(twin, plane(angle)) for angle in ANGLES]
        sphere, truth, view = exact_phase(twin, SPHERE), twin.with_specimen(SPHERE).truth(0.0).z, exact_view(twin)
        sigma = [np.full(twin.shape, NOISE)] * len(phases)
        exact = calibrate(twin, phases, sigma, plane=view)
        left = exact.reconstruct(sphere).z - truth
        paper = calibrate(twin, phases, sigma, plane=view, model="paper").reconstruct(sphere).z - truth
        noisy = calibrate(
            twin, [each + NOISE * generator.standard_normal(twin.shape) for each in phases], sigma, plane=view
        )
        with_noise = noisy.reconstruct(sphere + NOISE * generator.standard_normal(twin.shape)).z - truth
        rendered_error, frame_error, calibration = np.full((2, 2), np.nan), np.full((2, 2), np.nan), noisy
        if frames:
            (rendered_error, frame_error), calibration = from_frames(changes, width)
        maps[name] = (1e6 * rendered_error, 1e6 * np.asarray(paper))
        measured = (
            f"{rms(left):.3f}",
            f"{rms(rendered_error):.2f}",
            f"{rms(with_noise):.2f}",
            f"{rms(frame_error):.2f}",
        )
        verdict = str(calibration.verdict)
        table.append(
            [
                name,
                f"{rms(paper):.1f}" + (f" ({PAPER[name]:g})" if name in PAPER else ""),
                *measured,
                calibration.chosen,
                verdict,
            ]
        )
        print(" | ".join(table[-1]), flush=True)
    return table, maps, calibration


def random_rig(generator: np.random.Generator) -> dict[str, dict[str, float]]:
    """Return a rig whose distances are those of the table times 0.5 to 2, misaligned."""
    factor = 2 ** generator.uniform(-1, 1, 3)
    side = generator.uniform(-1, 1, 8)
    h0, hp, d = 400 * factor[0], 380 * factor[1], 180 * factor[2]
    return {
        "camera": {"distance_mm": h0, "tilt_x_degree": 0.2 * side[0], "tilt_y_degree": 0.2 * side[1]},
        "projector": {
            "z_mm": hp,
            "x_mm": d,
            # the same field is lit from any distance
            "focal_length_px": 3400 * math.hypot(hp, d) / math.hypot(380, 180),
            "yaw_degree": 0.2 * side[2],
            "pitch_degree": 0.2 * side[3],
            "roll_degree": 0.7 * side[4],
        },
        "stage": {"axis_x_mm": side[5], "axis_z_mm": side[6], "axis_yaw_degree": 0.3 * side[7]},
    }


def convergence(count: int, width: int) -> tuple[int, np.ndarray, dict[str, float], np.ndarray]:
    """Return how many rigs converged, z-scores of parameters, z-scores of x, y, z on a sphere, errors of z [µm]."""
    generator = np.random.default_rng(77001)
    converged, scores, errors = 0, [], []
    squares: dict[str, list[float]] = {name: [] for name in ("x", "y", "z")}
    for number in range(count):
        twin = twin_of(random_rig(generator), width)
        phases = [
            exact_phase(twin, plane(angle)) + NOISE * generator.standard_normal(twin.shape) for angle in ANGLES[:7]
        ]
        found = calibrate(twin, phases, [np.full(twin.shape, NOISE)] * 7, plane=exact_grids(twin, generator))
        sphere, truth = exact_phase(twin, SPHERE), twin.with_specimen(SPHERE).truth(0.0)
        shape = found.reconstruct(sphere, np.zeros_like(sphere))
        errors.append(rms(shape.z - truth.z))
        good = found.go and 0.8 < found.chi_square < 1.2
        converged += int(good)
        if not good:
            print(f"random rig {number}: chi square {found.chi_square:.3f}; {found.verdict}", flush=True)
        names = found.model.parameter_names
        optics = twin.optics()
        true = parameter_values(_Truth(optics), names)
        covariance = np.reshape(found.model.covariance, (len(names), len(names)))
        scores.append((parameter_values(found.model, names) - true) / np.sqrt(np.diag(covariance)))
        for name in squares:
            squares[name].append(float((((shape[name] - truth[name]) / shape[f"sigma_{name}"]) ** 2).mean()))
    by_name = {name: math.sqrt(np.mean(each)) for name, each in squares.items()}
    return converged, np.concatenate(scores), by_name, np.array(errors)


class _Truth:
    """The twin's parameters as attributes."""

    def __init__(self, optics: dict[str, Any]) -> None:
        self.__dict__.update(optics)


def seconds(width: int) -> tuple[float, str, str]:
    """Return the time of a calibration [s], and of a reconstruction without and with projector distortion in words."""
    twin = twin_of(RIGS["+ projector distortion"], width)
    phases = [exact_phase(twin, plane(angle)).astype(np.float32) for angle in ANGLES]
    sigma = [np.full(twin.shape, NOISE, np.float32)] * len(phases)
    begin = time.perf_counter()
    found = calibrate(twin, phases, sigma, plane=exact_view(twin))
    whole = time.perf_counter() - begin
    twin = twin_of(MISALIGNED, width)
    straight = calibrate(
        twin, [exact_phase(twin, plane(angle)) for angle in ANGLES], sigma, plane=exact_view(twin), model="general"
    )
    times = []
    for calibration in (straight, found):
        calibration.reconstruct(phases[0], sigma[0])
        runs = []
        for _ in range(20):
            begin = time.perf_counter()
            calibration.reconstruct(phases[0], sigma[0])
            runs.append(1e3 * (time.perf_counter() - begin))
        times.append(f"{np.median(runs):.1f} ms (best {min(runs):.1f})")
    return whole, times[0], times[1]


def picture(maps: dict[str, tuple[np.ndarray, np.ndarray]], scores: np.ndarray, errors: np.ndarray) -> Figure:
    """Draw the error of z for the fitted model and the paper's, and the distribution of the z-scores."""
    figure = Figure(figsize=(12, 7.5), layout="constrained")
    grid = figure.subplots(3, len(maps))
    for axes, (name, (rendered_error, paper_error)) in zip(grid[:2].T, maps.items(), strict=True):
        top = max(float(np.nanpercentile(np.abs(paper_error), 99)), 1e-3)
        # the middle alone: thinned out, fine waves would show others that are not there
        middle = rendered_error[tuple(slice(3 * n // 8, 5 * n // 8) for n in rendered_error.shape)]
        for place, values, limit, label in (
            (axes[0], paper_error[::4, ::4], top, "paper's model, exact phases"),
            (axes[1], middle, 5.0, "fitted, rendered frames, middle"),
        ):
            shown = place.imshow(values, cmap="RdBu_r", vmin=-limit, vmax=limit)
            place.set_title(f"{name}:\n{label}", fontsize=9)
            place.set_xticks([])
            place.set_yticks([])
            figure.colorbar(shown, ax=place, label="error of z [µm]", shrink=0.8)
    axes = grid[2, 0]
    bins = np.linspace(-4, 4, 33)
    axes.hist(scores, bins, density=True, color="#9db8d6")
    axes.plot(bins, np.exp(-(bins**2) / 2) / math.sqrt(2 * math.pi), color="#1f5fa8")
    axes.set_title("z-scores of the parameters, random rigs", fontsize=9)
    grid[2, 1].hist(errors, 30, color="#e2b48a")
    grid[2, 1].set_title("error of z that the calibration leaves", fontsize=9)
    grid[2, 1].set_xlabel("µm RMS on a sphere")
    for axes in grid[2, 2:]:
        axes.axis("off")
    return figure


def main() -> None:
    """Measure, print, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small images, ten rigs; the page is not written")
    parser.add_argument("--times", action="store_true", help="measure only the times and update them in the page")
    options = parser.parse_args()
    width = 320 if options.quick else 1280
    if options.times:
        renew_times(time_rows(*seconds(width)))
        return
    count = 10 if options.quick else 100
    print("rig | six-parameter model (reference) | exact phases | rendered | noisy phases | frames of 8 bits | chosen")
    table, maps, calibration = heights(width, frames=not options.quick)
    converged, scores, of_points, errors = convergence(count, 160)
    score = math.sqrt(float(np.mean(scores**2)))
    times = time_rows(*seconds(width))
    lines = [
        f"random rigs that converged without starting values: {converged} of {count} (target all)",
        f"z-scores of their parameters: {score:.3f} (0.9 to 1.1); of x, y, z by the calibration: "
        + ", ".join(f"{value:.3f}" for value in of_points.values()),
        *times.values(),
    ]
    print("\n".join(lines))
    if options.quick:
        return
    PAGE.parent.mkdir(exist_ok=True)
    picture(maps, scores, errors).savefig(PAGE.with_suffix(".png"), dpi=110)
    PAGE.write_text(page(table, converged, count, score, of_points, errors, calibration, times))


def time_rows(whole: float, straight: str, distorted: str) -> dict[str, str]:
    """Return rows of the page by their first cell."""
    return {
        CALIBRATION_ROW: f"| {CALIBRATION_ROW} | {whole:.1f} s | seconds |",
        SHAPE_ROW: f"| {SHAPE_ROW} | median of 20: {straight}, with projector distortion {distorted} | 25 ms |",
    }


def renew_times(rows: dict[str, str]) -> None:
    """Print the times and update them in the page."""
    text = PAGE.read_text("utf-8")
    for name, row in rows.items():
        print(row)
        text = re.sub(rf"^\| {re.escape(name)} .*$", row, text, flags=re.MULTILINE)
    PAGE.write_text(text, "utf-8")


def page(
    table: list[list[str]],
    converged: int,
    count: int,
    score: float,
    of_points: dict[str, float],
    errors: np.ndarray,
    calibration: RigCalibration,
    times: dict[str, str],
) -> str:
    """Return the page of measured figures."""
    rows = "\n".join("| " + " | ".join(each) + " |" for each in table)
    points = ", ".join(f"{name} {value:.2f}" for name, value in of_points.items())
    return f"""# Calibration of the rig: measured figures

This page shows the height error after a calibration, and how well the stated uncertainties agree with the errors.
It is written by `python benchmarks/calibration.py` (`--times` updates only the times). The virtual rig traces its
own rays and shares no code with the calibration.

## Height error

*Error of z on a sphere of radius 120 mm [µm RMS]. Virtual rig: 50 µm/pixel, h0 400 mm, hp 380 mm, d 180 mm, focal
length of the projector 3400 px, fringes of 10 px, q = 8. "Misaligned": target displaced by 1.5 mm, roll of 0.7
degree, camera tilted by 0.2 degree about x and y, rotation axis displaced by 1 mm in x and in z. Projector
distortion: k1 = 0.1; five coefficients: k2 = -2, p1 = 0.002, p2 = -0.003 and k3 = 20 beside it, where k1 alone would
leave errors of up to 10 µm. Seven planes from -15 to 15 degree are fitted; the plane at 7.5 degree is kept out:*

| rig | six-parameter model, exact phases (reference, with noise) | exact phases (≤ 1) | \
rendered frames without camera noise (≤ 2) | phases with 0.0021 fringe (≤ 6.2) | \
8-bit frames with read and shot noise | selected model | verdict |
|---|---:|---:|---:|---:|---:|---|---|
{rows}

Rendered frames: the projector has 8 bits and a blur of 0.45 px. The grid that gives scale, tilt and distortion is
rendered as well, at 0, -12 and 12 degree, and measured by `measure_distortion` and `locate_pin_hole`. The noise of
8-bit frames is 1 grey level and a variance of 0.02 per grey level.

## Convergence, uncertainty and time

*Random rigs: distances x 0.5 to 2, misaligned, with noise, without starting values. Their grids at -12 and 12
degree have blocks with an uncertainty of 0.001 px, so that h0, the tilt of the camera and the principal column of
the projector are parameters as well:*

| figure | measured | target |
|---|---:|---:|
| random rigs that converge | {converged} of {count} | all |
| z-scores of their parameters | {score:.3f} | 0.9 to 1.1 |
| z-scores of x, y, z on a sphere, error of the calibration alone | {points}, each ± {1 / math.sqrt(2 * count):.2f} | \
0.9 to 1.1 |
| remaining error of z, 160 x 120 px, median / largest | {np.median(errors):.2f} / \
{errors.max():.2f} µm | - |
{times[CALIBRATION_ROW]}
{times[SHAPE_ROW]}

The error by a calibration is nearly constant over the sphere: the scatter of a z-score is 1 / sqrt(2 rigs).

![Errors of z of both models, z-scores](calibration.png)

## Text of the report

The report of the last rig, from its 8-bit frames, contains:

> {verdict_sentence(calibration)} {model_choice_sentence(calibration)}
"""


if __name__ == "__main__":
    main()
