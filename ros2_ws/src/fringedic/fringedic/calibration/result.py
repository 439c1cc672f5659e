"""What a calibration of the rig found: model, residuals beside the predicted noise, sigmas, verdict; and its files."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml

from fringedic.calibration.planes import response_ripple
from fringedic.errors import CalibrationFileError, InvalidCalibrationError
from fringedic.rig import RigModel
from fringedic.sequence import Orientation

MODEL_FILE = "calibration.yaml"
FIT_FILE = "calibration_fit.yaml"
RESIDUAL_FILE = "calibration_residuals.nc"
_VERSION = 1
_MICRO, _MILLI = 1e-6, 1e-3
_FRINGE = 2 * math.pi


@dataclass(frozen=True)
class PlaneResult:
    """One plane beside the fitted model.

    Attributes
    ----------
    name
        For people: "image 3 (angle +5 degree)".
    angle, height
        As given [rad], [m].
    fitted
        False: kept out of the fit, or found to be bad.
    residual_phase, predicted_phase
        Root mean square of the pixels' residual and of their predicted noise [rad].
    residual, predicted
        The same as heights [m].
    systematic, systematic_noise
        Root mean square of the residual of blocks and of its predicted noise, as heights [m].
    chi_square
        Mean square of the pixels' residual in units of the predicted variance: 1 when there is noise alone.
    valid, outliers
        Share of the image that is measured, and of pixels that contradict their surroundings.
    ripple
        Amplitudes of the residual at 1 to 6 times the fringes' frequency [rad].
    problem
        What is wrong with this image, in words; empty when nothing is.
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
    problem: str = ""


@dataclass(frozen=True)
class Parameter:
    """One fitted parameter in the units of people.

    Attributes
    ----------
    name, title, unit
        Its name in the fit, in words, and the unit of value and sigma.
    value, sigma
        With the standard deviation that the phase's noise leaves.
    """

    name: str
    title: str
    unit: str
    value: float
    sigma: float


@dataclass(frozen=True)
class Candidate:
    """One of the models that were tried.

    Attributes
    ----------
    name
        "paper", "general", "general + k1", ...
    parameters
        How many are free.
    chi_square
        Sum of squares of the blocks' residuals in units of their standard deviation, per degree of freedom.
    criterion
        Bayesian information criterion relative to the chosen model.
    systematic
        Root mean square of the blocks' residual as height [m].
    """

    name: str
    parameters: int
    chi_square: float
    criterion: float
    systematic: float


