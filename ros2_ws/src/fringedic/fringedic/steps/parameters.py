"""Parameters of the three processing steps: type, default, bounds and meaning, declared once."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, PlainValidator, field_validator

from fringedic.frames.region import Region


class Parameters(BaseModel):
    """Base of all node parameters: unknown names, other types, NaN and infinity are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


def _region(value: Any) -> Region | None:
    """Return the region that a value describes: polygons with the size of their image, or these as a line of YAML."""
    if isinstance(value, Region):
        return value
    if value is None or value == "":
        return None
    return Region.from_text(value) if isinstance(value, str) else Region.from_content(value)


RegionOfImage = Annotated[
    Region | None, PlainValidator(_region), PlainSerializer(lambda region: region.to_text() if region else "")
]
"""A part of the image; None: the whole image."""


class PhaseParameters(Parameters):
    """Parameters of the phase node."""

    read_noise_grey_level: float = Field(
        0.0,
        ge=0,
        le=1e4,
        description="Standard deviation of the camera's noise in the dark [grey level]; 0 estimates the noise from "
        "the frames of each step.",
    )
    shot_noise_grey_level: float = Field(
        0.0,
        ge=0,
        le=1e4,
        description="Variance of the noise per grey level of brightness [grey level]; not used when it is estimated.",
    )
    saturation_grey_level: float = Field(
        0.0,
        ge=0,
        le=65535,
        description="Grey level from which a pixel counts as saturated [grey level]; 0 is the pixels' full scale.",
    )
    minimum_modulation_grey_level: float = Field(
        0.0,
        ge=0,
        le=65535,
        description="Smallest valid fringe amplitude, in addition to the threshold from the noise [grey level].",
    )
    minimum_valid_fraction: float = Field(
        0.05, ge=0, le=1, description="The step fails when a smaller fraction of the image has a phase [0 to 1]."
    )
    method: Literal["auto", "steps", "one_image"] = Field(
        "auto",
        description="steps: phase stepping; one_image: the last fringe image alone, for fast events, divided by the "
        "step's grey frame where there is one; auto: one_image when the step has one fringe image only.",
    )
    relative_phase: Literal["refuse", "accept"] = Field(
        "refuse",
        description="Whether a relative phase is accepted, which is known up to whole fringes only: that of one image, "
        "or of one pitch that repeats in view. Its shape is the one nearest to the reference plane and may be off by "
        "whole fringes.",
    )
    correct_harmonics: bool = Field(
        False,
        description="Correct the error that a nonlinear response of projector and camera causes; it is estimated from "
        "the phase of each step and reported in any case.",
    )
    lens_blur_px: float = Field(
        0.0,
        ge=0,
        le=5,
        description="Blur of the camera's lens, standard deviation [px], for the correction of its effect on the phase "
        "of a textured surface; 0: no correction.",
    )
    maximum_error_fringe: float = Field(
        0.003,
        gt=0,
        le=1,
        description="The step fails when flicker, or motion of the surface along the light while its frames are taken, "
        "causes a larger RMS phase error [fringe].",
    )
    maximum_motion_px: float = Field(
        0.2,
        gt=0,
        le=100,
        description="The step fails when the surface moves farther than this across the image while its frames are "
        "taken [px].",
    )
    region: RegionOfImage = Field(
        None,
        description="Part of the image that shows the specimen, as `region` of dic: the checks of the frames use no "
        "other pixels; the phase is measured everywhere. Empty: the whole image.",
    )


class DicParameters(Parameters):
    """Parameters of the dic node."""

    window: int = Field(
        32, ge=8, le=256, description="Width [px] of the bi-triangular window with the same noise as the window in use."
    )
    spacing: int = Field(1, ge=1, le=256, description="Distance of the measured points in both directions [px].")
    region: RegionOfImage = Field(
        None,
        description="Measured region of the reference image: polygons as `fringedic region` writes them; empty: all.",
    )
    method: Literal["dense", "zoi"] = Field(
        "dense",
        description="dense: window-weighted gradient least squares at every point; zoi: phase fit per zone "
        "(Molimard et al., section 2).",
    )
    minimum_valid_fraction: float = Field(
        0.05,
        ge=0,
        le=1,
        description="The step fails when a smaller fraction of the points has a displacement [0 to 1].",
    )
    rereference_fraction: float = Field(
        0.8,
        ge=0,
        le=1,
        description="When the number of points that agree with the reference falls below this fraction of the usual "
        "number, the step is correlated with the latest good step, and the displacements are composed [0 to 1]; 0: "
        "never.",
    )
    kept_steps: int = Field(
        16,
        ge=1,
        le=1000,
        description="Number of the latest steps whose texture is kept, so that each can become the reference.",
    )


class CouplingParameters(Parameters):
    """Parameters of the coupling node."""

    z_filter_px: float = Field(
        2.0,
        ge=0,
        le=50,
        description="Standard deviation of the Gaussian that smooths the surfaces before they are subtracted [px]; "
        "the published shape is not smoothed.",
    )
    local_frame_window_px: int = Field(
        21,
        ge=0,
        le=1001,
        description="Width of the window for the slopes of the surface, for the displacement along the surface and its "
        "normal [px]; 0: not computed.",
    )
    strain_window_px: int = Field(
        85, ge=0, le=1001, description="Width of the window of the surface strain [px]; 0: not computed."
    )
    minimum_valid_fraction: float = Field(
        0.05, ge=0, le=1, description="The step fails when a smaller fraction of the cloud is measured [0 to 1]."
    )
    kept_steps: int = Field(
        16,
        ge=1,
        le=1000,
        description="Number of the latest steps whose phase is kept, so that each can become the reference.",
    )
    drift_marker_px: list[int] = Field(
        [0, 0, 0, 0],
        description="First column, first row, width and height [px] of the drift marker, a textured marker fixed "
        "to the frame: its apparent motion is drift of the rig and is reported. Width 0: no marker.",
    )

    @field_validator("drift_marker_px")
    @classmethod
    def _is_a_rectangle(cls, region: list[int]) -> list[int]:
        if len(region) != 4 or min(region) < 0 or (region[2] == 0) != (region[3] == 0):
            raise ValueError(f"{region}: first column, first row, width and height are needed, none below 0")
        return region
