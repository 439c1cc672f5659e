"""Remaining distortion after one image of a grid, beside OpenCV's calibration.

The camera of the virtual rig has two lenses, one that Brown's model describes and one that it does not. OpenCV uses 15
images of a chessboard through the same lenses with the same noise. Writes docs/validation/distortion.md; ``--quick``
runs a short version and does not write the page, ``--times`` measures only the times and updates them in the page.
Takes about five minutes on two cores without other load.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the nodes; two threads only wait for each other here

import argparse
import math
import re
import textwrap
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import matplotlib.pyplot as plt
import numpy as np
from scipy.special import erf

from fringedic.camera import DistortionMap
from fringedic.camera.grid import GridMeasurement, measure_distortion
from fringedic.camera.homography import apply_homography, fit_homography
from fringedic.camera.tilted_grid import locate_pin_hole, measure_tilted_grid
from fringedic.errors import GridError
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

PAGE = Path(__file__).resolve().parents[1] / "docs" / "validation" / "distortion.md"
LENSES: dict[str, dict[str, Any]] = {
    "Brown": {"k1": -0.3, "k2": 1.0, "p1": 2e-4, "p2": -3e-4},
    "irregular": {
        "k1": -0.3,
        "bump_percent": (0.05, -0.03),
        "bump_centre_percent": (15.0, -8.0),
        "bump_radius_percent": 12.0,
    },
}
TARGETS = {"Brown": 0.0005, "irregular": 0.005}
REFERENCE = {"Brown": 0.0013, "irregular": 0.175}  # what OpenCV left in an earlier study of such lenses
PITCH_MM = 0.4
PITCHES_MM = (0.25, 0.3, 0.4, 0.5, 0.75, 1.0, 2.0)
TURNED = (-12.0, 12.0)  # [degree]
SMALL = (320, 240)  # [px] the same field with fewer pixels
SMALL_PERIODS = (6, 7, 8, 10)  # [px]
SMALL_TURNS = (2.0, 3.5)  # [degree]
SMALL_BLUR = 0.43  # [px] of the lines: lens and the area of a pixel
TIME_ROW = "time of one measurement [s]"
FRAMES = 5
VIEWS = 15
BOARD = (27, 19)  # inner corners
SQUARE = 1.9e-3  # [m]
CORNER_BLUR = 0.6  # [px] standard deviation of the chessboard's edges


def twin_with(lens: str, camera: dict[str, Any] | None = None, **stage: Any) -> VirtualRig:
    """Return the misaligned rig of the calibration table with a lens, in front of the grid."""
    return VirtualRig(
        VirtualRigConfiguration.from_dict(
            {
                "preset": "reference_plane",
                "alignment": "misaligned",
                "camera": {"lens": LENSES[lens], **(camera or {})},
                "specimen": {"surface": "grid"},
                "stage": {"grid_pitch_mm": PITCH_MM, **stage},
            }
        )
    )


def grid_image(twin: VirtualRig, frame: int) -> np.ndarray:
    """Return a white exposure."""
    return twin.expose(np.full(twin.projector_shape, 255, np.uint8), 0.0, frame)


class Truth:
    """What a lens really does, and what a measurement leaves of it."""

    def __init__(self, twin: VirtualRig) -> None:
        self.shape = twin.shape
        self.row, self.column = (each.astype(float) for each in np.mgrid[: twin.shape[0], : twin.shape[1]])
        self.true = np.stack(twin.straight_pixels(), axis=-1).reshape(-1, 2)

    def left(self, column: np.ndarray, row: np.ndarray) -> tuple[float, np.ndarray]:
        """Return root mean square over all pixels and map of the error of ideal pixels, after the best homography."""
        found = np.stack([column.ravel(), row.ravel()], axis=1)
        homography = fit_homography(found[::17], self.true[::17])
        error = apply_homography(homography, found) - self.true
        return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))), error.reshape(*self.shape, 2)

    def left_by(self, distortion: DistortionMap) -> tuple[float, np.ndarray]:
        """Return the same for a distortion map."""
        return self.left(*distortion.ideal(self.column, self.row))


# OpenCV --------------------------------------------------------------------------------------------------------------


def chessboard_views(twin: VirtualRig, count: int) -> list[np.ndarray]:
    """Return images of a chessboard in `count` poses through the twin's lens, with the noise of its sensor.

    Every pixel's line of sight is met with the board; its squares are a product of blurred steps.
    """
    optics = twin.optics()
    focal = optics["camera_distance"] / optics["pixel_size"]
    column, row = twin.straight_pixels()
    rays = np.stack(
        [(column - optics["principal_column"]) / focal, (row - optics["principal_row"]) / focal, np.ones(twin.shape)],
        axis=-1,
    )
    random = np.random.default_rng(5)
    sensor = twin.configuration.sensor
    blur = CORNER_BLUR * optics["pixel_size"]
    views = []
    for _ in range(count):
        rotation = cv2.Rodrigues(np.radians(random.uniform([-20, -20, -10], [20, 20, 10])))[0]
        centre = np.array([*random.uniform(-2e-3, 2e-3, 2), optics["camera_distance"] + random.uniform(-0.01, 0.03)])
        along = (rotation[:, 2] @ centre) / (rays @ rotation[:, 2])
        on_board = (along[..., None] * rays - centre) @ rotation
        squares = [_steps(on_board[..., k], count + 1, blur) for k, count in enumerate(BOARD)]
        half = [0.5 * (count + 1) * SQUARE for count in BOARD]
        inside = np.prod([np.abs(on_board[..., k]) < half[k] for k in range(2)], axis=0)
        white = 0.7 * np.where(inside, 0.535 - 0.465 * squares[0] * squares[1], 1.0)
        level = 255 * sensor.white_level * white
        sigma = np.sqrt(sensor.read_noise_grey_level**2 + sensor.shot_noise_grey_level * level)
        views.append(np.clip(np.round(level + sigma * random.normal(size=level.shape)), 0, 255).astype(np.uint8))
    return views


def _steps(position: np.ndarray, squares: int, blur: float) -> np.ndarray:
    """Return +1 and -1 on alternating squares around 0, with blurred edges."""
    value = np.ones_like(position)
    for n in range(1, squares):
        value *= erf((position - (n - squares / 2) * SQUARE) / (math.sqrt(2) * blur))
    return value


@dataclass
class OpenCv:
    """Result of OpenCV's calibration."""

    left: float
    error: np.ndarray
    reprojection: float
    views: int


