"""One calibration from its frames to its files, the same in the running system and at the desk.

The experiment node gives it what stands in front of the camera, step by step; `calibrate_recording` gives it the same
from a recording. The arithmetic is in `fringedic.camera` and `fringedic.calibration`.
"""

from __future__ import annotations

import dataclasses
import math
from datetime import datetime
from enum import IntEnum
from pathlib import Path

import numpy as np

from fringedic.calibration.calibrate import calibrate_rig
from fringedic.calibration.history import recorded_checks
from fringedic.calibration.planes import PlaneBlocks, check_different, plane_name, reduce_plane
from fringedic.calibration.result import RigCalibration
from fringedic.camera.grid import GridMeasurement, measure_distortion
from fringedic.camera.turned_grid import TurnedGrid, locate_pin_hole, measure_turned_grid
from fringedic.errors import CalibrationFileError, CalibrationStateError, InvalidCalibrationError
from fringedic.sequence import Orientation, Projection

DISTORTION_FILE = "distortion.yaml"
REPORT_FILE = "report.html"
CHECK_AFTER = 7 * 86400.0  # [s] after which temperature and hands have had time to move something
_MM, _UM = 1e3, 1e6


class PlaneKind(IntEnum):
    """What stands in front of the camera, numbered as in ``fringedic_msgs/ReferencePlane``."""

    GRID = 0
    PLANE = 1
    SPECIMEN = 2


def place_in_words(kind: int, angle: float, height: float) -> str:
    """Return what an operator shall put in front of the camera; angle [rad], height [m]."""
    if kind == PlaneKind.SPECIMEN:
        return "put the specimen back"
    degrees, lift = math.degrees(angle), _MM * height
    side = f" ({'right' if degrees > 0 else 'left'} side towards the camera)" if abs(degrees) > 1e-6 else ""
    if kind == PlaneKind.GRID and not side:
        return "lay the printed grid on the reference plane at 0 degree, turned in its plane by 1 to 3 degrees"
    if kind == PlaneKind.GRID:
        return f"turn the reference plane with the grid on it to {degrees:+.2f} degree{side}"
    lifted = f", {abs(lift):.3f} mm {'above' if lift > 0 else 'below'} its place" if abs(lift) > 1e-6 else ""
    return f"turn the plain reference plane to {degrees + 0.0:+.2f} degree{side}{lifted}"


def grid_in_words(grid: GridMeasurement) -> str:
    """Return what the grid told about the camera."""
    plane = grid.plane
    words = (
        f"The lens distorts the image by {grid.magnitude:.3f} px RMS; {grid.residual:.4f} px are left at the points of "
        f"the grid, known to {grid.sigma:.4f} px. A pixel sees {_UM * plane.pixel_size:.4f} µm of the plane."
    )
    if plane.pin_hole is not None:
        camera, sigma = plane.camera(plane.pin_hole.distance), np.sqrt(np.diag(plane.pin_hole.covariance))
        tilts = math.degrees(camera["camera_tilt_x"]), math.degrees(camera["camera_tilt_y"])
        words += (
            f" The camera stands {_MM * plane.pin_hole.distance:.2f} mm above it (known to {_MM * sigma[0]:.2g} mm), "
            f"tilted by {tilts[0]:+.3f} degree about x and {tilts[1]:+.3f} degree about y (known to "
            f"{math.degrees(sigma[1:].max() / plane.pin_hole.distance):.2g} degree)."
        )
    return " ".join([words, *map(_sentence, grid.warnings)])


def in_force_words(file: Path, now: datetime) -> list[str]:
    """Return what is to be said of a calibration before it is used: its age, the last check, and what it lacks.

    Parameters
    ----------
    file
        ``calibration.yaml`` with its companions beside it, or alone, when nothing is known about it.
    now
        The time.
    """
    try:
        calibration = RigCalibration.load(file.parent)
        checks = recorded_checks(file.parent)
    except (CalibrationFileError, InvalidCalibrationError):
        return [f"calibration {file}: nothing tells when and how well it was measured"]
    age = calibration.age(now)
    words = [f"calibration {calibration.model.identifier}, {_span_in_words(age)} old. {calibration.verdict}"]
    since = age
    if checks:
        since = (now - datetime.fromisoformat(checks[-1].created)).total_seconds()
        words.append(f"last checked {_span_in_words(since)} ago: {checks[-1].verdict}")
    if since > CHECK_AFTER:
        words.append(
            f"{'the check' if checks else 'it'} is older than {_span_in_words(CHECK_AFTER)}: `fringedic check` tells "
            "whether it still holds"
        )
    return [*words, *calibration.warnings]


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}{'' if words.endswith(('.', '?')) else '.'}"


