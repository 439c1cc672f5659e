"""Options of the procedures that an operator may start: names, units, limits and defaults are those of the commands."""

from __future__ import annotations

from pydantic import Field

from fringedic.configuration.yaml_section import Section


class RunOptions(Section):
    """Option of ``fringedic run``: the folder of a run that ended early, by its name; empty: a new run."""

    continue_run: str = ""


class LiveOptions(Section):
    """Options of ``fringedic live``."""

    region: str = ""


class TimingOptions(Section):
    """Options of ``fringedic timing``."""

    exposure_ms: float = Field(3.0, ge=0.05, le=1000)
    longest_ms: float = Field(300.0, ge=20, le=10_000)


class CalibrateOptions(Section):
    """Options of ``fringedic calibrate``; without angles those of the rig file."""

    angles_deg: str = ""


class CheckOptions(Section):
    """Options of ``fringedic check``."""

    distance_mm: float = Field(5.0, gt=0, le=1000)
    vdi: bool = False


class NoiseOptions(Section):
    """Options of ``fringedic noise``."""

    steps: int = Field(10, ge=3, le=1000)


class AdviseOptions(Section):
    """Options of ``fringedic advise``."""

    wanted_noise_px: float | None = Field(None, gt=0)
    wanted_period_px: float | None = Field(None, gt=0)
    pixel_size_mm: float | None = Field(None, gt=0)
    strain_window_points: int = Field(5, ge=3, le=1001)
