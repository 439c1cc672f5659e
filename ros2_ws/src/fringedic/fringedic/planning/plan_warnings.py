"""What to look at in a planned rig before it is bought; `fringedic.planning.sentences` composes the sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator
from enum import Enum, auto
from typing import NamedTuple

import numpy as np

from fringedic.patterns.pattern import Orientation
from fringedic.planning.planned_patch import PatchUncertainty
from fringedic.planning.planned_rig import PlannedRig, pixel_ripple
from fringedic.rig_setup.settings_warnings import LARGEST_FEATURE, SMALLEST_FEATURE
from fringedic.rig_setup.window_choice import USUAL_FEATURES
from fringedic.settings.experiment import FINEST_DEFAULT_PITCH_PX

LEAST_FRINGE = 6.0  # [camera px] three times the Nyquist limit: a pixel still passes 95 % of the modulation
LEAST_MODULATION = 0.8  # the edges of the field keep at least this part of the modulation in focus
LEAST_MEASURED = 0.999  # at least this part of the surface has certain fringe orders
MOST_RIPPLE = 0.1  # error by the projector's pixels over the noise of the phase; filters of z leave it as it is
GRAZING = math.radians(10.0)  # least angle between the light and the steepest slope
_SIDES = 21  # points along each side of the field


class PlanProblem(Enum):
    """Kinds of warnings, with the meaning of `PlanWarning.value` and `PlanWarning.limit`."""

    CAMERA_DEPTH = auto()
    """Value: depth of field of the camera; limit: range of the heights [m]."""
    PROJECTOR_DEPTH = auto()
    """Value: smallest modulation in the field over that in focus; limit: the smallest good one."""
    FRINGE_CAMERA = auto()
    """Value: period of the finest fringes; limit: the smallest good one [camera px]."""
    FRINGE_PROJECTOR = auto()
    """Value: finest pitch; limit: the smallest good one [projector px]."""
    SMALL_SPECKLES = auto()
    """Value: size of a speckle; limit: the smallest good one [camera px]."""
    LARGE_SPECKLES = auto()
    """Value: size of a speckle; limit: the largest good one [camera px]."""
    PROJECTOR_PIXELS = auto()
    """Value: size of a projector pixel on the surface; limit: size of a speckle [camera px]."""
    FEW_SPECKLES = auto()
    """Value: width of the displacement window; limit: the smallest good one [px]."""
    PIXEL_RIPPLE = auto()
    """Value: phase error by the pixels of a sharp projector; limit: the largest good one [rad]."""
    SHADOW = auto()
    """Value: angle plus steepest slope; limit: the largest good one [rad]."""
    FIELD = auto()
    """Value and limit: part of the image that the projector lights."""
    ORDERS = auto()
    """Value and limit: part of the surface with certain fringe orders and modulation."""


class PlanWarning(NamedTuple):
    """One thing to look at.

    Attributes
    ----------
    problem
        Kind of the warning.
    value, limit
        What is predicted and what it is compared with, see `PlanProblem`.
    """

    problem: PlanProblem
    value: float
    limit: float


def find_warnings(planned: PlannedRig, predicted: PatchUncertainty) -> Iterator[PlanWarning]:
    """Yield what is wrong or doubtful in a planned rig with these uncertainties."""
    plan = planned.components
    if plan is not None:
        depth = depth_of_field(planned)
        if depth < 1e-3 * plan.depth_mm:
            yield PlanWarning(PlanProblem.CAMERA_DEPTH, depth, 1e-3 * plan.depth_mm)
        points = np.concatenate([_field_points(planned, side * 0.5e-3 * plan.depth_mm) for side in (-1, 1)], axis=1)
        finest = planned.layout.pitches[-1]
        blurred = planned.modulation(finest, planned.projector_blur(points))[1].min()
        sharp = float(planned.modulation(finest, np.array(planned.configuration.projector.defocus_px))[1])
        if blurred < LEAST_MODULATION * sharp:
            yield PlanWarning(PlanProblem.PROJECTOR_DEPTH, float(blurred) / sharp, LEAST_MODULATION)
    pixel, finest = planned.model.pixel_size, planned.layout.pitches[-1]
    period, speckle = fringe_period(planned), 1e-6 * planned.configuration.texture.feature_um / pixel
    if period < LEAST_FRINGE:
        yield PlanWarning(PlanProblem.FRINGE_CAMERA, period, LEAST_FRINGE)
    if finest < FINEST_DEFAULT_PITCH_PX:
        yield PlanWarning(PlanProblem.FRINGE_PROJECTOR, finest, FINEST_DEFAULT_PITCH_PX)
    if speckle < SMALLEST_FEATURE:
        yield PlanWarning(PlanProblem.SMALL_SPECKLES, speckle, SMALLEST_FEATURE)
    if speckle > LARGEST_FEATURE:
        yield PlanWarning(PlanProblem.LARGE_SPECKLES, speckle, LARGEST_FEATURE)
    if planned.dic.window < USUAL_FEATURES * speckle:
        yield PlanWarning(PlanProblem.FEW_SPECKLES, planned.dic.window, USUAL_FEATURES * speckle)
    if projector_pixel(planned) > pixel * speckle:
        yield PlanWarning(PlanProblem.PROJECTOR_PIXELS, projector_pixel(planned) / pixel, speckle)
    slope = planned.steepest_slope
    if planned.angle + slope > math.pi / 2 - GRAZING:
        yield PlanWarning(PlanProblem.SHADOW, planned.angle + slope, math.pi / 2 - GRAZING)
    x, y = _field_points(planned)[:2]
    rig = planned.model
    # at a pitch of 2 pi the phase is the distance from the middle of the projector's image [px]
    inside = [
        np.abs(rig.phase(x, y, 0.0, 2 * math.pi, each)) <= size / 2
        for each, size in zip(Orientation, (rig.projector_width, rig.projector_height), strict=True)
    ]
    lit = float(np.mean(inside[0] & inside[1]))
    if lit < 1.0:
        yield PlanWarning(PlanProblem.FIELD, lit, 1.0)
    if predicted.measured < LEAST_MEASURED:
        yield PlanWarning(PlanProblem.ORDERS, predicted.measured, LEAST_MEASURED)
    ripple = pixel_ripple(planned.layout.pitches[-1], planned.configuration.projector.defocus_px)
    if ripple > MOST_RIPPLE * predicted.phase:
        yield PlanWarning(PlanProblem.PIXEL_RIPPLE, ripple, MOST_RIPPLE * predicted.phase)


def steepest_light(planned: PlannedRig) -> float:
    """Return the largest angle of the projector at which the steepest slope still gets light [rad]."""
    return math.pi / 2 - GRAZING - planned.steepest_slope


def depth_of_field(planned: PlannedRig) -> float:
    """Return the range of heights that the camera shows with a blur of up to one pixel [m]; infinite when unknown.

    A thin lens of magnification m blurs a point at the distance D from its focus by a disc of D m^2 / (N (1 + m)) on
    the sensor, N being its f-number.
    """
    plan = planned.components
    if plan is None:
        return math.inf
    m = plan.magnification
    return 2 * plan.f_number * 1e-6 * plan.camera_pixel_um * (1 + m) / m**2


def fringe_period(planned: PlannedRig) -> float:
    """Return the smallest period of the finest fringes in the camera's image [px]."""
    x, y = _field_points(planned)[:2]
    vertical = planned.orientation == Orientation.VERTICAL
    phase = planned.model.phase(x, y, 0.0, planned.layout.pitches[-1], planned.orientation)
    length = planned.model.camera_width if vertical else planned.model.camera_height
    step = (length - 1) / (_SIDES - 1)
    return float(2 * math.pi * step / np.abs(np.diff(phase, axis=1 if vertical else 0)).max())


def projector_pixel(planned: PlannedRig) -> float:
    """Return the size of a projector pixel on the reference plane along its short side [m]."""
    distance = float(np.linalg.norm(planned.model.projector_position))
    return distance / planned.model.projector_focal_length


def _field_points(planned: PlannedRig, height: float = 0.0) -> np.ndarray:
    """Return points (3, row, column) [m] all over the field of view, lifted by a height."""
    rig = planned.model
    columns, rows = (np.linspace(0, length - 1, _SIDES) for length in (rig.camera_width, rig.camera_height))
    points = planned.points(*np.meshgrid(columns, rows))
    points[2] += height
    return points
