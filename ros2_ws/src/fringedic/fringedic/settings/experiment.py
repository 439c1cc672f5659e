"""Settings of the experiment node: patterns of a step, conditions and time-outs."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from fringedic import phase
from fringedic.errors import ErrorCode, PatternError
from fringedic.metadata import Metadata
from fringedic.patterns.pattern import PHASE_KINDS, ProjectedPattern
from fringedic.patterns.sequences import FringeOrder, moving_sequence, step_sequence
from fringedic.settings.base import MILLI, OR_EMPTY, Settings
from fringedic.settings.load_frame import HoldSettings
from fringedic.settings.signals import RequiredSignals
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters

MOVING_FRAMES = 8
"""Frames of the finest pitch of a stack in motion: two cycles of four shifts."""
MOVING_DRIFT = 0.6
"""Phase by which a surface may move from frame to frame without bad condition, in either direction [rad]."""
MOVING_ONE_WAY = 0.28
"""Fringes by which it may move from frame to frame in one direction, when this is known."""
FINEST_DEFAULT_PITCH_PX = 8.0  # finer fringes lose their modulation in most projector lenses


def _listed(value: Any) -> Any:
    return [value] if isinstance(value, int) else value


class SequenceSettings(Settings):
    """The fringe patterns of one step."""

    pitches_px: list[Annotated[float, Field(ge=2)]] = Field(
        [],
        max_length=8,
        description="Fringe pitches, coarse to fine [projector pixel]; the coarsest covers the visible width. Empty: "
        "the projector's width, a fifth, a twentieth and an eightieth of it, none below 8 px.",
    )
    shifts: Annotated[list[Annotated[int, Field(ge=3, le=64)]], BeforeValidator(_listed)] = Field(
        [4], min_length=1, max_length=8, description="Phase shifts of each pitch; one number for all pitches."
    )
    orientation: Literal["vertical", "horizontal"] = Field(
        "vertical", description="vertical: fringes along y, projector left or right; horizontal: projector above."
    )
    fringe_order: FringeOrder = Field(
        "pitches",
        description="Source of the fringe orders. pitches: each coarser pitch for the next finer one; gray_code: a "
        "Gray code of the finest pitch; one_image: none, a single image of the finest pitch, for fast events.",
    )
    grey_frame: bool = Field(
        False, description="With one_image: a frame in grey light before it, which removes the texture of the surface."
    )
    exposures_ms: list[Annotated[float, Field(gt=0, le=60e3)]] = Field(
        [],
        max_length=8,
        description="Exposure times of every pattern [ms], for surfaces with glare and dark parts; empty: the one of "
        "the camera.",
    )
    motion_fringes: list[float] = Field(
        [],
        max_length=2,
        description="Range of the motion across the finest fringes from frame to frame that a step in motion follows, "
        "such as [0, 0.25]: positive where the phase grows, towards +x (vertical fringes) or +y. Empty: a tenth of a "
        "fringe in either direction.",
    )

    @model_validator(mode="after")
    def _lists_are_possible(self) -> Self:
        if self.motion_fringes and not (
            len(self.motion_fringes) == 2
            and -1 <= self.motion_fringes[0] <= 0 <= self.motion_fringes[1] <= 1
            and self.motion_fringes[0] < self.motion_fringes[1]
        ):
            raise ValueError(
                f"motion_fringes is a range that contains 0, such as [0, {MOVING_ONE_WAY}], because a part of the "
                "specimen may stand still"
            )
        if any(fine >= coarse for coarse, fine in pairwise(self.pitches_px)):
            raise ValueError("pitches_px must become smaller from one to the next")
        if len(set(self.exposures_ms)) < len(self.exposures_ms):
            raise ValueError("exposures_ms must differ from each other")
        return self

    @property
    def exposure_times(self) -> list[float]:
        """Exposure times of every pattern [s]; empty: the camera's own."""
        return [time * MILLI for time in self.exposures_ms]

    @property
    def motion_range(self) -> tuple[float, float]:
        """Motion across the finest fringes from frame to frame that a step in motion follows [fringes]."""
        either = MOVING_DRIFT / (2 * math.pi)
        low, high = self.motion_fringes or (-either, either)
        return low, high

    @property
    def fastest_motion(self) -> float:
        """The largest motion of `motion_range` in either direction [fringes]."""
        return max(abs(each) for each in self.motion_range)

    def moving_plan(self) -> phase.ShiftPlan:
        """Return the shifts of the finest pitch of a MOVING step, chosen for the range of its motion."""
        low, high = (2 * math.pi * each for each in self.motion_range)
        return phase.plan_shifts((low + high) / 2, MOVING_FRAMES, uncertainty=(high - low) / 2)

    def pitches(self, width: int) -> list[float]:
        """Return the fringe pitches for a projector of `width` columns, coarse to fine [projector pixel]."""
        parts = [part for part in (1, 5, 20, 80) if part == 1 or width / part >= FINEST_DEFAULT_PITCH_PX]
        return list(self.pitches_px) or [width / part for part in parts]

    def patterns(self, width: int, height: int) -> tuple[ProjectedPattern, ...]:
        """Return the patterns of a FRINGES step in their order, each once for each exposure time.

        Parameters
        ----------
        width, height
            Size of the projector [px].

        Raises
        ------
        PatternError
            No sequence has these pitches, shifts and size.
        """
        pitches = self.pitches(width)
        shifts = self.shifts * len(pitches) if len(self.shifts) == 1 else self.shifts
        sequence = step_sequence(
            width, height, pitches, shifts, self.orientation, self.fringe_order, grey_frame=self.grey_frame
        )
        return tuple(pattern for pattern in sequence.patterns for _ in self.exposures_ms or [0.0])

    def moving_patterns(self, width: int, height: int) -> tuple[ProjectedPattern, ...]:
        """Return the patterns of a MOVING step in their order.

        Parameters
        ----------
        width, height
            Size of the projector [px].

        Raises
        ------
        PatternError
            The sequence is none that a moving surface can be measured with.
        """
        if self.fringe_order != "pitches" or self.exposures_ms:
            raise PatternError(
                "a moving surface is measured with fringe_order: pitches and one exposure time; remove fringe_order "
                "and exposures_ms from the sequence, or measure step by step",
                code=ErrorCode.INVALID_SEQUENCE,
            )
        pitches = self.pitches(width)
        shifts = (self.shifts * len(pitches) if len(self.shifts) == 1 else self.shifts)[: len(pitches) - 1]
        plan = self.moving_plan()
        if plan.follows:
            low, high = self.motion_range
            raise PatternError(
                f"no shifts follow a motion of {low:g} to {high:g} fringes from frame to frame; set "
                f"sequence.motion_fringes to [0, {MOVING_ONE_WAY}] or [-{MOVING_ONE_WAY}, 0] at most, and reduce the "
                "speed, or use a coarser finest pitch",
                code=ErrorCode.INVALID_SEQUENCE,
            )
        sequence = moving_sequence(
            width, height, pitches, shifts, self.orientation, order=plan.order, parts=plan.shifts
        )
        return sequence.patterns