def _span_in_words(seconds: float) -> str:
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} seconds"


@dataclasses.dataclass(frozen=True)
class Plane:
    """The measured phase of the reference plane at a known angle and height.

    Attributes
    ----------
    angle, height
        Of the plane z = height + x tan(angle) [rad, m].
    held_out
        Not used by the fit, but to test it.
    phase, sigma : (row, column)
        Absolute phase and its standard deviation [rad], NaN where not measured.
    """

    angle: float
    height: float
    held_out: bool
    phase: np.ndarray
    sigma: np.ndarray


@dataclasses.dataclass(frozen=True)
class Setting:
    """What a calibration needs to know beside the planes.

    Attributes
    ----------
    identifier
        Names the calibration in results.
    projector_size
        Width and height of the projector [px].
    finest
        The fringes that the phases belong to.
    sigma_angle, sigma_height
        Standard deviations of the stage [rad, m].
    """

    identifier: str
    projector_size: tuple[int, int]
    finest: Projection
    sigma_angle: float = 0.0
    sigma_height: float = 0.0


class CalibrationSession:
    """Collects the grid and the planes of one calibration and makes a model of the rig from them.

    Attributes
    ----------
    grid
        The camera as the printed grid told it; None as long as it was not measured.
    result
        What came of the planes; None as long as nothing did.
    drift
        How far the first plane seemed to have moved when it was measured once more at the end, RMS without the noise
        [m]; NaN when it was not.
    """

    def __init__(self) -> None:
        self.grid: GridMeasurement | None = None
        self.result: RigCalibration | None = None
        self.drift = math.nan
        self._setting: Setting | None = None
        self._turned: list[TurnedGrid] = []
        self._planes: list[Plane] = []
        self._blocks: list[PlaneBlocks] = []

    def measure_grid(self, frames: np.ndarray, grid_pitch: float) -> GridMeasurement:
        """Measure the distortion of the camera from white frames of the printed grid.

        Parameters
        ----------
        frames : (frame, row, column)
            Grey levels; their mean is used.
        grid_pitch
            Distance of the printed lines [m].

        Raises
        ------
        FringedicError
            The frames do not show a grid that can be measured; the message says why.
        """
        self.grid, self._turned = None, []
        self.grid = measure_distortion(frames.mean(axis=0, dtype=np.float64), pitch=grid_pitch)
        return self.grid

    def measure_turned_grid(self, frames: np.ndarray, angle: float) -> TurnedGrid:
        """Find the grid in white frames of the turned plane; the grid at angle 0 comes first.

        Parameters
        ----------
        frames : (frame, row, column)
            Grey levels; their mean is used.
        angle
            Of the plane [rad].

        Raises
        ------
        FringedicError
            The frames do not show the grid well enough; the message says why.
        """
        if self.grid is None:
            raise CalibrationStateError("the grid on the turned plane comes after that on the plane at 0 degree")
        self._turned.append(measure_turned_grid(frames.mean(axis=0, dtype=np.float64), self.grid, angle))
        return self._turned[-1]

    def locate_pin_hole(self, sigma_angle: float, orientation: Orientation) -> GridMeasurement:
        """Find where the camera stands from the grids on the turned plane, if there were any.

        Parameters
        ----------
        sigma_angle
            Standard deviation of the stage's single angles [rad].
        orientation
            Of the fringes, along which the stage's axis runs.

        Raises
        ------
        GridAngleError
            The plane was not turned by the angles that were said, or to one side only.
        """
        if self.grid is None:
            raise CalibrationStateError("the printed grid was not measured")
        if self._turned:
            self.grid = locate_pin_hole(self.grid, self._turned, sigma_angle=sigma_angle, orientation=orientation)
            self._turned = []
        return self.grid

    def begin(self, setting: Setting) -> None:
        """Begin to collect planes; those of an earlier calibration are forgotten.

        Raises
        ------
        CalibrationStateError
            The grid was not measured.
        """
        if self.grid is None:
            raise CalibrationStateError("the scale is not known: measure the printed grid first (calibrate_distortion)")
        self._setting = setting
        self._planes, self._blocks = [], []
        self.result, self.drift = None, math.nan

    def add_plane(self, plane: Plane) -> str:
        """Take one plane and return in words how well it was measured.

        Raises
        ------
        CalibrationPhaseError
            Too little of the image is measured.
        CalibrationPlanesError
            The plane is where it was before, although it should have been moved.
        """
        planes = [*self._planes, plane]
        angles, heights = np.array([each.angle for each in planes]), np.array([each.height for each in planes])
        blocks = reduce_plane(plane.phase, plane.sigma, plane_name(len(planes) - 1, angles, heights))
        check_different([*self._blocks, blocks], angles, heights)
        self._planes, self._blocks = planes, [*self._blocks, blocks]
        return f"{100 * blocks.valid:.0f} % of the image measured, noise {blocks.noise / (2 * math.pi):.4f} fringe"

    def calibrate(self, created: datetime) -> RigCalibration:
        """Fit the model of the rig to all planes; the verdict speaks of the drift as well.

        Parameters
        ----------
        created
            When the planes were measured.

        Raises
        ------
        CalibrationPlanesError, CalibrationAnglesError, CalibrationPhaseError
            The planes do not make a calibration; the message says what is wrong with them.
        """
        grid, setting, planes = self.grid, self._setting, self._planes
        if grid is None or setting is None:
            raise CalibrationStateError("there are no planes: begin comes first")
        fitted = calibrate_rig(
            [plane.phase for plane in planes],
            [plane.angle for plane in planes],
            grid.plane.pixel_size,
            pitch=setting.finest.pitch,
            projector_size=setting.projector_size,
            sigma=[plane.sigma for plane in planes],
            heights=[plane.height for plane in planes],
            held_out=[index for index, plane in enumerate(planes) if plane.held_out],
            orientation=setting.finest.orientation,
            distortion=grid.distortion,
            plane=grid.plane,
            sigma_angle=setting.sigma_angle,
            sigma_height=setting.sigma_height,
            identifier=setting.identifier,
            created=created,
        )
        self.drift, noise = _drift(fitted, planes[0], planes[-1])
        warnings = [*map(_sentence, grid.warnings), *fitted.warnings]
        if self.drift > noise:
            warnings.append(
                f"The rig moved by {_UM * self.drift:.2f} µm RMS while it was calibrated, more than the noise of a "
                f"pixel ({_UM * noise:.2f} µm): let projector and camera warm up, see that nothing can shift, and "
                "calibrate again."
            )
        self.result = dataclasses.replace(fitted, warnings=tuple(warnings))
        return self.result

    def save_grid(self, folder: Path) -> None:
        """Write ``distortion.yaml``."""
        assert self.grid is not None, "measure_grid comes first"
        folder.mkdir(parents=True, exist_ok=True)
        self.grid.distortion.save(folder / DISTORTION_FILE)

    def save(self, folder: Path) -> None:
        """Write ``report.html``, and the files of the calibration when it may be used."""
        assert self.result is not None, "calibrate comes first"
        folder.mkdir(parents=True, exist_ok=True)
        self.result.write_report(folder / REPORT_FILE)
        if self.result.go:
            self.result.save(folder)


def _drift(fitted: RigCalibration, first: Plane, last: Plane) -> tuple[float, float]:
    """Return what the first plane changed by until it was measured last, and the noise of one pixel [m]."""
    surface = fitted.reconstruct(first.phase, first.sigma)
    slope = np.abs(surface.dz_dphi.values.astype(float))
    noise = float(np.nanmedian(slope * first.sigma))
    if first is last or (first.angle, first.height) != (last.angle, last.height):
        return math.nan, noise
    change = slope * (last.phase.astype(float) - first.phase)
    variance = slope**2 * (first.sigma.astype(float) ** 2 + last.sigma.astype(float) ** 2)
    return math.sqrt(max(float(np.nanmean(change**2 - variance)), 0.0)), noise
