"""Calibration of the rig from phase maps of a plane at known angles or heights, without starting values."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Literal

import numpy as np
import xarray as xr

from fringedic.calibration.assessment import Origin, Selection, assess
from fringedic.calibration.fit import Prior, StageUncertainty
from fringedic.calibration.geometry import Camera
from fringedic.calibration.models import ModelFitter, choose_model
from fringedic.calibration.outliers import find_problems
from fringedic.calibration.placement import Placement
from fringedic.calibration.planes import CalibrationPlanes
from fringedic.calibration.result import RigCalibration
from fringedic.camera.distortion import DistortionMap
from fringedic.camera.plane_homography import PlaneHomography
from fringedic.errors import CalibrationError
from fringedic.patterns.pattern import Orientation
from fringedic.rig.geometry import current_model_name
from fringedic.wording.arguments import array, check_arguments, number, one_of, optional, several, whole
from fringedic.wording.numbers import number_text

UNKNOWN_TILT = math.radians(1.0)  # standard uncertainty of the tilt of a camera that was aligned by eye
_OUTSIDE = 0.02  # phases may reach beyond the projector's image by this part of it
_MANY = 0.01  # so many of the blocks may lie outside
_SAME_SCALE = 0.01  # relative difference of two pixel sizes that are meant to be the same


@check_arguments(
    CalibrationError,
    phases=several(array(2)),
    angles=optional(several(number())),
    pixel_size=number(),
    pitch=number(),
    projector_size=several(whole(1), length=2),
    sigma=optional(several(array(2))),
    heights=optional(several(number())),
    held_out=several(whole()),
    pixel_aspect=number(),
    principal_point=optional(several(number(), length=2)),
    sigma_angle=number(0),
    sigma_height=number(0),
    sigma_pixel_size=number(0),
    camera_distance=optional(number()),
    sigma_camera_distance=number(1e-12),
    model=optional(one_of("six_parameter", "general", "paper")),
)
def calibrate_rig(  # noqa: PLR0913 - the public function: every keyword is one thing that a user may know
    phases: Sequence[np.ndarray | xr.DataArray],
    angles: Sequence[float] | None,
    pixel_size: float,
    *,
    pitch: float,
    projector_size: tuple[int, int],
    sigma: Sequence[np.ndarray | xr.DataArray] | None = None,
    heights: Sequence[float] | None = None,
    held_out: Sequence[int] = (),
    orientation: Orientation = Orientation.VERTICAL,
    pixel_aspect: float = 1.0,
    principal_point: tuple[float, float] | None = None,
    distortion: DistortionMap | None = None,
    plane: PlaneHomography | None = None,
    sigma_angle: float = 0.0,
    sigma_height: float = 0.0,
    sigma_pixel_size: float = 0.0,
    camera_distance: float | None = None,
    sigma_camera_distance: float = 1e-3,
    model: Literal["six_parameter", "general"] | None = None,
    identifier: str = "",
    source: str = "",
    created: datetime | None = None,
) -> RigCalibration:
    """Calibrate the rig by known rotations of the reference plane (Breque 2004), known translations, or both.

    A closed form gives the six-parameter model, which is refined by least squares. The general model has a pin-hole
    projector of free direction with the distortion of its lens, and a free rotation axis; what the planes do not
    determine keeps its prior. The information criterion compares both. No starting values are needed.

    Parameters
    ----------
    phases
        Absolute phase [rad] of the plane, one image (row, column) for each position; NaN where not measured.
    angles
        Angle of each plane [rad]. A positive one raises the +x side, z = x tan(angle); with horizontal fringes the +y
        side, z = y tan(angle). The reference plane z = 0 is the plane at angle 0 and height 0. None: all 0.
    pixel_size
        gamma, length on the reference plane per row at the principal point [m], from the pitch of the grid: the one
        length that phases cannot give.
    pitch
        Fringe pitch that the phases belong to [projector px].
    projector_size
        Width and height of the projector's image [px]. Its optical axis is assumed in the middle (across the fringes),
        unless translated planes, `camera_distance` or grids on the tilted plane determine it.
    sigma
        Standard deviation of each phase map [rad]; by default estimated from the scatter of neighbouring pixels.
    heights
        Translation of each plane along z [m]; None: all 0. At least three heights, or three angles at one height.
    held_out
        Indices of planes that are kept out of the fit and test its result.
    orientation
        Direction of the fringes.
    pixel_aspect
        tau, rows over columns.
    principal_point
        Column and row of the camera's optical axis [ideal px]; by default that of `plane`, or the image's centre.
    distortion
        From pixels of the image to ideal pixels.
    plane
        Homography of a grid on the plane at angle 0 (`GridMeasurement.plane`): it gives the camera's tilt, pixel size
        and aspect. Without it tilts of about one degree are fitted. When the grid was also measured on the tilted
        plane, its ``pin_hole`` gives h0 and separates the tilt of the camera from that of its lens.
    sigma_angle, sigma_height
        Standard uncertainty of single angles [rad] and heights [m] of the stage.
    sigma_pixel_size
        Standard uncertainty of the pixel size [m].
    camera_distance, sigma_camera_distance
        h0 [m] when it was measured otherwise, and its standard uncertainty.
    model
        ``"six_parameter"`` (for comparison) or ``"general"``; None selects by the Bayesian information criterion.
    identifier, source, created
        Name of the calibration, its origin and its time; by default the present time.

    Returns
    -------
    RigCalibration
        ``model`` is the rig with the covariance of its parameters. ``go`` is False when the calibration should not be
        used; ``reason`` says why.

    Raises
    ------
    CalibrationError
        Too few planes, planes at the same position or a plane that was not moved; angles of the wrong sign or unit;
        phases that run backwards, leave the projector's image or are not measured; numbers that are not allowed.
    ImageError
        Maps of different sizes, or lists of different lengths.

    References
    ----------
    C. Breque, J.-C. Dupre, F. Bremand, "Calibration of a system of projection moire for relief measuring: biomechanical
    applications", Optics and Lasers in Engineering 41 (2004) 241-260.

    J. Molimard, G. Boyer, H. Zahouani, "Frequency-based image analysis of random patterns: an alternative way to
    classical stereocorrelation", section 3.2.

    Z. Zhang, "A flexible new technique for camera calibration", IEEE Transactions on Pattern Analysis and Machine
    Intelligence 22 (2000) 1330-1334: a homography of a plane constrains the camera.

    G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6 (1978) 461-464.

    Examples
    --------
    Exact phases of the digital twin at seven angles:

    >>> import numpy as np
    >>> import fringedic
    >>> from fringedic.virtual_rig import VirtualRig
    >>> angles = np.radians([-15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 15.0])
    >>> rig = VirtualRig.from_preset("plate", size="tiny")
    >>> optics = rig.optics()
    >>> phases = []
    >>> for angle in angles:
    ...     plane = rig.with_specimen({"kind": "reference_plane", "angle_degree": np.degrees(angle)})
    ...     phases.append(2 * np.pi * (plane.view(0.0).projector_column - (optics["projector_width"] - 1) / 2) / 10.0)
    >>> calibration = fringedic.calibrate_rig(
    ...     phases, angles, optics["pixel_size"], pitch=10.0,
    ...     projector_size=(optics["projector_width"], optics["projector_height"]),
    ...     sigma=[np.full(phases[0].shape, 0.01)] * 7,
    ... )
    >>> print(calibration.verdict)
    GO
    """
    placement = Placement.stated(len(phases), angles, heights)
    planes = CalibrationPlanes.reduce(phases, sigma, placement, held_out)
    rows, columns = np.shape(phases[0])
    camera = _known_camera(
        Camera(
            width=columns,
            height=rows,
            pixel_size=pixel_size,
            pixel_aspect=pixel_aspect,
            principal_column=(columns - 1) / 2,
            principal_row=(rows - 1) / 2,
            distortion=distortion,
            plane=plane,
            projector_width=projector_size[0],
            projector_height=projector_size[1],
            pitch=pitch,
            orientation=orientation,
        ),
        principal_point,
    )
    _check_projector(planes, camera)
    distance = None if camera_distance is None else Prior(camera_distance, sigma_camera_distance)
    priors: dict[str, Prior] = {}
    if camera.plane is None:
        priors |= {name: Prior(0.0, UNKNOWN_TILT) for name in ("camera_tilt_x", "camera_tilt_y")}
    if sigma_pixel_size > 0:
        priors["pixel_size"] = Prior(camera.pixel_size, sigma_pixel_size)
    if distance is not None:
        priors["camera_distance"] = distance
    fitter = ModelFitter(camera, planes, priors, StageUncertainty(sigma_angle, sigma_height))
    created = created or datetime.now(UTC)
    origin = Origin(identifier or f"{created:%Y-%m-%d %H:%M} UTC", source or "calibrate_rig", created)
    family = None if model is None else current_model_name(model)
    problems = find_problems(fitter, fitter.planes.fitted)
    used = tuple(index for index in fitter.planes.fitted if index not in problems)
    fits = fitter.fit_all(used)
    return assess(fitter, Selection(used, problems, fits, choose_model(fits, family)), origin)


def _known_camera(camera: Camera, principal_point: tuple[float, float] | None) -> Camera:
    """Return the camera with what the grid on the plane and the user say, checked."""
    for name in ("pixel_size", "pixel_aspect", "pitch"):
        value = getattr(camera, name)
        if not (math.isfinite(value) and value > 0):
            raise CalibrationError(f"{name} is {value}: it has to be above 0")
    size, distortion = (camera.width, camera.height), camera.distortion
    if distortion is not None and (distortion.width, distortion.height) != size:
        raise CalibrationError(
            f"the distortion belongs to an image of {distortion.width} x {distortion.height} px, the phase maps have "
            f"{size[0]} x {size[1]}"
        )
    if camera.plane is not None:
        plane = camera.plane
        if abs(plane.pixel_size / camera.pixel_size - 1) > _SAME_SCALE:
            raise CalibrationError(
                f"pixel_size is {number_text(1e6 * camera.pixel_size)} µm, the grid on the plane gives "
                f"{number_text(1e6 * plane.pixel_size)} µm: is the grid's pitch right?"
            )
        return dataclasses.replace(
            camera,
            pixel_size=plane.pixel_size,
            pixel_aspect=plane.pixel_aspect,
            principal_column=plane.principal_column,
            principal_row=plane.principal_row,
        )
    if principal_point is not None:
        return dataclasses.replace(camera, principal_column=principal_point[0], principal_row=principal_point[1])
    return camera


def _check_projector(planes: CalibrationPlanes, camera: Camera) -> None:
    """Raise an error when phases lie outside the projector's image."""
    size = camera.projector_width if camera.vertical else camera.projector_height
    outside = []
    for blocks, name in zip(planes.blocks, planes.names, strict=True):
        pixels = np.abs(blocks.phase[np.isfinite(blocks.phase)]) * camera.pitch / (2 * math.pi)
        if np.mean(pixels > size * (0.5 + _OUTSIDE)) > _MANY:
            outside.append((name, float(pixels.max())))
    if outside:
        named = "all images" if len(outside) == len(planes.blocks) else ", ".join(name for name, _ in outside)
        raise CalibrationError(
            f"{named}: the phase reaches {max(reach for _, reach in outside):.0f} projector pixels from the axis, and "
            f"the projector's image ends at {size / 2:.0f}; the pitch of {camera.pitch:g} px, the size of the "
            "projector's image or the fringe orders are wrong"
        )