class ProcessingSettings(Settings):
    """Parameters of the processing nodes."""

    phase: PhaseParameters = Field(PhaseParameters(), description="Parameters of the phase node.")
    dic: DicParameters = Field(DicParameters(), description="Parameters of the dic node.")
    coupling: CouplingParameters = Field(CouplingParameters(), description="Parameters of the coupling node.")


class ExperimentNodeSettings(SequenceSettings, HoldSettings, RequiredSignals):
    """Settings of the experiment node."""

    experiment: str = Field("", description="Name of the first experiment; empty: the time of its start.")
    first_step: int = Field(
        0,
        ge=0,
        le=2**31 - 1,
        description="Number of the first step, above 0 to resume an experiment of this name. Increased while the node "
        "runs: smallest number of the next step.",
    )
    reference_step: int = Field(
        -1, ge=-1, le=2**31 - 1, description="Earlier step that is still the reference; -1: the first that succeeds."
    )
    reference_lost: bool = Field(
        False,
        description="The reference of the earlier steps is lost: the first step that succeeds takes its place.",
    )
    calibration_file: str = Field(
        "", description="YAML file of the pin-hole model of the rig, published on `calibration`."
    )
    calibration_folder: str = Field("calibration", description="Folder that contains one folder for each calibration.")
    projector: bool = Field(
        True, description="A projector shows the patterns; without one, only WHITE steps are possible."
    )
    projector_width_px: int = Field(800, ge=1, le=16384, description="Columns of the projector [px].")
    projector_height_px: int = Field(600, ge=1, le=16384, description="Rows of the projector [px].")
    camera_first_column_px: int = Field(
        -1,
        ge=-1,
        le=32768,
        description="Column of the sensor with which the camera's image begins, for calibrations [px]; -1: not known.",
    )
    camera_first_row_px: int = Field(
        -1, ge=-1, le=32768, description="Row of the sensor with which it begins [px]; -1: not known."
    )
    white_between_steps: bool = Field(
        False,
        description="The projector is white after the frames of a step, also of one that fails, for a free run of the "
        "camera.",
    )
    dark_between_steps: bool = Field(
        False,
        description="The projector is dark after the frames of a step, also of one that fails, so that its light does "
        "not fall into the images of other sensors.",
    )
    nodes: list[Literal["phase", "dic", "coupling"]] = Field(
        ["phase", "dic", "coupling"], description="Processing nodes whose results end a step."
    )
    common_frame: str = Field(
        "", description="Frame in which the rig frame has a pose, such as that of another sensor; empty: none."
    )
    pose_in_common_frame: list[float] = Field(
        [],
        max_length=6,
        description="Pose of the rig frame in it: its origin [m], then its rotation vector [rad]; x, y and z each.",
    )
    record_only: bool = Field(False, description="A step ends without results: frames are recorded and measured later.")
    later_parameters: Annotated[ProcessingSettings, OR_EMPTY] = Field(
        ProcessingSettings(),
        description="With record_only: the parameters of phase, dic and coupling node for the later measurement; they "
        "are recorded as if these nodes ran.",
    )
    recording_required: bool = Field(False, description="Refuse a step unless a recorder is recording.")
    load_frame: bool = Field(
        False, description="The rig has a load frame; otherwise it has one from its first sample in an experiment on."
    )
    settle_time_s: float = Field(
        0.0, ge=0, le=3600, description="Pause between the start of a step and its first pattern [s]."
    )
    start_timeout_s: float = Field(
        20.0, gt=0, le=600, description="Longest wait for nodes, subscribers and recorder at the first step [s]."
    )
    projector_timeout_s: float = Field(
        5.0, gt=0, le=600, description="Longest wait for a pattern to be on the screen [s]."
    )
    camera_timeout_s: float = Field(10.0, gt=0, le=600, description="Longest wait for a frame [s].")
    placing_timeout_s: float = Field(
        600.0,
        gt=0,
        le=86400,
        description="Longest wait for the stage or the operator to place the reference plane [s].",
    )
    placing_attempts: int = Field(
        1,
        ge=1,
        le=1000,
        description="Times that a plane is placed and measured until it is accepted; a calibration with an operator "
        "sets a larger number.",
    )
    processing_timeout_s: float = Field(
        120.0, gt=0, le=86400, description="Longest wait from the last exposure to the results [s]."
    )
    input_timeout_s: float = Field(
        10.0,
        gt=0,
        le=86400,
        description="Time after the last exposure, or the result of the node before, within which a processing node "
        "has to have received what it needs for a step [s].",
    )
    metadata: Annotated[Metadata, OR_EMPTY] = Field(
        Metadata(), description="Metadata of specimen and hardware, for the recording only."
    )

    @model_validator(mode="after")
    def _showable(self) -> Self:
        self.step_patterns()
        return self

    @model_validator(mode="after")
    def _white_or_dark(self) -> Self:
        if self.white_between_steps and self.dark_between_steps:
            raise ValueError("white_between_steps and dark_between_steps exclude each other; set one of them to false")
        return self

    @model_validator(mode="after")
    def _pose_has_a_frame(self) -> Self:
        if len(self.pose_in_common_frame) != (6 if self.common_frame else 0):
            raise ValueError("pose_in_common_frame has six numbers with common_frame, and none without it")
        return self

    @model_validator(mode="after")
    def _reference_was_before(self) -> Self:
        if self.reference_step >= self.first_step:
            raise ValueError(f"reference_step {self.reference_step} is not before first_step {self.first_step}")
        return self

    def step_patterns(self) -> tuple[ProjectedPattern, ...]:
        """Return the patterns of a FRINGES step on the projector of the rig."""
        return self.patterns(self.projector_width_px, self.projector_height_px)

    def moving_step_patterns(self) -> tuple[ProjectedPattern, ...]:
        """Return the patterns of a MOVING step on the projector of the rig.

        Raises
        ------
        PatternError
            The sequence is none that a moving surface can be measured with.
        """
        return self.moving_patterns(self.projector_width_px, self.projector_height_px)

    def exposure_time(self, index: int, pattern: ProjectedPattern) -> float:
        """Return the exposure time of a frame [s]; 0: the one of the camera.

        Parameters
        ----------
        index
            Index of the frame within its step.
        pattern
            Its pattern; only those of a FRINGES step are taken at several exposure times.
        """
        times = self.exposure_times if pattern.kind in PHASE_KINDS else ()
        return times[index % len(times)] if times else 0.0
