"""Plan of a rig as text: lengths, uncertainties, recommendations and warnings."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from fringedic.planning.motion_limit import MotionLimit, motion_limit
from fringedic.planning.plan import NoiseSource, Plan
from fringedic.planning.plan_warnings import PlanProblem, PlanWarning, depth_of_field, fringe_period, projector_pixel
from fringedic.planning.planned_patch import QUANTITIES
from fringedic.planning.planned_rig import PlannedRig
from fringedic.settings.experiment import MOVING_ONE_WAY, SequenceSettings
from fringedic.wording.numbers import number_text

NOTE = (
    "Standard uncertainties (1 sigma) of the camera's noise in one measurement. They do not contain the calibration, "
    "vibration, light that changes with a turning surface, or displacement waves shorter than the resolution."
)
_SOURCES = {
    NoiseSource.PHASE_PHOTON: "photon noise of the fringes",
    NoiseSource.PHASE_READ: "read noise of the fringes",
    NoiseSource.TEXTURE_PHOTON: "photon noise of the texture",
    NoiseSource.TEXTURE_READ: "read noise of the texture",
}


def plan_text(plan: Plan) -> str:
    """Return a plan as text: lengths, a table of uncertainties, recommendations and warnings."""
    lines = [f"  {name:34s} {value}" for name, value in length_rows(plan)]
    heads = ("", "centre", "field (RMS)", "largest source", "reduced most by")
    table = [f"  {a:6s} {b:>14s} {c:>14s}  {d:34s} {e}" for a, b, c, d, e in (heads, *uncertainty_rows(plan))]
    parts = ["Lengths", *lines, "\nStandard uncertainties", *table, f"  {NOTE}"]
    parts += ["\nRecommended", *(f"  - {each}" for each in recommendation_sentences(plan))]
    if plan.warnings:
        parts += ["\nBefore buying", *(f"  - {plan_warning_sentence(each)}" for each in plan.warnings)]
    return "\n".join(parts)


def length_rows(plan: Plan) -> list[tuple[str, str]]:
    """Return names and values of the lengths of a plan."""
    planned, rig = plan.planned, plan.planned.model
    pixel, gauge = rig.pixel_size, planned.dic.window + planned.coupling.strain_window_px
    depth, finest = depth_of_field(planned), planned.layout.pitches[-1]
    field = f"{1e3 * pixel * rig.camera_width:.1f} x {1e3 * pixel * rig.camera_height:.1f} mm"
    rows = [
        ("field of view", field),
        ("camera pixel on the surface", f"{1e6 * pixel:.1f} µm"),
        ("projector pixel on the surface", f"{1e6 * projector_pixel(planned):.1f} µm"),
        ("angle of the projector", f"{math.degrees(plan.angle):.1f} degree"),
        ("finest fringes", f"{finest:g} projector px, {fringe_period(planned):.1f} camera px"),
        ("frames of a step", f"{len(planned.patterns)}"),
        (
            "mean level, modulation",
            f"{plan.centre.level:.0f}, {plan.centre.modulation:.0f} of {planned.full_scale:.0f}",
        ),
        ("speckle", f"{1e-6 * planned.configuration.texture.feature_um / pixel:.1f} px"),
        ("resolution of the displacement", f"{plan.resolution:.0f} px, {1e3 * pixel * plan.resolution:.2f} mm"),
        ("virtual strain gauge", f"{gauge} px, {1e3 * pixel * gauge:.2f} mm"),
        ("phase, in-plane displacement", f"{plan.centre.phase:.4f} rad, {max(plan.centre.in_plane):.4f} px"),
    ]
    if planned.layout.code == 0:  # a Gray code is refused for a surface in motion
        rows.append(("fastest motion without a hold", _motion_text(motion_limit(planned))))
    if math.isfinite(depth):
        rows.append(("depth of field of the camera", f"{1e3 * depth:.1f} mm"))
    return rows


def _motion_text(limit: MotionLimit) -> str:
    frames = f"{limit.per_frame:.2f} px from frame to frame across the fringes, condition {limit.condition:.1f}"
    if math.isnan(limit.speed):
        return frames
    return (
        f"{number_text(1e3 * limit.speed, 3)} mm/s: {frames}, {limit.frame_rate:.0f} frames/s, "
        f"{100 * limit.contrast:.0f} % of the modulation left"
    )


def uncertainty_rows(plan: Plan) -> list[tuple[str, str, str, str, str]]:
    """Return (quantity, at the centre, over the field, largest source, change that reduces it most)."""
    rows = []
    for name in QUANTITIES:
        source, share = plan.dominant(name)
        change, factor = plan.best_change(name)
        rows.append(
            (
                name,
                _value(name, plan.centre.sigma[name]),
                _value(name, plan.field.sigma[name]),
                f"{_SOURCES[source]}, {100 * share:.0f} %" if math.isfinite(share) else "not computed",
                f"{change.value}: x {factor:.2f}" if math.isfinite(factor) else "",
            )
        )
    return rows


def change_rows(plan: Plan) -> list[tuple[str, list[str]]]:
    """Return each possible change of the rig with the factors of all uncertainties."""
    return [(change.value, [f"{each[name]:.2f}" for name in QUANTITIES]) for change, each in plan.changes.items()]


def recommendation_sentences(plan: Plan) -> list[str]:
    """Return the recommended direction of the fringes and angle, with their effect on z, and what allows more speed."""
    best, planned = plan.recommended_orientation, plan.planned.orientation
    words = f"{best.name.lower()} fringes"
    if best != planned:
        words += (
            f" (sequence.orientation: {best.name.lower()}): the noise of z becomes {plan.directions[best]:.2g} times"
        )
    else:
        words += ", as planned: the projector stands across them"
    noise = dict(plan.angles)[plan.recommended_angle]
    angle = f"an angle of {math.degrees(plan.recommended_angle):.0f} degree: the noise of z becomes {noise:.2f} times"
    sentences = [f"{words}.", f"{angle}; the planned angle is {math.degrees(plan.angle):.0f} degree."]
    return sentences + ([faster_motion_sentence(plan.planned)] if plan.planned.layout.code == 0 else [])


def faster_motion_sentence(planned: PlannedRig) -> str:
    """Return what makes the fastest motion without a hold faster, each change alone."""
    limit = motion_limit(planned)

    def times(**changes: Any) -> float:
        other = motion_limit(replace(planned, **changes))
        return other.speed / limit.speed if math.isfinite(limit.speed) else other.per_frame / limit.per_frame

    finest = planned.layout.pitches[-1]
    ways = [f"a finest pitch of {2 * finest:g} projector px: x 2, with twice the noise of z"]
    if math.isfinite(limit.speed):
        shorter = 0.5 * planned.exposure_time
        ways.append(f"an exposure of {1e3 * shorter:.3g} ms: x {times(exposure_time=shorter):.2f}")
    if planned.sequence.fastest_motion < MOVING_ONE_WAY:
        one_way = SequenceSettings(motion_fringes=[0.0, MOVING_ONE_WAY])
        ways.append(
            f"sequence.motion_fringes [0, {MOVING_ONE_WAY}] or [-{MOVING_ONE_WAY}, 0] where the direction is known: "
            f"x {times(sequence=one_way):.2f}"
        )
    return f"for a faster motion across the fringes without a hold: {'; '.join(ways)}."


def plan_warning_sentence(warning: PlanWarning) -> str:
    """Return the sentence of one warning."""
    return _SENTENCES[warning.problem](warning.value, warning.limit)


def _value(name: str, sigma: float) -> str:
    if not math.isfinite(sigma):
        return "-"
    return f"{number_text(1e6 * sigma, 3)} µstrain" if name.startswith("e_") else f"{number_text(1e6 * sigma, 3)} µm"


_SENTENCES: dict[PlanProblem, Callable[[float, float], str]] = {
    PlanProblem.CAMERA_DEPTH: lambda value, limit: (
        f"the camera's depth of field is {1e3 * value:.1f} mm, the surface is {1e3 * limit:.1f} mm deep: close the "
        "aperture, or move the camera back"
    ),
    PlanProblem.PROJECTOR_DEPTH: lambda value, _: (
        f"the projector is out of focus at the edges: fringes keep {100 * value:.0f} % of their modulation there; use "
        "a coarser pitch, a smaller angle or a smaller lens opening"
    ),
    PlanProblem.FRINGE_CAMERA: lambda value, limit: (
        f"the finest fringes have a period of {value:.1f} camera pixels, at least {limit:g} are needed: use a coarser "
        "pitch"
    ),
    PlanProblem.FRINGE_PROJECTOR: lambda value, limit: (
        f"a pitch of {value:g} projector pixels loses its modulation in most projector lenses: use {limit:g} or more"
    ),
    PlanProblem.SMALL_SPECKLES: lambda value, limit: (
        f"speckles of {value:.1f} px alias: make them {limit:g} px or larger, or go closer"
    ),
    PlanProblem.LARGE_SPECKLES: lambda value, limit: (
        f"speckles of {value:.1f} px waste resolution: up to {limit:g} px are good"
    ),
    PlanProblem.PROJECTOR_PIXELS: lambda value, limit: (
        f"a projector pixel covers {value:.1f} camera pixels and a speckle {limit:.1f}: the grid of the projector's "
        "pixels may be taken for texture; use a smaller image of the projector"
    ),
    PlanProblem.FEW_SPECKLES: lambda value, limit: (
        f"a displacement window of {value:.0f} px holds few speckles: errors of u, v and strain are up to a third "
        f"larger than predicted; use {math.ceil(limit)} px, or smaller speckles"
    ),
    PlanProblem.PIXEL_RIPPLE: lambda value, limit: (
        f"the pixels of a projector as sharp as this change the phase by {value:.2g} rad along with the fringes, and "
        f"more than {limit:.2g} rad shows in w: focus it slightly beside the surface, or use a coarser pitch"
    ),
    PlanProblem.SHADOW: lambda value, limit: (
        f"angle and steepest slope add to {math.degrees(value):.0f} degree; above {math.degrees(limit):.0f} degree "
        "slopes that face away lie in shadow: reduce the angle"
    ),
    PlanProblem.FIELD: lambda value, _: (
        f"the projector lights {100 * value:.0f} % of the camera's field: move it back, turn it, or use a shorter throw"
    ),
    PlanProblem.ORDERS: lambda value, _: (
        f"fringe order and modulation are certain on {100 * value:.1f} % of the surface: use more shifts, more light "
        "or smaller ratios of the pitches"
    ),
}
