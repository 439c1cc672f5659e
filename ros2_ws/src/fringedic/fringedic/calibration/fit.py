"""Weighted least squares of the phases of planes, and the choice of the model that the data ask for.

Every residual is divided by the standard deviation that the phase's own noise predicts, so that the covariance is the
inverse of the normal matrix, scaled by nothing. Errors of angles and heights are parameters of their own, held by what
is known of the stage. Models are compared by the Bayesian information criterion, chi^2 / s^2 + parameters ln(blocks);
s^2 is 1, or more when even the richest model leaves more than noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from fringedic.calibration.geometry import (
    AXIS,
    GENERAL,
    PAPER,
    SCALES,
    Camera,
    Placement,
    angle_error,
    height_error,
    pin_hole_deviation,
    predict,
)
from fringedic.calibration.planes import PlaneBlocks
from fringedic.errors import InvalidCalibrationError

_STEP = 1e-5  # of a scale, for central differences: 1e-10 of the derivative
_OUT_OF_REACH = 1e6  # residual of parameters that mean no rig
_TOLERANCE = 1e-10
_MOST_STEPS = 60


@dataclass(frozen=True)
class Prior:
    """What is known of a parameter before the fit: its value and the standard deviation of that."""

    value: float
    sigma: float


@dataclass(frozen=True)
class Observations:
    """The phases that a fit explains.

    Attributes
    ----------
    planes
        Indices of the planes.
    pixels
        For each plane the ideal pixels of its blocks, (n, 3): column, row, 1.
    phases, sigmas
        For each plane [rad], (n,).
    """

    planes: tuple[int, ...]
    pixels: tuple[np.ndarray, ...]
    phases: tuple[np.ndarray, ...]
    sigmas: tuple[np.ndarray, ...]

    def __len__(self) -> int:
        return sum(len(phase) for phase in self.phases)

    def only(self, planes: Sequence[int], skip: int = 1) -> Observations:
        """Return those of some planes, every `skip`-th block."""
        chosen = [self.planes.index(plane) for plane in planes]
        return Observations(
            tuple(planes),
            tuple(self.pixels[i][::skip] for i in chosen),
            tuple(self.phases[i][::skip] for i in chosen),
            tuple(self.sigmas[i][::skip] for i in chosen),
        )


@dataclass(frozen=True)
class Solution:
    """A fitted model.

    Attributes
    ----------
    names
        Of the free parameters.
    values
        All parameters by name (SI, px), those that are fixed included.
    covariance
        Of the free parameters.
    chi_square
        Sum of squares of the residuals of blocks in units of their standard deviation, priors included.
    count
        Number of blocks.
    """

    names: tuple[str, ...]
    values: dict[str, float]
    covariance: np.ndarray
    chi_square: float
    count: int

    @property
    def freedom(self) -> int:
        """Blocks beyond parameters."""
        return max(1, self.count - len(self.names))


def observe(camera: Camera, planes: Sequence[PlaneBlocks]) -> Observations:
    """Return the blocks of all planes that are measured."""
    pixels, phases, sigmas = [], [], []
    for plane in planes:
        column, row = np.meshgrid(plane.column, plane.row)
        known = np.isfinite(plane.phase)
        ideal = camera.ideal(column[known], row[known])
        pixels.append(np.stack([*ideal, np.ones(int(known.sum()))], axis=-1))
        phases.append(plane.phase[known])
        sigmas.append(plane.sigma[known])
    return Observations(tuple(range(len(planes))), tuple(pixels), tuple(phases), tuple(sigmas))


def fit(
    camera: Camera,
    placement: Placement,
    observations: Observations,
    start: Mapping[str, float],
    free: Sequence[str],
    priors: Mapping[str, Prior],
) -> Solution:
    """Fit the free parameters, from a start that names all parameters.

    Parameters
    ----------
    free
        Parameters to be found; the others of `start` stay as they are.
    priors
        Of free parameters. What is known of the pin-hole by grids on the turned plane is added where the camera's tilt
        is free.
    """
    names = tuple(free)
    fixed = dict(start)
    scales = np.array([_scale(name) for name in names])
    phases, sigmas = np.concatenate(observations.phases), np.concatenate(observations.sigmas)
    held = [(i, priors[name]) for i, name in enumerate(names) if name in priors]
    pin_hole = camera.plane.pin_hole if camera.plane is not None and "camera_tilt_x" in names else None

    def residuals(scaled: np.ndarray) -> np.ndarray:
        values = {**fixed, **dict(zip(names, (scaled * scales).tolist(), strict=True))}
        try:
            seen = predict(camera, values, placement, observations.planes, observations.pixels)
        except InvalidCalibrationError:
            seen = np.full_like(phases, np.nan)
        known = [(scaled[i] * scales[i] - prior.value) / prior.sigma for i, prior in held]
        if pin_hole is not None:
            known += pin_hole_deviation(camera, pin_hole, values).tolist()
        return np.nan_to_num(np.concatenate([(seen - phases) / sigmas, known]), nan=_OUT_OF_REACH)

    def jacobian(scaled: np.ndarray) -> np.ndarray:
        columns = []
        for i in range(len(names)):
            step = np.zeros(len(names))
            step[i] = _STEP
            columns.append((residuals(scaled + step) - residuals(scaled - step)) / (2 * _STEP))
        return np.stack(columns, axis=1)

    found = least_squares(
        residuals,
        np.array([start[name] for name in names]) / scales,
        jac=jacobian,
        method="lm",
        x_scale="jac",
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        gtol=_TOLERANCE,
        max_nfev=_MOST_STEPS,
    )
    slopes = np.asarray(found.jac)
    normal = slopes.T @ slopes
    unit = np.sqrt(np.diag(normal))
    unit = np.where(unit > 0, unit, 1.0)
    covariance = np.linalg.pinv(normal / np.outer(unit, unit), rcond=1e-14, hermitian=True) / np.outer(unit, unit)
    return Solution(
        names=names,
        values={**fixed, **dict(zip(names, (found.x * scales).tolist(), strict=True))},
        covariance=covariance * np.outer(scales, scales),
        chi_square=float(2 * found.cost),
        count=len(observations),
    )


def information_criterion(solution: Solution, scatter: float) -> float:
    """Return chi^2 / s^2 + parameters ln(blocks); the lower the better."""
    return solution.chi_square / scatter + len(solution.names) * math.log(solution.count)


def parameters_of(
    model: str, *, turned: bool, tilts: bool, principal: bool, stage_errors: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the free parameters of a model.

    Parameters
    ----------
    model
        "paper"; "general"; "general + k1"; "general + k1 + y": the projector's position along the fringes, which shifts
        the centre of its distortion.
    turned
        Planes stand at several angles: the axis is sought.
    tilts, principal
        The camera's tilts and the projector's principal point are sought, by the general model.
    stage_errors
        Names of errors of angles and heights.
    """
    if model == "paper":
        names = PAPER if turned else tuple(name for name in PAPER if name != "axis_position")
        return (*names, *stage_errors)
    names = GENERAL + (AXIS if turned else ())
    names += ("camera_tilt_x", "camera_tilt_y") if tilts else ()
    names += ("projector_principal",) if principal else ()
    names += ("projector_k1",) if "k1" in model else ()
    names += ("projector_along",) if model.endswith("y") else ()
    return (*names, *stage_errors)


def stage_priors(planes: Sequence[int], sigma_angle: float, sigma_height: float) -> dict[str, Prior]:
    """Return the priors of the errors of angles [rad] and heights [m] of these planes."""
    priors = {}
    for plane in planes:
        if sigma_angle > 0:
            priors[angle_error(plane)] = Prior(0.0, sigma_angle)
        if sigma_height > 0:
            priors[height_error(plane)] = Prior(0.0, sigma_height)
    return priors


def _scale(name: str) -> float:
    if name.startswith("angle_error"):
        return 1e-3
    return 1e-4 if name.startswith("height_error") else SCALES[name]
