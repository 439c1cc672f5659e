"""Fits of all models to a selection of planes, and the choice between them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fringedic.calibration.closed_form import closed_form
from fringedic.calibration.fit import (
    MOST_STEPS,
    Observations,
    Prior,
    Solution,
    StageUncertainty,
    fit,
    information_criterion,
    observe,
    parameters_of,
)
from fringedic.calibration.geometry import Camera, check_size, general_start, predict, rig_model, six_parameter_start
from fringedic.calibration.placement import SMALLEST_MOVE, Placement
from fringedic.calibration.planes import CalibrationPlanes
from fringedic.calibration.residual_correlation import residual_correlation
from fringedic.calibration.variants import ModelVariant
from fringedic.camera.plane_homography import PinHole

# Standard uncertainty of a term of the distortion at the corner of the projector's image, over the distance of the
# corner from the axis, and the power of this distance [focal length] in the term.
_LARGEST_DISTORTION = {
    "projector_k1": (2e-2, 2),
    "projector_k2": (1e-2, 4),
    "projector_k3": (3e-3, 6),
    "projector_p1": (5e-4, 1),
    "projector_p2": (5e-4, 1),
}
# Standard uncertainty of the rotation axis: its direction [rad], and its position over the camera's distance.
_AXIS_DIRECTION = {"axis_skew": 0.05, "axis_slope": 0.05}
_AXIS_POSITION = {"axis_across": 0.1, "axis_height": 0.25}
_ALONG = 0.1  # standard uncertainty of the projector's position along the fringes, over the camera's distance
# The variance of the phases is multiplied by these factors first. As long as the priors hold the parameters which the
# planes determine least, the others approach their values, and the curved valleys of the sum of squares become short.
_CONTINUATION = (1e6, 1e3, 1.0)
_ROUGH = 7  # every such block suffices to find an outlier; a prime, so that it selects no column of blocks
_ROUGH_STEPS = 30  # suffice for residuals; what moves along a valley of the sum of squares later changes none of them


@dataclass(frozen=True, eq=False)
class ModelFitter:
    """Fits the possible models to a selection of planes.

    Attributes
    ----------
    camera
        The known part of the rig.
    planes
        All planes.
    priors
        Of the camera's parameters.
    stage
        Standard uncertainty of angles and heights.
    """

    camera: Camera
    planes: CalibrationPlanes
    priors: Mapping[str, Prior]
    stage: StageUncertainty

    @property
    def placement(self) -> Placement:
        """Stated angles and heights of the planes."""
        return self.planes.placement

    @cached_property
    def observations(self) -> Observations:
        """Measured blocks of all planes."""
        return observe(self.camera, self.planes.blocks)

    @property
    def pin_hole(self) -> PinHole | None:
        """The pin-hole that grids on the tilted plane located, None without them."""
        return None if self.camera.plane is None else self.camera.plane.pin_hole

    @property
    def fits_principal_point(self) -> bool:
        """Whether translated planes, or a known distance, determine the projector's principal point."""
        known = "camera_distance" in self.priors or self.pin_hole is not None
        return known or float(np.ptp(self.placement.heights)) > SMALLEST_MOVE

    def fit_all(self, planes: Sequence[int]) -> dict[ModelVariant, Solution]:
        """Return the fits of all models to some planes.

        Raises
        ------
        CalibrationError
            There is no start.
        """
        six = self._fit_six(planes)
        near = self.fit_roughly(planes).values
        best = self._fit(ModelVariant.GENERAL, planes, near, most_steps=_ROUGH_STEPS)
        correlation = residual_correlation([self.residual(best, plane) for plane in planes])
        starts = {ModelVariant.SIX_PARAMETER: six.values, ModelVariant.GENERAL: best.values}
        return {
            variant: self._fit(variant, planes, values, correlation=correlation) for variant, values in starts.items()
        }

    def residual(self, solution: Solution, plane: int) -> np.ndarray:
        """Return measured minus predicted phase of the blocks of a plane in units of their deviation, (row, column)."""
        blocks = self.planes.blocks[plane]
        column, row = self.camera.ideal(*np.meshgrid(blocks.column, blocks.row))
        pixels = np.stack([column.ravel(), row.ravel(), np.ones(column.size)])
        predicted = predict(self.camera, solution.values, self.placement, (plane,), (pixels,)).reshape(column.shape)
        deviation: np.ndarray = (blocks.phase - predicted) / blocks.sigma
        return deviation

    @cached_property
    def _rough_fits(self) -> dict[tuple[int, ...], Solution]:
        """The quick fits so far, by their planes: the search for outliers and the fit itself need the same one."""
        return {}

    def fit_roughly(self, planes: Sequence[int]) -> Solution:
        """Return a quick fit of the general model, from a part of the blocks.

        Raises
        ------
        CalibrationError
            There is no start.
        """
        chosen = tuple(planes)
        if chosen not in self._rough_fits:
            values = self._general_start(self._fit_six(planes, _ROUGH), planes)
            for correlation in _CONTINUATION:
                fitted = self._fit(ModelVariant.GENERAL, planes, values, _ROUGH, correlation, _ROUGH_STEPS)
                values = fitted.values
            self._rough_fits[chosen] = fitted
        return self._rough_fits[chosen]

    def principal_effect(self, variant: ModelVariant, planes: Sequence[int], solution: Solution) -> float:
        """Return the effect on z of one pixel of the projector's assumed principal point, RMS over the planes [m].

        NaN when the point is fitted, or the model determines the camera's distance otherwise.
        """
        if variant is ModelVariant.SIX_PARAMETER or self.fits_principal_point:
            return math.nan
        shifted = self._fit(
            variant, planes, {**solution.values, "projector_principal": 1.0}, _ROUGH, most_steps=_ROUGH_STEPS
        )
        rigs = [rig_model(self.camera, each.values) for each in (solution, shifted)]
        squares = []
        for plane in planes:
            phase = self.planes.blocks[plane].as_phase_map()
            first, second = (
                rig.reconstruct(phase, self.camera.pitch, orientation=self.camera.orientation)["z"] for rig in rigs
            )
            squares.append(float(((second - first) ** 2).mean()))
        return math.sqrt(sum(squares) / len(squares))

    def expect(self, variant: ModelVariant, planes: Sequence[int], solution: Solution) -> Solution:
        """Return a solution with the covariance that its values have with the camera and planes of this fitter."""
        return self._fit(variant, planes, solution.values, _ROUGH, solution.correlation / _ROUGH, most_steps=0)

    def _fit_six(self, planes: Sequence[int], skip: int = 1) -> Solution:
        column, row = np.meshgrid(self.planes.blocks[0].column, self.planes.blocks[0].row)
        across, along = self.camera.on_reference(*self.camera.ideal(column, row))
        some = list(planes)
        placement = Placement(self.placement.angles[some], self.placement.heights[some])
        found = closed_form([self.planes.blocks[i] for i in some], across, along, placement)
        check_size(self.camera, found.camera_distance)  # a wrong unit: no fit would converge
        start = six_parameter_start(found, self.camera)
        return self._fit(ModelVariant.SIX_PARAMETER, planes, start, skip)

    def _general_start(self, six: Solution, planes: Sequence[int]) -> dict[str, float]:
        start = general_start(six.values, self.camera, self.placement.turned(planes))
        if self.camera.plane is not None and self.pin_hole is not None:
            seen = self.camera.plane.camera(self.pin_hole.distance)
            start |= {name: seen[name] for name in ("camera_tilt_x", "camera_tilt_y")}
        return start

    def _lens_priors(self, start: Mapping[str, float]) -> dict[str, Prior]:
        """Return what the lens of a projector can have: distortion at the corner of its image, over the distance."""
        corner = 0.5 * math.hypot(self.camera.projector_width, self.camera.projector_height)
        radius = corner / start["projector_focal_length"]
        priors = {name: Prior(0.0, part / radius**power) for name, (part, power) in _LARGEST_DISTORTION.items()}
        priors["projector_along"] = Prior(0.0, _ALONG * start["camera_distance"])
        return priors

    @staticmethod
    def _axis_priors(start: Mapping[str, float]) -> dict[str, Prior]:
        position = {name: part * start["camera_distance"] for name, part in _AXIS_POSITION.items()}
        return {name: Prior(0.0, sigma) for name, sigma in (_AXIS_DIRECTION | position).items()}

    def _fit(
        self,
        variant: ModelVariant,
        planes: Sequence[int],
        start: Mapping[str, float],
        skip: int = 1,
        correlation: float = 1.0,
        most_steps: int = MOST_STEPS,
    ) -> Solution:
        priors = self.stage.priors(planes)
        free = parameters_of(
            variant,
            turned=self.placement.turned(planes),
            tilts=self.camera.plane is None or self.pin_hole is not None,
            principal=self.fits_principal_point,
            stage_errors=[*priors, *(["pixel_size"] if "pixel_size" in self.priors else [])],
        )
        priors |= self.priors
        if variant is ModelVariant.GENERAL:
            priors |= self._lens_priors(start) | self._axis_priors(start)
        defaults = {name: priors[name].value if name in priors else 0.0 for name in free}
        observed = self.observations.only(planes, skip, correlation)
        found = fit(self.camera, self.placement, observed, {**defaults, **start}, free, priors, most_steps)
        return replace(found, chi_square=correlation * found.chi_square, correlation=correlation)


def choose_model(fits: Mapping[ModelVariant, Solution], family: str | None) -> ModelVariant:
    """Return the model that is used: that of one family when it is given.

    The general model always contains the distortion of the projector's lens. The data and the priors of its
    coefficients decide how much of it is seen, and the uncertainty contains the rest. A choice between models with
    nearly the same evidence would leave it out.

    Parameters
    ----------
    fits
        The fitted models.
    family
        ``"six_parameter"`` or ``"general"``; None compares both.
    """
    if family is not None:
        return ModelVariant(family)
    return min(fits, key=lambda variant: information_criterion(fits[variant], fits[variant].correlation))
