"""Sections of a rig file: projector, sequence, reference plane, load frame, nodes, recording.

Positions in an image are (column, row).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from fringedic.configuration.yaml_section import Section
from fringedic.patterns.sequences import FringeOrder
from fringedic.recording.writer import Split
from fringedic.settings.base import MILLI
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters

# Angles [degree] of the plane for another image of its grid: below the first the perspective hides in the noise of the
# grid (benchmarks/distortion.py), at the second it is clear and the grid is still in focus
_LEAST_TURN, _GOOD_TURN = 2.0, 12.0
FINEST_DEFAULT_PITCH_PX = 8.0  # finer fringes lose their modulation in most projector lenses
VIRTUAL_RIG = "virtual_rig"

# Keys that only some sources of a section use, with those sources, and where another source has such settings
_PROJECTOR_USERS = {"display": ("display",)}
_PROJECTOR_ADVICE = {"virtual": "source: display shows the patterns on a display of this computer"}
_LOAD_FRAME_USERS = {
    "joint_states_topic": ("controller",),
    "joint": ("controller",),
    "wrench_topic": ("controller",),
    "force_axis": ("controller",),
    "force_sign": ("controller",),
    "slowest_mm_per_s": ("controller",),
    "motion_span_s": ("controller",),
    "position_tolerance_mm": ("simulated", "machine", "controller"),
}
_LOAD_FRAME_ADVICE = {
    "simulated": "the section virtual_rig describes this machine",
    "machine": "a negative scale in the machine file or specimen.force_sign reverses the force, and motion in the "
    "machine file defines a motion",
    "external": "the node that publishes load_frame/state has its own settings, and specimen.force_sign reverses the "
    "force",
}


def _refuse_unused(
    section: ProjectorSection | LoadFrameSection,
    users: Mapping[str, tuple[str, ...]],
    advice: Mapping[str, str],
) -> None:
    """Refuse keys that the source of a section does not use; a default value changes nothing and is accepted."""
    fields = type(section).model_fields
    unused = [
        key
        for key, sources in users.items()
        if section.source not in sources and getattr(section, key) != fields[key].default
    ]
    if unused:
        them = "it" if len(unused) == 1 else "them"
        raise ValueError(
            f"source: {section.source} does not use {', '.join(unused)}; remove {them}: {advice[section.source]}"
        )


class ProjectorSection(Section):
    """The projector of the rig."""

    source: Literal["virtual", "display"] = Field(
        "virtual",
        description="Destination of the patterns. virtual: the virtual rig; display: a projector on this computer.",
    )
    display: int = Field(0, ge=0, le=15, description="Number of the projector among this computer's displays, from 0.")
    width: int | None = Field(None, ge=16, le=32768, description="Image width [px]; known from a virtual rig.")
    height: int | None = Field(None, ge=16, le=32768, description="Image height [px]; known from a virtual rig.")
    response_curve: str | None = Field(
        None, description="YAML file of the response curve that the patterns correct for, relative to this file."
    )

    @model_validator(mode="after")
    def _display_has_a_size(self) -> ProjectorSection:
        if self.source == "display" and (self.width is None or self.height is None):
            raise ValueError("source: display needs width and height, the projector's own resolution")
        _refuse_unused(self, _PROJECTOR_USERS, _PROJECTOR_ADVICE)
        return self


class SequenceSection(Section):
    """The fringe patterns of one step."""

    pitches_px: list[Annotated[float, Field(ge=2)]] | None = Field(
        None,
        min_length=1,
        max_length=8,
        description="Fringe pitches, coarse to fine [projector pixel]; the coarsest covers the visible width. "
        "By default the projector's width, a fifth, a twentieth and an eightieth of it, none below 8 px.",
    )
    shifts: int = Field(4, ge=3, le=64, description="Phase shifts per pitch.")
    orientation: Literal["vertical", "horizontal"] = Field("vertical", description="Direction of the fringes.")
    fringe_order: FringeOrder = Field(
        "pitches",
        description="Source of the fringe orders. pitches: each coarser pitch for the next finer one; gray_code: a "
        "Gray code of the finest pitch; one_image: none, a single image of the finest pitch, for fast events.",
    )
    grey_frame: bool = Field(
        False, description="With one_image: a frame in grey light before it, which removes the texture of the surface."
    )
    exposures_ms: list[Annotated[float, Field(gt=0, le=60e3)]] | None = Field(
        None,
        min_length=2,
        max_length=8,
        description="Exposure times of every pattern [ms], for surfaces with glare and dark parts; by default the "
        "camera's exposure_ms alone.",
    )

    @model_validator(mode="after")
    def _coarse_to_fine(self) -> SequenceSection:
        pitches = self.pitches_px or []
        if any(fine >= coarse for coarse, fine in pairwise(pitches)):
            raise ValueError("pitches_px must become smaller from one to the next")
        return self

    @model_validator(mode="after")
    def _exposures_differ(self) -> SequenceSection:
        if len(set(self.exposures_ms or [])) < len(self.exposures_ms or []):
            raise ValueError("exposures_ms must differ from each other")
        return self

    @property
    def exposure_times(self) -> list[float]:
        """Exposure times of every pattern [s]; empty: the camera's own."""
        return [time * MILLI for time in self.exposures_ms or ()]


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


