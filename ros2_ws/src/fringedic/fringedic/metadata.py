"""Metadata of a test that no sensor measures: specimen, operator, load cell, and the parts of the rig.

They are entered once in the rig file or the programme, recorded with the parameters of the experiment node (as
``facts``), and contained in datasets, exports and reports. All are optional and never guessed.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from fringedic.errors import ConfigurationError
from fringedic.wording.causes import cause_of
from fringedic.wording.sealed_yaml import unsealed
from fringedic.wording.yaml_text import load_yaml

FIRST_STEP = "first_step"
OLD_GAUGES = "extensometers_px"  # key of earlier versions, (row, column)
ImagePosition = Annotated[list[float], Field(min_length=2, max_length=2)]
"""Column and row in an image [px]."""


class _Entries(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Gauge(_Entries):
    """The two gauge points of a virtual extensometer."""

    first: ImagePosition = Field(description="Column and row of the first point [px].")
    second: ImagePosition = Field(description="Column and row of the second point [px].")
    name: str = Field("", description="Name in the report; by default its number.")


class SpecimenMetadata(_Entries):
    """The specimen, and sign and tare of its load."""

    name: str = Field("", description="Name of the specimen.")
    number: str = Field("", description="Number of the specimen, for the certificate.")
    test_number: str = Field("", description="Number of the test, for the certificate.")
    customer: str = Field("", description="Customer, for the certificate.")
    material: str = Field("", description="Material of the specimen.")
    youngs_modulus_gpa: float | None = Field(
        None, gt=0, description="Young's modulus of an isotropic elastic material [GPa], for maps of the stress."
    )
    poisson_ratio: float | None = Field(None, gt=-1, lt=0.5, description="Poisson's ratio of the material.")
    section_mm2: float | None = Field(
        None, gt=0, description="Area that carries the force [mm²]: stress = force / area."
    )
    operator: str = Field("", description="Name of the operator.")
    notes: str = Field("", description="Notes about the test.")
    pattern: str = Field("", description="Patterning technique, such as 'black spray on white' or 'natural'.")
    force_tare_newton: float | Literal["first_step"] = Field(
        0.0, description="Reading of the load cell without load [N]; first_step: its mean during the first step."
    )
    force_sign: Literal[1, -1] = Field(1, description="-1 if the load cell reports tension as negative.")
    gauges_px: list[Gauge] = Field([], description="Virtual extensometers of the report, in the reference image.")
    entries: dict[str, str | float] = Field(
        {}, description="Other entries by their names with unit, such as those of `test_form`."
    )

    @model_validator(mode="before")
    @classmethod
    def _refuse_the_old_order(cls, entries: Any) -> Any:
        if isinstance(entries, dict) and OLD_GAUGES in entries:
            raise ValueError(
                f"{OLD_GAUGES} with the order [row, column, row, column] is replaced by gauges_px with the order "
                "[column, row]: write gauges_px: [{first: [column, row], second: [column, row]}]"
            )
        return entries


class HardwareMetadata(_Entries):
    """The parts of the rig, as named in reports."""

    camera: str = Field("", description="Maker and model of the camera.")
    lens: str = Field("", description="Maker and model of the lens.")
    focal_length_mm: float | None = Field(None, gt=0, description="Focal length of the lens [mm].")
    aperture: str = Field("", description="Aperture, such as f/8.")
    filters: str = Field("", description="Optical filters, such as 'polarisers, crossed'.")
    lighting: str = Field("", description="Light beside that of the projector.")
    projector: str = Field("", description="Maker and model of the projector.")
    calibration_target: str = Field("", description="Maker, kind and dimensions of the calibration target.")


class CheckMetadata(_Entries):
    """One check of the calibration by a flat plane and a known distance; saved with the files of the calibration."""

    created: str = Field("", description="Time of the check.")
    holds: bool = Field(False, description="Whether the calibration is still valid.")
    verdict: str = Field("", description="The same as a sentence, with warnings.")
    flatness_um: float | None = Field(None, description="RMS of block means about the best plane [µm].")
    noise_um: float | None = Field(None, description="Predicted noise of a pixel's height [µm].")
    expected_mm: float | None = Field(None, description="The known distance [mm].")
    distance_mm: float | None = Field(None, description="The measured value of the known distance [mm].")
    drift_um: float | None = Field(None, description="RMS change of the plane during the check [µm].")
    response_fringe: float | None = Field(
        None, description="Amplitude of the ripple at the third and higher harmonics that the response leaves [fringe]."
    )


class CalibrationMetadata(_Entries):
    """Date and quality of the calibration, from its files."""

    created: str = Field("", description="Time of the calibration.")
    residual_um: float | None = Field(None, description="RMS of the planes about the model [µm].")
    predicted_um: float | None = Field(None, description="RMS that the noise of the phase explains [µm].")
    held_out_um: float | None = Field(None, description="Largest RMS of a plane that is not part of the fit [µm].")
    verdict: str = Field("", description="Assessment of the calibration.")
    response_fringe: float | None = Field(
        None, description="Ripple of the planes at the third and higher harmonics that the response leaves [fringe]."
    )
    checks: list[CheckMetadata] = Field([], description="The latest checks of the calibration, the oldest first.")


NOISE_COLUMNS = ("over points", "over steps", "mean", "as stated", "Cramer-Rao")


class NoiseQuantity(NamedTuple):
    """A quantity in the units of reports: name with unit, title, unit, and the unit's value in that of the dataset."""

    name: str
    title: str
    unit: str
    factor: float