def calibrate_opencv(views: list[np.ndarray], truth: Truth, flags: int) -> OpenCv:
    """Calibrate with the corners of all views in which the whole board is found."""
    board = np.zeros((BOARD[0] * BOARD[1], 3), np.float32)
    board[:, :2] = SQUARE * np.mgrid[: BOARD[0], : BOARD[1]].T.reshape(-1, 2)
    found = [cv2.findChessboardCornersSB(view, BOARD, flags=cv2.CALIB_CB_ACCURACY) for view in views]
    corners = [points for there, points in found if there]
    size = truth.shape[1], truth.shape[0]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 300, 1e-14)
    error, matrix, coefficients, _, _ = cv2.calibrateCamera(
        [board] * len(corners), corners, size, None, None, flags=flags, criteria=criteria
    )
    # exact inverse of OpenCV's own model at every pixel: its iteration, started from few points, is not exact enough
    ideal = _undistorted(truth, matrix, coefficients.ravel())
    left, error_map = truth.left(*ideal)
    return OpenCv(left, error_map, error, len(corners))


def _undistorted(truth: Truth, matrix: np.ndarray, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    column, row = truth.column.copy(), truth.row.copy()
    for _ in range(12):
        x, y = (column - matrix[0, 2]) / matrix[0, 0], (row - matrix[1, 2]) / matrix[1, 1]
        points = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
        seen = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, coefficients)[0].reshape(*truth.shape, 2)
        column += truth.column - seen[..., 0]
        row += truth.row - seen[..., 1]
    return column, row


# The page -------------------------------------------------------------------------------------------------------------


@dataclass
class LensResult:
    """Everything measured with one lens."""

    raw: float
    raw_error: np.ndarray
    left: list[float]
    error: np.ndarray
    measurement: GridMeasurement
    seconds: float
    opencv: dict[str, OpenCv]
    by_order: dict[int, float]


MODELS = {
    "k1 k2 p1 p2 k3": 0,
    "rational and thin prism, 12 coefficients": cv2.CALIB_RATIONAL_MODEL | cv2.CALIB_THIN_PRISM_MODEL,
}


