"""Description of fringe images that any program made: what each image of a folder shows."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from fringedic.configuration.yaml_section import Section, load_sections
from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern


class FringeImages(Section):
    """Images of one pitch.

    Image k shows ``A + B cos(2 pi (c - origin) / pitch - 2 pi shift_k / q)``, c being the column (vertical fringes) or
    row (horizontal fringes) of the projector, and q the number of different shifts.
    """

    pitch_px: float = Field(gt=2, le=1e6, description="Fringe pitch [projector px].")
    images: list[str] = Field(min_length=3, description="Files, in the order of the shifts.")
    shifts: list[int] | None = Field(None, description="Shift of each image; 1, 2, ... q if left out.")

    @model_validator(mode="after")
    def _has_one_shift_for_each_image(self) -> FringeImages:
        if self.shifts is not None and sorted(self.shifts) != list(range(1, len(self.images) + 1)):
            raise ValueError(
                f"shifts: {len(self.images)} images need each shift from 1 to {len(self.images)} once, such as "
                f"{list(range(len(self.images), 0, -1))}"
            )
        return self

    def patterns(self, orientation: Orientation) -> list[ProjectedPattern]:
        """Return the pattern of each image."""
        count = len(self.images)
        shown = self.shifts or range(1, count + 1)
        return [ProjectedPattern(PatternKind.FRINGES, orientation, self.pitch_px, shift, count) for shift in shown]


class GrayCodeImages(Section):
    """Images of a Gray code that numbers blocks of the projector from 0 on, coarsest bit first."""

    block_px: float = Field(gt=1, le=1e6, description="Width of a block [projector px]; the first begins at 0.")
    images: list[str] = Field(min_length=2, description="Files, coarsest bit first.")
    inverted: bool = Field(False, description="Each bit is followed by its inverse.")

    @model_validator(mode="after")
    def _has_pairs(self) -> GrayCodeImages:
        if self.inverted and len(self.images) % 2:
            raise ValueError(f"images: {len(self.images)} images are not pairs of a bit and its inverse")
        return self


class FringeImageDescription(Section):
    """What the images of a folder show: fringes of one direction, with or without a Gray code."""

    direction: Literal["vertical", "horizontal"] = Field("vertical", description="Of the fringes.")
    projector_px: int = Field(
        gt=1, le=100_000, description="Width (vertical fringes) or height (horizontal) of the projector's image."
    )
    origin_px: float | None = Field(
        None, description="Column or row where the phase of shift q is 0; the projector's centre if left out."
    )
    fringes: list[FringeImages] = Field(min_length=1)
    gray_code: GrayCodeImages | None = None
    minimum_modulation: float = Field(0.0, ge=0, description="That the surface has at least [grey level].")
    correct_harmonics: bool = Field(
        False, description="Correct the error of each pitch that a nonlinear response causes."
    )
    maximum_error_fringe: float = Field(
        0.003,
        gt=0,
        le=1,
        description="Refuse images when flicker that cannot be fitted, or motion along the light, causes a larger RMS "
        "phase error [fringe].",
    )
    saturation: int | None = Field(None, ge=1, description="Grey level of a saturated pixel; full scale if left out.")

    @classmethod
    def load(cls, path: Path) -> FringeImageDescription:
        """Read a description.

        Raises
        ------
        ConfigurationError
            The file cannot be read, or a key is unknown, missing or out of its range.
        """
        return load_sections(path, cls)

    @property
    def orientation(self) -> Orientation:
        """Direction of the fringes."""
        return Orientation.VERTICAL if self.direction == "vertical" else Orientation.HORIZONTAL

    @property
    def origin(self) -> float:
        """Column or row where the phase is 0 [projector px]."""
        return 0.5 * (self.projector_px - 1) if self.origin_px is None else self.origin_px