NOISE_QUANTITIES = {
    "displacement_x": NoiseQuantity("displacement_x_px", "displacement x (right)", "px", 1.0),
    "displacement_y": NoiseQuantity("displacement_y_px", "displacement y (down)", "px", 1.0),
    "u": NoiseQuantity("u_um", "displacement u", "µm", 1e-6),
    "v": NoiseQuantity("v_um", "displacement v", "µm", 1e-6),
    "w": NoiseQuantity("w_um", "displacement w", "µm", 1e-6),
    "phase": NoiseQuantity("phase_fringe", "phase of one step", "fringe", 2 * math.pi),
    "shape_z": NoiseQuantity("z_um", "height z of one step", "µm", 1e-6),
    "e_11": NoiseQuantity("e_11_ustrain", "strain e_11", "µstrain", 1e-6),
    "e_22": NoiseQuantity("e_22_ustrain", "strain e_22", "µstrain", 1e-6),
    "e_12": NoiseQuantity("e_12_ustrain", "strain e_12", "µstrain", 1e-6),
    "e_xx": NoiseQuantity("e_xx_ustrain", "strain e_xx", "µstrain", 1e-6),
    "e_yy": NoiseQuantity("e_yy_ustrain", "strain e_yy", "µstrain", 1e-6),
    "e_xy": NoiseQuantity("e_xy_ustrain", "strain e_xy", "µstrain", 1e-6),
}


