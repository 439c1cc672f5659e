"""Checks of the goals that ask for a calibration, and the planes that they ask for."""

from __future__ import annotations

import math

from experiment_node.active_goal import StepFailure
from fringedic.camera.tilted_grid import SMALLEST_TURN
from fringedic_msgs.action import CalibrateDistortion, CalibrateRig
from fringedic_msgs.msg import ReferencePlane

MAXIMUM_ANGLE = math.radians(80)


def grid_angles(request: CalibrateDistortion.Goal) -> list[float]:
    """Return the angles of the grid besides 0 [rad]: none, or some on both sides of 0.

    Raises
    ------
    StepFailure
        INVALID_GOAL.
    """
    angles = list(request.angles)
    one_sided = bool(angles) and not min(angles) < -SMALLEST_TURN < SMALLEST_TURN < max(angles)
    if one_sided or not all(abs(angle) < MAXIMUM_ANGLE for angle in angles) or not 0 <= request.sigma_angle < 1:
        raise StepFailure(
            CalibrateDistortion.Result.INVALID_GOAL,
            f"angles {angles} rad, sigma_angle {request.sigma_angle:g} rad: give no angles, or some on both sides of 0 "
            "in radian",
        )
    if not 0 < request.grid_pitch < 1:
        raise StepFailure(
            CalibrateDistortion.Result.INVALID_GOAL,
            f"grid_pitch is {request.grid_pitch:g} m; give the distance of the printed lines in metre",
        )
    return angles


def plane_sequence(request: CalibrateRig.Goal) -> list[ReferencePlane]:
    """Return the planes to measure; the last one repeats the first, to measure the drift.

    Raises
    ------
    StepFailure
        INVALID_GOAL.
    """
    angles, heights = list(request.angles), list(request.heights) or [0.0] * len(request.angles)
    held_out = set(request.held_out)
    _check_planes(request, angles, heights, held_out)
    return [
        ReferencePlane(
            kind=ReferencePlane.PLANE,
            angle=angle,
            height=height,
            held_out=index in held_out or index == len(angles),
            sigma_angle=request.sigma_angle,
            sigma_height=request.sigma_height,
        )
        for index, (angle, height) in enumerate(zip([*angles, angles[0]], [*heights, heights[0]], strict=True))
    ]


def _check_planes(request: CalibrateRig.Goal, angles: list[float], heights: list[float], held_out: set[int]) -> None:
    message = ""
    if not angles or len(heights) != len(angles):
        message = f"{len(angles)} angles and {len(heights)} heights; give one of each for every plane"
    elif not all(abs(angle) < MAXIMUM_ANGLE for angle in angles) or not all(map(math.isfinite, heights)):
        message = (
            f"angles {angles} rad, heights {heights} m: give angles in radian between -1.4 and 1.4 and finite heights"
        )
    elif not held_out < set(range(len(angles))):
        message = (
            f"held_out names the planes {sorted(held_out)} of {len(angles)}; count the planes from 0 and leave one "
            "for the fit"
        )
    elif not (0 <= request.sigma_angle < 1 and 0 <= request.sigma_height < 1):
        message = (
            f"sigma_angle {request.sigma_angle:g} rad, sigma_height {request.sigma_height:g} m: give values from 0 to 1"
        )
    if message:
        raise StepFailure(CalibrateRig.Result.INVALID_GOAL, message)
