"""Sections of a rig file: reference plane, extensometer, recording.

Positions in an image are (column, row).
"""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field, model_validator

from fringedic.configuration.yaml_section import Section
from fringedic.settings.base import MILLI
from fringedic.settings.experiment import ProcessingSettings
from fringedic.settings.extensometer import ExtensometerSettings
from fringedic.settings.recorder import RecorderSettings

# Angles [degree] of the plane for another image of its grid: below the first the perspective hides in the noise of the
# grid (benchmarks/distortion.py), at the second it is clear and the grid is still in focus
_LEAST_TURN, _GOOD_TURN = 2.0, 12.0
VIRTUAL_RIG = "virtual_rig"


class ReferencePlaneSection(Section):
    """The plane that calibrates the rig, and its angles and heights."""

    grid_pitch_mm: float | None = Field(
        None, gt=0, description="Pitch of the printed grid [mm]; known from a virtual rig."
    )
    grid_angles_degree: list[Annotated[float, Field(gt=-80, lt=80)]] | None = Field(
        None,
        description="Angles of the grid besides 0 [degree], on both sides: they separate a tilted camera from a "
        "decentred lens. By default those of angles_degree that are nearest to -12 and 12; [] for none.",
    )
    grid_frames: int = Field(8, ge=1, le=1000, description="Frames of the grid that are averaged.")
    angles_degree: list[Annotated[float, Field(gt=-80, lt=80)]] = Field(
        [0.0, -18.0, -12.0, -6.0, 6.0, 12.0, 18.0],
        min_length=1,
        description="Angles of the plain plane [degree]; above 0 the +x side is nearer to the camera. The first is "
        "measured again at the end.",
    )
    heights_mm: list[float] | None = Field(None, description="Heights of the same planes [mm]; by default 0.")
    held_out: list[Annotated[int, Field(ge=1)]] = Field(
        [5], description="Numbers of the planes, from 1, that test the calibration and are not part of the fit."
    )
    sigma_angle_degree: float = Field(0.0, ge=0, le=10, description="Standard deviation of a single angle [degree].")
    sigma_height_mm: float = Field(0.0, ge=0, le=10, description="Standard deviation of a single height [mm].")

    @model_validator(mode="after")
    def _lists_belong_together(self) -> ReferencePlaneSection:
        count = len(self.angles_degree)
        if self.heights_mm is not None and len(self.heights_mm) != count:
            raise ValueError(f"{count} angles_degree and {len(self.heights_mm)} heights_mm: give one of each per plane")
        if any(number > count for number in self.held_out):
            raise ValueError(f"held_out names planes {self.held_out}, but there are {count}")
        turned = max(self.angles_degree) - min(self.angles_degree)
        if count > 1 and self.heights_mm is None and turned < 2 * _LEAST_TURN:
            raise ValueError(
                f"angles_degree differ by {turned:g} degree, and planes at one height need at least "
                f"{2 * _LEAST_TURN:g}: use angles on both sides, such as 0,-15,-10,-5,5,10,15"
            )
        grid = self.grid_angles_degree
        if grid and not min(grid) <= -_LEAST_TURN < _LEAST_TURN <= max(grid):
            raise ValueError(f"grid_angles_degree {grid}: angles on both sides are needed, at least {_LEAST_TURN:g}")
        return self

    @property
    def grid_angles(self) -> list[float]:
        """Angles of the plane with the grid on it besides 0 [rad]."""
        chosen = self.grid_angles_degree
        if chosen is None:
            sides = [[angle for angle in self.angles_degree if side * angle >= _LEAST_TURN] for side in (-1, 1)]
            chosen = [min(side, key=lambda angle: abs(abs(angle) - _GOOD_TURN)) for side in sides] if all(sides) else []
        return [math.radians(angle) for angle in chosen]

    @property
    def angles(self) -> list[float]:
        """Angles of the planes [rad]."""
        return [math.radians(angle) for angle in self.angles_degree]

    @property
    def heights(self) -> list[float]:
        """Heights of the planes [m]."""
        return [height * MILLI for height in self.heights_mm or [0.0] * len(self.angles_degree)]

    @property
    def sigma_angle(self) -> float:
        """Standard deviation of a single angle [rad]."""
        return math.radians(self.sigma_angle_degree)

    @property
    def sigma_height(self) -> float:
        """Standard deviation of a single height [m]."""
        return self.sigma_height_mm * MILLI


class ExtensometerSection(ExtensometerSettings):
    """Two points of the surface whose distance is measured in a free run of the camera between the steps."""

    rate_hz: float = Field(30.0, gt=0, le=1000, description="Rate of the frames of the free run [Hz].")


class NodesSection(ProcessingSettings):
    """Settings of the processing nodes, and whether they share a process."""

    composed: bool = Field(
        False, description="Whether these nodes run in one process, in which they pass results on without messages."
    )


class RecordingSection(RecorderSettings):
    """What is recorded, and where."""

    folder: str = Field("recordings", description="Folder for recordings, relative to the working directory.")
    process: bool = Field(
        True, description="Whether steps are measured during the test; false: all are measured at the end."
    )
