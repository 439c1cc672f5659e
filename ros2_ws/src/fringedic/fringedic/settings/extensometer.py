"""Settings of the virtual extensometer between the steps."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from fringedic.settings.base import Settings

Pixel = Annotated[list[Annotated[int, Field(ge=0, le=32768)]], Field(min_length=2, max_length=2)]
"""Column and row of a pixel."""


class ExtensometerSettings(Settings):
    """Two points of the surface whose distance is measured."""

    first_px: Pixel = Field(
        [], validate_default=True, description="Column and row of the first point in the reference image [px]."
    )
    second_px: Pixel = Field([], validate_default=True, description="Column and row of the second point [px].")
    subset_px: int = Field(48, ge=16, le=256, description="Width of the subset around each point [px].")
    largest_sigma_ustrain: float = Field(
        1000.0, gt=0, le=1e6, description="Standard uncertainty above which a strain is invalid [µstrain]."
    )


class ExtensometerNodeSettings(ExtensometerSettings):
    """Settings of the extensometer node."""

    frame_timeout_s: float = Field(
        0.1, gt=0, le=10, description="Time without a frame after which the strain is invalid [s]."
    )
