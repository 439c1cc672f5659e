"""Calibration of the rig from phase maps of a plane at known angles, or heights: no starting values, no tuning."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Literal

import numpy as np
import xarray as xr

from fringedic.calibration.closed_form import PaperParameters, closed_form
from fringedic.calibration.fit import (
    Observations,
    Prior,
    Solution,
    fit,
    information_criterion,
    observe,
    parameters_of,
    stage_priors,
)
from fringedic.calibration.geometry import (
    Camera,
    Placement,
    general_start,
    paper_start,
    rig_model,
)
from fringedic.calibration.judgement import judge
from fringedic.calibration.planes import (
    SMALLEST_MOVE,
    SMALLEST_TURN,
    PlaneBlocks,
    check_different,
    check_planes,
    plane_name,
    reduce_plane,
)
from fringedic.calibration.result import RigCalibration
from fringedic.calibration.suspects import explain, find_suspect
from fringedic.camera import DistortionMap
from fringedic.camera.plane_view import PlaneView
from fringedic.errors import (
    CalibrationPhaseError,
    FringedicError,
    InvalidCalibrationError,
)
from fringedic.sequence import Orientation

UNKNOWN_TILT = math.radians(1.0)  # of a camera whose tilt was not measured by a grid
_CURVED = 5.0  # standard deviations of k1 from which the centre of the distortion can be sought
_SUSPICIOUS = 3.0  # chi square per degree of freedom from which a bad image is looked for
_ROUGH = 7  # every such block is enough to find a bad image; prime, so that it is no column of blocks
_AGREEMENT = 5.0  # standard deviations of a block
_OUTSIDE = 0.02  # part of the projector's image that phases may reach beyond it
_SAME_SCALE = 0.01  # difference of two pixel sizes that are meant to be the same
_MANY = 0.01  # share of the blocks


def calibrate_rig(
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
    plane: PlaneView | None = None,
    sigma_angle: float = 0.0,
    sigma_height: float = 0.0,
    sigma_pixel_size: float = 0.0,
    camera_distance: float | None = None,
    sigma_camera_distance: float = 1e-3,
    model: Literal["paper", "general"] | None = None,
    identifier: str = "",
    source: str = "",
    created: datetime | None = None,
) -> RigCalibration:
    """Calibrate the rig by known rotations of the reference plane (Breque 2004), known translations, or both.

    The paper's six parameters come in closed form and are refined; a general pin-hole projector with a free rotation
    axis, its radial distortion and the centre of that are added as far as the data ask for them. See
    `fringedic.calibration` for the model.

    Parameters
    ----------
    phases
        Absolute phase [rad] of the plane, one image (row, column) for each position; NaN where not measured.
    angles
        Angle of each plane [rad]. A positive one raises the +x side, z = x tan(angle); with horizontal fringes the +y
        side, z = y tan(angle). The reference plane z = 0 is the plane at angle 0 and height 0. None: all 0.
    pixel_size
        gamma, length on the reference plane per row at the principal point [m], from the grid's pitch: the one length
        that phases cannot give.
    pitch
        Fringe pitch that the phases belong to [projector px].
    projector_size
        Width and height of the projector's image [px]. Its optical axis is taken to leave it in the middle (across the
        fringes), unless translated planes, `camera_distance` or grids on the turned plane allow to find where.
    sigma
        Standard deviation of each phase map [rad]; by default the scatter of neighbouring pixels tells it.
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
        From pixels of the image to ideal ones.
    plane
        What the image of a grid lying on the plane at angle 0 tells: the camera's tilt, pixel size and aspect. Without
        it tilts up to some degree are sought. Where the grid was seen on the turned plane too, `PlaneView.pin_hole`
        tells h0 and what part of the tilt is the lens's.
    sigma_angle, sigma_height
        Standard deviations of the errors of single angles [rad] and heights [m]: of the stage.
    sigma_pixel_size
        Standard deviation of the pixel size [m].
    camera_distance, sigma_camera_distance
        h0 [m] when it was measured otherwise, and how well.
    model
        The paper's six parameters, for comparison, or the general model, whatever the data say; None: the data decide.
    identifier, source, created
        Name of the calibration, where it comes from and when; by default the time.

    Returns
    -------
    RigCalibration
        ``go`` is False, and ``verdict`` names the reason, when the calibration should not be used.

    Raises
    ------
    CalibrationPlanesError
        Too few planes, planes at the same place, or a plane that was not moved.
    CalibrationAnglesError
        Angles of the wrong sign or unit.
    CalibrationPhaseError
        Phases that run backwards, leave the projector's image, or are not measured.
    InvalidCalibrationError
        Numbers that have no meaning.
    ShapeMismatchError
        Maps of different sizes, or lists of different lengths.
    """
    turn, lift, fitted = check_planes(phases, angles, heights, sigma, held_out)
    rows, columns = np.shape(phases[0])
    camera = _camera(
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
    names = [plane_name(i, turn, lift) for i in range(len(phases))]
    blocks = [reduce_plane(phase, None if sigma is None else sigma[i], names[i]) for i, phase in enumerate(phases)]
    check_different(blocks, turn, lift)
    _check_projector(blocks, camera, names)
    priors: dict[str, Prior] = {}
    if plane is None:
        priors |= {name: Prior(0.0, UNKNOWN_TILT) for name in ("camera_tilt_x", "camera_tilt_y")}
    if sigma_pixel_size > 0:
        priors["pixel_size"] = Prior(camera.pixel_size, sigma_pixel_size)
    if camera_distance is not None:
        priors["camera_distance"] = Prior(camera_distance, sigma_camera_distance)
    fitter = _Fitter(camera, Placement(turn, lift), blocks, priors, sigma_angle, sigma_height)
    chosen = [int(i) for i in np.flatnonzero(fitted)]
    problems = fitter.problems(chosen)
    used = [i for i in chosen if i not in problems]
    trials = fitter.trials(used)
    created = created or datetime.now(UTC)
    name = fitter.best({name: trials[name] for name in trials if model is None or name.startswith(model)})
    return judge(
        camera=camera,
        placement=fitter.placement,
        blocks=blocks,
        names=names,
        used=used,
        held_out=[int(i) for i in np.flatnonzero(~fitted)],
        problems=problems,
        trials=trials,
        best=name,
        principal_effect=fitter.principal_effect(name, used, trials[name]),
        view=plane,
        identifier=identifier or f"{created:%Y-%m-%d %H:%M} UTC",
        source=source or "calibrate_rig",
        created=created,
    )


@dataclasses.dataclass
class _Fitter:
    """Fits the models that are possible to a selection of planes."""

    camera: Camera
    placement: Placement
    blocks: Sequence[PlaneBlocks]
    priors: dict[str, Prior]
    sigma_angle: float
    sigma_height: float

    def __post_init__(self) -> None:
        self.observations: Observations = observe(self.camera, self.blocks)
        column, row = np.meshgrid(self.blocks[0].column, self.blocks[0].row)
        self.reference = self.camera.on_reference(*self.camera.ideal(column, row))
        # a plane translated as well as turned, or a known distance, tells where the projector's axis is
        plane = self.camera.plane
        self.pin_hole = None if plane is None else plane.pin_hole
        known = "camera_distance" in self.priors or self.pin_hole is not None
        self.principal = known or float(np.ptp(self.placement.heights)) > SMALLEST_MOVE

    def trials(self, planes: Sequence[int]) -> dict[str, Solution]:
        """Return the fits of all models to these planes by name.

        Raises
        ------
        CalibrationAnglesError, CalibrationPhaseError, CalibrationPlanesError
            When there is no start.
        """
        found = {"paper": self._fit("paper", planes, paper_start(self._closed_form(planes), self.camera))}
        start = self._general_start(found["paper"], planes)
        found["general"] = self._fit("general", planes, start)
        found["general + k1"] = self._fit("general + k1", planes, found["general"].values)
        bend = found["general + k1"]
        index = bend.names.index("projector_k1")
        scatter = max(1.0, bend.chi_square / bend.freedom)
        if abs(bend.values["projector_k1"]) > _CURVED * math.sqrt(bend.covariance[index, index] * scatter):
            found["general + k1 + y"] = self._fit("general + k1 + y", planes, bend.values)
        return found

    def rough(self, planes: Sequence[int]) -> Solution:
        """Return a quick fit of the general model with distortion, from a part of the blocks.

        Raises
        ------
        CalibrationAnglesError, CalibrationPhaseError, CalibrationPlanesError
            When there is no start.
        """
        paper = self._fit("paper", planes, paper_start(self._closed_form(planes), self.camera), _ROUGH)
        return self._fit("general + k1", planes, self._general_start(paper, planes), _ROUGH)

    def best(self, trials: dict[str, Solution]) -> str:
        """Return the name of the model that the data ask for."""
        scatter = max(1.0, min(each.chi_square / each.freedom for each in trials.values()))
        return min(trials, key=lambda name: information_criterion(trials[name], scatter))

    def problems(self, planes: Sequence[int]) -> dict[int, str]:
        """Return what is wrong with the one image that spoils the fit, if there is one.

        Raises
        ------
        CalibrationAnglesError, CalibrationPhaseError, CalibrationPlanesError
            When there is no start with or without any of the images.
        """
        whole: Solution | None = None
        failure: FringedicError | None = None
        try:
            whole = self.rough(planes)
        except FringedicError as error:
            failure = error
        if whole is not None and whole.chi_square / whole.freedom < _SUSPICIOUS:
            return {}
        suspect = find_suspect(planes, self.rough, whole)
        if suspect is None:
            if failure is not None:
                raise failure
            return {}
        plane, solution = suspect
        # agreement as good as that of the others, but no better than noise allows
        agreement = max(_AGREEMENT, 2 * math.sqrt(solution.chi_square / solution.freedom))
        tolerance = agreement * float(np.median(self.observations.sigmas[plane]))
        problem = explain(plane, solution, self.camera, self.placement, self.observations, self.blocks, tolerance)
        return {plane: problem}

    def principal_effect(self, model: str, planes: Sequence[int], solution: Solution) -> float:
        """Return what one pixel of the projector's assumed principal point does to z on the planes, rms [m].

        NaN when the point is fitted, or the model takes another way to hold the camera's distance.
        """
        if model == "paper" or self.principal:
            return math.nan
        shifted = self._fit(model, planes, {**solution.values, "projector_principal": 1.0})
        rigs = [rig_model(self.camera, each.values) for each in (solution, shifted)]
        squares = []
        for plane in planes:
            blocks = self.blocks[plane]
            phase = xr.DataArray(
                blocks.phase, dims=("row", "column"), coords={"row": blocks.row, "column": blocks.column}
            )
            first, second = (
                rig.reconstruct(phase, self.camera.pitch, orientation=self.camera.orientation)["z"] for rig in rigs
            )
            squares.append(float(((second - first) ** 2).mean()))
        return math.sqrt(sum(squares) / len(squares))

    def _closed_form(self, planes: Sequence[int]) -> PaperParameters:
        some = list(planes)
        return closed_form(
            [self.blocks[i] for i in some], *self.reference, self.placement.angles[some], self.placement.heights[some]
        )

    def _general_start(self, paper: Solution, planes: Sequence[int]) -> dict[str, float]:
        start = general_start(paper.values, self.camera, self._turned(planes))
        if self.camera.plane is not None and self.pin_hole is not None:
            seen = self.camera.plane.camera(self.pin_hole.distance)
            start |= {name: seen[name] for name in ("camera_tilt_x", "camera_tilt_y")}
        return start

    def _turned(self, planes: Sequence[int]) -> bool:
        return bool(np.ptp(self.placement.angles[list(planes)]) > SMALLEST_TURN)

    def _fit(self, model: str, planes: Sequence[int], start: dict[str, float], skip: int = 1) -> Solution:
        priors = stage_priors(planes, self.sigma_angle, self.sigma_height)
        free = parameters_of(
            model,
            turned=self._turned(planes),
            tilts=self.camera.plane is None or self.pin_hole is not None,
            principal=self.principal,
            stage_errors=[*priors, *(["pixel_size"] if "pixel_size" in self.priors else [])],
        )
        priors |= self.priors
        defaults = {name: priors[name].value if name in priors else 0.0 for name in free}
        return fit(
            self.camera, self.placement, self.observations.only(planes, skip), {**defaults, **start}, free, priors
        )


def _camera(camera: Camera, principal_point: tuple[float, float] | None) -> Camera:
    """Return the camera with what the grid on the plane and the user say, checked."""
    for name in ("pixel_size", "pixel_aspect", "pitch"):
        value = getattr(camera, name)
        if not (math.isfinite(value) and value > 0):
            raise InvalidCalibrationError(f"{name} is {value}: it has to be above 0")
    size, distortion, plane = (camera.width, camera.height), camera.distortion, camera.plane
    if distortion is not None and (distortion.width, distortion.height) != size:
        raise InvalidCalibrationError(
            f"the distortion is that of {distortion.width} x {distortion.height} px, the phase maps have "
            f"{size[0]} x {size[1]}"
        )
    if plane is not None:
        if abs(plane.pixel_size / camera.pixel_size - 1) > _SAME_SCALE:
            raise InvalidCalibrationError(
                f"pixel_size is {1e6 * camera.pixel_size:.4g} µm, the grid on the plane says "
                f"{1e6 * plane.pixel_size:.4g} µm: is the grid's pitch right?"
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


def _check_projector(blocks: Sequence[PlaneBlocks], camera: Camera, names: Sequence[str]) -> None:
    """Raise an error when phases lie outside the projector's image."""
    size = camera.projector_width if camera.vertical else camera.projector_height
    outside = []
    for plane, name in zip(blocks, names, strict=True):
        pixels = np.abs(plane.phase[np.isfinite(plane.phase)]) * camera.pitch / (2 * math.pi)
        if np.mean(pixels > size * (0.5 + _OUTSIDE)) > _MANY:
            outside.append((name, float(pixels.max())))
    if outside:
        named = "all images" if len(outside) == len(names) else ", ".join(name for name, _ in outside)
        raise CalibrationPhaseError(
            f"{named}: the phase reaches {max(reach for _, reach in outside):.0f} projector pixels from the axis, and "
            f"the projector's image ends at {size / 2:.0f}; the pitch of {camera.pitch:g} px, the size of the "
            "projector's image or the fringe orders are wrong"
        )
