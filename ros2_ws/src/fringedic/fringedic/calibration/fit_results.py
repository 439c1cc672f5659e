"""The figures of a calibration: residuals beside the predicted noise, parameters, candidates, and the verdict."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

import numpy as np
import xarray as xr

from fringedic.calibration.findings import CalibrationWarning
from fringedic.calibration.placement import Placement
from fringedic.calibration.planes import response_ripple
from fringedic.calibration.variants import ModelVariant
from fringedic.camera.findings import Finding
from fringedic.patterns.pattern import Orientation
from fringedic.rig.model import RigModel

# Limits of the systematic residual in units of the noise of one pixel (docs/calibration.md, figures of the report).
GOOD = 1.0
USABLE = 3.0


class Verdict(StrEnum):
    """Whether a calibration can be used."""

    GO = "GO"
    GO_WITH_CARE = "GO with care"
    NO_GO = "NO-GO"


class Reason(StrEnum):
    """Reason of a verdict."""

    WITHIN_NOISE = "within_noise"
    BEYOND_NOISE = "beyond_noise"  # a plane deviates by more than its noise, and less than USABLE times that
    BAD_IMAGE = "bad_image"
    NO_RIG_FITS = "no_rig_fits"
    HELD_OUT_DEVIATES = "held_out_deviates"
    UNCERTAIN_HEIGHT = "uncertain_height"
    NOT_CONVERGED = "not_converged"


_VERDICTS = {Reason.WITHIN_NOISE: Verdict.GO, Reason.BEYOND_NOISE: Verdict.GO_WITH_CARE}


@dataclass(frozen=True)
class PlaneResult:
    """One plane beside the fitted model.

    Attributes
    ----------
    name
        For people: "image 3 (angle +5 degree)".
    angle, height
        As stated [rad], [m].
    fitted
        False for a plane that was kept out of the fit, or is an outlier.
    residual_phase, predicted_phase
        Root mean square of the pixels' residual and of their predicted noise [rad].
    residual, predicted
        The same as heights [m].
    systematic, systematic_noise
        Root mean square of the residual of block means and of its predicted noise, as heights [m].
    chi_square
        Mean square of the pixels' residual in units of the predicted variance: 1 for noise alone.
    valid, outliers
        Share of the image that is measured, and share of pixels that contradict their surroundings.
    ripple
        Amplitudes of the residual at 1 to 6 times the frequency of the fringes [rad].
    problem
        Why this image contradicts the others; None when it does not.
    """

    name: str
    angle: float
    height: float
    fitted: bool
    residual_phase: float
    predicted_phase: float
    residual: float
    predicted: float
    systematic: float
    systematic_noise: float
    chi_square: float
    valid: float
    outliers: float
    ripple: tuple[float, ...]
    problem: Finding | None = None


@dataclass(frozen=True)
class Parameter:
    """One fitted parameter in the units of people.

    Attributes
    ----------
    name, title, unit
        Its name in the fit, its name for people, and the unit of value and sigma.
    value, sigma
        With the standard deviation due to the noise of the phase.
    """

    name: str
    title: str
    unit: str
    value: float
    sigma: float


@dataclass(frozen=True)
class Candidate:
    """One of the fitted models.

    Attributes
    ----------
    name
        Which model.
    parameters
        Number of free parameters.
    chi_square
        Sum of squares of the blocks' residuals in units of their standard deviation, per degree of freedom.
    criterion
        Bayesian information criterion relative to the chosen model.
    systematic
        Root mean square of the blocks' residual as height [m].
    """

    name: ModelVariant
    parameters: int
    chi_square: float
    criterion: float
    systematic: float


@dataclass(frozen=True, eq=False)
class FitResult:
    """Everything that a calibration found; `fringedic.calibration.RigCalibration` describes the attributes."""

    model: RigModel
    pitch: float
    orientation: Orientation
    variant: ModelVariant
    candidates: tuple[Candidate, ...]
    planes: tuple[PlaneResult, ...]
    parameters: tuple[Parameter, ...]
    correlation: np.ndarray
    chi_square: float
    residual: float
    predicted: float
    systematic: float
    held_out: float
    height_sigma: float
    principal_effect: float
    residual_map: xr.Dataset
    warnings: tuple[Finding, ...]
    created: datetime
    summary: str = ""

    @property
    def chosen(self) -> str:
        """Name of the model in files: "six_parameter" or "general"."""
        return str(self.variant)

    @property
    def bad_images(self) -> tuple[str, ...]:
        """Names of the images that contradict the others."""
        return tuple(plane.name for plane in self.planes if plane.problem)

    @property
    def worst_plane(self) -> PlaneResult:
        """The fitted plane whose residual is largest in units of its noise."""
        return max(
            (plane for plane in self.planes if plane.fitted), key=lambda plane: plane.systematic / plane.predicted
        )

    @property
    def reason(self) -> Reason:
        """The reason of the verdict: systematic residuals are compared with the noise of a single pixel."""
        worst = self.worst_plane
        if self.bad_images:
            return Reason.BAD_IMAGE
        if worst.systematic > USABLE * worst.predicted:
            return Reason.NO_RIG_FITS
        if self.held_out > USABLE * self.predicted:
            return Reason.HELD_OUT_DEVIATES
        if self.height_sigma > USABLE * self.predicted:
            return Reason.UNCERTAIN_HEIGHT
        if any(each.code is CalibrationWarning.NOT_CONVERGED for each in self.warnings):
            return Reason.NOT_CONVERGED
        if worst.systematic > GOOD * worst.predicted or self.held_out > GOOD * self.predicted:
            return Reason.BEYOND_NOISE
        return Reason.WITHIN_NOISE

    @property
    def verdict(self) -> Verdict:
        """Whether the calibration can be used."""
        return _VERDICTS.get(self.reason, Verdict.NO_GO)

    @property
    def go(self) -> bool:
        """Whether the calibration can be used, possibly with care."""
        return self.verdict is not Verdict.NO_GO

    @property
    def tested(self) -> bool:
        """Whether a plane kept out of the fit tests it: the first one repeated shows drift alone."""
        placement = Placement.stated(
            len(self.planes), [plane.angle for plane in self.planes], [plane.height for plane in self.planes]
        )
        kept_out = [index for index, plane in enumerate(self.planes) if not plane.fitted and not plane.problem]
        fitted = [index for index, plane in enumerate(self.planes) if plane.fitted]
        return any(all(placement.apart(index, other) for other in fitted) for index in kept_out)

    @property
    def response(self) -> float:
        """Ripple of the fitted planes due to the response of projector and camera, median over them [rad]."""
        return float(np.median([response_ripple(plane.ripple) for plane in self.planes if plane.fitted]))