class NoiseFloorMetadata(_Entries):
    """The noise floor with the specimen mounted, from the file that `fringedic noise` writes.

    Names of the quantities contain their unit: displacement_x_px, u_um, z_um, e_11_ustrain, ...
    """

    created: str = Field("", description="Time of the measurement.")
    steps: int = Field(0, ge=0, description="Number of steps or images at rest, with the reference.")
    read_noise_grey_level: float | None = Field(
        None, description="Noise of a pixel without light, with rounding [grey level]."
    )
    shot_noise_grey_level: float | None = Field(None, description="Variance of the noise per grey level [grey level].")
    flicker_percent: float | None = Field(None, description="Standard deviation of the light from step to step [%].")
    window_px: int | None = Field(None, description="Window of the displacement [px].")
    spacing_px: int | None = Field(None, description="Distance of its points [px].")
    strain_window_px: int | None = Field(None, description="Window of the strain [px].")
    spatial: dict[str, float] = Field({}, description="Standard deviation over the points, mean over the steps.")
    temporal: dict[str, float] = Field({}, description="Standard deviation over the steps, RMS over the points.")
    bias: dict[str, float] = Field({}, description="Mean over points and steps.")
    predicted: dict[str, float] = Field({}, description="RMS of the stated standard deviations.")
    limit: dict[str, float] = Field(
        {}, description="RMS of the Cramer-Rao bound, which no unbiased estimate goes below."
    )

    def table(self) -> list[tuple[NoiseQuantity, list[str]]]:
        """Return the noise floors as rows of a table with the columns `NOISE_COLUMNS`; "-" where not known."""
        columns = (self.spatial, self.temporal, self.bias, self.predicted, self.limit)
        return [
            (quantity, [f"{column[quantity.name]:.4g}" if quantity.name in column else "-" for column in columns])
            for quantity in NOISE_QUANTITIES.values()
            if any(quantity.name in column for column in columns)
        ]

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> NoiseFloorMetadata:
        """Read the file that `fringedic noise` wrote.

        Raises
        ------
        ConfigurationError
            The file cannot be read or holds no noise floor.
        """
        try:
            content, _ = unsealed(load_yaml(Path(path).read_text("utf-8")), str(path))
            return cls.model_validate(content)
        except OSError as error:
            raise ConfigurationError(f"{path}: cannot be read: {cause_of(error)}") from error
        except (yaml.YAMLError, UnicodeDecodeError, ValidationError) as error:
            raise ConfigurationError(f"{path}: is no noise floor from 'fringedic noise': {error}") from error


class Metadata(_Entries):
    """Specimen, hardware, calibration and noise floor of one experiment."""

    specimen: SpecimenMetadata = SpecimenMetadata()
    hardware: HardwareMetadata = HardwareMetadata()
    calibration: CalibrationMetadata = CalibrationMetadata()
    noise: NoiseFloorMetadata = NoiseFloorMetadata()

    def to_text(self) -> str:
        """Return the entries as one line of YAML; empty without entries."""
        entered = self.model_dump(exclude_defaults=True)
        return (
            yaml.safe_dump(entered, default_flow_style=True, allow_unicode=True, width=10**6).strip() if entered else ""
        )

    @classmethod
    def from_text(cls, text: str) -> Metadata:
        """Read what `to_text` wrote, in this version or an earlier one.

        Raises
        ------
        ConfigurationError
            An entry is unknown or invalid.
        """
        try:
            content = load_yaml(text) or {}
            return cls.model_validate(translate_metadata(content) if isinstance(content, dict) else content)
        except yaml.YAMLError as error:
            raise ConfigurationError(f"specimen and hardware: no YAML: {error}") from error
        except ValidationError as error:
            problems = "; ".join(f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors())
            raise ConfigurationError(f"specimen and hardware: {problems}") from error


def translate_metadata(recorded: Mapping[str, Any]) -> dict[str, Any]:
    """Return recorded metadata of this version or an earlier one with the keys of this version.

    Examples
    --------
    Earlier versions recorded virtual extensometers as [row, column, row, column]:

    >>> translate_metadata({"specimen": {"extensometers_px": [[480, 200, 480, 1000]]}})
    {'specimen': {'gauges_px': [{'first': [200, 480], 'second': [1000, 480]}]}}
    """
    specimen = recorded.get("specimen")
    if not isinstance(specimen, Mapping) or OLD_GAUGES not in specimen:
        return dict(recorded)
    specimen = dict(specimen)
    specimen["gauges_px"] = [
        {"first": [left, top], "second": [right, bottom]} for top, left, bottom, right in specimen.pop(OLD_GAUGES)
    ]
    return {**recorded, "specimen": specimen}