class LoadFrameSection(Section):
    """The testing machine."""

    source: Literal["simulated", "machine", "controller", "external"] = Field(
        "simulated",
        description="Source of force and position. simulated: the machine of the virtual rig; machine: one that a file "
        "describes; controller: joint states and wrench of ros2_control; external: a node that publishes "
        "load_frame/state.",
    )
    file: str | None = Field(None, description="Machine file of the source 'machine', relative to this file.")
    joint_states_topic: str = Field("/joint_states", description="Joint states of the source 'controller'.")
    joint: str = Field("crosshead", description="Joint of the source 'controller'.")
    wrench_topic: str = Field("/wrench", description="Wrench of the source 'controller'.")
    force_axis: Literal["x", "y", "z"] = Field("z", description="Axis of the force of the source 'controller'.")
    force_sign: Literal[-1, 1] = Field(1, description="-1 when the tension of the source 'controller' is negative.")
    slowest_mm_per_s: float = Field(
        0.01, gt=0, le=100, description="Speed above which the crosshead of the source 'controller' moves [mm/s]."
    )
    motion_span_s: float = Field(
        0.2, gt=0, le=10, description="Time over which the source 'controller' determines this speed [s]."
    )
    position_tolerance_mm: float = Field(
        0.01, gt=0, le=10, description="A move has arrived when the crosshead stands this close to its target [mm]."
    )
    rate_hz: float = Field(100.0, ge=2, le=1000, description="Rate of the samples of force and position [Hz].")
    hold_required: bool = Field(True, description="Whether a step fails when the machine does not hold.")
    load_drift_n: float = Field(
        0.0, ge=0, le=1e6, description="Largest change of the force during the exposures of a step [N]; 0: any."
    )
    position_drift_um: float = Field(
        0.0, ge=0, le=1e6, description="Largest change of the crosshead position during the exposures [µm]; 0: any."
    )

    @model_validator(mode="after")
    def _keys_belong_to_their_source(self) -> LoadFrameSection:
        if (self.source == "machine") != (self.file is not None):
            raise ValueError("source: machine needs the key file, and only this source uses it")
        _refuse_unused(self, _LOAD_FRAME_USERS, _LOAD_FRAME_ADVICE)
        return self


class ExtensometerSection(Section):
    """Two points of the surface whose distance is measured in a free run of the camera between the steps."""

    first_px: list[Annotated[int, Field(ge=0, le=32768)]] = Field(
        min_length=2, max_length=2, description="Column and row of the first point in the reference image [px]."
    )
    second_px: list[Annotated[int, Field(ge=0, le=32768)]] = Field(
        min_length=2, max_length=2, description="Column and row of the second point [px]."
    )
    subset_px: int = Field(48, ge=16, le=256, description="Width of the subset around each point [px].")
    rate_hz: float = Field(30.0, gt=0, le=1000, description="Rate of the frames of the free run [Hz].")
    largest_sigma_ustrain: float = Field(
        1000.0, gt=0, le=1e6, description="Standard deviation above which a strain is invalid [µstrain]."
    )


class NodesSection(Section):
    """Parameters of the processing nodes."""

    phase: PhaseParameters = Field(PhaseParameters(), description="Parameters of the phase node.")
    dic: DicParameters = Field(DicParameters(), description="Parameters of the dic node.")
    coupling: CouplingParameters = Field(CouplingParameters(), description="Parameters of the coupling node.")


class RecordingSection(Section):
    """What is recorded, and where."""

    folder: str = Field("recordings", description="Folder for recordings, relative to the working directory.")
    process: bool = Field(
        True, description="Whether steps are measured during the test; false: all are measured at the end."
    )
    derived: bool = Field(True, description="Whether phase maps, displacements and clouds are recorded, too.")
    compression: Literal["zstd", "none"] = Field(
        "none", description="Compression; zstd saves a fifth of the space for two to three times the processor time."
    )
    split_gb: float | None = Field(
        None, gt=0, le=1e5, description="Size after which a recording continues in its next file [GB]."
    )
    split_minutes: float | None = Field(
        None, gt=0, le=1e5, description="Duration after which a recording continues in its next file."
    )

    @property
    def split(self) -> Split:
        """When a recording continues in its next file."""
        return Split(size=1e9 * (self.split_gb or math.inf), duration=60 * (self.split_minutes or math.inf))
