"""A calibration session: planes are added one by one, then lens and rig are fitted and saved."""

from __future__ import annotations

import dataclasses
import math
from datetime import datetime
from pathlib import Path

import numpy as np

from fringedic.calibration.calibrate import calibrate_rig
from fringedic.calibration.findings import CalibrationWarning
from fringedic.calibration.placement import Placement, apart
from fringedic.calibration.planes import PlaneBlocks, check_different, reduce_plane
from fringedic.calibration.result import RigCalibration
from fringedic.camera.findings import Finding
from fringedic.camera.grid import GridMeasurement, measure_distortion
from fringedic.camera.tilted_grid import TiltedGrid, locate_pin_hole, measure_tilted_grid
from fringedic.errors import CalibrationError
from fringedic.frames.sensor import SENSOR
from fringedic.patterns.pattern import Orientation, ProjectedPattern
from fringedic.rig.geometry import UNKNOWN_FIRST

DISTORTION_FILE = "distortion.yaml"


@dataclasses.dataclass(frozen=True)
class Plane:
    """The measured phase of the reference plane at a known angle and height.

    Attributes
    ----------
    angle, height
        Of the plane z = height + x tan(angle) [rad], [m].
    held_out
        Tests the fit instead of being used by it.
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
    """Settings of a calibration besides its planes.

    Attributes
    ----------
    identifier
        Name of the calibration in results.
    projector_size
        Width and height of the projector [px].
    finest
        The fringes that the phases belong to.
    sigma_angle, sigma_height
        Standard uncertainty of the stage [rad, m].
    camera_first
        (column, row) of the sensor with which the camera's image begins [px]; -1 when unknown.
    sensor
        Name of the camera with its projector.
    """

    identifier: str
    projector_size: tuple[int, int]
    finest: ProjectedPattern
    sigma_angle: float = 0.0
    sigma_height: float = 0.0
    camera_first: tuple[int, int] = UNKNOWN_FIRST
    sensor: str = SENSOR


@dataclasses.dataclass(frozen=True)
class PlaneQuality:
    """How well a plane was measured.

    Attributes
    ----------
    valid
        Share of the image that is measured.
    noise
        Root mean square of the predicted noise of the pixels [rad].
    """

    valid: float
    noise: float


class CalibrationSession:
    """Collects the grid and the planes of one calibration and fits the model of the rig to them.

    Attributes
    ----------
    grid
        The camera as the printed grid shows it; None before it is measured.
    result
        The calibration; None before it is computed.
    drift
        Apparent movement of the first plane until it was measured again at the end, RMS without the noise [m]; NaN when
        it was not measured again.
    """

    def __init__(self) -> None:
        self.grid: GridMeasurement | None = None
        self.result: RigCalibration | None = None
        self.drift = math.nan
        self._setting: Setting | None = None
        self._tilted: list[TiltedGrid] = []
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
            The frames do not show a grid that can be measured; the message gives the reason.
        """
        self.grid, self._tilted = None, []
        self.grid = measure_distortion(frames.mean(axis=0, dtype=np.float64), pitch=grid_pitch)
        return self.grid

    def measure_tilted_grid(self, frames: np.ndarray, angle: float) -> TiltedGrid:
        """Find the grid in white frames of the tilted plane; the grid at angle 0 comes first.

        Parameters
        ----------
        frames : (frame, row, column)
            Grey levels; their mean is used.
        angle
            Of the plane [rad].

        Raises
        ------
        FringedicError
            The frames do not show the grid well enough; the message gives the reason.
        """
        if self.grid is None:
            raise CalibrationError("the grid on the tilted plane comes after that on the plane at 0 degree")
        self._tilted.append(measure_tilted_grid(frames.mean(axis=0, dtype=np.float64), self.grid, angle))
        return self._tilted[-1]

    def locate_pin_hole(self, sigma_angle: float, orientation: Orientation) -> GridMeasurement:
        """Locate the camera's pin-hole by the grids on the tilted plane, if there were any.

        Parameters
        ----------
        sigma_angle
            Standard uncertainty of single angles of the stage [rad].
        orientation
            Of the fringes; the axis of the stage is parallel to them.

        Raises
        ------
        CalibrationError
            The printed grid was not measured.
        GridError
            The plane was not at the stated angles, or was turned to one side only.
        """
        if self.grid is None:
            raise CalibrationError("the printed grid was not measured")
        if self._tilted:
            self.grid = locate_pin_hole(self.grid, self._tilted, sigma_angle=sigma_angle, orientation=orientation)
            self._tilted = []
        return self.grid

    def begin(self, setting: Setting) -> None:
        """Begin to collect planes; those of an earlier calibration are discarded.

        Raises
        ------
        CalibrationError
            The grid was not measured.
        """
        if self.grid is None:
            raise CalibrationError("the scale is not known: measure the printed grid first (calibrate_distortion)")
        self._setting = setting
        self._planes, self._blocks = [], []
        self.result, self.drift = None, math.nan

    def add_plane(self, plane: Plane) -> PlaneQuality:
        """Add one plane and return how well it was measured.

        Raises
        ------
        CalibrationError
            Too little of the image is measured, or the plane was not moved although its stated position changed. The
            plane is not added then.
        """
        planes = [*self._planes, plane]
        placement = Placement(np.array([each.angle for each in planes]), np.array([each.height for each in planes]))
        blocks = reduce_plane(plane.phase, plane.sigma, placement.name(len(planes) - 1))
        check_different([*self._blocks, blocks], placement)
        self._planes, self._blocks = planes, [*self._blocks, blocks]
        return PlaneQuality(blocks.valid, blocks.noise)

    def calibrate(self, created: datetime) -> RigCalibration:
        """Fit the model of the rig to all planes; the warnings include those of the grid and the drift.

        Parameters
        ----------
        created
            When the planes were measured.

        Raises
        ------
        CalibrationError
            There are no planes, or they do not give a calibration; the message gives the reason.
        """
        grid, setting, planes = self.grid, self._setting, self._planes
        if grid is None or setting is None:
            raise CalibrationError("there are no planes: begin comes first")
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
        first = planes[0]
        last = planes[-1]
        surface = fitted.reconstruct(first.phase, first.sigma)
        slope = np.abs(surface.dz_dphi.values.astype(float))
        noise = float(np.nanmedian(slope * first.sigma))
        if first is last or apart(last.angle - first.angle, last.height - first.height):
            self.drift = math.nan
        else:
            change = slope * (last.phase.astype(float) - first.phase)
            variance = slope**2 * (first.sigma.astype(float) ** 2 + last.sigma.astype(float) ** 2)
            self.drift = math.sqrt(max(float(np.nanmean(change**2 - variance)), 0.0))
        warnings = [*grid.warnings, *fitted.warnings]
        if math.isnan(self.drift):
            warnings.append(Finding(CalibrationWarning.DRIFT_UNKNOWN))
        elif self.drift > noise:
            warnings.append(Finding(CalibrationWarning.DRIFT, values={"change": self.drift, "noise": noise}))
        column, row = setting.camera_first
        model = dataclasses.replace(
            fitted.model, sensor=setting.sensor, camera_first_column=column, camera_first_row=row
        )
        self.result = dataclasses.replace(fitted, model=model, warnings=tuple(warnings))
        return self.result

    def save_grid(self, folder: Path) -> None:
        """Write ``distortion.yaml``.

        Raises
        ------
        CalibrationError
            The grid was not measured.
        """
        if self.grid is None:
            raise CalibrationError("the printed grid was not measured")
        folder.mkdir(parents=True, exist_ok=True)
        self.grid.distortion.save(folder / DISTORTION_FILE)

    def save(self, folder: Path, summary: str = "") -> None:
        """Write the files of the calibration if it can be used; see `RigCalibration.save`.

        Raises
        ------
        CalibrationError
            No calibration was computed.
        """
        if self.result is None:
            raise CalibrationError("there is no calibration: calibrate comes first")
        if self.result.go:
            self.result.save(folder, summary)
