"""Section ``plan`` of a rig file: components of a rig that is not built yet, as their data sheets state them."""

from __future__ import annotations

import math
from typing import Any, Literal

from pydantic import Field, model_validator

from fringedic.configuration.yaml_section import Section

_SIDES = {"right": (1, 0), "left": (-1, 0), "above": (0, 1), "below": (0, -1)}
_MARGIN = 1.3  # of the virtual specimen over the field of view


class PlanSection(Section):
    """Camera, lenses, positions and surface of a planned rig; sizes in pixels come from the other sections."""

    camera_pixel_um: float = Field(gt=0, le=50, description="Pixel pitch of the sensor [µm].")
    full_well_electrons: float = Field(
        10_000, gt=10, le=1e7, description="Saturation capacity (EMVA 1288) [electron]; the full scale of the camera."
    )
    read_noise_electrons: float = Field(3.0, ge=0, le=1e4, description="Temporal dark noise (EMVA 1288) [electron].")
    focal_length_mm: float = Field(gt=0, le=2000, description="Focal length of the camera's lens [mm].")
    f_number: float = Field(8.0, ge=0.5, le=64, description="F-number of the camera's lens.")
    camera_distance_mm: float = Field(gt=0, le=1e5, description="From the surface to the lens of the camera [mm].")
    throw_ratio: float = Field(
        gt=0, le=20, description="Distance of the projector over the width of its image (data sheet)."
    )
    projector_distance_mm: float = Field(gt=0, le=1e5, description="From the surface to the projector's lens [mm].")
    projector_side: Literal["right", "left", "above", "below"] = Field(
        "right", description="Position of the projector as seen in the camera's image."
    )
    angle_degree: float = Field(25.0, gt=0, lt=80, description="Angle between camera and projector [degree].")
    projector_aperture_mm: float = Field(
        0.0,
        ge=0,
        le=200,
        description="Diameter of the projector's lens opening [mm], for its depth of field; 0: a point.",
    )
    projector_blur_px: float = Field(
        0.6, ge=0.05, le=10, description="Blur in focus, standard deviation [projector px]."
    )
    white_level: float = Field(
        0.82, gt=0, le=1, description="White light on the bright surface, part of the full scale."
    )
    ambient_light: float = Field(0.02, ge=0, le=1, description="Room light relative to the projector's white.")
    speckle_um: float = Field(gt=0, le=1e5, description="Full width at half height of a speckle on the surface [µm].")
    speckle_coverage: float = Field(0.5, gt=0, lt=1, description="Part of the surface that is darker than half.")
    speckle_floor: float = Field(0.12, ge=0, lt=1, description="Darkest reflectance relative to the bare surface.")
    depth_mm: float = Field(0.0, ge=0, le=1e4, description="Range of the heights of the surface [mm].")
    slope_degree: float = Field(20.0, ge=0, lt=85, description="Steepest slope of the surface [degree].")

    @model_validator(mode="after")
    def _has_an_image(self) -> PlanSection:
        if self.camera_distance_mm <= self.focal_length_mm:
            raise ValueError(
                f"camera_distance_mm {self.camera_distance_mm:g} is not beyond focal_length_mm "
                f"{self.focal_length_mm:g}: such a lens gives no image; move the camera back"
            )
        return self

    @property
    def magnification(self) -> float:
        """Length on the sensor over that on the surface, of a thin lens."""
        return self.focal_length_mm / (self.camera_distance_mm - self.focal_length_mm)

    @property
    def projector_position_mm(self) -> tuple[float, float, float]:
        """Position (x, y, z) of the projector in the rig frame [mm]."""
        across = self.projector_distance_mm * math.sin(math.radians(self.angle_degree))
        x, y = _SIDES[self.projector_side]
        return x * across, y * across, self.projector_distance_mm * math.cos(math.radians(self.angle_degree))

    def virtual_entries(
        self, camera_size: tuple[int, int], projector_size: tuple[int, int], bits: int
    ) -> dict[str, Any]:
        """Return the section ``virtual_rig`` of a rig with these components: a matt speckled plane that moves.

        Parameters
        ----------
        camera_size, projector_size
            (width, height) [px].
        bits
            Of a grey level.
        """
        gain = (2**bits - 1) / self.full_well_electrons  # [grey level / electron]
        pixel = self.camera_pixel_um / self.magnification
        x, y, z = self.projector_position_mm
        half_width, half_height = (_MARGIN * 0.5e-3 * pixel * each for each in camera_size)
        return {
            "camera": {
                "columns": camera_size[0],
                "rows": camera_size[1],
                "distance_mm": self.camera_distance_mm,
                "pixel_size_um": pixel,
            },
            "projector": {
                "columns": projector_size[0],
                "rows": projector_size[1],
                "x_mm": x,
                "y_mm": y,
                "z_mm": z,
                "focal_length_px": self.throw_ratio * projector_size[0],
                "defocus_px": self.projector_blur_px,
            },
            "sensor": {
                "bits": bits,
                "white_level": self.white_level,
                "ambient_light": self.ambient_light,
                "read_noise_grey_level": self.read_noise_electrons * gain,
                "shot_noise_grey_level": gain,
            },
            "texture": {
                "kind": "speckle",
                "feature_um": self.speckle_um,
                "coverage": self.speckle_coverage,
                "floor": self.speckle_floor,
            },
            "specimen": {
                "kind": "rigid",
                "half_width_mm": half_width,
                "half_height_mm": half_height,
                "translation": (0.5, 0.3, 1.0),
            },
        }
