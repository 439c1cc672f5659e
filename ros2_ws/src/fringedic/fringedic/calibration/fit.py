"""Weighted least squares of the phases of planes, and the information criterion that compares models.

Every residual is divided by the standard deviation that the noise of the phase predicts, so that the covariance is the
inverse of the normal matrix without scaling. Errors of angles and heights are parameters with priors, the standard
uncertainty of the stage; so are the coefficients of the projector's lens, with what a lens can have. Residuals that
neighbouring blocks share count as fewer blocks: their variance is multiplied by the factor of
`fringedic.calibration.residual_correlation`. Models are compared by the Bayesian information criterion (Schwarz 1978),
chi^2 / factor + parameters ln(blocks / factor).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fringedic.calibration.curved_least_squares import minimise
from fringedic.calibration.geometry import (
    AXIS,
    GENERAL,
    SCALES,
    SIX_PARAMETERS,
    Camera,
    pin_hole_deviation,
    predict,
)
from fringedic.calibration.placement import Placement, angle_error, height_error
from fringedic.calibration.planes import PlaneBlocks
from fringedic.calibration.variants import ModelVariant
from fringedic.errors import CalibrationError

_STEP = 1e-5  # of a scale, for central differences: relative error of the derivative about 1e-10
_OUT_OF_REACH = 1e6  # standard deviations; residual of parameters that are not those of a rig
MOST_STEPS = 100


@dataclass(frozen=True)
class Prior:
    """Prior knowledge of a parameter: its value and standard deviation."""

    value: float
    sigma: float


@dataclass(frozen=True)
class StageUncertainty:
    """Standard uncertainty of single angles [rad] and heights [m] of the stage; 0 for exact ones."""

    angle: float = 0.0
    height: float = 0.0

    def priors(self, planes: Sequence[int]) -> dict[str, Prior]:
        """Return the priors of the errors of angles [rad] and heights [m] of these planes."""
        priors = {}
        for plane in planes:
            if self.angle > 0:
                priors[angle_error(plane)] = Prior(0.0, self.angle)
            if self.height > 0:
                priors[height_error(plane)] = Prior(0.0, self.height)
        return priors


@dataclass(frozen=True, eq=False)
class Observations:
    """The phases that a fit explains.

    Attributes
    ----------
    planes
        Indices of the planes.
    pixels
        For each plane the ideal pixels of its blocks, (3, n): column, row, 1.
    phases, sigmas
        For each plane [rad], (n,).
    """

    planes: tuple[int, ...]
    pixels: tuple[np.ndarray, ...]
    phases: tuple[np.ndarray, ...]
    sigmas: tuple[np.ndarray, ...]

    def __len__(self) -> int:
        return sum(len(phase) for phase in self.phases)

    def only(self, planes: Sequence[int], skip: int = 1, correlation: float = 1.0) -> Observations:
        """Return the observations of some planes, every `skip`-th block, their variance multiplied by a factor."""
        spread = math.sqrt(correlation)
        chosen = [self.planes.index(plane) for plane in planes]
        return Observations(
            tuple(planes),
            tuple(self.pixels[i][:, ::skip] for i in chosen),
            tuple(self.phases[i][::skip] for i in chosen),
            tuple(spread * self.sigmas[i][::skip] for i in chosen),
        )


@dataclass(frozen=True, eq=False)
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
    correlation
        By how much the variance of smooth parameters exceeds that of as many independent blocks.
    converged
        Whether the minimum was reached.
    """

    names: tuple[str, ...]
    values: dict[str, float]
    covariance: np.ndarray
    chi_square: float
    count: int
    correlation: float = 1.0
    converged: bool = True

    @property
    def freedom(self) -> int:
        """Number of blocks minus number of parameters."""
        return max(1, self.count - len(self.names))

    @property
    def reduced_chi_square(self) -> float:
        """Chi square per degree of freedom."""
        return self.chi_square / self.freedom


