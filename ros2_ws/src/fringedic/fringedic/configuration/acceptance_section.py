"""Section ``acceptance`` of a rig file: artefacts, measured volume and maximum permissible errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from fringedic.configuration.yaml_section import Section

if TYPE_CHECKING:
    from fringedic.calibration.acceptance import AcceptanceError, Artefacts

_MILLI, _MICRO = 1e-3, 1e-6


class AcceptanceSection(Section):
    """Acceptance test with balls, a ball bar and a plane."""

    ball_diameter_mm: float = Field(gt=0, le=1e4, description="Calibrated diameter of the balls [mm].")
    bar_spacing_mm: float = Field(gt=0, le=1e4, description="Calibrated distance of the centres of the ball bar [mm].")
    volume_mm: list[float] = Field(
        min_length=3, max_length=3, description="Extent of the measured volume along x, y and z [mm]."
    )
    probing_form_um: float | None = Field(None, gt=0, description="Maximum permissible probing error, form [µm].")
    probing_size_um: float | None = Field(None, gt=0, description="Maximum permissible probing error, size [µm].")
    sphere_spacing_um: float | None = Field(None, gt=0, description="Maximum permissible sphere-spacing error [µm].")
    flatness_um: float | None = Field(None, gt=0, description="Maximum permissible flatness measurement error [µm].")

    @property
    def artefacts(self) -> Artefacts:
        """Sizes [m]."""
        from fringedic.calibration.acceptance import Artefacts  # not at the top: a rig file is read without computing

        x, y, z = (each * _MILLI for each in self.volume_mm)
        return Artefacts(self.ball_diameter_mm * _MILLI, self.bar_spacing_mm * _MILLI, (x, y, z))

    @property
    def limits(self) -> dict[AcceptanceError, float]:
        """Maximum permissible errors that are given [m]."""
        from fringedic.calibration.acceptance import AcceptanceError

        given = {
            AcceptanceError.FORM: self.probing_form_um,
            AcceptanceError.SIZE: self.probing_size_um,
            AcceptanceError.SPACING: self.sphere_spacing_um,
            AcceptanceError.FLATNESS: self.flatness_um,
        }
        return {error: limit * _MICRO for error, limit in given.items() if limit is not None}
