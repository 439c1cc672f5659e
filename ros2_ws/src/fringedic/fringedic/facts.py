"""What a person knows about a test and no sensor tells: specimen, operator, load cell, and the parts of the rig.

Entered once in the rig file or the programme, recorded among the parameters of the experiment node, and found again in
datasets, exports and reports. Everything is optional: what nobody entered is missing, never guessed.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fringedic.errors import FactsError

FIRST_STEP = "first_step"


class _Entries(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class SpecimenFacts(_Entries):
    """The specimen and how its load is counted."""

    name: str = Field("", description="Name of the specimen.")
    material: str = Field("", description="What it is made of.")
    section_mm2: float | None = Field(None, gt=0, description="Area that carries the force: stress = force / area.")
    operator: str = Field("", description="Who runs the test.")
    notes: str = Field("", description="Anything else worth keeping.")
    pattern: str = Field("", description="Patterning technique, such as 'black spray on white' or 'natural'.")
    force_tare_newton: float | Literal["first_step"] = Field(
        0.0, description="Reading of the load cell without load; first_step: its mean during the first step."
    )
    force_sign: Literal[1, -1] = Field(1, description="-1 when the load cell counts tension as negative.")
    extensometers_px: list[Annotated[list[float], Field(min_length=4, max_length=4)]] = Field(
        [], description="Virtual extensometers of the report: row, column of one pad, row, column of the other [px]."
    )


class HardwareFacts(_Entries):
    """The parts of the rig as they are to be named in a report."""

    camera: str = Field("", description="Maker and model.")
    lens: str = Field("", description="Maker and model.")
    focal_length_mm: float | None = Field(None, gt=0, description="Focal length of the lens.")
    aperture: str = Field("", description="Such as f/8.")
    filters: str = Field("", description="Optical filters, such as 'polarisers, crossed'.")
    lighting: str = Field("", description="Light other than the projector's.")
    projector: str = Field("", description="Maker and model.")
    calibration_target: str = Field("", description="Maker, kind and dimensions.")


class CheckFacts(_Entries):
    """One check of the calibration by a flat plane and a known distance; kept beside the calibration's files."""

    created: str = Field("", description="Time of the check.")
    holds: bool = Field(False, description="Whether the rig still held its calibration.")
    verdict: str = Field("", description="The same in words, with warnings.")
    flatness_um: float | None = Field(None, description="RMS of the plane about the best one, means over blocks.")
    noise_um: float | None = Field(None, description="Predicted noise of a pixel's height.")
    expected_mm: float | None = Field(None, description="The known distance.")
    distance_mm: float | None = Field(None, description="The known distance as it was measured.")
    drift_um: float | None = Field(None, description="RMS change of the plane during the check.")
    response_fringe: float | None = Field(
        None, description="Amplitude of the ripple, three times per fringe and more, that the response leaves."
    )


class CalibrationFacts(_Entries):
    """When and how well the rig was calibrated; not entered, but read from the files of the calibration."""

    created: str = Field("", description="Time of the calibration.")
    residual_um: float | None = Field(None, description="RMS of the planes about the model, as height.")
    predicted_um: float | None = Field(None, description="What the noise of the phase alone would leave.")
    held_out_um: float | None = Field(None, description="RMS of the planes kept out of the fit, as height.")
    verdict: str = Field("", description="The calibration's own judgement.")
    response_fringe: float | None = Field(
        None, description="Ripple of the planes, three times per fringe and more, that the response leaves."
    )
    checks: list[CheckFacts] = Field([], description="The latest checks of the calibration, the oldest first.")


NOISE_COLUMNS = ("over points", "over steps", "mean", "as stated")


class NoiseQuantity(NamedTuple):
    """A quantity of the dataset as it is kept: its name with unit, what it is, the unit, and that in the dataset's."""

    name: str
    title: str
    unit: str
    factor: float


