"""Settings of the recorder."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from fringedic.frames.sensor import SensorName
from fringedic.recording.writer import Split
from fringedic.settings.base import Settings


class RecorderSettings(Settings):
    """What is recorded, and into which files."""

    derived: bool = Field(True, description="Record phase, displacement and clouds as well, not only the raw topics.")
    compression: Literal["none", "zstd"] = Field(
        "none", description="Compression; zstd saves a fifth of the space for two to three times the processor time."
    )
    split_gb: float = Field(
        0.0, ge=0, le=1e5, description="Size after which a recording continues in its next file [GB]; 0: one file."
    )
    split_minutes: float = Field(
        0.0,
        ge=0,
        le=1e5,
        description="Duration after which a recording continues in its next file [min]; 0: one file.",
    )

    @property
    def split(self) -> Split:
        """When a recording continues in its next file."""
        return Split(size=1e9 * (self.split_gb or math.inf), duration=60 * (self.split_minutes or math.inf))


class RecorderNodeSettings(RecorderSettings):
    """Settings of the recorder node."""

    bag_path: str = Field("", description="Folder of the recording, which must not exist; empty: nothing is recorded.")
    sensors: list[SensorName] = Field(
        [], description="Sensors of the rig, whose topics in the namespaces of these names are recorded, too."
    )
    flush_interval_s: float = Field(
        0.5, gt=0, le=60, description="Messages received earlier than this survive a kill of the recorder [s]."
    )
    smallest_free_mb: float = Field(
        100.0, ge=0, le=1e6, description="The recording is closed when less than this is free on the disk [MB]."
    )