def study(lens: str, frames: int, views: int, orders: tuple[int, ...]) -> LensResult:
    """Measure one lens with both methods."""
    twin = twin_with(lens)
    truth = Truth(twin)
    raw, raw_error = truth.left(truth.column, truth.row)
    left, error, times = [], np.empty(0), []
    for frame in range(frames):
        image = grid_image(twin, 10 + frame)
        begin = time.perf_counter()
        measurement = measure_distortion(image, pitch=1e-3 * PITCH_MM)
        times.append(time.perf_counter() - begin)
        each, error = truth.left_by(measurement.distortion)
        left.append(each)
    image = grid_image(twin, 10 + frames - 1)
    by_order = {
        order: truth.left_by(measure_distortion(image, pitch=1e-3 * PITCH_MM, order=order).distortion)[0]
        for order in orders
    }
    boards = chessboard_views(twin, views)
    opencv = {name: calibrate_opencv(boards, truth, flags) for name, flags in MODELS.items()}
    return LensResult(raw, raw_error, left, error, measurement, min(times), opencv, by_order)


def pitches() -> list[tuple[float, float, float]]:
    """Return pitch [mm], remaining distortion of Brown's lens and its prediction from the noise [px]."""
    rows = []
    for pitch in PITCHES_MM:
        twin = twin_with("Brown", grid_pitch_mm=pitch)
        found = measure_distortion(grid_image(twin, 3), pitch=1e-3 * pitch)
        rows.append((pitch, Truth(twin).left_by(found.distortion)[0], found.sigma))
    return rows


