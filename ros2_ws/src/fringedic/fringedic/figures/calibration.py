"""Figures of a calibration: the rig with its lengths, residuals of each plane, correlations, uncertainty, lens."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fringedic.calibration.check import RigCheck
from fringedic.calibration.result import RigCalibration
from fringedic.errors import CalibrationError
from fringedic.patterns.pattern import Orientation
from fringedic.rig.model import RigModel
from fringedic.rig.uncertainty import position_errors
from fringedic.wording.numbers import number_text
from fringedic.wording.optional_packages import optional_import

with optional_import("figures"):
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Arc, FancyArrowPatch, Rectangle
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

_CAMERA, _PROJECTOR, _PLANE, _GREY = "#1f5fa8", "#c25e00", "#222222", "#777777"
_PER_LINE = 4  # residual maps
_RANGE = 4.0  # standard deviations of a block; the colours cover these, or the values if they are larger


def draw_geometry(
    rig: RigModel,
    angles: Sequence[float],
    orientation: Orientation = Orientation.VERTICAL,
    numbers: bool = True,
) -> Figure:
    """Draw camera, projector and tilted planes in the plane of the rig, to scale.

    Parameters
    ----------
    rig
        The calibrated rig.
    angles
        Of the planes [rad].
    orientation
        Direction of the fringes: for vertical fringes the figure shows x and z, for horizontal ones y and z.
    numbers
        Write the measured lengths; otherwise their symbols only.
    """
    vertical = orientation == Orientation.VERTICAL
    h0, hp = 1e3 * rig.camera_distance, 1e3 * rig.projector_position[2]
    d = 1e3 * rig.projector_position[0 if vertical else 1]
    width = rig.camera_width / rig.pixel_aspect if vertical else rig.camera_height
    half = 0.5e3 * rig.pixel_size * width
    figure = Figure(figsize=(7.2, 5.6), layout="constrained")
    axes = figure.add_subplot()
    axes.set_aspect("equal")
    axes.axis("off")
    reach = 1.35 * half
    axes.plot([-reach, reach], [0, 0], color=_PLANE, lw=2.5, solid_capstyle="butt")
    for angle in angles:
        if abs(angle) > 1e-9:
            c, s = reach * math.cos(angle), reach * math.sin(angle)
            axes.plot([-c, c], [-s, s], color=_PLANE, lw=0.7, alpha=0.5)
    largest = max(angles, key=abs, default=0.0)
    if largest:
        turned = math.degrees(abs(largest))
        axes.add_patch(Arc((0, 0), 2.3 * half, 2.3 * half, theta1=0, theta2=turned, color=_GREY, lw=1))
        # below the plane, where no light crosses the text
        axes.text(reach, -0.03 * h0, "angle > 0 raises\nthis side", fontsize=8, color=_GREY, va="top")
    for side in (-half, half):
        axes.plot([0, side], [h0, 0], color=_CAMERA, lw=0.8, alpha=0.7)
    across = rig.projector_width if vertical else rig.projector_height
    place = (d, hp)
    half_angle = math.atan(0.5 * across / rig.projector_focal_length)
    forward = -rig.projector_axes[:, 2]
    direction = math.atan2(forward[2], forward[0 if vertical else 1])
    for side in (-half_angle, half_angle):
        slope = direction + side
        length = -place[1] / math.sin(slope)
        axes.plot(
            [place[0], place[0] + length * math.cos(slope)], [place[1], 0], color=_PROJECTOR, lw=0.8, alpha=0.7
        )  # fmt: skip
    aim = (place[0] + math.cos(direction), place[1] + math.sin(direction))
    _device(axes, place, aim, 0.09 * 1e3 * rig.camera_distance, _PROJECTOR, "projector")
    _device(axes, (0.0, h0), (0.0, 0.0), 0.09 * h0, _CAMERA, "camera")
    towards, sides = math.copysign(1.0, d), ("right", "left") if d > 0 else ("left", "right")
    beside, gap = -1.15 * towards * reach, 0.03 * towards * h0
    _measure(axes, (beside, 0), (beside, h0), _text("h0", h0, "mm", numbers), (beside - gap, 0.5 * h0), sides[0])
    _measure(axes, (d, 0), (d, hp), _text("hp", hp, "mm", numbers), (d + gap, 0.5 * hp), sides[1])
    level = max(h0, hp) * 1.13
    _measure(axes, (0, level), (d, level), _text("d", d, "mm", numbers), (0.5 * d, level * 1.015), "center")
    for line in (([0, 0], [h0, level * 1.02]), ([0, beside], [h0, h0]), ([0, beside], [0, 0])):
        axes.plot(*line, color=_GREY, lw=0.5, ls=":")
    axes.plot([d, d], [hp, level * 1.02], color=_GREY, lw=0.5, ls=":")
    name = "x" if vertical else "y"
    for tip in ((0.55 * half, 0.0), (0.0, 0.16 * h0)):
        axes.add_patch(FancyArrowPatch((0, 0), tip, arrowstyle="-|>", mutation_scale=10, color="black", lw=1))
    axes.text(0.57 * half, -0.045 * h0, name, fontsize=9)
    axes.text(0.012 * h0, 0.15 * h0, "z", fontsize=9)
    axes.text(
        0.3 * half,
        -0.03 * h0 - reach * math.sin(abs(largest)),
        f"reference plane z = 0,\n{2 * half:.1f} mm in view" if numbers else "reference plane z = 0",
        fontsize=8,
        color=_PLANE,
        ha="right",
        va="top",
    )
    axes.margins(0.06)
    return figure


def _device(
    axes: Axes, place: tuple[float, float], aim: tuple[float, float], size: float, colour: str, name: str
) -> None:
    """Draw a box behind a pin-hole."""
    angle = math.degrees(math.atan2(aim[1] - place[1], aim[0] - place[0]))
    box = Rectangle(
        (place[0] - size, place[1] - 0.5 * size),
        size,
        size,
        angle=angle,
        rotation_point=place,
        facecolor=colour,
        alpha=0.85,
    )
    axes.add_patch(box)
    axes.plot(*place, "o", color="white", ms=4, mec=colour)
    back = math.radians(angle)
    axes.text(
        place[0] + math.copysign(0.8 * size, place[0] or -1.0) - 0.5 * size * math.cos(back),
        place[1] - 0.5 * size * math.sin(back),
        name,
        color=colour,
        fontsize=9,
        ha="left" if place[0] > 0 else "right",
        va="center",
    )


def _measure(
    axes: Axes,
    first: tuple[float, float],
    last: tuple[float, float],
    text: str,
    at: tuple[float, float],
    side: str,
) -> None:
    axes.annotate("", last, first, arrowprops={"arrowstyle": "<->", "color": _GREY, "lw": 0.9})
    axes.text(*at, text, fontsize=9, ha=side, va="bottom" if side == "center" else "center")


def _text(symbol: str, value: float, unit: str, numbers: bool) -> str:
    return f"{symbol} = {value:.2f} {unit}" if numbers else symbol


def draw_residuals(calibration: RigCalibration) -> Figure:
    """Draw the residual of the block means of every plane as heights [µm], all in one range of colours."""
    maps = 1e6 * calibration.residual_map["residual"].to_numpy()
    fitted = [i for i, plane in enumerate(calibration.planes) if plane.fitted] or list(range(len(maps)))
    limit = max(
        _RANGE * 1e6 * calibration.planes[fitted[0]].systematic_noise,
        float(np.nanpercentile(np.abs(maps[fitted]), 99)),
    )
    lines = math.ceil(len(maps) / _PER_LINE)
    figure = Figure(figsize=(10, 2.3 * lines + 0.4), layout="constrained")
    grid = np.ravel(figure.subplots(lines, min(_PER_LINE, len(maps)), squeeze=False))
    column, row = calibration.residual_map["column"].to_numpy(), calibration.residual_map["row"].to_numpy()
    shown = None
    for axes, values, plane in zip(grid, maps, calibration.planes, strict=False):
        shown = axes.imshow(
            values,
            extent=(column[0], column[-1], row[-1], row[0]),
            cmap="RdBu_r",
            vmin=-limit,
            vmax=limit,
            interpolation="nearest",
        )
        kind = "" if plane.fitted else (" - BAD" if plane.problem else " - kept out")
        axes.set_title(
            f"{plane.name.replace(' (', chr(10)).rstrip(')')}{kind}\n{number_text(1e6 * plane.systematic, 2)} µm rms",
            fontsize=8,
        )
        axes.set_xticks([])
        axes.set_yticks([])
    for axes in grid[len(maps) :]:
        axes.axis("off")
    if shown is not None:
        figure.colorbar(shown, ax=grid.tolist(), label="residual [µm]", shrink=0.8)
    return figure


def draw_flatness(check: RigCheck) -> Figure:
    """Draw the distance of the block means of a flat plate from the best plane [µm]."""
    residual = check.residual_map["residual"]
    values = 1e6 * residual.to_numpy()
    limit = max(_RANGE * 1e6 * check.flatness_noise, float(np.nanmax(np.abs(values))))
    column, row = residual["column"].to_numpy(), residual["row"].to_numpy()
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axes = figure.add_subplot()
    extent = (column[0], column[-1], row[-1], row[0])
    shown = axes.imshow(values, extent=extent, cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest")
    axes.set(xlabel="column [px]", ylabel="row [px]")
    figure.colorbar(shown, ax=axes, label="distance [µm]")
    return figure


def draw_planes(calibration: RigCalibration) -> Figure:
    """Draw the residuals of all planes beside the predicted noise."""
    figure = Figure(figsize=(7.2, 3.2), layout="constrained")
    axes = figure.add_subplot()
    place = np.arange(len(calibration.planes))
    axes.bar(place - 0.2, [1e6 * each.residual for each in calibration.planes], 0.38, label="pixel", color="#9db8d6")
    axes.plot(
        place - 0.2,
        [1e6 * each.predicted for each in calibration.planes],
        "_",
        ms=22,
        mew=2,
        color=_CAMERA,
        label="pixel, predicted noise",
    )
    axes.bar(
        place + 0.2, [1e6 * each.systematic for each in calibration.planes], 0.38, label="block mean", color="#e2b48a"
    )
    axes.plot(
        place + 0.2,
        [1e6 * each.systematic_noise for each in calibration.planes],
        "_",
        ms=22,
        mew=2,
        color=_PROJECTOR,
        label="block mean, predicted noise",
    )
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_ylim(bottom=0.5e6 * min(each.systematic for each in calibration.planes))
    labels = [
        f"{number_text(math.degrees(each.angle), sign=True)}°"
        + (f"\n{1e3 * each.height:+g} mm" if each.height else "")
        + ("" if each.fitted else "\nbad" if each.problem else "\nkept out")
        for each in calibration.planes
    ]
    axes.set_xticks(place, labels, fontsize=8)
    axes.set_ylabel("residual [µm]")
    axes.grid(axis="y", alpha=0.3)
    axes.legend(fontsize=8, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def draw_correlation(calibration: RigCalibration) -> Figure:
    """Draw the correlation matrix of the errors of the fitted parameters."""
    names = [each.title for each in calibration.parameters]
    figure = Figure(figsize=(8.4, 4.2), layout="constrained")
    axes = figure.add_subplot()
    shown = axes.imshow(calibration.correlation, cmap="RdBu_r", vmin=-1, vmax=1)
    axes.set_xticks(range(len(names)), [str(i + 1) for i in range(len(names))], fontsize=8)
    axes.set_yticks(range(len(names)), [f"{name}  {i + 1}" for i, name in enumerate(names)], fontsize=8)
    figure.colorbar(shown, ax=axes, label="correlation")
    return figure


def draw_uncertainty(calibration: RigCalibration) -> Figure:
    """Draw the standard deviation of z due to the calibration, over the image at three heights."""
    rig = calibration.model
    reach = max(abs(math.tan(plane.angle)) for plane in calibration.planes) * 0.5 * rig.camera_width * rig.pixel_size
    reach = max(reach, *(abs(plane.height) for plane in calibration.planes), 1e-3)
    column, row = np.meshgrid(np.linspace(0, rig.camera_width - 1, 60), np.linspace(0, rig.camera_height - 1, 45))
    figure = Figure(figsize=(10, 2.7), layout="constrained")
    grid = figure.subplots(1, 3)
    heights = (-reach, 0.0, reach)
    maps = [
        1e6 * np.sqrt(np.sum(position_errors(rig, column, row, z, calibration.orientation)[:, 2] ** 2, axis=0))
        for z in heights
    ]
    top = max(float(each.max()) for each in maps) or 1e-3
    for axes, z, values in zip(grid, heights, maps, strict=True):
        shown = axes.imshow(
            values, extent=(0, rig.camera_width, rig.camera_height, 0), cmap="viridis", vmin=0, vmax=top
        )
        axes.set_title(f"z = {1e3 * z:+.1f} mm", fontsize=9)
        axes.set_xticks([])
        axes.set_yticks([])
    figure.colorbar(shown, ax=grid.tolist(), label="sigma of z [µm]", shrink=0.9)
    return figure


def draw_distortion(rig: RigModel) -> Figure:
    """Draw the shift of the image by the camera's lens [px].

    Raises
    ------
    CalibrationError
        The rig has no distortion.
    """
    distortion = rig.camera_distortion
    if distortion is None:
        raise CalibrationError("the rig has no distortion to draw")
    column, row = np.meshgrid(np.linspace(0, rig.camera_width - 1, 80), np.linspace(0, rig.camera_height - 1, 60))
    ideal_column, ideal_row = distortion.ideal(column, row)
    shift = np.hypot(ideal_column - column, ideal_row - row)
    figure = Figure(figsize=(7.2, 4.4), layout="constrained")
    axes = figure.add_subplot()
    shown = axes.imshow(shift, extent=(0, rig.camera_width, rig.camera_height, 0), cmap="viridis")
    part = (slice(3, None, 6), slice(3, None, 6))
    axes.quiver(
        column[part],
        row[part],
        (ideal_column - column)[part],
        -(ideal_row - row)[part],
        color="white",
        width=0.002,
    )
    axes.set_xlabel("column [px]")
    axes.set_ylabel("row [px]")
    figure.colorbar(shown, ax=axes, label="shift by the lens [px]")
    return figure