NOISE_QUANTITIES = {
    "displacement_x": NoiseQuantity("displacement_x_px", "displacement along columns", "px", 1.0),
    "displacement_y": NoiseQuantity("displacement_y_px", "displacement along rows", "px", 1.0),
    "u": NoiseQuantity("u_um", "displacement u", "µm", 1e-6),
    "v": NoiseQuantity("v_um", "displacement v", "µm", 1e-6),
    "w": NoiseQuantity("w_um", "displacement w", "µm", 1e-6),
    "shape_z": NoiseQuantity("z_um", "height z of one step", "µm", 1e-6),
    "e_11": NoiseQuantity("e_11_ustrain", "strain e_11", "µstrain", 1e-6),
    "e_22": NoiseQuantity("e_22_ustrain", "strain e_22", "µstrain", 1e-6),
    "e_12": NoiseQuantity("e_12_ustrain", "strain e_12", "µstrain", 1e-6),
}


class NoiseFacts(_Entries):
    """The noise floor with the specimen mounted; not entered, but read from the file that `fringedic noise` writes.

    Names of the quantities carry their unit: displacement_x_px, u_um, z_um, e_11_ustrain, ...
    """

    created: str = Field("", description="Time of the measurement.")
    steps: int = Field(0, ge=0, description="Steps or images at rest, with the reference.")
    read_noise_grey_level: float | None = Field(None, description="Noise of a pixel without light, with rounding.")
    shot_noise_grey_level: float | None = Field(None, description="Variance of the noise per grey level.")
    flicker_percent: float | None = Field(None, description="Standard deviation of the light from step to step.")
    window_px: int | None = Field(None, description="Window of the displacement.")
    spacing_px: int | None = Field(None, description="Distance of its points.")
    strain_window_px: int | None = Field(None, description="Window of the strain.")
    spatial: dict[str, float] = Field({}, description="Standard deviation over the points, mean over the steps.")
    temporal: dict[str, float] = Field({}, description="Standard deviation over the steps, RMS over the points.")
    bias: dict[str, float] = Field({}, description="Mean over points and steps.")
    predicted: dict[str, float] = Field({}, description="RMS of the stated standard deviations.")

    def table(self) -> list[tuple[NoiseQuantity, list[str]]]:
        """Return the noise floors as cells of a table with the `NOISE_COLUMNS`; "-" where not known."""
        columns = (self.spatial, self.temporal, self.bias, self.predicted)
        return [
            (quantity, [f"{column[quantity.name]:.4g}" if quantity.name in column else "-" for column in columns])
            for quantity in NOISE_QUANTITIES.values()
            if any(quantity.name in column for column in columns)
        ]

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> NoiseFacts:
        """Read the file that `fringedic noise` wrote.

        Raises
        ------
        FactsError
            The file cannot be read or holds no noise floor.
        """
        try:
            return cls.model_validate(yaml.safe_load(Path(path).read_text("utf-8")))
        except OSError as error:
            raise FactsError(f"{path}: cannot be read: {error.strerror}") from error
        except (yaml.YAMLError, UnicodeDecodeError, ValidationError) as error:
            raise FactsError(f"{path}: is no noise floor as 'fringedic noise' writes it: {error}") from error


class Facts(_Entries):
    """Specimen, hardware, calibration and noise floor of one experiment."""

    specimen: SpecimenFacts = SpecimenFacts()
    hardware: HardwareFacts = HardwareFacts()
    calibration: CalibrationFacts = CalibrationFacts()
    noise: NoiseFacts = NoiseFacts()

    def to_text(self) -> str:
        """Return what was entered as one line of YAML, empty when nothing was."""
        entered = self.model_dump(exclude_defaults=True)
        return (
            yaml.safe_dump(entered, default_flow_style=True, allow_unicode=True, width=10**6).strip() if entered else ""
        )

    @classmethod
    def from_text(cls, text: str) -> Facts:
        """Read what `to_text` wrote.

        Raises
        ------
        FactsError
            An entry is unknown or has no meaning.
        """
        try:
            return cls.model_validate(yaml.safe_load(text) or {})
        except yaml.YAMLError as error:
            raise FactsError(f"specimen and hardware: no YAML: {error}") from error
        except ValidationError as error:
            problems = "; ".join(f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors())
            raise FactsError(f"specimen and hardware: {problems}") from error