@dataclass(frozen=True)
class RigCalibration:
    """A calibrated rig and how far it can be trusted.

    Attributes
    ----------
    model
        The rig with the covariance of its parameters.
    pitch, orientation
        Of the fringes that the planes were measured with [projector px].
    chosen
        "paper" or "general".
    why
        Why this model, in words.
    candidates
        The models that were tried.
    planes
        Every plane beside the model.
    parameters, correlation
        Fitted parameters, and the correlation of their errors (n, n).
    chi_square
        Sum of squares of the blocks' residuals per degree of freedom, in units of the predicted variance.
    residual, predicted, systematic, held_out
        Root mean squares over the fitted planes as heights [m]: of pixels, of their predicted noise, of blocks, and
        of the blocks of planes kept out of the fit (NaN without one).
    height_sigma
        Largest standard deviation of z that the calibration itself brings, over the calibrated volume [m].
    residual_map
        ``residual`` and ``noise`` [m] of blocks with the dimensions plane, row, column.
    principal_effect
        What one pixel of error of the assumed principal point of the projector does to z over the calibrated volume
        [m]; NaN when it was fitted.
    warnings
        Sentences.
    go, verdict
        Whether the calibration can be used, and the answer in words.
    created
        When it was made.
    """

    model: RigModel
    pitch: float
    orientation: Orientation
    chosen: str
    why: str
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
    warnings: tuple[str, ...]
    go: bool
    verdict: str
    created: datetime

    @property
    def bad_images(self) -> tuple[str, ...]:
        """Names of the images that something is wrong with."""
        return tuple(plane.name for plane in self.planes if plane.problem)

    @property
    def response(self) -> float:
        """Ripple of the fitted planes that the response of projector and camera leaves, median over them [rad]."""
        return float(np.median([response_ripple(plane.ripple) for plane in self.planes if plane.fitted]))

    def reconstruct(
        self, phase: np.ndarray | xr.DataArray, sigma_phase: np.ndarray | xr.DataArray | None = None
    ) -> xr.Dataset:
        """Return the surface of a phase map at the calibrated pitch; see `RigModel.reconstruct`."""
        return self.model.reconstruct(phase, self.pitch, sigma_phase, self.orientation)

    def age(self, now: datetime | None = None) -> float:
        """Return the time since the calibration was made [s]."""
        return ((now or datetime.now(UTC)) - self.created).total_seconds()

    def save(self, folder: str | Path) -> Path:
        """Write ``calibration.yaml`` (the model, as rigs take it), ``calibration_fit.yaml`` (how good it is, in mm, µm
        and degree) and ``calibration_residuals.nc``; return the first.

        Raises
        ------
        OSError
            When the folder cannot be written.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        self.model.to_yaml(folder / MODEL_FILE)
        (folder / FIT_FILE).write_text(yaml.safe_dump(_fit_to_people(self), sort_keys=False), encoding="utf-8")
        self.residual_map.to_netcdf(
            folder / RESIDUAL_FILE,
            engine="h5netcdf",
            encoding={name: {"zlib": True} for name in self.residual_map.data_vars},
        )
        return folder / MODEL_FILE

    @classmethod
    def load(cls, folder: str | Path) -> RigCalibration:
        """Read what `save` wrote.

        Raises
        ------
        CalibrationFileError
            When a file is missing or is none of this kind.
        InvalidCalibrationError
            When the model's file is no model.
        """
        folder = Path(folder)
        try:
            content = yaml.safe_load((folder / FIT_FILE).read_text(encoding="utf-8"))
            model = RigModel.from_yaml(folder / MODEL_FILE)
            with xr.open_dataset(folder / RESIDUAL_FILE, engine="h5netcdf") as stored:
                residual_map = stored.load()
            return _fit_from_people(content, model, residual_map)
        except InvalidCalibrationError:
            raise
        except (OSError, KeyError, TypeError, ValueError, yaml.YAMLError) as error:
            raise CalibrationFileError(f"{folder} does not hold a calibration of the rig: {error!r}") from error

    def write_report(self, path: str | Path) -> Path:
        """Write one HTML file for people, pictures inside; return its path.

        Raises
        ------
        OSError
            When the file cannot be written.
        """
        from fringedic.calibration.report import report_html  # pictures take time to load, most users need none

        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(report_html(self), encoding="utf-8")
        return path


_PLANE_UNITS: dict[str, tuple[str, float]] = {
    "angle": ("angle_degree", math.radians(1)),
    "height": ("height_mm", _MILLI),
    "residual_phase": ("residual_fringe", _FRINGE),
    "predicted_phase": ("predicted_fringe", _FRINGE),
    "residual": ("residual_um", _MICRO),
    "predicted": ("predicted_um", _MICRO),
    "systematic": ("systematic_um", _MICRO),
    "systematic_noise": ("systematic_noise_um", _MICRO),
    "ripple": ("ripple_fringe", _FRINGE),
}
_CANDIDATE_UNITS: dict[str, tuple[str, float]] = {"systematic": ("systematic_um", _MICRO)}
_FIT_UNITS: dict[str, tuple[str, float]] = {
    "pitch": ("pitch_px", 1.0),
    "residual": ("residual_um", _MICRO),
    "predicted": ("predicted_um", _MICRO),
    "systematic": ("systematic_um", _MICRO),
    "held_out": ("held_out_um", _MICRO),
    "height_sigma": ("height_sigma_um", _MICRO),
    "principal_effect": ("principal_effect_um", _MICRO),
}
_PLAIN = ("verdict", "go", "chosen", "why", "chi_square")


def _to_people(value: Any, units: Mapping[str, tuple[str, float]]) -> dict[str, Any]:
    result = {}
    for field in dataclasses.fields(value):
        name, unit = units.get(field.name, (field.name, None))
        content = getattr(value, field.name)
        if unit is not None:
            content = (
                [_rounded(each / unit) for each in content] if isinstance(content, tuple) else _rounded(content / unit)
            )
        result[name] = content
    return result


def _rounded(value: float) -> float:
    """Return the number that people expect: 15 degree, not 15.000000000000002."""
    return float(f"{value:.13g}")


def _from_people(content: Mapping[str, Any], kind: type, units: Mapping[str, tuple[str, float]]) -> Any:
    values = {}
    for field in dataclasses.fields(kind):
        name, unit = units.get(field.name, (field.name, None))
        value = content[name]
        if unit is not None:
            value = tuple(each * unit for each in value) if isinstance(value, Sequence) else value * unit
        values[field.name] = value
    return kind(**values)


def _fit_to_people(calibration: RigCalibration) -> dict[str, Any]:
    return {
        "version": _VERSION,
        "created": calibration.created.isoformat(),
        **{name: getattr(calibration, name) for name in _PLAIN},
        "warnings": list(calibration.warnings),
        "orientation": calibration.orientation.name.lower(),
        **{people: _rounded(getattr(calibration, name) / unit) for name, (people, unit) in _FIT_UNITS.items()},
        "planes": [_to_people(plane, _PLANE_UNITS) for plane in calibration.planes],
        "candidates": [_to_people(each, _CANDIDATE_UNITS) for each in calibration.candidates],
        "parameters": [_to_people(each, {}) for each in calibration.parameters],
        "correlation": calibration.correlation.tolist(),
    }


def _fit_from_people(content: Mapping[str, Any], model: RigModel, residual_map: xr.Dataset) -> RigCalibration:
    if content["version"] > _VERSION:
        raise ValueError(f"version {content['version']} is newer than this program")
    return RigCalibration(
        model=model,
        **{name: content[name] for name in _PLAIN},
        **{name: content[people] * unit for name, (people, unit) in _FIT_UNITS.items()},
        orientation=Orientation[content["orientation"].upper()],
        warnings=tuple(content["warnings"]),
        planes=tuple(_from_people(each, PlaneResult, _PLANE_UNITS) for each in content["planes"]),
        candidates=tuple(_from_people(each, Candidate, _CANDIDATE_UNITS) for each in content["candidates"]),
        parameters=tuple(_from_people(each, Parameter, {}) for each in content["parameters"]),
        correlation=np.array(content["correlation"], float),
        residual_map=residual_map,
        created=datetime.fromisoformat(content["created"]),
    )
