"""Whether a calibration belongs to the rig that it is used with, and whether its lengths fit each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fringedic.errors import CalibrationError, ErrorCode, PatternError
from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic.phase.layout import nearly_alike, unambiguous_range
from fringedic.rig.geometry import UNKNOWN_FIRST, RigGeometry
from fringedic.wording.numbers import number_text

if TYPE_CHECKING:
    import xarray as xr

# Half width of the view over its distance: 0.2 to 120 degree of view. The limits differ by a factor of 1000, so that a
# length in m or µm instead of mm is outside for every lens between them.
_NARROWEST, _WIDEST = 1.75e-3, 1.75
_FARTHER = 30.0  # times the distance of the camera, or as much nearer: farther than any rig, nearer than another unit
LARGEST_HEIGHT = 0.5  # of the camera's distance: surfaces are calibrated up to about a tenth of it
_SAMPLED = 8  # [px]; a surface is judged by its median, which needs no more points
_LINES = 257  # rows and columns of the grid of pixels on which the visible part of the projector is found


@dataclass(frozen=True)
class RigSetup:
    """The parts of a rig that a calibration has to fit, as far as they are known.

    Attributes
    ----------
    camera_size, projector_size
        (width, height) of their images [px]; None when unknown.
    camera_first
        (column, row) of the sensor with which the camera's image begins [px]; -1 when unknown.
    patterns
        Patterns of a step whose phase has to be absolute; empty when unknown.
    sensor
        Name of the camera with its projector; None when unknown.
    """

    camera_size: tuple[int, int] | None = None
    projector_size: tuple[int, int] | None = None
    patterns: Sequence[ProjectedPattern] = ()
    camera_first: tuple[int, int] = UNKNOWN_FIRST
    sensor: str | None = None


def check_calibration(calibration: RigGeometry, setup: RigSetup) -> None:
    """Refuse a calibration that belongs to another rig, or a sequence whose phase would be ambiguous in its view.

    Parameters
    ----------
    calibration
        The model of the rig.
    setup
        The rig that it is to be used with.

    Raises
    ------
    CalibrationError
        With the code OTHER_RIG: it is that of another sensor; camera or projector have another size; the image begins
        elsewhere on the sensor; its lengths contradict each other, as those in different units do; the projector does
        not light the camera's view.
    PatternError
        With the code INVALID_SEQUENCE: the coarsest fringes repeat in the view, so that fringe orders would be wrong.
    """
    if setup.sensor not in (None, calibration.sensor):
        raise _other_rig(
            f"{_name(calibration)} is that of the sensor '{calibration.sensor}', this is the sensor '{setup.sensor}': "
            f"use the calibration of '{setup.sensor}', or calibrate it"
        )
    if setup.camera_size is not None:
        check_camera(calibration, setup.camera_size)
    known_first = (calibration.camera_first_column, calibration.camera_first_row)
    if known_first != setup.camera_first and min(*known_first, *setup.camera_first) >= 0:
        raise _other_rig(
            f"{_name(calibration)} is that of images which begin at (column, row) {known_first} of the sensor, those "
            f"of this camera begin at {setup.camera_first}: use the region of the calibration, or calibrate again"
        )
    if setup.projector_size is not None:
        known = (calibration.projector_width, calibration.projector_height)
        _check_size(calibration, "projector", known, setup.projector_size)
    _check_lengths(calibration)
    if math.isnan(needed_pitch(calibration)):
        raise _other_rig(
            f"{_name(calibration)}: its projector does not light the reference plane in the camera's view: use the "
            "calibration of this rig, or check position, angles and focal length of the projector"
        )
    _check_coarsest(calibration, setup.patterns)


def check_camera(calibration: RigGeometry, size: tuple[int, int]) -> None:
    """Refuse the calibration of a camera with another image.

    Parameters
    ----------
    calibration
        The model of the rig.
    size
        (width, height) of the images [px].

    Raises
    ------
    CalibrationError
        With the code OTHER_RIG: the calibrated camera has another size.
    """
    _check_size(calibration, "camera", (calibration.camera_width, calibration.camera_height), size)


def needed_pitch(calibration: RigGeometry, orientation: Orientation = Orientation.VERTICAL) -> float:
    """Return the smallest pitch whose single fringe covers the visible part of the projector's image [projector px].

    Parameters
    ----------
    calibration
        The model of the rig.
    orientation
        Direction of the fringes.

    Returns
    -------
    float
        Twice the distance from the middle of the projector's image to the farthest line that the camera sees on the
        reference plane; NaN when it sees none.
    """
    columns, rows = np.meshgrid(
        np.linspace(0, calibration.camera_width - 1, _LINES), np.linspace(0, calibration.camera_height - 1, _LINES)
    )
    if calibration.camera_distortion is not None:
        columns, rows = calibration.camera_distortion.ideal(columns, rows)
    rays = np.stack([columns, rows, np.ones(columns.shape)], axis=-1) @ calibration.ray_matrix.T
    x, y = (-calibration.camera_distance * rays[..., each] / rays[..., 2] for each in (0, 1))
    # at a pitch of 2 pi the phase is the distance from the middle of the projector's image [px]
    across, up = (calibration.phase(x, y, 0.0, 2 * math.pi, each) for each in Orientation)
    half_width, half_height = calibration.projector_width / 2, calibration.projector_height / 2
    beside = 1 + 2 / _LINES  # the edge of the light may lie between two lines of the grid
    lit = (np.abs(across) <= half_width * beside) & (np.abs(up) <= half_height * beside)
    vertical = orientation == Orientation.VERTICAL
    seen, half = (across, half_width) if vertical else (up, half_height)
    return 2 * min(float(np.abs(seen[lit]).max()), half) if lit.any() else math.nan


def check_heights(surface: xr.Dataset, calibration: RigGeometry) -> None:
    """Refuse a calibration with which a surface lies outside the measured volume.

    Parameters
    ----------
    surface
        ``z`` [m] of `RigModel.reconstruct`, NaN where not measured.
    calibration
        The model that it was reconstructed with.

    Raises
    ------
    CalibrationError
        With the code OTHER_RIG: most points are farther from the reference plane than half the camera's distance.
    """
    heights = surface.z.values[::_SAMPLED, ::_SAMPLED]
    measured = heights[np.isfinite(heights)]
    height = float(np.median(measured)) if measured.size else 0.0
    if abs(height) > LARGEST_HEIGHT * calibration.camera_distance:
        raise _other_rig(
            f"{_name(calibration)} places the surface at z = {number_text(1e3 * height)} mm, its camera is at "
            f"{number_text(1e3 * calibration.camera_distance)} mm: use the calibration of this rig, and check its units"
        )


def _other_rig(message: str) -> CalibrationError:
    return CalibrationError(message, code=ErrorCode.OTHER_RIG)


def _name(calibration: RigGeometry) -> str:
    return f"calibration '{calibration.identifier}'" if calibration.identifier else "calibration"


def _check_size(calibration: RigGeometry, part: str, known: tuple[int, int], size: tuple[int, int]) -> None:
    if known != tuple(size):
        raise _other_rig(
            f"{_name(calibration)} is that of a {part} of {known[0]} x {known[1]} px, this {part} has "
            f"{size[0]} x {size[1]} px: use the calibration of this rig, or calibrate it"
        )


def _check_lengths(calibration: RigGeometry) -> None:
    size = calibration.pixel_size * calibration.camera_width / calibration.pixel_aspect
    view = size / (2 * calibration.camera_distance)
    if not _NARROWEST <= view <= _WIDEST:
        raise _other_rig(
            f"{_name(calibration)}: a pixel_size of {number_text(1e3 * calibration.pixel_size)} mm makes a view of "
            f"{number_text(1e3 * size)} mm, {math.degrees(2 * math.atan(view)):.3g} degree at the camera_distance of "
            f"{number_text(1e3 * calibration.camera_distance)} mm: check the units of both"
        )
    away = float(np.linalg.norm(calibration.projector_position))
    if not 1 / _FARTHER <= away / calibration.camera_distance <= _FARTHER:
        raise _other_rig(
            f"{_name(calibration)}: the projector is {number_text(1e3 * away)} mm away from the origin, the camera "
            f"{number_text(1e3 * calibration.camera_distance)} mm: check the units of both"
        )


def _check_coarsest(calibration: RigGeometry, patterns: Sequence[ProjectedPattern]) -> None:
    fringes = [each for each in patterns if each.kind == PatternKind.FRINGES]
    has_code = any(each.kind == PatternKind.GRAY_CODE for each in patterns)
    if len(fringes) < 2 or has_code:  # one image gives a relative phase, a code numbers all fringes
        return
    pitches = sorted({each.pitch for each in fringes})
    covered = unambiguous_range(pitches)
    needed = needed_pitch(calibration, fringes[0].orientation)
    if covered < needed:
        what = "beats" if nearly_alike(pitches) else "coarsest fringes"
        raise PatternError(
            f"the {what} of {covered:g} px repeat in the camera's view, their order would be unknown: show "
            f"a coarsest pitch of at least {math.ceil(needed)} px, or a Gray code",
            code=ErrorCode.INVALID_SEQUENCE,
        )
