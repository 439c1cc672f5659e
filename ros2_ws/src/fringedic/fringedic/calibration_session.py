"""One calibration from its frames to its files, the same in the running system and at the desk.

The experiment node gives it what stands in front of the camera, step by step; `calibrate_recording` gives it the same
from a recording. The arithmetic is in `fringedic.camera` and `fringedic.calibration`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np

from fringedic.calibration.planes import PlaneBlocks, check_different, plane_name, reduce_plane
from fringedic.errors import CalibrationStateError
from fringedic.rig import RigModel
from fringedic.sequence import Projection

_MM, _UM = 1e3, 1e6


class PlaneKind(IntEnum):
    """What stands in front of the camera, numbered as in ``fringedic_msgs/ReferencePlane``."""

    GRID = 0
    PLANE = 1
    SPECIMEN = 2


def place_in_words(kind: int, angle: float, height: float) -> str:
    """Return what an operator shall put in front of the camera; angle [rad], height [m]."""
    if kind == PlaneKind.GRID:
        return "lay the printed grid on the reference plane at 0 degree, turned in its plane by 1 to 3 degrees"
    if kind == PlaneKind.SPECIMEN:
        return "put the specimen back"
    degrees, lift = math.degrees(angle), _MM * height
    side = f" ({'right' if degrees > 0 else 'left'} side towards the camera)" if abs(degrees) > 1e-6 else ""
    lifted = f", {abs(lift):.3f} mm {'above' if lift > 0 else 'below'} its place" if abs(lift) > 1e-6 else ""
    return f"turn the plain reference plane to {degrees + 0.0:+.2f} degree{side}{lifted}"


@dataclass(frozen=True)
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


@dataclass(frozen=True)
class Calibrated:
    """What came of a calibration.

    Attributes
    ----------
    calibration
        The result of the fit.
    drift
        How far the first plane seemed to have moved when it was measured once more at the end, RMS without the noise
        [m]; NaN when it was not.
    noise
        Median standard deviation of z of one pixel on the first plane [m].
    """

    calibration: Any
    drift: float
    noise: float

    @property
    def model(self) -> RigModel:
        """The pin-hole model."""
        return self.calibration.model

    @property
    def go(self) -> bool:
        """Whether the calibration may be used."""
        return bool(self.calibration.go)

    @property
    def drifted(self) -> bool:
        """Whether the rig moved by more than the noise of a pixel while it was calibrated."""
        return self.drift > self.noise

    @property
    def verdict(self) -> str:
        """In words, the drift included."""
        if math.isnan(self.drift):
            return str(self.calibration.verdict)
        words = f"The rig drifted by {_UM * self.drift:.2f} µm RMS meanwhile"
        if self.drifted:
            words += (
                f", more than the noise of a pixel ({_UM * self.noise:.1f} µm): let projector and camera warm up, see "
                "that nothing can move, and calibrate again"
            )
        return f"{self.calibration.verdict} {words}."


class CalibrationSession:
    """Collects the grid and the planes of one calibration and makes a model of the rig from them.

    Attributes
    ----------
    grid
        The camera as the printed grid told it; None as long as it was not measured, or not well enough.
    """

    def __init__(self) -> None:
        self.grid: Any = None
        self._measured_grid: Any = None
        self._planes: list[Plane] = []
        self._blocks: list[PlaneBlocks] = []
        self._calibrated: Calibrated | None = None

    # the grid

    def measure_grid(self, frames: np.ndarray, grid_pitch: float, identifier: str) -> Any:
        """Measure the distortion of the camera from white frames of the printed grid.

        Parameters
        ----------
        frames : (frame, row, column)
            Grey levels; their mean is used.
        grid_pitch
            Distance of the printed lines [m].
        identifier
            Names the result.

        Raises
        ------
        FringedicError
            The frames do not show a grid that can be measured; the message says why.
        """
        from fringedic.camera import measure_distortion

        image = frames.mean(axis=0, dtype=np.float64).astype(np.float32)
        self._measured_grid = measure_distortion(image, pitch=grid_pitch)
        self.grid = self._measured_grid
        return self._measured_grid

    def save_grid(self, folder: Path) -> None:
        """Write ``distortion.yaml``."""
        folder.mkdir(parents=True, exist_ok=True)
        self._measured_grid.map.save(folder / "distortion.yaml")

    # the planes

    def begin(self, identifier: str, *, projector_size: tuple[int, int], finest: Projection) -> None:
        """Begin to collect planes.

        Parameters
        ----------
        identifier
            Names the calibration in results.
        projector_size
            Width and height of the projector [px].
        finest
            The fringes that the phases belong to.
        """
        self._identifier = identifier
        self._projector_size = projector_size
        self._finest = finest
        self._planes, self._blocks, self._calibrated = [], [], None

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

    def calibrate(self) -> Calibrated:
        """Fit the model of the rig to all planes.

        Raises
        ------
        CalibrationStateError
            The grid was not measured.
        CalibrationPlanesError, CalibrationAnglesError, CalibrationPhaseError
            The planes do not make a calibration; the message says what is wrong with them.
        """
        from fringedic.calibration import calibrate_rig

        if self.grid is None:
            raise CalibrationStateError("the grid was not measured: the scale is not known")
        calibration = calibrate_rig(
            [plane.phase for plane in self._planes],
            [plane.angle for plane in self._planes],
            self.grid.plane.pixel_size,
            pitch=self._finest.pitch,
            sigma=[plane.sigma for plane in self._planes],
            held_out=[index for index, plane in enumerate(self._planes) if plane.held_out],
            orientation=self._finest.orientation,
            heights=[plane.height for plane in self._planes],
            distortion=self.grid.map,
            plane=self.grid.plane,
            projector_size=self._projector_size,
            identifier=self._identifier,
        )
        self._calibrated = Calibrated(calibration, *self._drift(calibration.model))
        return self._calibrated

    def _drift(self, model: RigModel) -> tuple[float, float]:
        """Return what the first plane changed by until it was measured last, and the noise of one pixel [m]."""
        first, last = self._planes[0], self._planes[-1]
        surface = model.reconstruct(first.phase, self._finest.pitch, first.sigma, self._finest.orientation)
        slope = surface.dz_dphi.values.astype(float)
        noise = float(np.nanmedian(np.abs(slope) * first.sigma))
        if first is last or (first.angle, first.height) != (last.angle, last.height):
            return math.nan, noise
        change = slope * (last.phase - first.phase)
        variance = slope**2 * (first.sigma.astype(float) ** 2 + last.sigma.astype(float) ** 2)
        return math.sqrt(max(float(np.nanmean(change**2 - variance)), 0.0)), noise

    def save(self, folder: Path) -> None:
        """Write the report, and the calibration when it may be used."""
        assert self._calibrated is not None, "calibrate comes first"
        folder.mkdir(parents=True, exist_ok=True)
        if self._calibrated.go:
            self._calibrated.calibration.save(folder)
        self._calibrated.calibration.write_report(folder / "report.html")
