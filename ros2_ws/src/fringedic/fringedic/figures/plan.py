"""Figures of a planned rig: side view, fields of view on the surface, noise of z over the angle."""

from __future__ import annotations

import math

import numpy as np

from fringedic.figures.calibration import draw_geometry
from fringedic.patterns.pattern import Orientation
from fringedic.planning.plan import Plan
from fringedic.planning.plan_warnings import depth_of_field
from fringedic.wording.optional_packages import optional_import

with optional_import("figures"):
    from matplotlib.figure import Figure
    from matplotlib.patches import Polygon

_CAMERA, _PROJECTOR, _GREY = "#1f5fa8", "#c25e00", "#777777"


def draw_side_view(plan: Plan) -> Figure:
    """Draw camera, projector and reference plane from the side, to scale, with lengths, angle and depth of field."""
    rig = plan.planned.model
    across = (
        Orientation.VERTICAL
        if abs(rig.projector_position[0]) >= abs(rig.projector_position[1])
        else Orientation.HORIZONTAL
    )
    figure = draw_geometry(rig, (), across)
    axes = figure.axes[0]
    depth = depth_of_field(plan.planned)
    known = math.isfinite(depth)
    if known:
        axes.axhspan(-0.5e3 * depth, 0.5e3 * depth, color=_CAMERA, alpha=0.15, lw=0)
    words = f"angle {math.degrees(plan.angle):.1f}°" + (
        f", depth of field of the camera {1e3 * depth:.3g} mm" if known else ""
    )
    axes.set_title(words, fontsize=9)
    return figure


def draw_fields(plan: Plan) -> Figure:
    """Draw the fields of camera and projector on the reference plane [mm], and the noise of z over the angle."""
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    fields, angles = figure.subplots(1, 2)
    rig = plan.planned.model
    columns, rows = np.array([0, 1, 1, 0]) * (rig.camera_width - 1), np.array([0, 0, 1, 1]) * (rig.camera_height - 1)
    camera = 1e3 * plan.planned.points(columns.astype(float), rows.astype(float))[:2].T
    rig = plan.planned.model
    m = np.array([-1, 1, 1, -1]) * 0.5 * rig.projector_width / rig.projector_focal_length
    n = np.array([-1, -1, 1, 1]) * 0.5 * rig.projector_height / rig.projector_focal_length
    directions = np.stack([m, n, -np.ones(4)], axis=1) @ rig.projector_axes.T
    position = np.array(rig.projector_position)
    points: np.ndarray = position + directions * (-position[2] / directions[:, 2:])
    projector = 1e3 * points[:, :2]
    for corners, colour, name in ((projector, _PROJECTOR, "projector"), (camera, _CAMERA, "camera")):
        fields.add_patch(Polygon(corners, closed=True, facecolor=colour, alpha=0.15))
        fields.add_patch(Polygon(corners, closed=True, fill=False, edgecolor=colour, lw=1.5, label=name))
    width, height = np.ptp(camera, axis=0)
    fields.set_title(f"fields on the surface; camera {width:.1f} mm × {height:.1f} mm", fontsize=10)
    fields.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    fields.autoscale_view()
    fields.legend(fontsize=8, loc="upper right")
    fields.grid(alpha=0.3)
    angle, noise = np.array(plan.angles).T
    scale = 1e6 * plan.field.sigma["z"]
    angles.plot(np.degrees(angle), scale * noise, color=_GREY)
    angles.plot(
        math.degrees(plan.angle), scale, "o", color=_PROJECTOR, label=f"planned: {math.degrees(plan.angle):.0f}°"
    )
    recommended = math.degrees(plan.recommended_angle)
    angles.axvline(recommended, color=_CAMERA, ls="--", lw=1, label=f"recommended: {recommended:.0f}°")
    angles.set(xlabel="angle of the projector [degree]", ylabel="standard uncertainty of z [µm]")
    angles.set_ylim(bottom=0, top=1.05 * scale * min(noise.max(), 3.0))
    angles.grid(alpha=0.3)
    angles.legend(fontsize=8, loc="upper right")
    return figure
