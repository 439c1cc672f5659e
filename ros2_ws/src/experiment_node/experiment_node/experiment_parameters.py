"""Parameters of the experiment node: patterns of a step, conditions and time-outs."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator
from yaml import YAMLError

from fringedic.patterns.pattern import PHASE_KINDS, ProjectedPattern
from fringedic.patterns.sequences import FringeOrder, step_sequence
from fringedic.steps.recorded_parameters import MODELS
from fringedic.wording.yaml_text import load_yaml


class ExperimentParameters(BaseModel):
    """Parameters of the experiment node."""

    model_config = ConfigDict(frozen=True)

    experiment: str = Field("", description="Name of the first experiment; empty: the time of its start.")
    first_step: int = Field(
        0, ge=0, le=2**31 - 1, description="Number of the first step, above 0 to resume an experiment of this name."
    )
    reference_step: int = Field(
        -1, ge=-1, le=2**31 - 1, description="Earlier step that is still the reference; -1: the first that succeeds."
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
    pitches_px: list[float] = Field(
        [800.0, 160.0, 40.0, 10.0], description="Fringe pitches, coarse to fine [projector pixel]."
    )
    shifts: list[int] = Field([4, 4, 4, 8], description="Phase-shifted frames of each pitch, at least 3.")
    fringe_order: FringeOrder = Field(
        "pitches",
        description="Source of the fringe orders. pitches: the next coarser pitch; gray_code: a code of the finest "
        "pitch, which is then the only one; one_image: none, one image of the finest pitch is taken.",
    )
    grey_frame: bool = Field(False, description="With one_image: a frame in grey light before it, for the texture.")
    exposure_times_s: list[float] = Field(
        [],
        max_length=8,
        description="Exposure times of each pattern of a step [s]; empty: the one of the camera.",
    )
    orientation: Literal["vertical", "horizontal"] = Field(
        "vertical", description="vertical: fringes along y, projector left or right; horizontal: projector above."
    )
    white_between_steps: bool = Field(
        False,
        description="The projector is white after the frames of a step, also of one that fails, for a free run of the "
        "camera.",
    )
    nodes: list[Literal["phase", "dic", "coupling"]] = Field(
        ["phase", "dic", "coupling"], description="Processing nodes whose results end a step."
    )
    record_only: bool = Field(False, description="A step ends without results: frames are recorded and measured later.")
    later_parameters: str = Field(
        "",
        description="With record_only: the parameters of phase, dic and coupling node for the later measurement as "
        "YAML; they are recorded as if these nodes ran.",
    )
    recording_required: bool = Field(False, description="Refuse a step unless a recorder is recording.")
    load_frame: bool = Field(
        False, description="The rig has a load frame; otherwise it has one from its first sample in an experiment on."
    )
    hold_required: bool = Field(
        True, description="Refuse a step unless samples of the load frame show a hold before, during and after it."
    )
    load_drift_n: float = Field(
        0.0, ge=0, le=1e6, description="Largest change of the force during the exposures of a step [N]; 0: no limit."
    )
    position_drift_um: float = Field(
        0.0,
        ge=0,
        le=1e6,
        description="Largest change of the crosshead position during the exposures [µm]; 0: no limit.",
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
    facts: str = Field("", description="Metadata of specimen and hardware as YAML, for the recording only.")

    @model_validator(mode="after")
    def _showable(self) -> Self:
        self.patterns()
        return self

    @model_validator(mode="after")
    def _exposures_differ(self) -> Self:
        times = self.exposure_times_s
        if len(set(times)) < len(times) or not all(0 < time <= 60 for time in times):
            raise ValueError("exposure_times_s must be above 0, 60 s at most, and differ from each other")
        return self

    @model_validator(mode="after")
    def _reference_was_before(self) -> Self:
        if self.reference_step >= self.first_step:
            raise ValueError(f"reference_step {self.reference_step} is not before first_step {self.first_step}")
        return self

    @model_validator(mode="after")
    def _measurable_later(self) -> Self:
        self.later()
        return self

    def later(self) -> dict[str, BaseModel]:
        """Return the parameters of the processing nodes for the later measurement, by node; empty without.

        Raises
        ------
        ValueError
            The text is no YAML, there is no such node, or it does not have such parameters.
        """
        try:
            given = load_yaml(self.later_parameters) if self.record_only and self.later_parameters else {}
        except YAMLError as error:
            raise ValueError(f"later_parameters: {error}") from None
        if not isinstance(given, dict) or not given.keys() <= MODELS.keys():
            raise ValueError(f"later_parameters has to contain one mapping for each of {', '.join(MODELS)}")
        return {node: MODELS[node].model_validate(values) for node, values in given.items()}

    def patterns(self) -> tuple[ProjectedPattern, ...]:
        """Return the patterns of a FRINGES step, each pattern once for each exposure time.

        Raises
        ------
        PatternError
            No sequence has these pitches, shifts and size.
        """
        sequence = step_sequence(
            self.projector_width_px,
            self.projector_height_px,
            self.pitches_px,
            self.shifts,
            self.orientation,
            self.fringe_order,
            grey_frame=self.grey_frame,
        )
        return tuple(pattern for pattern in sequence.patterns for _ in self.exposure_times_s or [0.0])

    def exposure_time(self, index: int, pattern: ProjectedPattern) -> float:
        """Return the exposure time of a frame [s]; 0: the one of the camera.

        Parameters
        ----------
        index
            Index of the frame within its step.
        pattern
            Its pattern; only those of a FRINGES step are taken at several exposure times.
        """
        times = self.exposure_times_s if pattern.kind in PHASE_KINDS else ()
        return times[index % len(times)] if times else 0.0
