"""From fits to a result: residuals of every plane beside the predicted noise, sigmas, and warnings."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
import xarray as xr

from fringedic.calibration.findings import CalibrationWarning
from fringedic.calibration.fit import Solution, information_criterion
from fringedic.calibration.fit_results import Candidate, Parameter, PlaneResult
from fringedic.calibration.geometry import check_size, rig_model
from fringedic.calibration.models import ModelFitter
from fringedic.calibration.outliers import unusual_ripple
from fringedic.calibration.result import RigCalibration
from fringedic.calibration.uncertainty import best_actions, height_sigma, motion_sigma, rig_with_covariance
from fringedic.calibration.variants import ModelVariant
from fringedic.camera.findings import Finding
from fringedic.rig.model import RigModel

_RIPPLE = 2e-3 * 2 * math.pi  # [rad] the noise of a usual sequence (q = 8, 1 grey level); averaging does not reduce it
_OUTLIERS = 1e-3  # noise alone has no pixels beyond six standard deviations
_SPREAD = math.radians(8)  # a smaller range of angles calibrates the heights poorly
_IN_PLANE = 1e-3  # of a motion along z, in u or v: about the noise of the displacement after 1 mm
_UNEXPLAINED = 4.0  # standard deviations of chi square; noise alone has so many in 1 of 30 000 calibrations
_ALIKE = 2.0  # blocks that count as one
_ADVISED_PLANES = 5  # with so many planes an outlier can be found

_TITLES: dict[str, tuple[str, str, float]] = {
    "camera_distance": ("camera distance h0", "mm", 1e-3),
    "projector_across": ("projector base d", "mm", 1e-3),
    "projector_height": ("projector distance hp", "mm", 1e-3),
    "projector_focal_length": ("projector focal length", "px", 1.0),
    "projector_turn": ("projector turned in the plane of the rig", "degree", math.radians(1)),
    "projector_nod": ("projector turned out of the plane of the rig", "degree", math.radians(1)),
    "projector_roll": ("projector roll", "degree", math.radians(1)),
    **{f"projector_{each}": (f"projector distortion {each}", "1", 1.0) for each in ("k1", "k2", "p1", "p2", "k3")},
    "projector_along": ("projector position along the fringes", "mm", 1e-3),
    "projector_principal": ("projector axis relative to the middle of its image", "px", 1.0),
    "axis_across": ("rotation axis: position across the fringes", "mm", 1e-3),
    "axis_height": ("rotation axis: height", "mm", 1e-3),
    "axis_skew": ("rotation axis relative to the direction of the fringes", "degree", math.radians(1)),
    "axis_slope": ("rotation axis relative to the reference plane", "degree", math.radians(1)),
    "phase_offset": ("phase on the rotation axis", "fringe", 2 * math.pi),
    "axis_position": ("rotation axis: position across the fringes", "mm", 1e-3),
    "camera_tilt_x": ("camera tilt about x", "degree", math.radians(1)),
    "camera_tilt_y": ("camera tilt about y", "degree", math.radians(1)),
    "pixel_size": ("pixel size", "µm", 1e-6),
}


@dataclass(frozen=True)
class Origin:
    """Name of a calibration, where it comes from and when it was made."""

    identifier: str
    source: str
    created: datetime


@dataclass(frozen=True, eq=False)
class Selection:
    """The planes and the model that a calibration uses.

    Attributes
    ----------
    used
        Indices of the fitted planes.
    problems
        What is wrong with the planes that were rejected, by index.
    fits
        The fits of all models.
    variant
        The chosen one.
    """

    used: tuple[int, ...]
    problems: Mapping[int, Finding]
    fits: Mapping[ModelVariant, Solution]
    variant: ModelVariant

    @property
    def solution(self) -> Solution:
        """The fit of the chosen model."""
        return self.fits[self.variant]


def assess(fitter: ModelFitter, selection: Selection, origin: Origin) -> RigCalibration:
    """Return the calibration with its figures and warnings.

    Raises
    ------
    CalibrationError
        The rig would look at a field wider than any lens sees, or the camera would be nearer or farther than that of
        any rig: angles or lengths of the wrong unit.
    """
    camera, planes, solution = fitter.camera, fitter.planes, selection.solution
    check_size(camera, solution.values["camera_distance"])
    model = dataclasses.replace(
        rig_with_covariance(camera, solution), identifier=origin.identifier, source=origin.source
    )
    results, maps = zip(
        *(_plane_result(fitter, selection, model, index) for index in range(len(planes.blocks))), strict=True
    )
    fitted = [results[index] for index in selection.used]
    blocks = planes.blocks
    dims = ("plane", "row", "column")
    sigma = np.sqrt(np.diag(solution.covariance))
    correlation: np.ndarray = solution.covariance / np.where(sigma > 0, np.outer(sigma, sigma), 1.0)
    calibration = RigCalibration(
        model=model,
        pitch=camera.pitch,
        orientation=camera.orientation,
        variant=selection.variant,
        candidates=tuple(_candidates(fitter, selection)),
        planes=results,
        parameters=tuple(_parameter(name, i, solution) for i, name in enumerate(solution.names)),
        correlation=correlation,
        chi_square=solution.reduced_chi_square,
        residual=_root_mean([plane.residual for plane in fitted]),
        predicted=_root_mean([plane.predicted for plane in fitted]),
        systematic=_root_mean([plane.systematic for plane in fitted]),
        held_out=max((results[index].systematic for index in planes.held_out), default=math.nan),
        height_sigma=height_sigma(fitter, selection.used, solution, model),
        principal_effect=fitter.principal_effect(selection.variant, selection.used, solution),
        residual_map=xr.Dataset(
            {
                "residual": (
                    dims,
                    np.array(maps, np.float32),
                    {"units": "m", "long_name": "residual of block means as height"},
                ),
                "phase": (
                    dims,
                    np.array([each.phase for each in blocks]),
                    {"units": "rad", "long_name": "absolute phase at the centre of blocks"},
                ),
                "sigma": (
                    dims,
                    np.array([each.sigma for each in blocks], np.float32),
                    {"units": "rad", "long_name": "standard deviation of the phase of blocks"},
                ),
            },
            coords={"plane": planes.names, "row": blocks[0].row, "column": blocks[0].column},
        ),
        warnings=(),
        created=origin.created,
    )
    return dataclasses.replace(calibration, warnings=tuple(_warnings(calibration, fitter, selection)))


def _plane_result(
    fitter: ModelFitter, selection: Selection, model: RigModel, index: int
) -> tuple[PlaneResult, np.ndarray]:
    """Return the figures of a plane, and the residual of its blocks as height [m] (n, m)."""
    placement, plane = fitter.placement, fitter.planes.blocks[index]
    residual = _residual(fitter, selection.solution, index)
    slope = np.abs(_slope(fitter, model, index))
    height = residual * slope
    sensitivity = math.sqrt(float(np.nanmean(slope**2)))
    block = math.sqrt(float(np.nanmean(residual**2)))
    block_noise = math.sqrt(float(np.nanmean(plane.sigma**2)))
    pixels = math.sqrt(plane.scatter * plane.noise**2 + max(0.0, block**2 - block_noise**2))
    result = PlaneResult(
        name=placement.name(index),
        angle=float(placement.angles[index]),
        height=float(placement.heights[index]),
        fitted=index in selection.used,
        residual_phase=pixels,
        predicted_phase=plane.noise,
        residual=pixels * sensitivity,
        predicted=plane.noise * sensitivity,
        systematic=math.sqrt(float(np.nanmean(height**2))),
        systematic_noise=math.sqrt(float(np.nanmean((plane.sigma * slope) ** 2))),
        chi_square=(pixels / plane.noise) ** 2,
        valid=plane.valid,
        outliers=plane.outliers,
        ripple=plane.ripple,
        problem=selection.problems.get(index),
    )
    return result, height


def _residual(fitter: ModelFitter, solution: Solution, index: int) -> np.ndarray:
    """Return measured - predicted phase of the blocks of a plane [rad], (n, m)."""
    residual: np.ndarray = fitter.residual(solution, index) * fitter.planes.blocks[index].sigma
    return residual


def _slope(fitter: ModelFitter, model: RigModel, index: int) -> np.ndarray:
    """Return dz/dphi of the blocks of a plane [m/rad], (n, m)."""
    phase, camera = fitter.planes.blocks[index].as_phase_map(), fitter.camera
    slope: np.ndarray = model.reconstruct(phase, camera.pitch, orientation=camera.orientation)["dz_dphi"].to_numpy()
    return slope


def _candidates(fitter: ModelFitter, selection: Selection) -> Iterator[Candidate]:
    correlation = selection.solution.correlation
    reference = information_criterion(selection.solution, correlation)
    for variant, fit in selection.fits.items():
        model = rig_model(fitter.camera, fit.values)
        squares = [
            math.sqrt(float(np.nanmean((_residual(fitter, fit, index) * _slope(fitter, model, index)) ** 2)))
            for index in selection.used
        ]
        yield Candidate(
            variant,
            len(fit.names),
            fit.reduced_chi_square,
            information_criterion(fit, correlation) - reference,
            _root_mean(squares),
        )


def _parameter(name: str, index: int, solution: Solution) -> Parameter:
    if name.startswith("angle_error"):
        title, unit, scale = f"error of the angle of image {name.rsplit('_', 1)[1]}", "degree", math.radians(1)
    elif name.startswith("height_error"):
        title, unit, scale = f"error of the height of image {name.rsplit('_', 1)[1]}", "mm", 1e-3
    else:
        title, unit, scale = _TITLES[name]
    sigma = math.sqrt(max(0.0, float(solution.covariance[index, index])))
    return Parameter(name, title, unit, solution.values[name] / scale, sigma / scale)


def _root_mean(values: Sequence[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values))


def _warnings(calibration: RigCalibration, fitter: ModelFitter, selection: Selection) -> Iterator[Finding]:
    used = selection.used
    for plane in calibration.planes:
        if plane.problem:
            yield dataclasses.replace(plane.problem, subject=plane.name)
    for plane in calibration.planes:
        if plane.outliers > _OUTLIERS:
            yield Finding(CalibrationWarning.OUTLIERS, plane.name, {"share": plane.outliers})
    for index, plane in enumerate(calibration.planes):
        ripple = unusual_ripple(index, fitter.planes.blocks)
        if ripple and not plane.problem:
            yield Finding(CalibrationWarning.RIPPLE, plane.name, {"amplitude": ripple})
    usual = np.nanmedian(np.array([fitter.planes.blocks[index].ripple for index in used]), axis=0)
    if np.any(usual > _RIPPLE):
        values = {"harmonic": int(np.nanargmax(usual)) + 1, "amplitude": float(np.nanmax(usual))}
        yield Finding(CalibrationWarning.COMMON_RIPPLE, values=values)
    angles, heights = fitter.placement.angles[list(used)], fitter.placement.heights[list(used)]
    if not np.ptp(heights) and np.ptp(angles) < _SPREAD:
        yield Finding(CalibrationWarning.NARROW_ANGLES, values={"span": float(np.ptp(angles))})
    if fitter.camera.plane is None:
        yield Finding(CalibrationWarning.TILT_UNKNOWN)
    elif fitter.pin_hole is None:
        yield Finding(CalibrationWarning.TILT_FROM_ONE_PLANE)
    if len(used) < _ADVISED_PLANES:
        yield Finding(CalibrationWarning.FEW_PLANES, values={"count": len(used)})
    if not calibration.tested:
        yield Finding(CalibrationWarning.NOT_TESTED)
    if not selection.solution.converged:
        yield Finding(CalibrationWarning.NOT_CONVERGED)
    yield from _uncertainties(calibration, fitter, selection)


def _uncertainties(calibration: RigCalibration, fitter: ModelFitter, selection: Selection) -> Iterator[Finding]:
    """Yield the uncertainties that are larger than the noise of a measurement, each with what reduces it most."""
    solution = selection.solution
    in_plane = motion_sigma(calibration.model, calibration.orientation)
    unexplained = solution.reduced_chi_square > 1 + _UNEXPLAINED * math.sqrt(2 / solution.freedom)
    if in_plane > _IN_PLANE and unexplained and solution.correlation > _ALIKE:
        yield Finding(CalibrationWarning.UNEXPLAINED, values={"blocks": solution.correlation, "sigma": in_plane})
    large = {
        CalibrationWarning.UNCERTAIN_HEIGHT: (calibration.height_sigma, calibration.predicted),
        CalibrationWarning.UNCERTAIN_MOTION: (in_plane, _IN_PLANE),
    }
    large = {code: (sigma, limit) for code, (sigma, limit) in large.items() if sigma > limit}
    if large:
        actions = best_actions(fitter, selection.used, selection.variant, solution)
        for code, (sigma, _) in large.items():
            action, reduced = actions[code]
            yield Finding(code, values={"sigma": sigma, "action": float(action), "reduced": reduced})