def small() -> list[str]:
    """Return rows of the period and the remaining distortion on a small image, for each angle of the grid."""
    columns, rows = SMALL
    pixel = 64.0 / columns  # [mm]
    camera = {"columns": columns, "rows": rows, "pixel_size_um": 1e3 * pixel}
    lines = []
    for period in SMALL_PERIODS:
        cells = [f"{period} ({rows // period})"]
        for turn in SMALL_TURNS:
            stage = {"grid_pitch_mm": period * pixel, "grid_blur_um": 1e3 * SMALL_BLUR * pixel}
            twin = twin_with("Brown", camera, grid_turned_degree=turn, **stage)
            image = np.mean([grid_image(twin, frame) for frame in range(8)], axis=0)
            try:
                found = measure_distortion(image, pitch=1e-3 * period * pixel)
            except GridError:
                cells.append("refused")
                continue
            left = Truth(twin).left_by(found.distortion)[0]
            cells.append(f"{left:.5f} ({found.sigma:.5f}){', with a warning' if found.warnings else ''}")
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def turned() -> list[str]:
    """Return rows of the position of the pin-hole from one and from three images of the grid."""
    rows = []
    for lens in LENSES:
        twin = twin_with(lens)
        flat = measure_distortion(grid_image(twin, 0), pitch=1e-3 * PITCH_MM)
        pictures = []
        for degrees in TURNED:
            plane = {"kind": "reference_plane", "surface": "grid", "angle_degree": degrees}
            picture = grid_image(twin.with_specimen(plane), 50 + round(degrees))
            pictures.append(measure_tilted_grid(picture, flat, math.radians(degrees)))
        found = locate_pin_hole(flat, pictures)
        assert found.plane.pin_hole is not None
        distance = twin.optics()["camera_distance"]
        # the pin-hole is above the origin: its foot, seen from the point that the image's middle looks at
        truth, (row, column) = twin.truth(0.0), (n // 2 for n in twin.shape)
        middle = [float(values[row - 1 : row + 1, column - 1 : column + 1].mean()) for values in (truth.x, truth.y)]
        for name, each in (("one image", flat), ("three images", found)):
            camera = each.plane.camera(distance)
            tilt_x, tilt_y = camera["camera_tilt_x"], camera["camera_tilt_y"]
            off = (
                distance * math.tan(tilt_y) / math.cos(tilt_x) + middle[0],
                -distance * math.tan(tilt_x) + middle[1],
            )
            known = "-"
            if each.plane.pin_hole is not None:
                sigma = 1e6 * math.sqrt(each.plane.pin_hole.covariance[0, 0])
                known = f"{1e6 * (each.plane.pin_hole.distance - distance):+.1f} (sigma {sigma:.1f})"
            size = math.hypot(*off)
            rows.append(f"| {lens}, {name} | {1e6 * size:.1f} | {100 * size / distance:.4f} | {known} |")
    return rows


def table(results: dict[str, LensResult]) -> list[str]:
    """Return the rows of the comparison, in Markdown."""
    lines = [
        "| remaining distortion after the best homography, RMS over all pixels [px] | Brown lens | irregular lens |",
        "|---|---:|---:|",
    ]

    def row(name: str, cells: list[str]) -> None:
        lines.append(f"| {name} | {' | '.join(cells)} |")

    each = list(results.values())
    row("raw", [f"{result.raw:.3f}" for result in each])
    row(
        f"**one grid image**, mean of {len(each[0].left)} (worst)",
        [f"**{np.mean(result.left):.5f}** ({max(result.left):.5f})" for result in each],
    )
    row(
        "target",
        [
            f"{TARGETS[name]:g}" + ("" if max(results[name].left) <= TARGETS[name] else ", **missed**")
            for name in results
        ],
    )
    row("predicted from the scatter", [f"{result.measurement.sigma:.5f}" for result in each])
    for model in MODELS:
        count = each[0].opencv[model].views
        row(
            f"OpenCV, {count} chessboards, {model}",
            [f"{result.opencv[model].left:.5f}" for result in each],
        )
    row("OpenCV in an earlier study of such lenses", [f"{REFERENCE[name]:g}" for name in results])
    row("order selected by cross-validation", [str(result.measurement.order) for result in each])
    row(TIME_ROW, [f"{result.seconds:.1f}" for result in each])
    return lines


def draw(results: dict[str, LensResult], path: Path) -> None:
    """Draw the residual maps and the choice of the order."""
    figure, axes = plt.subplots(2, 4, figsize=(15, 6.6), layout="constrained")
    for axis_row, (name, result) in zip(axes, results.items(), strict=True):
        opencv = result.opencv["k1 k2 p1 p2 k3"]
        for axis, error, title in (
            (axis_row[0], result.raw_error, f"{name} lens, raw: {result.raw:.3f} px"),
            (axis_row[1], opencv.error, f"remaining, OpenCV: {opencv.left:.4f} px"),
            (axis_row[2], result.error, f"remaining, one grid image: {result.left[-1]:.5f} px"),
        ):
            length = np.hypot(error[..., 0], error[..., 1])
            top = float(np.percentile(length, 99.5))
            picture = axis.imshow(length, vmin=0, vmax=top, cmap="viridis")
            step = 120
            rows, columns = np.mgrid[60 : error.shape[0] : step, 80 : error.shape[1] : step]
            arrows = error[rows, columns]
            axis.quiver(
                columns, rows, arrows[..., 0], arrows[..., 1], color="w", angles="xy", scale_units="xy",
                scale=max(float(np.abs(arrows).max()), 1e-9) / step,
            )  # fmt: skip
            axis.set_title(title, fontsize=10)
            axis.set_xticks([])
            axis.set_yticks([])
            figure.colorbar(picture, ax=axis, shrink=0.8, label="px")
        axis = axis_row[3]
        found = result.measurement
        axis.semilogy(found.orders, found.cross_validation, "o-", label="left-out points (cross-validation)")
        if result.by_order:
            axis.semilogy(list(result.by_order), list(result.by_order.values()), "s--", label="truth, all pixels")
        axis.axvline(found.order, color="k", lw=0.8)
        axis.set_xlabel("order of the polynomials")
        axis.set_ylabel("error [px]")
        axis.set_title(f"selected order {found.order}", fontsize=10)
        axis.legend(fontsize=8)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def write_page(
    results: dict[str, LensResult],
    by_pitch: list[tuple[float, float, float]],
    with_few_lines: list[str],
    by_turning: list[str],
) -> None:
    """Write the page and its picture."""
    draw(results, PAGE.with_suffix(".png"))
    introduction = """
    This page shows the distortion that remains after a measurement with one image of a grid, beside OpenCV's
    calibration. It is written by `python benchmarks/distortion.py` (`--times` updates only the times)."""
    conditions = f"""
    *Virtual rig, 1280x960 px, 8 bits, read noise 1 grey level, shot noise 0.02 per grey level, lines of {PITCH_MM} mm
    pitch (8 px) turned by 2 degrees on a surface of reflectance 0.7, projector displaced by 1.5 mm, camera tilted by
    0.2 degree. Brown lens: k1 -0.3, k2 1, p1 2e-4, p2 -3e-4. Irregular lens: k1 -0.3 and a Gaussian bump of 154 px with
    0.64 px in x and -0.38 px in y. OpenCV: {VIEWS} chessboards of {BOARD[0]} x {BOARD[1]} corners in poses up to 20
    degrees through the same lens, with the same noise, corners by `findChessboardCornersSB`, in the same run:*"""
    below = """
    Arrows and colours have a different scale in each picture. The cross-validation contains the scatter of the left-out
    points; the error against the ground truth does not."""
    predicted = """
    The prediction contains the eight terms that a homography removes, so that the remaining distortion is
    slightly smaller."""
    few = f"""
    *The same field on {SMALL[0]} x {SMALL[1]} px, Brown lens, mean of 8 frames, lines blurred by {SMALL_BLUR} px:*"""
    aliases = """
    Aliased harmonics vary more slowly on a small image, so that the polynomials follow them. A larger angle of the grid
    increases their frequency; the warning states the required angle."""
    place = f"""
    One image of the grid cannot separate a tilted camera from a decentred lens. Two more images on the plane, tilted by
    {" and ".join(f"{degrees:+g}" for degrees in TURNED)} degree, can."""
    place_conditions = """
    *One frame for each image; the rotation axis is displaced by 1 mm:*"""
    lines = [
        "# Camera distortion: measured figures",
        "",
        *_paragraph(introduction),
        "",
        "## Remaining distortion",
        "",
        *_paragraph(conditions),
        "",
        *table(results),
        "",
        "![Distortion before and after, and the choice of the order](distortion.png)",
        "",
        *_paragraph(below),
        "",
        "## Pitch of the grid",
        "",
        "*Brown lens:*",
        "",
        "| pitch [mm] | pitch [px] | remaining [px] | predicted from the scatter [px] |",
        "|---:|---:|---:|---:|",
        *(f"| {pitch:g} | {pitch / 0.05:g} | {left:.5f} | {sigma:.5f} |" for pitch, left, sigma in by_pitch),
        "",
        *_paragraph(predicted),
        "",
        "## Small images",
        "",
        *_paragraph(few),
        "",
        "| period [px] (lines along the shorter side) | "
        + " | ".join(f"turned by {turn:g} degree: remaining (predicted) [px]" for turn in SMALL_TURNS)
        + " |",
        "|---:|" + "---:|" * len(SMALL_TURNS),
        *with_few_lines,
        "",
        *_paragraph(aliases),
        "",
        "## Position of the camera",
        "",
        *_paragraph(place),
        "",
        *_paragraph(place_conditions),
        "",
        "| lens | error of the foot [µm] | part of a motion along z in x, y [%] | error of the distance [µm] |",
        "|---|---:|---:|---:|",
        *by_turning,
        "",
    ]
    PAGE.write_text("\n".join(lines), encoding="utf-8")


def _paragraph(text: str) -> list[str]:
    return textwrap.wrap(" ".join(text.split()), 120)


def renew_times() -> None:
    """Measure only the times and update them in the page."""
    cells = []
    for lens in LENSES:
        image, times = grid_image(twin_with(lens), 10), []
        for _ in range(FRAMES):
            begin = time.perf_counter()
            measure_distortion(image, pitch=1e-3 * PITCH_MM)
            times.append(time.perf_counter() - begin)
        cells.append(f"{min(times):.1f}")
    row = f"| {TIME_ROW} | {' | '.join(cells)} |"
    print(row)
    PAGE.write_text(
        re.sub(rf"^\| {re.escape(TIME_ROW)} .*$", row, PAGE.read_text("utf-8"), flags=re.MULTILINE), "utf-8"
    )


def main() -> None:
    """Measure, print the table, write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one frame and few boards; the page is not written")
    parser.add_argument("--times", action="store_true", help="measure only the times and update them in the page")
    options = parser.parse_args()
    if options.times:
        renew_times()
        return
    if options.quick:
        print("\n".join(table({lens: study(lens, 1, 4, ()) for lens in LENSES})))
        return
    results = {lens: study(lens, FRAMES, VIEWS, (1, 3, 5, 7, 9, 11, 13, 15, 17, 18)) for lens in LENSES}
    by_pitch = pitches()
    print("\n".join(table(results)))
    with_few_lines, by_turning = small(), turned()
    print("\n".join([*with_few_lines, *by_turning]))
    write_page(results, by_pitch, with_few_lines, by_turning)
    print(f"page: {PAGE}")


if __name__ == "__main__":
    main()
