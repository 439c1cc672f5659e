"""Calibration that a rig file contains or names."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from fringedic.configuration.yaml_section import Section
from fringedic.errors import CalibrationError
from fringedic.frames.sensor import SensorName
from fringedic.metadata import CalibrationMetadata, CheckMetadata
from fringedic.rig.files import edited_identifier
from fringedic.rig.model import RigModel
from fringedic.settings.base import FILE, MILLI
from fringedic.wording.sealed_yaml import EDITED, HASH, ChangedFileError, unsealed

LATEST_CHECKS = 5  # of the calibration in the metadata of a recording


def _or_the_file(source: str, info: ValidationInfo) -> str:
    return source or (info.context or {}).get(FILE, "")


class CalibratedCamera(Section):
    """Pin-hole model of the camera."""

    width_px: int = Field(ge=16, description="Width of the image [px].")
    height_px: int = Field(ge=16, description="Height of the image [px].")
    first_column_px: int = Field(-1, ge=-1, description="Column of the sensor with which it begins; -1: not known.")
    first_row_px: int = Field(-1, ge=-1, description="Row of the sensor with which it begins; -1: not known.")
    distance_mm: float = Field(gt=0, description="Distance h0 from the reference plane [mm].")
    pixel_size_mm: float = Field(
        gt=0, description="Length of a row on the reference plane at the principal point [mm]."
    )
    pixel_aspect: float = Field(1.0, gt=0, description="Row spacing over column spacing (tau).")
    principal_column_px: float | None = Field(None, description="Principal column [px]; by default the centre.")
    principal_row_px: float | None = Field(None, description="Principal row [px]; by default the centre.")
    tilt_x_degree: float = Field(0.0, gt=-45, lt=45, description="Rotation of the camera about x [degree].")
    tilt_y_degree: float = Field(0.0, gt=-45, lt=45, description="Rotation of the camera about y [degree].")


class CalibratedProjector(Section):
    """Pin-hole model of the projector."""

    width_px: int = Field(ge=16, description="Width of the image [px].")
    height_px: int = Field(ge=16, description="Height of the image [px].")
    position_mm: list[float] = Field(
        min_length=3, max_length=3, description="Position (d, y, hp) of the pin-hole [mm]."
    )
    yaw_pitch_roll_degree: list[float] = Field(
        [0.0, 0.0, 0.0],
        min_length=3,
        max_length=3,
        description="Yaw, pitch and roll relative to the view of the origin [degree].",
    )
    focal_length_px: float = Field(gt=0, description="Focal length [px].")
    principal_column_px: float | None = Field(None, description="Principal column [px]; by default the centre.")
    principal_row_px: float | None = Field(None, description="Principal row [px]; by default the centre.")
    k1: float = Field(0.0, ge=-1, le=1, description="Radial distortion (Brown's lens as in OpenCV), dimensionless.")
    k2: float = Field(0.0, ge=-100, le=100, description="Radial, of the fourth power.")
    p1: float = Field(0.0, ge=-1, le=1, description="Tangential.")
    p2: float = Field(0.0, ge=-1, le=1, description="Tangential.")
    k3: float = Field(0.0, ge=-10_000, le=10_000, description="Radial, of the sixth power.")


class CovarianceSection(Section):
    """Covariance of the fitted parameters in SI units, row-major."""

    parameters: list[str] = Field([], description="Names of the parameters.")
    values: list[float] = Field([], description="Covariances, one per pair of parameters, row by row.")


class CalibrationSection(Section):
    """Model of camera and projector, laid out as in the file of a calibration."""

    sensor: SensorName | None = Field(None, description="Name of the sensor; by default that of the rig file.")
    identifier: str = Field("rig file", description="Name of this calibration in results.")
    model: Literal["six_parameter", "general", "paper"] = Field(
        "general", description="six_parameter: no angles and no distortion; paper: its name in older files."
    )
    source: Annotated[str, AfterValidator(_or_the_file)] = Field(
        "", validate_default=True, description="Origin of the calibration; by default the rig file."
    )
    camera: CalibratedCamera = Field(description="Pin-hole model of the camera.")
    projector: CalibratedProjector = Field(description="Pin-hole model of the projector.")
    covariance_si: CovarianceSection = Field(CovarianceSection(), description="Covariance of the parameters.")

    @model_validator(mode="before")
    @classmethod
    def _of_a_file(cls, content: Any) -> Any:
        """Compare the numbers of a calibration file that was pasted with its hash."""
        if not isinstance(content, dict) or not content.keys() & {HASH, EDITED}:
            return content  # written by hand
        try:
            plain, edited = unsealed(content, "calibration")
        except ChangedFileError as error:
            raise ValueError(str(error)) from None
        return plain | {"identifier": edited_identifier(str(plain.get("identifier", "")))} if edited else plain

    def rig_model(self, sensor: str) -> RigModel:
        """Return the model in SI units, that of a sensor unless the section names another one."""
        camera, projector = self.camera, self.projector
        return RigModel(
            sensor=self.sensor or sensor,
            identifier=self.identifier,
            model=self.model,
            source=self.source,
            camera_width=camera.width_px,
            camera_height=camera.height_px,
            camera_first_column=camera.first_column_px,
            camera_first_row=camera.first_row_px,
            camera_distance=camera.distance_mm * MILLI,
            pixel_size=camera.pixel_size_mm * MILLI,
            pixel_aspect=camera.pixel_aspect,
            principal_column=_centre(camera.principal_column_px, camera.width_px),
            principal_row=_centre(camera.principal_row_px, camera.height_px),
            camera_tilt_x=math.radians(camera.tilt_x_degree),
            camera_tilt_y=math.radians(camera.tilt_y_degree),
            projector_width=projector.width_px,
            projector_height=projector.height_px,
            projector_position=_triple(value * MILLI for value in projector.position_mm),
            projector_rotation=_triple(math.radians(value) for value in projector.yaw_pitch_roll_degree),
            projector_focal_length=projector.focal_length_px,
            projector_principal_column=_centre(projector.principal_column_px, projector.width_px),
            projector_principal_row=_centre(projector.principal_row_px, projector.height_px),
            projector_k1=projector.k1,
            projector_k2=projector.k2,
            projector_p1=projector.p1,
            projector_p2=projector.p2,
            projector_k3=projector.k3,
            parameter_names=tuple(self.covariance_si.parameters),
            covariance=tuple(self.covariance_si.values),
        )


def calibration_metadata(file: Path) -> CalibrationMetadata:
    """Return the metadata of a calibration from the files beside it; empty where there are none of its own."""
    from fringedic.calibration.result import RigCalibration  # not at the top: a rig file is read without computing

    try:
        found = RigCalibration.load(file)
    except CalibrationError:
        return CalibrationMetadata()
    return CalibrationMetadata(
        created=found.created.isoformat(timespec="seconds"),
        residual_um=found.residual * 1e6,
        predicted_um=found.predicted * 1e6,
        held_out_um=None if math.isnan(found.held_out) else found.held_out * 1e6,
        verdict=found.summary or str(found.verdict),
        response_fringe=None if math.isnan(found.response) else found.response / (2 * math.pi),
        checks=_checks(file.parent)[-LATEST_CHECKS:],
    )


def _checks(folder: Path) -> list[CheckMetadata]:
    from fringedic.calibration.history import recorded_checks

    try:
        return recorded_checks(folder)
    except CalibrationError:
        return []  # an unreadable list of checks is no reason to refuse an experiment


def _centre(principal: float | None, size: int) -> float:
    return (size - 1) / 2 if principal is None else principal


def _triple(values: Iterable[float]) -> tuple[float, float, float]:
    first, second, third = values
    return first, second, third
