"""Fits of all models to a selection of planes, and the choice between them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fringedic.calibration.closed_form import closed_form
from fringedic.calibration.fit import (
    Observations,
    Prior,
    Solution,
    StageUncertainty,
    fit,
    information_criterion,
    observe,
    parameters_of,
)
from fringedic.calibration.geometry import Camera, check_size, general_start, rig_model, six_parameter_start
from fringedic.calibration.placement import SMALLEST_MOVE, Placement
from fringedic.calibration.planes import CalibrationPlanes
from fringedic.calibration.variants import ModelVariant
from fringedic.camera.plane_homography import PinHole

_CURVED = 5.0  # standard deviations of k1 above which more of the distortion can be fitted
_ROUGH = 7  # every such block suffices to find an outlier; a prime, so that it selects no column of blocks


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
        found = {ModelVariant.SIX_PARAMETER: six}
        general = self._fit(ModelVariant.GENERAL, planes, self._general_start(six, planes))
        found[ModelVariant.GENERAL] = general
        curved = self._fit(ModelVariant.GENERAL_K1, planes, general.values)
        found[ModelVariant.GENERAL_K1] = curved
        index = curved.names.index("projector_k1")
        scatter = max(1.0, curved.reduced_chi_square)
        if abs(curved.values["projector_k1"]) > _CURVED * math.sqrt(curved.covariance[index, index] * scatter):
            for variant in (ModelVariant.GENERAL_K1_Y, ModelVariant.GENERAL_BROWN):
                found[variant] = self._fit(variant, planes, curved.values)
        return found

    def fit_roughly(self, planes: Sequence[int]) -> Solution:
        """Return a quick fit of the general model with distortion, from a part of the blocks.

        Raises
        ------
        CalibrationError
            There is no start.
        """
        six = self._fit_six(planes, _ROUGH)
        return self._fit(ModelVariant.GENERAL_K1, planes, self._general_start(six, planes), _ROUGH)

    def principal_effect(self, variant: ModelVariant, planes: Sequence[int], solution: Solution) -> float:
        """Return the effect on z of one pixel of the projector's assumed principal point, RMS over the planes [m].

        NaN when the point is fitted, or the model determines the camera's distance otherwise.
        """
        if variant is ModelVariant.SIX_PARAMETER or self.fits_principal_point:
            return math.nan
        shifted = self._fit(variant, planes, {**solution.values, "projector_principal": 1.0})
        rigs = [rig_model(self.camera, each.values) for each in (solution, shifted)]
        squares = []
        for plane in planes:
            phase = self.planes.blocks[plane].as_phase_map()
            first, second = (
                rig.reconstruct(phase, self.camera.pitch, orientation=self.camera.orientation)["z"] for rig in rigs
            )
            squares.append(float(((second - first) ** 2).mean()))
        return math.sqrt(sum(squares) / len(squares))

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

    def _fit(self, variant: ModelVariant, planes: Sequence[int], start: Mapping[str, float], skip: int = 1) -> Solution:
        priors = self.stage.priors(planes)
        free = parameters_of(
            variant,
            turned=self.placement.turned(planes),
            tilts=self.camera.plane is None or self.pin_hole is not None,
            principal=self.fits_principal_point,
            stage_errors=[*priors, *(["pixel_size"] if "pixel_size" in self.priors else [])],
        )
        priors |= self.priors
        defaults = {name: priors[name].value if name in priors else 0.0 for name in free}
        return fit(
            self.camera, self.placement, self.observations.only(planes, skip), {**defaults, **start}, free, priors
        )


def scatter_of(fits: Mapping[ModelVariant, Solution]) -> float:
    """Return s^2 of the information criterion: chi square per degree of freedom of the best fit, at least 1."""
    return max(1.0, min(each.reduced_chi_square for each in fits.values()))


def choose_model(fits: Mapping[ModelVariant, Solution], family: str | None) -> ModelVariant:
    """Return the model with the smallest information criterion, of one family when it is given.

    Parameters
    ----------
    fits
        The fitted models.
    family
        ``"six_parameter"`` or ``"general"``; None compares all.
    """
    allowed = {variant: each for variant, each in fits.items() if family in (None, variant.family)}
    scatter = scatter_of(allowed)
    return min(allowed, key=lambda variant: information_criterion(allowed[variant], scatter))
