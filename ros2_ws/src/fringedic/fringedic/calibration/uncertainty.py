"""Uncertainties that a calibration leaves, and the measurement that reduces each of them most."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np

from fringedic.calibration.findings import Action, CalibrationWarning
from fringedic.calibration.fit import Solution
from fringedic.calibration.geometry import SCALES, Camera, place_planes, rig_model
from fringedic.calibration.models import ModelFitter
from fringedic.calibration.placement import Placement
from fringedic.calibration.variants import ModelVariant
from fringedic.camera.plane_homography import PinHole, PlaneHomography
from fringedic.patterns.pattern import Orientation
from fringedic.rig.geometry import PARAMETERS, parameter_values
from fringedic.rig.model import RigModel
from fringedic.rig.uncertainty import displacement_variance, position_errors

_STEP = 1e-5  # central differences use this part of the scale of a parameter
_MOTION = 1e-3  # [m] towards the camera; the uncertainty grows in proportion to it
_POINTS = 7  # along each side of the image
_LOCATED = (1e-4, 5e-5, 5e-5)  # of h0: how well grids on tilted planes usually locate the pin-hole (height, foot)
_WIDEST = math.radians(20)  # to which angles are advised; the fringes of steeper planes lose contrast


def rig_with_covariance(camera: Camera, solution: Solution) -> RigModel:
    """Return the fitted rig with the covariance of the model's own parameters (linear propagation)."""
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
        parameter_names=tuple(name for name, use in zip(names, known, strict=True) if use),
        covariance=tuple(covariance[np.ix_(known, known)].ravel().tolist()),
    )


def motion_sigma(model: RigModel, orientation: Orientation) -> float:
    """Return the standard uncertainty of u or v after a motion along z, over the motion.

    It is due to the covariance of the calibration alone: the larger of u and v, RMS over the image. The camera's tilt
    contributes most where no grid was measured, 17 um for each millimetre and degree.
    """
    column, row = np.meshgrid(
        np.linspace(0, model.camera_width - 1, _POINTS), np.linspace(0, model.camera_height - 1, _POINTS)
    )
    before, after = np.zeros(column.shape), np.full(column.shape, _MOTION)
    variance = displacement_variance(model, (column, row, before), (column, row, after), orientation)
    return math.sqrt(float(variance[:2].mean(axis=(1, 2)).max())) / _MOTION


def height_sigma(fitter: ModelFitter, planes: Sequence[int], solution: Solution, model: RigModel) -> float:
    """Return the largest standard deviation of z due to the calibration, at the corners of the fitted planes [m]."""
    camera, values = fitter.camera, solution.values
    largest = 0.0
    placed = place_planes(camera, values, *fitter.placement.of(planes, values))
    for index, normal, offset in zip(planes, *placed, strict=True):
        plane = fitter.planes.blocks[index]
        column, row = np.meshgrid(plane.column[[0, -1]], plane.row[[0, -1]])
        rays = np.stack([*camera.ideal(column, row), np.ones(column.shape)], axis=-1) @ model.ray_matrix.T
        along = (offset - normal[2] * model.camera_distance) / (rays @ normal)
        z = model.camera_distance + along * rays[..., 2]
        errors = position_errors(model, column, row, z, camera.orientation)
        largest = max(largest, float(np.sqrt(np.sum(errors[:, 2] ** 2, axis=0)).max()))
    return largest


def best_actions(
    fitter: ModelFitter, planes: Sequence[int], variant: ModelVariant, solution: Solution
) -> dict[CalibrationWarning, tuple[Action, float]]:
    """Return the measurement that reduces each uncertainty most, with the value that it would have.

    The covariance of each measurement is that of its own geometry and of the noise of the present one.

    Parameters
    ----------
    fitter, planes, variant, solution
        The calibration: its planes, those that were fitted, and the chosen model.

    Returns
    -------
    dict
        For ``UNCERTAIN_HEIGHT`` the action and its `height_sigma` at the present planes [m], for ``UNCERTAIN_MOTION``
        the action and its `motion_sigma`.
    """
    heights, motions = {}, {}
    for action, changed in _actions(fitter, planes, solution):
        model = rig_with_covariance(changed.camera, changed.expect(variant, planes, solution))
        heights[action] = height_sigma(fitter, planes, solution, model)
        motions[action] = motion_sigma(model, fitter.camera.orientation)
    return {
        code: min(values.items(), key=lambda each: each[1])
        for code, values in (
            (CalibrationWarning.UNCERTAIN_HEIGHT, heights),
            (CalibrationWarning.UNCERTAIN_MOTION, motions),
        )
    }


def _actions(fitter: ModelFitter, planes: Sequence[int], solution: Solution) -> Iterator[tuple[Action, ModelFitter]]:
    """Yield what can be measured in addition, as the fitter of the calibration that it would give."""
    camera, placement = fitter.camera, fitter.placement
    if fitter.pin_hole is None:
        distance = solution.values["camera_distance"]
        located = PinHole(distance, 0.0, 0.0, np.diag(np.square(distance * np.array(_LOCATED))))
        plane = camera.plane or _untilted_view(camera)
        untilted = {name: prior for name, prior in fitter.priors.items() if not name.startswith("camera_tilt")}
        seen = dataclasses.replace(camera, plane=dataclasses.replace(plane, pin_hole=located))
        yield Action.GRIDS, dataclasses.replace(fitter, camera=seen, priors=untilted)
    widest = float(np.abs(placement.angles[list(planes)]).max())
    if 0 < widest < _WIDEST:
        wider = Placement(placement.angles * min(2.0, _WIDEST / widest), placement.heights)
        yield Action.ANGLES, dataclasses.replace(fitter, planes=dataclasses.replace(fitter.planes, placement=wider))
    twice = tuple(dataclasses.replace(each, sigma=each.sigma / math.sqrt(2)) for each in fitter.planes.blocks)
    yield Action.PLANES, dataclasses.replace(fitter, planes=dataclasses.replace(fitter.planes, blocks=twice))


def _untilted_view(camera: Camera) -> PlaneHomography:
    size, column, row = camera.pixel_size, camera.principal_column, camera.principal_row
    across = size / camera.pixel_aspect
    view = np.array([[across, 0.0, -across * column], [0.0, -size, size * row], [0.0, 0.0, 1.0]])
    return PlaneHomography(view, column, row)