def observe(camera: Camera, planes: Sequence[PlaneBlocks]) -> Observations:
    """Return the measured blocks of all planes."""
    pixels, phases, sigmas = [], [], []
    for plane in planes:
        column, row = np.meshgrid(plane.column, plane.row)
        known = np.isfinite(plane.phase)
        ideal = camera.ideal(column[known], row[known])
        pixels.append(np.stack([*ideal, np.ones(int(known.sum()))]))
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
    most_steps: int = MOST_STEPS,
) -> Solution:
    """Fit the free parameters.

    Parameters
    ----------
    camera, placement, observations
        The known part of the rig, the stated positions of the planes, and the phases to be explained.
    start
        Values of all parameters (SI, px).
    free
        Parameters to be fitted; the others keep their value of `start`.
    priors
        Of free parameters. The pin-hole that grids on the tilted plane located is added as an observation where the
        camera's tilt is free.
    most_steps
        The search ends after so many steps.
    """
    names = tuple(free)
    fixed = dict(start)
    scales = np.array(
        [
            (1e-3 if name.startswith("angle_error") else 1e-4 if name.startswith("height_error") else SCALES[name])
            for name in names
        ]
    )
    phases, sigmas = np.concatenate(observations.phases), np.concatenate(observations.sigmas)
    held = [(i, priors[name]) for i, name in enumerate(names) if name in priors]
    pin_hole = camera.plane.pin_hole if camera.plane is not None and "camera_tilt_x" in names else None

    def residuals(scaled: np.ndarray) -> np.ndarray:
        values = {**fixed, **dict(zip(names, (scaled * scales).tolist(), strict=True))}
        try:
            seen = predict(camera, values, placement, observations.planes, observations.pixels)
        except CalibrationError:
            seen = np.full_like(phases, np.nan)
        known = [(scaled[i] * scales[i] - prior.value) / prior.sigma for i, prior in held]
        if pin_hole is not None:
            known += pin_hole_deviation(camera, pin_hole, values).tolist()
        deviations: np.ndarray = np.concatenate([(seen - phases) / sigmas, known])
        residual: np.ndarray = np.nan_to_num(deviations, nan=_OUT_OF_REACH)
        return residual

    def jacobian(scaled: np.ndarray) -> np.ndarray:
        columns = []
        for i in range(len(names)):
            step = np.zeros(len(names))
            step[i] = _STEP
            columns.append((residuals(scaled + step) - residuals(scaled - step)) / (2 * _STEP))
        return np.stack(columns, axis=1)

    found = minimise(residuals, jacobian, np.array([start[name] for name in names]) / scales, most_steps)
    normal = found.jacobian.T @ found.jacobian
    unit = np.sqrt(np.diag(normal))
    unit = np.where(unit > 0, unit, 1.0)
    covariance = np.linalg.pinv(normal / np.outer(unit, unit), rcond=1e-14, hermitian=True) / np.outer(unit, unit)
    return Solution(
        names=names,
        values={**fixed, **dict(zip(names, (found.x * scales).tolist(), strict=True))},
        covariance=covariance * np.outer(scales, scales),
        chi_square=float(found.residual @ found.residual),
        count=len(observations),
        converged=found.converged,
    )


def information_criterion(solution: Solution, correlation: float) -> float:
    """Return chi^2 / factor + parameters ln(blocks / factor); the lower the better."""
    return solution.chi_square / correlation + len(solution.names) * math.log(solution.count / correlation)


def parameters_of(
    variant: ModelVariant, *, turned: bool, tilts: bool, principal: bool, stage_errors: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the free parameters of a model.

    Parameters
    ----------
    variant
        The model.
    turned
        The planes have several angles: the rotation axis is fitted.
    tilts, principal
        The camera's tilts and the projector's principal point are fitted, by the general model.
    stage_errors
        Names of errors of angles and heights.
    """
    if variant is ModelVariant.SIX_PARAMETER:
        names = tuple(name for name in SIX_PARAMETERS if turned or name != "axis_position")
        return (*names, *stage_errors)
    names = GENERAL + (AXIS if turned else ())
    names += ("camera_tilt_x", "camera_tilt_y") if tilts else ()
    names += ("projector_principal",) if principal else ()
    return (*names, *stage_errors)
