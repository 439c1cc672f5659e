"""From fits to an answer: residuals of every plane beside the predicted noise, warnings, go or no-go in words."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from datetime import datetime

import numpy as np
import xarray as xr

from fringedic.calibration.fit import Solution, information_criterion
from fringedic.calibration.geometry import SCALES, Camera, Placement, place_plane, predict, rig_model
from fringedic.calibration.planes import PlaneBlocks
from fringedic.calibration.result import Candidate, Parameter, PlaneResult, RigCalibration
from fringedic.calibration.suspects import unusual_ripple
from fringedic.camera.plane_view import PlaneView
from fringedic.errors import CalibrationAnglesError, InvalidCalibrationError
from fringedic.rig import RigModel
from fringedic.rig_uncertainty import PARAMETERS, parameter_values, position_errors

GOOD = 1.0  # systematic residual in units of the noise of one pixel, up to which it is hidden by noise
USABLE = 3.0  # and up to which the calibration can still be used, with a warning
WIDEST_FIELD = 2.0  # width of the field in units of the camera's distance; wider means wrong angles
NEAREST, FARTHEST = 0.01, 50.0  # [m] of the camera from the plane; beyond these the scale is wrong
_STEP = 1e-5
_RIPPLE = 2e-3 * 2 * math.pi  # [rad]
_NEGLIGIBLE_RIPPLE = 5.0  # times its own noise
_OUTLIERS = 1e-3
_SPREAD = math.radians(8)  # range of angles below which the heights are poorly calibrated

_TITLES: dict[str, tuple[str, str, float]] = {
    "camera_distance": ("camera distance h0", "mm", 1e-3),
    "projector_across": ("projector base d", "mm", 1e-3),
    "projector_height": ("projector distance hp", "mm", 1e-3),
    "projector_focal_length": ("projector focal length", "px", 1.0),
    "projector_turn": ("projector turned in the plane of the rig", "degree", math.radians(1)),
    "projector_nod": ("projector turned out of the plane of the rig", "degree", math.radians(1)),
    "projector_roll": ("projector roll", "degree", math.radians(1)),
    "projector_k1": ("projector distortion k1", "1", 1.0),
    "projector_along": ("projector position along the fringes", "mm", 1e-3),
    "projector_principal": ("projector axis beside the middle of its image", "px", 1.0),
    "axis_across": ("rotation axis: position across the fringes", "mm", 1e-3),
    "axis_height": ("rotation axis: height", "mm", 1e-3),
    "axis_skew": ("rotation axis against the fringes' direction", "degree", math.radians(1)),
    "axis_slope": ("rotation axis against the reference plane", "degree", math.radians(1)),
    "phase_offset": ("phase on the rotation axis", "fringe", 2 * math.pi),
    "axis_position": ("rotation axis: position across the fringes", "mm", 1e-3),
    "camera_tilt_x": ("camera tilt about x", "degree", math.radians(1)),
    "camera_tilt_y": ("camera tilt about y", "degree", math.radians(1)),
    "pixel_size": ("pixel size", "µm", 1e-6),
}


def _check_size(camera: Camera, distance: float, turned: bool) -> None:
    """Refuse a rig of a size that no rig has: phases do not tell it, and would fit as well."""
    width = camera.pixel_size * max(camera.width / camera.pixel_aspect, camera.height)
    if width > WIDEST_FIELD * distance:
        wrong = "angles are too large; are they in radian?" if turned else "heights are too large; are they in metre?"
        raise CalibrationAnglesError(
            f"the camera would stand {1e3 * distance:.3g} mm from a field of {1e3 * width:.3g} mm: the {wrong}"
        )
    if not NEAREST < distance < FARTHEST:
        raise InvalidCalibrationError(
            f"the camera would stand {distance:.3g} m from a field of {width:.3g} m: are the grid's pitch, the pixel "
            "size and heights given in metre and angles in radian (in files: millimetre, degree)?"
        )


def judge(
    *,
    camera: Camera,
    placement: Placement,
    blocks: Sequence[PlaneBlocks],
    names: Sequence[str],
    used: Sequence[int],
    held_out: Sequence[int],
    problems: Mapping[int, str],
    trials: Mapping[str, Solution],
    best: str,
    principal_effect: float,
    view: PlaneView | None,
    identifier: str,
    source: str,
    created: datetime,
) -> RigCalibration:
    """Return the calibration with everything that is said about it.

    Raises
    ------
    CalibrationAnglesError
        When the rig would look at a field wider than any lens sees: angles or heights of the wrong unit.
    InvalidCalibrationError
        When the camera would stand nearer or farther than that of any rig: lengths of the wrong unit.
    """
    solution = trials[best]
    _check_size(camera, solution.values["camera_distance"], bool(np.any(placement.angles)))
    model = _with_covariance(camera, solution, identifier, source)
    planes, maps = [], []
    for i, plane in enumerate(blocks):
        result, height = _plane_result(
            camera, placement, solution, model, plane, i, names[i], i in used, problems.get(i, "")
        )
        planes.append(result)
        maps.append(height)
    fitted = [planes[i] for i in used]
    systematic = {
        name: _root_mean([_systematic(camera, placement, trial, blocks[i], i) for i in used])
        for name, trial in trials.items()
    }
    scatter = max(1.0, min(each.chi_square / each.freedom for each in trials.values()))
    reference = information_criterion(solution, scatter)
    candidates = tuple(
        Candidate(
            name,
            len(trial.names),
            trial.chi_square / trial.freedom,
            information_criterion(trial, scatter) - reference,
            systematic[name],
        )
        for name, trial in trials.items()
    )
    predicted = _root_mean([plane.predicted for plane in fitted])
    kept_out = [planes[i] for i in held_out]
    calibration = RigCalibration(
        model=model,
        pitch=camera.pitch,
        orientation=camera.orientation,
        chosen="paper" if best == "paper" else "general",
        why=_why(best, candidates, predicted),
        candidates=candidates,
        planes=tuple(planes),
        parameters=tuple(_parameter(name, i, solution) for i, name in enumerate(solution.names)),
        correlation=_correlation(solution.covariance),
        chi_square=solution.chi_square / solution.freedom,
        residual=_root_mean([plane.residual for plane in fitted]),
        predicted=predicted,
        systematic=_root_mean([plane.systematic for plane in fitted]),
        held_out=_root_mean([plane.systematic for plane in kept_out]) if kept_out else math.nan,
        height_sigma=_height_sigma(camera, placement, solution, model, blocks, used),
        principal_effect=principal_effect,
        residual_map=_residual_map(maps, blocks, names),
        warnings=(),
        go=False,
        verdict="",
        created=created,
    )
    warnings = _warnings(calibration, blocks, placement, used, view)
    go, verdict = _verdict(calibration)
    return dataclasses.replace(calibration, warnings=tuple(warnings), go=go, verdict=verdict)


def _with_covariance(camera: Camera, solution: Solution, identifier: str, source: str) -> RigModel:
    """Return the fitted rig; the covariance is carried over to the parameters of the model."""
    rig = rig_model(camera, solution.values)
    names = tuple(PARAMETERS)
    columns = []
    for name in solution.names:
        step = _STEP * SCALES.get(name, 1e-3)
        sides = [
            parameter_values(rig_model(camera, {**solution.values, name: solution.values[name] + side}), names)
            for side in (step, -step)
        ]
        columns.append((sides[0] - sides[1]) / (2 * step))
    jacobian = np.stack(columns, axis=1)
    covariance = jacobian @ solution.covariance @ jacobian.T
    known = np.diag(covariance) > 0
    return dataclasses.replace(
        rig,
        identifier=identifier,
        source=source,
        parameter_names=tuple(name for name, use in zip(names, known, strict=True) if use),
        covariance=tuple(covariance[np.ix_(known, known)].ravel().tolist()),
    )


def _plane_result(
    camera: Camera,
    placement: Placement,
    solution: Solution,
    model: RigModel,
    plane: PlaneBlocks,
    index: int,
    name: str,
    fitted: bool,
    problem: str,
) -> tuple[PlaneResult, np.ndarray]:
    residual = _residual(camera, placement, solution, plane, index)
    slope = np.abs(
        model.reconstruct(
            xr.DataArray(plane.phase, dims=("row", "column"), coords={"row": plane.row, "column": plane.column}),
            camera.pitch,
            orientation=camera.orientation,
        )["dz_dphi"].to_numpy()
    )
    height = residual * slope
    sensitivity = math.sqrt(float(np.nanmean(slope**2)))
    block = math.sqrt(float(np.nanmean(residual**2)))
    block_noise = math.sqrt(float(np.nanmean(plane.sigma**2)))
    pixels = math.sqrt(plane.scatter * plane.noise**2 + max(0.0, block**2 - block_noise**2))
    systematic = math.sqrt(float(np.nanmean(height**2)))
    result = PlaneResult(
        name=name,
        angle=float(placement.angles[index]),
        height=float(placement.heights[index]),
        fitted=fitted,
        residual_phase=pixels,
        predicted_phase=plane.noise,
        residual=pixels * sensitivity,
        predicted=plane.noise * sensitivity,
        systematic=systematic,
        systematic_noise=math.sqrt(float(np.nanmean((plane.sigma * slope) ** 2))),
        chi_square=(pixels / plane.noise) ** 2,
        valid=plane.valid,
        outliers=plane.outliers,
        ripple=plane.ripple,
        problem=problem,
    )
    return result, height


def _residual(camera: Camera, placement: Placement, solution: Solution, plane: PlaneBlocks, index: int) -> np.ndarray:
    """Return measured - predicted phase of the blocks [rad], (n, m)."""
    column, row = camera.ideal(*np.meshgrid(plane.column, plane.row))
    pixels = np.stack([column.ravel(), row.ravel(), np.ones(column.size)], axis=-1)
    predicted = predict(camera, solution.values, placement, (index,), (pixels,)).reshape(column.shape)
    result: np.ndarray = plane.phase - predicted
    return result


def _systematic(camera: Camera, placement: Placement, solution: Solution, plane: PlaneBlocks, index: int) -> float:
    residual = _residual(camera, placement, solution, plane, index)
    phase = xr.DataArray(plane.phase, dims=("row", "column"), coords={"row": plane.row, "column": plane.column})
    slope = rig_model(camera, solution.values).reconstruct(phase, camera.pitch, orientation=camera.orientation)
    return math.sqrt(float(np.nanmean((residual * slope["dz_dphi"].to_numpy()) ** 2)))


def _height_sigma(
    camera: Camera,
    placement: Placement,
    solution: Solution,
    model: RigModel,
    blocks: Sequence[PlaneBlocks],
    used: Sequence[int],
) -> float:
    """Return the largest standard deviation of z that the calibration brings on the fitted planes [m]."""
    largest = 0.0
    for index in used:
        column, row = np.meshgrid(blocks[index].column[[0, -1]], blocks[index].row[[0, -1]])
        largest = max(largest, _sigma_on_plane(camera, placement, solution, model, column, row, index))
    return largest


def _sigma_on_plane(
    camera: Camera,
    placement: Placement,
    solution: Solution,
    model: RigModel,
    column: np.ndarray,
    row: np.ndarray,
    index: int,
) -> float:
    normal, offset = place_plane(camera, solution.values, *placement.of(index, solution.values))
    ideal = camera.ideal(column, row)
    rays = np.stack([*ideal, np.ones(column.shape)], axis=-1) @ model.ray_matrix.T
    along = (offset - normal[2] * model.camera_distance) / (rays @ normal)
    z = model.camera_distance + along * rays[..., 2]
    errors = position_errors(model, column, row, z, camera.orientation)
    return float(np.sqrt(np.sum(errors[:, 2] ** 2, axis=0)).max())


def _residual_map(maps: Sequence[np.ndarray], blocks: Sequence[PlaneBlocks], names: Sequence[str]) -> xr.Dataset:
    dims = ("plane", "row", "column")
    units = {"units": "m"}
    return xr.Dataset(
        {
            "residual": (dims, np.array(maps, np.float32), units | {"long_name": "residual of block means as height"}),
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
        coords={"plane": list(names), "row": blocks[0].row, "column": blocks[0].column},
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


def _correlation(covariance: np.ndarray) -> np.ndarray:
    sigma = np.sqrt(np.diag(covariance))
    result: np.ndarray = covariance / np.where(sigma > 0, np.outer(sigma, sigma), 1.0)
    return result


def _root_mean(values: Sequence[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values))


def _why(best: str, candidates: Sequence[Candidate], predicted: float) -> str:
    found = {each.name: each for each in candidates}
    of = {name: f"{1e6 * each.systematic:.3g} µm" for name, each in found.items()}
    noise = f"the noise of a pixel is {1e6 * predicted:.3g} µm"
    if best == "paper":
        return (
            f"The paper's six parameters leave {of['paper']} and the general model {of['general']} ({noise}): "
            "the data do not ask for more than the six."
        )
    words = (
        f"The paper's six parameters leave {of['paper']}; a projector free in its direction and roll and a free "
        f"rotation axis leave {of['general']} ({noise})."
    )
    if "k1" in best:
        words += f" With the projector's radial distortion it is {of['general + k1']}: the data ask for it."
    else:
        words += " The data ask for no distortion of the projector."
    if best.endswith("y"):
        words += f" With the centre of the distortion free it is {of[best]}."
    return words


def _warnings(
    calibration: RigCalibration,
    blocks: Sequence[PlaneBlocks],
    placement: Placement,
    used: Sequence[int],
    view: PlaneView | None,
) -> list[str]:
    warnings = [f"{plane.name}: {plane.problem}." for plane in calibration.planes if plane.problem]
    for plane in calibration.planes:
        if plane.outliers > _OUTLIERS:
            warnings.append(
                f"{plane.name}: {100 * plane.outliers:.1f} % of the pixels contradict their surroundings "
                "(wrong fringe orders, dirt or edges); they were left out."
            )
    for i, plane in enumerate(calibration.planes):
        ripple = unusual_ripple(i, blocks) / (2 * math.pi)
        if ripple and not plane.problem:
            warnings.append(
                f"{plane.name}: its phase ripples with the fringes by {ripple:.4f} fringe, the others do not: the "
                "light changed, or something moved, while its frames were taken."
            )
    ripples = np.array([blocks[i].ripple for i in used])
    usual = np.nanmedian(ripples, axis=0) if len(ripples) else np.zeros(1)
    if np.any(usual > _RIPPLE):
        harmonic = int(np.nanargmax(usual)) + 1
        warnings.append(
            f"All phases ripple {harmonic} times per fringe by {np.nanmax(usual) / (2 * math.pi):.4f} fringe: "
            + (
                "the light or the exposure is not the same for all frames."
                if harmonic <= 2
                else "measure the response curve of projector and camera, or use more shifts."
            )
        )
    angles = placement.angles[list(used)]
    if not np.ptp(placement.heights[list(used)]) and np.ptp(angles) < _SPREAD:
        warnings.append(
            f"The angles span {math.degrees(np.ptp(angles)):.1f} degree only; 20 to 30 degree calibrate the heights "
            "several times better."
        )
    if view is None:
        warnings.append(
            "The camera's tilt was not measured by a grid on the plane: it is known to a degree only, which x, y and "
            "their sigmas feel."
        )
    elif view.pin_hole is None:
        warnings.append(
            "The grid was seen on the plane at 0 degree only, which does not tell a tilted camera from a lens that is "
            "off its axis: some tenths of a percent of a motion towards the camera may turn up in x and y. Look at the "
            "grid with the plane turned to both sides as well."
        )
    if len(used) < 5:
        warnings.append(f"{len(used)} planes were fitted: with 5 or more a bad one can be recognised.")
    if math.isnan(calibration.held_out):
        warnings.append("No plane was kept out of the fit to test it.")
    if calibration.height_sigma > calibration.predicted:
        warnings.append(
            f"The calibration leaves z uncertain by up to {1e6 * calibration.height_sigma:.3g} µm, more than the noise "
            "of a pixel: use more planes or larger angles."
        )
    return warnings


def _verdict(calibration: RigCalibration) -> tuple[bool, str]:
    """Return go, and why: systematic residuals are compared with the noise of a single pixel."""
    bad = [plane for plane in calibration.planes if plane.problem]
    noise = calibration.predicted
    fitted = [plane for plane in calibration.planes if plane.fitted]
    worst = max(fitted, key=lambda plane: plane.systematic / plane.predicted)
    size = f"{1e6 * calibration.systematic:.2g} µm"
    against = f"the noise of a pixel is {1e6 * noise:.2g} µm"
    if bad:
        named = "; ".join(f"{plane.name}: {plane.problem}" for plane in bad)
        return False, f"NO-GO. {named}. Without it the planes agree to {size} ({against})."
    if worst.systematic > USABLE * worst.predicted:
        return False, (
            f"NO-GO. The planes do not agree with any rig: they deviate by {size} where {against}, most "
            f"of all {worst.name} by {1e6 * worst.systematic:.2g} µm. Did the rig move? Is the plane flat?"
        )
    if calibration.held_out > USABLE * noise:
        return False, (
            f"NO-GO. The planes kept out of the fit deviate by {1e6 * calibration.held_out:.2g} µm, those in "
            f"it by {size} ({against}): their angles are wrong, or there are too few planes in the fit."
        )
    if calibration.height_sigma > USABLE * noise:
        return False, (
            f"NO-GO. The planes leave z uncertain by {1e6 * calibration.height_sigma:.2g} µm ({against}): use more "
            "planes or larger angles."
        )
    tested = "" if math.isnan(calibration.held_out) else f", planes kept out by {1e6 * calibration.held_out:.2g} µm"
    if worst.systematic > GOOD * worst.predicted or calibration.held_out > GOOD * noise:
        return True, (
            f"GO, with care. The planes deviate by {size}{tested} from the model, more than noise explains in "
            f"{worst.name} ({1e6 * worst.systematic:.2g} µm; {against})."
        )
    return True, f"GO. The planes deviate by {size} from the model{tested}; {against}."
